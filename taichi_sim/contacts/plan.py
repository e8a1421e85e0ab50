"""ContactPlan: what the contacts of one simulation are made of, and why."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_sim.analysis.touching import may_collide
from taichi_sim.contacts.grid import SKIN
from taichi_sim.scene.scene import Scene, max_restitution, used_materials

__all__ = ["ContactPlan", "plan_contacts", "slowest_bounce"]

MOST_BOUNCE = 0.5  # restitution above which iterations over many contacts could add energy
CARRIED_PART, CARRIED_POWER = 0.25, 0.3  # see carried_part
UNEQUAL_MASSES = 4.0  # times: from here on iterations converge slowly


@dataclass(frozen=True)
class ContactPlan:
    """Parts of the contact code that are built and compiled; a part that the scene lacks is no code at all."""

    pairs: bool  # of balls
    neighbours: bool  # balls or sticks look for balls
    walls: bool  # or colliders
    colliders: bool
    sticks: bool  # that balls touch
    triangles: bool  # that collide
    bends: bool  # paths that bounce off walls are followed to where they meet balls, see kernels.contacts.bent_paths
    skin: float  # of a radius, see Grid
    warm_starts: bool  # solves start from the accumulated impulses of the step before, the load of piles
    soft: bool  # pairs are damped springs, see kernels.contacts.contact_law, else rigid and pushed apart
    impacts_in_turn: bool  # pairs that close fast bounce one by one first, see kernels.contacts.pair_impacts
    bounces: bool  # any of them may
    walls_in_turn: bool  # so do walls of crowded balls
    keeps_loads: bool  # of an impact solves carry a part only into the next step, see kernels.contacts.warm_start
    foresees: bool  # pairs that may meet within the step count
    loaded: bool  # what forces add in a step is no impact
    late_part: float  # of that, which balls had not yet at their places: no bounce throws it back
    friction_part: float  # of a step, for which friction acts in one solve
    marks_bounces: bool  # balls that bounce are known, to methods that ask for forces at the end of a step
    line_search: bool  # see kernels.contacts.impact_iterations
    limits_energy: bool  # see kernels.contacts.energy_limiter
    reflects: (
        bool  # what forces did before an impact on a wall is thrown back with the ball, see kernels.contacts.impact
    )
    at_search: bool  # impacts in turn follow the search at once, see kernels.contacts.struck_pairs
    throws_back: bool  # what forces did before is thrown back there as well
    iterations: int  # of the solve before the move
    gathers: bool  # both balls of a pair list it, and each sums what it gets: no order of pairs, and no atomics
    atomic: bool  # impulses are added by atomics
    serial: bool  # one thread runs all
    reasons: tuple[str, ...]  # a line for each decision

    @property
    def active(self) -> bool:
        """True if there may be any contact at all."""
        return self.pairs or self.walls

    def __str__(self) -> str:
        return "\n".join(self.reasons)


def plan_contacts(
    scene: Scene,
    rule: Any,
    *,
    method: Any,
    custom_method: bool,
    extra_forces: bool,
    iterations: int,
    parallel: bool,
    atomic: bool,
    serial: bool,
) -> ContactPlan:
    """The plan of a scene whose contacts a ContactRule solves. method: an Integrator; custom_method:
    it is no built-in one; extra_forces: there are others than gravity and springs; parallel: as many threads as balls are to have
    work."""
    reasons: list[str] = []
    chosen: dict[str, Any] = {}

    def decide(name: str, choice: Any, needs: str) -> bool:
        reasons.append(f"{name}: {'yes' if choice else 'no'} (needs {needs})")
        chosen[name] = bool(choice)
        return bool(choice)

    on = decide(
        "contacts", rule.name != "off" and np.any(~scene.pinned), "another rule than off, and a ball that is not pinned"
    )
    sticks = decide(
        "sticks",
        on and scene.collides.any() and scene.n_balls > 2,
        "a spring that collides, and a ball that it may meet",
    )
    triangles = decide(
        "triangles",
        on and scene.solid.any() and scene.n_balls > 3,
        "a triangle that collides, and a ball that it may meet",
    )
    joints = sticks or triangles  # contacts of more than two balls
    pairs = decide(
        "pairs",
        on and (joints or may_collide(scene)),
        "two balls that may touch, or sticks or triangles, which look for theirs too",
    )
    walls = decide("walls", on and (scene.walls or scene.colliders), "walls or colliders")
    decide(
        "neighbours",
        pairs and (sticks or may_collide(scene)),
        "two balls that may touch, or sticks: triangles look for theirs in a tree",
    )
    decide(
        "bends",
        walls and chosen["neighbours"],
        "walls, and two balls that may touch, or sticks",
    )
    gathers = decide(
        "gathers",
        pairs and parallel and rule.gathers,
        "pairs, a device or accumulate: gather, and a rule that takes all contacts at once",
    )
    decide("colliders", on and scene.colliders, "colliders")
    decide(
        "skin",
        not (joints or custom_method),
        "no sticks, triangles or custom method: they take a grid made anew in each step",
    )
    gravity = bool(np.any(scene.gravity != 0))
    pulls = bool(np.any(scene.stiffness > 0) or np.any(scene.damping > 0)) or extra_forces
    warm_starts = decide(
        "warm_starts",
        rule.warm_starts and (gravity or pulls or scene.moving_pins),
        "gravity, springs, forces or driven pins: what may press balls together for long",
    )
    soft = decide(
        "soft",
        rule.softens and gravity and pairs and method.relaxes,
        "gravity, pairs, and a method that takes back what pushing out adds; a rigid contact is exact for two balls",
    )
    impacts_in_turn = decide(
        "impacts_in_turn",
        rule.impacts_in_turn and pairs and not joints,
        "a rule that does so, pairs, and neither sticks nor triangles: it is exact for pairs alone",
    )
    decide(
        "keeps_loads",
        soft and warm_starts and not impacts_in_turn,
        "soft contacts, warm starts, and no impacts in turn: iterations over all contacts throw back what an impact took",
    )
    restitution = any(material.restitution > 0 for material in used_materials(scene))
    throws = pairs and restitution and rule.warm_starts and not impacts_in_turn  # by iterations over all contacts
    bounces = decide("bounces", impacts_in_turn and restitution, "impacts in turn, and a material with restitution")
    decide(
        "reflects",
        walls and restitution and pulls and method.reflects,
        "walls, restitution, forces that change within a step, and a method that asks for them at its end",
    )
    at_search = decide("at_search", bounces and pulls, "bounces, and forces that change within a step")
    decide(
        "throws_back",
        at_search and method.reflects,
        "at_search, and a method that asks for forces at the end of a step",
    )
    decide(
        "foresees",
        impacts_in_turn and soft and not bounces,
        "impacts in turn, soft contacts, and no restitution: what bounces has to touch first",
    )
    decide(
        "loaded",
        (bounces or throws) and (pulls or gravity),
        "pairs that bounce, and gravity, springs or forces, which may press single balls together",
    )
    decide(
        "marks_bounces",
        (bounces or throws) and pulls and method.reflects,
        "pairs that bounce, forces that change within a step, and a method that asks for them at its end",
    )
    mass = scene.mass[~scene.pinned]
    decide(
        "line_search",
        impacts_in_turn and len(mass) > 0 and mass.max() > UNEQUAL_MASSES * mass.min(),
        f"impacts in turn, and masses that differ more than {UNEQUAL_MASSES:g} times",
    )
    decide(
        "walls_in_turn",
        walls and (soft or impacts_in_turn),
        "walls, and soft contacts or impacts in turn: balls that touch others are pushed into walls within a step",
    )
    # they may do work
    driven = scene.moving_pins or scene.motors or any(collider.motion.moves for collider in scene.colliders)
    # split masses gain nothing from nothing, nor impacts in turn
    gains = joints if rule.in_turn else warm_starts
    decide(
        "limits_energy",
        rule.energy_limiter and pairs and not driven and gains and max_restitution(scene) > MOST_BOUNCE,
        "a rule that does so, pairs that bounce well and could gain energy, and nothing driven, which may give them some",
    )
    del chosen["contacts"]
    chosen["skin"] = SKIN if chosen["skin"] else 0.0
    return ContactPlan(
        **chosen,
        late_part=method.late_part,
        friction_part=method.friction_part,
        iterations=iterations,
        atomic=atomic and not gathers,
        serial=serial,
        reasons=tuple(reasons),
    )


def carried_part(scene: Scene) -> float:
    """Part of what an impact gave a contact that the next solve starts from. The more masses differ, the more steps iterations
    take to stop an impact, and the heavier ball would sink meanwhile: measured, 1/4 for like masses, all of it from 1:100 on."""
    mass = scene.mass[~scene.pinned]
    return min(1.0, CARRIED_PART * float(mass.max() / mass.min()) ** CARRIED_POWER) if len(mass) else 0.0


def slowest_bounce(scene: Scene, h: float) -> float:
    """The approach speed below which nothing bounces [m/s]: twice what gravity adds in a substep of h seconds; without gravity
    everything does."""
    return 2.0 * float(np.linalg.norm(scene.gravity)) * h
