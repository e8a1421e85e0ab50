"""Outcome: whether what a run says of itself is good, by scales of its own scene. Plain numbers; no Taichi."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.coarse_meshes import ropes
from taichi_sim.analysis.late_impacts import late_share
from taichi_sim.analysis.rounding_heat import CURE, WHY
from taichi_sim.common.quantities import measured
from taichi_sim.scene.scene import Scene

__all__ = [
    "DEEP",
    "MESH",
    "SHORTER",
    "STARTS_DEEP",
    "Scales",
    "cure_of_depth",
    "gained_in_steps",
    "has_mesh",
    "left_out",
    "not_included",
    "of_approach",
    "of_cells",
    "of_depth",
    "of_energy",
    "takers",
    "untouched",
]

SHALLOW, DEEP = 0.1, 0.5  # of the radius: overlap that piles may have; half of the way to the centre
SLOW_PART = 0.01  # of the largest speed: approach that is slow where nothing falls
MANY = 10.0  # times what is slow
DRIVEN = "may add or take energy here, so the energy change is no measure of the step error"
LATE = 1e-4  # share of the energy of impacts that a step misses, above which it is said
KEPT, LOST = 0.005, 0.05  # of the energy of what moved
FEW_CELLS = 0.05  # of all cells: corners that a landing turns inside out for a moment

MESH = "the mesh"

BY_CONTACT = ("restitution", "friction")  # of what takes energy
SHORTER = "take shorter steps"
STARTS_DEEP = "move apart what overlaps at the start"


class Scales(NamedTuple):
    """Scales that a run is judged by. slow [m/s]: 2 g h, below which nothing bounces. drivers: what works on it, in words;
    takers: what takes energy, see `takers`. motion [J]: the largest kinetic and elastic energy seen. swing: the part of
    it that the method's own moves by, where all is elastic; swing_power: of the elastic part, with which that grows; elastic:
    that part at the start or the end, whichever is larger. squeezes: colliders or pins move. damps: the name of a method that
    takes energy itself. gains: why the method may give energy, in words; cure: of that. held [J]: the largest kinetic
    and elastic energy that the one at the start explains, 0 where it is not known; risen [J]: the most by which the total was
    above the least before; gained: the most that a step gave, where that is wrong, in parts of the largest kinetic energy;
    climbed: the same of steps together. touches: there may be contacts, or there were. starts_deep: balls were seen that overlap
    deeply at the start. rounding [J]: by which sums of energy may be off; heat [J]: the most that rounding of places may have
    added, see rounding_heat. rows: sticks or surfaces collide, of whose contacts no residual is known."""

    slow: float
    drivers: tuple[str, ...]
    takers: tuple[str, ...]
    motion: float
    swing: float
    squeezes: bool
    swing_power: float = 1.0
    elastic: float = 1.0
    damps: str = ""
    touches: bool = True
    starts_deep: bool = False
    gains: str = ""
    cure: str = SHORTER
    held: float = 0.0
    risen: float = 0.0
    gained: float = 0.0
    climbed: float = 0.0
    rounding: float = 0.0
    heat: float = 0.0
    rows: bool = False


def untouched(names: Sequence[str]) -> tuple[str, ...]:
    """Those of `takers` in a run of whose frames none shows a contact."""
    kept = [name for name in names if name not in BY_CONTACT]
    return tuple(kept if len(kept) == len(names) else [*kept, "contacts that no frame shows"])


def takers(scene: Scene, touches: bool, tore: bool = False) -> tuple[str, ...]:
    """Names of what takes energy in a scene. touches: there may be contacts; tore: springs have torn. Of
    two materials the larger restitution and the geometric mean of frictions count, so those of the balls decide."""
    made_of = [scene.materials[k] for k in np.unique(scene.material)] if touches else []
    losses = [
        table[name] for table in scene.tables.values() for name in ("damping", "viscosity") if name in table.names
    ]
    found = {
        "restitution": any(m.restitution < 1.0 for m in made_of),
        "friction": any(m.friction > 0.0 or m.viscous_friction > 0.0 for m in made_of),
        "damping": any(of.any() for of in losses),
        "tearing": tore,
    }
    return tuple(name for name, takes in found.items() if takes)


def left_out(
    scene: Scene,
    settled: Any = None,
    h: float = 0.0,
    end: NDArray[np.float64] | None = None,
    at_touch: bool = False,
) -> Iterator[str]:
    """Errors that another run of the same scene does not show. settled: what is known of its start at rest, or None. h: its step
    [s]; end: velocities (n, dim) at the end [m/s]; at_touch: whether what bounces is solved at the moment of touch."""
    if has_mesh(scene):
        yield MESH
    velocities = [scene.velocity] + ([] if end is None else [end])
    if max(late_share(scene, velocity, h, at_touch) for velocity in velocities) > LATE:
        yield "the delay of impacts of balls, which both runs may find in the same place: compare with runs at other steps"
    if settled is not None and settled.residual:
        yield f"the net force of {measured(settled.residual, unit='N')} left at the start"


def has_mesh(scene: Scene) -> bool:
    """True if balls and springs of a scene stand for a body, so that more of them would be nearer to it."""
    return scene.n_volumes() > 0 or len(scene.triangles) > 0 or len(scene.bends) > 0 or len(ropes(scene)) > 0


def not_included(errors: Sequence[str]) -> str:
    """A line on the errors that a stated uncertainty does not include, under the line that states it."""
    return f"{'':12} not included: {'; '.join(errors)}"


def _grade(value: float, good: float, wrong: float) -> str:
    return "good" if value <= good else "look at it" if value <= wrong else "wrong"


def cure_of_depth(squeezes: bool, step: float | None = None) -> str:
    """Advice where balls lie deep in something: overlap falls with the step, and hardly with iterations. step [s]: in which the
    fastest ball moves little, where it moves far."""
    shorter = (
        "take shorter steps" if step is None else f"take steps of {step:.2g} s, in which the fastest ball moves little"
    )
    return f"where something that moves squeezes them, stop it sooner; else {shorter}" if squeezes else shorter


def of_depth(part: float, squeezes: bool, starts_deep: bool = False) -> str:
    """Verdict on the largest overlap as a part of the smaller radius."""
    grade = _grade(part, SHALLOW, DEEP)
    cure = STARTS_DEEP if starts_deep else cure_of_depth(squeezes)
    return grade if grade == "good" else f"{grade}; {cure}"


def of_approach(left: float, scales: Scales, fastest: float, iterations: int) -> str:
    """Verdict on the approach speed [m/s] that iterations leave in most frames (a hit that runs through what is held leaves more
    for a moment); fastest [m/s]: of a ball in the run."""
    slow = max(scales.slow, SLOW_PART * fastest)
    grade = _grade(left, slow, MANY * slow)
    return grade if grade == "good" else f"{grade}; take shorter steps, or more contact_iterations than {iterations}"


def of_cells(now: int, most: int, cells: int) -> str:
    """Verdict on cells that are inverted at the end, and at most in a frame; cells: how many there are."""
    if now:
        return "wrong; the body is crushed: make it stiffer, give it a larger poisson_ratio, or take shorter steps"
    return "look at it; the body was crushed for a moment and recovered" if most > FEW_CELLS * cells else "good"


def gained_in_steps(gained: float, climbed: float, why: str, cure: str) -> str:
    """Words on the energy that one step gave, or, where none gave much, steps together, in parts of the largest kinetic energy.
    why: empty where nothing explains it."""
    cause = f"as {why}" if why else "which nothing explains"
    much = f"{_times(gained)} the largest kinetic energy in one step" if gained else ""
    return f"gained {much or f'{_times(climbed)} the largest kinetic energy step by step'}, {cause}: {cure}"


def of_energy(start: float, end: float, scales: Scales) -> str:
    """Verdict on the total energy [J]: none where something works on the scene, or nothing moved."""
    if scales.motion <= scales.rounding:
        return ""
    if abs(end - start) <= scales.rounding:
        end = start
    part = (end - start) / scales.motion
    if scales.drivers:
        return f"{_listed(scales.drivers)} {DRIVEN}" if abs(part) > KEPT else ""
    much = f"{_times(abs(part))} the largest energy in motion, {scales.motion:.4g} J"
    kept = max(KEPT, scales.swing * min(1.0, max(0.0, scales.elastic)) ** scales.swing_power)
    held = scales.held or scales.motion
    if KEPT * held < end - start <= scales.heat:  # no swing, which would hide it
        return f"gained {end - start:.4g} J, {_times((end - start) / held)} {_of_held(scales)}: wrong; {WHY}: {CURE}"
    if rose := _rose(start, end, scales, kept):
        return f"{rose}; {scales.gains or 'nothing in the scene explains it'}: {scales.cure}"
    grade = _grade(abs(part), kept, max(LOST, kept))
    if not scales.takers and not scales.damps:
        who = "only contacts can have changed it" if scales.touches else "nothing in the scene takes energy"
        cure = "" if grade == "good" else f"; {who}: take shorter steps, see `check`"
        return f"off by {much}: {grade}{cure}"
    if part >= -kept:
        return ""
    lost = f"{start - end:.4g} J of it"
    if not scales.takers:
        return f"{lost} went into the own damping of {scales.damps}; shorter steps lose less"
    if not scales.damps:
        return f"{lost} went into {_listed(scales.takers)}, as expected"
    return f"{lost} went into {_listed(scales.takers)}, or into the own damping of {scales.damps}: shorter steps tell"


def _rose(start: float, end: float, scales: Scales, kept: float) -> str:
    """Words on the energy [J] at the end, above the start, or by which it rose, by the largest in motion that the start explains;
    empty where it is no more than methods keep to."""
    held = scales.held or scales.motion
    gained, risen = (end - start) / held, scales.risen / held
    of = _of_held(scales)
    if risen > max(LOST, scales.swing, gained):
        return f"rose by up to {scales.risen:.4g} J above the least before, {_times(risen)} {of}: wrong"
    if gained > kept:
        return f"gained {end - start:.4g} J, {_times(gained)} {of}: {_grade(gained, kept, max(LOST, kept))}"
    return ""


def _of_held(scales: Scales) -> str:
    """The energy in words that gains are parts of."""
    explained = " that the start explains" if scales.held else ""
    return f"the largest energy in motion{explained}, {scales.held or scales.motion:.4g} J"


def _times(part: float) -> str:
    return f"{part:.2g}{' times' if part >= 1.0 else ' of'}"


def _listed(names: Sequence[str]) -> str:
    """Names in words: `wind, gases and motors`."""
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))
