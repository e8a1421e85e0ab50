"""Relations that one run must obey: ledgers of energy, momentum and friction, overlap, rest, rebound."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import taichi_sim as ts
from taichi_sim.scene.materials import used_materials

from .observe import Case, Record
from .scenes import components

__all__ = ["LEDGERS", "Finding", "Relation", "angular", "judged", "law", "passive"]


FIRST_ORDER = ("implicit_euler", "xpbd")


@dataclass(frozen=True)
class Relation:
    """judge(case, records): a figure that must not be above `tolerance`, or None where it says nothing about the case.

    runs: the cases whose records it needs, the case itself first; None where it needs another scene that cannot be made.
    """

    name: str
    tolerance: float
    judge: Callable[[Case, list[Record]], float | None]
    runs: Callable[[Case], list[Case] | None] = lambda case: [case]


@dataclass(frozen=True)
class Finding:
    """One relation on one case. figure None: it does not apply."""

    relation: str
    figure: float | None
    tolerance: float

    @property
    def fails(self) -> bool:
        return self.figure is not None and not self.figure <= self.tolerance


def judged(relation: Relation, case: Case, records: list[Record]) -> Finding:
    """What the relation says. A run that ended as unstable fails it; one that was refused with a reason says nothing."""
    if any(record.failed.startswith("refused") for record in records):
        return Finding(relation.name, None, relation.tolerance)
    if any(record.failed for record in records):
        return Finding(relation.name, np.inf, relation.tolerance)
    figure = relation.judge(case, records)
    if figure is not None and not np.isfinite(figure):
        figure = np.inf
    return Finding(relation.name, figure, relation.tolerance)


# What kind of scene it is ---------------------------------------------------------------------------------------------


def law(scene: ts.Scene, i: int, j: int) -> tuple[float, float]:
    """Restitution and friction between the materials i and j."""
    a, b = scene.materials[i], scene.materials[j]
    return max(a.restitution, b.restitution), float(np.sqrt(a.friction * b.friction))


def passive(scene: ts.Scene) -> bool:
    """Nothing does work on it but gravity."""
    moves = any(c.motion.moves for c in scene.colliders)
    driven = moves or scene.moving_pins or scene.motors or scene.wind is not None
    return not (driven or np.isfinite(scene.break_strain).any())


def _rigid(scene: ts.Scene) -> bool:
    return not (scene.n_springs or scene.has_elements())


def _free(scene: ts.Scene) -> bool:
    """Nothing outside holds or pushes it."""
    return not (scene.walls or scene.colliders or scene.pinned.any() or scene.wind is not None)


def _elastic(scene: ts.Scene) -> bool:
    laws = used_materials(scene)
    smooth = all(m.restitution == 1.0 and m.friction == m.viscous_friction == 0.0 for m in laws)
    losses = ("damping", "bend_damping", "membrane_damping", "brick_viscosity", "solid_viscosity")
    return smooth and passive(scene) and not any(getattr(scene, name).any() for name in losses)


# Energy and momentum --------------------------------------------------------------------------------------------------


def _scale(case: Case, record: Record) -> float:
    """Joule: the largest kinetic energy, or what gravity has given."""
    m = np.where(case.scene.pinned, 0.0, case.scene.mass)
    kinetic = 0.5 * np.einsum("n,sni->s", m, record.v**2)
    fall = np.abs(np.einsum("n,sni,i->s", m, record.x - record.x[0], case.scene.gravity))
    return float(max(kinetic.max(), fall.max(), 1e-300))


def _slow(scene: ts.Scene, h: float) -> bool:
    """Springs alone, so slow that the energy of a step swings by less than a thousandth: (omega h)^2 / 8 of theirs."""
    w = np.where(scene.pinned, 0.0, 1.0 / scene.mass)
    slow = np.all(scene.stiffness * w[scene.pairs].sum(axis=1) * h * h < 8e-3)
    return bool(slow) and not scene.has_elements()


def _kept(case: Case, records: list[Record]) -> float | None:
    h = records[0].dt / records[0].substeps
    if not _elastic(case.scene) or not (_rigid(case.scene) or _slow(case.scene, h)):
        return None
    energy = records[0].energy(case.scene)
    return float(np.abs(energy - energy[0]).max()) / _scale(case, records[0])


def _grown(case: Case, records: list[Record]) -> float | None:
    swings = not _rigid(case.scene) and case.settings.get("integrator") not in FIRST_ORDER
    if not passive(case.scene) or swings:
        return None
    energy = records[0].energy(case.scene)
    return float((energy - np.minimum.accumulate(energy)).max()) / _scale(case, records[0])


def _momentum(case: Case, records: list[Record]) -> float | None:
    scene, r = case.scene, records[0]
    if not _free(scene):
        return None
    p = np.einsum("n,sni->si", scene.mass, r.v) - scene.mass.sum() * r.time[:, None] * scene.gravity
    size = float(np.einsum("n,sn->s", scene.mass, np.linalg.norm(r.v, axis=2)).max())
    return float(np.linalg.norm(p - p[0], axis=1).max()) / max(size, 1e-300)


def angular(scene: ts.Scene, r: Record) -> tuple[np.ndarray, float]:
    """Angular momentum about the centre of mass (s, 1 or 3) [kg m^2/s], and the most that it could be."""
    m, dim = scene.mass, scene.dim
    centre = np.einsum("n,sni->si", m, r.x) / m.sum()
    drift = np.einsum("n,sni->si", m, r.v) / m.sum()
    x, v = r.x - centre[:, None], r.v - drift[:, None]
    part = 0.5 if dim == 2 else 0.4
    spin = np.einsum("n,snk->sk", part * m * scene.radius**2, r.spin)
    crossed = x[..., 0] * v[..., 1] - x[..., 1] * v[..., 0] if dim == 2 else np.cross(x, v)
    orbit = np.einsum("n,sn...->s...", m, crossed).reshape(len(r.x), -1)
    size = np.einsum("n,sn,sn->s", m, np.linalg.norm(x, axis=2), np.linalg.norm(v, axis=2)).max()
    return orbit + spin, float(max(size, 1e-300))


def _turning(case: Case, records: list[Record]) -> float | None:
    if not _free(case.scene) or any(m.friction for m in used_materials(case.scene)):
        return None
    now, size = angular(case.scene, records[0])
    return float(np.linalg.norm(now - now[0], axis=1).max()) / size


def _turning_by_order_2(case: Case, records: list[Record]) -> float | None:
    """Implicit Euler and xpbd take h W^2 of it a second from what turns at W."""
    return None if case.settings.get("integrator") in FIRST_ORDER else _turning(case, records)


def _weighed_momentum(case: Case, records: list[Record]) -> float | None:
    """What balls have lost to colliders is what colliders have received."""
    scene, r = case.scene, records[0]
    if not case.weighed or scene.walls or scene.pinned.any() or scene.wind is not None:
        return None
    fall = scene.mass.sum() * r.time[:, None] * scene.gravity
    p = np.einsum("n,sni->si", scene.mass, r.v) - fall + r.impulse.sum(axis=1)
    size = float(np.einsum("n,sn->s", scene.mass, np.linalg.norm(r.v, axis=2)).max())
    size = max(size, float(np.linalg.norm(fall, axis=1).max()))
    return float(np.linalg.norm(p - p[0], axis=1).max()) / max(size, 1e-300)


def _work(case: Case, records: list[Record]) -> float | None:
    """Energy less the work of colliders that move on: grows nowhere; is kept where all is elastic and smooth."""
    scene, r = case.scene, records[0]
    if not case.weighed or scene.pinned.any() or scene.wind is not None or not _rigid(scene):
        return None
    if any(len(c.motion.times) > 1 or c.motion.turns.any() for c in scene.colliders):
        return None
    speed = np.array([c.motion.velocity for c in scene.colliders])
    energy = r.energy(scene) + np.einsum("sci,ci->s", r.impulse, speed)
    laws = used_materials(scene)
    smooth = all(m.restitution == 1.0 and m.friction == m.viscous_friction == 0.0 for m in laws)
    off = np.abs(energy - energy[0]) if smooth else energy - np.minimum.accumulate(energy)
    return float(off.max()) / _scale(case, r)


# Friction -------------------------------------------------------------------------------------------------------------


def _ground(scene: ts.Scene) -> tuple[np.ndarray, int] | None:
    """Normal and material of the one thing to stand on; colliders are taken to be level."""
    if len(scene.walls) + len(scene.colliders) != 1 or not passive(scene) or scene.pinned.any():
        return None
    if scene.walls:
        return np.array(scene.walls[0].normal), scene.walls[0].material
    return np.eye(scene.dim)[1], scene.colliders[0].material


def _friction(case: Case, records: list[Record]) -> float | None:
    """Impulse of the ground along it against mu times that across: equal while all slides, at most that else."""
    scene, r = case.scene, records[0]
    ground = _ground(scene)
    if ground is None:
        return None
    n, material = ground
    worst = None
    for balls in components(scene):
        mu = law(scene, int(scene.material[balls[0]]), material)[1]
        if mu == 0.0 or len(balls) == 1:
            continue
        m = scene.mass[balls]
        p = np.einsum("n,sni->si", m, r.v[:, balls])
        given = p[-1] - p[0] - m.sum() * scene.gravity * (r.time[-1] - r.time[0])
        across = float(given @ n)
        along = given - across * n
        if across <= 1e-3 * np.linalg.norm(m.sum() * scene.gravity) * r.time[-1]:
            continue
        ratio = float(np.linalg.norm(along)) / (mu * across)
        v = r.v[:, balls] - np.einsum("sni,i->sn", r.v[:, balls], n)[..., None] * n
        start = np.einsum("n,ni->i", m, v[0]) / m.sum()
        speed = float(np.linalg.norm(start))
        slides = speed > 0 and float(np.einsum("sni,i->sn", v, start / max(speed, 1e-300)).min()) > 0.1 * speed
        off = abs(ratio - 1.0) if slides else max(0.0, ratio - 1.0)
        worst = off if worst is None else max(worst, off)
    return worst


def _stays(case: Case, records: list[Record]) -> float | None:
    """How far a body slid on ground that is less steep than friction holds, in units of a free slide."""
    scene, r = case.scene, records[0]
    ground = _ground(scene)
    if ground is None or scene.velocity.any() or not scene.gravity.any():
        return None
    n, material = ground
    press = -float(scene.gravity @ n)
    down = scene.gravity + press * n
    worst = None
    for balls in components(scene):
        mu = law(scene, int(scene.material[balls[0]]), material)[1]
        pull = float(np.linalg.norm(down))
        if len(balls) == 1 or pull < 0.05 * press or pull > 0.85 * mu * press:
            continue
        m = scene.mass[balls] / scene.mass[balls].sum()
        speed = float(abs(np.einsum("n,ni->i", m, r.v[-1, balls]) @ down)) / pull
        off = speed / (pull * r.time[-1])
        worst = off if worst is None else max(worst, off)
    return worst


# Overlap, rest and rebound --------------------------------------------------------------------------------------------


def _pairs(scene: ts.Scene) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of balls that may touch."""
    i, j = np.triu_indices(scene.n_balls, 1)
    on = ~(scene.pinned[i] & scene.pinned[j]) & ((scene.body[i] == 0) | (scene.body[i] != scene.body[j]))
    if scene.n_springs:
        joined = np.sort(scene.pairs, axis=1) @ [scene.n_balls, 1]
        on &= ~np.isin(i * scene.n_balls + j, joined)
    return i[on], j[on]


def _overlap(case: Case, records: list[Record]) -> float | None:
    """The largest at any moment, in units of the smaller radius: balls, walls, colliders, sticks."""
    scene, r = case.scene, records[0]
    i, j = _pairs(scene)
    worst = 0.0
    loose = ~scene.pinned
    for t, x in zip(r.time, r.x):
        if len(i):
            gap = np.linalg.norm(x[i] - x[j], axis=1) - scene.radius[i] - scene.radius[j]
            worst = max(worst, float((-gap / np.minimum(scene.radius[i], scene.radius[j])).max()))
        for wall in scene.walls:
            deep = scene.radius - (x @ np.array(wall.normal) - wall.offset)
            worst = max(worst, float((deep / scene.radius)[loose].max(initial=0.0)))
        for collider in scene.colliders:
            deep = scene.radius - collider.distance(x, t)
            worst = max(worst, float((deep / scene.radius)[loose].max(initial=0.0)))
        for a, b in scene.pairs[scene.collides]:
            side = x[b] - x[a]
            for k in np.flatnonzero(loose):
                if k in (a, b):
                    continue
                along = np.clip((x[k] - x[a]) @ side / (side @ side), 0.0, 1.0)
                deep = scene.radius[k] - np.linalg.norm(x[k] - x[a] - along * side)
                worst = max(worst, float(deep / scene.radius[k]))
    return worst


def _entered(case: Case, records: list[Record]) -> float | None:
    """The deepest in a collider that stands still, in units of what the fastest ball moves in one step."""
    scene, r = case.scene, records[0]
    if not scene.colliders or not passive(scene):
        return None
    h = r.dt / r.substeps
    travel = float(np.linalg.norm(r.v, axis=2).max(initial=0.0)) * h + np.linalg.norm(scene.gravity) * h**2
    deep = [(scene.radius - c.distance(x, 0.0))[~scene.pinned].max() for x in r.x for c in scene.colliders]
    return max(0.0, float(max(deep))) / max(travel, 1e-300)


def _up(scene: ts.Scene) -> np.ndarray | None:
    """Normal of the only wall, where balls stand in columns above it and all come down."""
    if len(scene.walls) != 1 or scene.colliders or not _rigid(scene) or scene.pinned.any():
        return None
    n = np.array(scene.walls[0].normal)
    along = scene.position - (scene.position @ n)[:, None] * n
    apart = np.linalg.norm(along[:, None] - along[None], axis=2)
    beside = (apart > 1e-9) & (apart < np.add.outer(scene.radius, scene.radius))
    drift = scene.velocity - (scene.velocity @ n)[:, None] * n
    return None if beside.any() or drift.any() or (scene.velocity @ n > 0).any() else n


def _comes_back(case: Case, records: list[Record]) -> float | None:
    """The largest speed upward of what came down at restitution 0, in units of the largest speed of arrival."""
    scene, r = case.scene, records[0]
    n = _up(scene)
    if n is None or any(m.restitution for m in used_materials(scene)):
        return None
    speed = r.v @ n
    return float(speed.max()) / max(float(-speed.min()), 1e-300)


def _with_e(case: Case, records: list[Record]) -> float | None:
    """Speed of balls side by side just after they met a wall, against e times that just before."""
    scene, r = case.scene, records[0]
    v = scene.velocity
    if not _rigid(scene) or not scene.n_balls or not np.ptp(v, axis=0).max() < 1e-12 or not v.any():
        return None
    n = -v[0] / float(np.linalg.norm(v[0]))
    meets = [w for w in scene.walls if np.allclose(w.normal, n)]
    if len(meets) != 1 or scene.colliders or abs(float(scene.gravity @ n)) > 1e-12:
        return None
    if np.ptp(scene.position @ n) > 1e-12:
        return None
    e = law(scene, int(scene.material[0]), meets[0].material)[0]
    near = np.abs(r.x @ n - meets[0].offset - scene.radius) < 0.1 * scene.radius  # (s, n)
    if e < 0.1 or not near.any(axis=0).all():
        return None
    worst = 0.0
    for k, met in enumerate(near.argmax(axis=0)):
        speed = r.v[:, k] @ n
        after = met + int(np.argmax(speed[met:] > -1e-3 * abs(speed[met])))
        if after < 2 or after + 1 >= len(speed):
            continue
        worst = max(worst, abs(float(speed[after + 1] / (-speed[after - 2])) / e - 1.0))
    return worst


def _rests(case: Case, records: list[Record]) -> float | None:
    """What lies at restitution 0 on a stick does not move down or up at the end, nor says so: m/s over sqrt(g r)."""
    scene, r = case.scene, records[0]
    if not scene.gravity.any() or any(m.restitution for m in used_materials(scene)) or scene.velocity.any():
        return None
    if not scene.collides.any() or not scene.pinned.any():
        return None
    unit = np.sqrt(np.linalg.norm(scene.gravity) * scene.radius.max())
    down = scene.gravity / np.linalg.norm(scene.gravity)
    return float(np.abs(r.v[-1] @ down).max() / unit)


def _settles(case: Case, records: list[Record]) -> float | None:
    """The largest speed at the end, in units of that of a fall by a radius."""
    scene = case.scene
    if not passive(scene) or not scene.gravity.any():
        return None
    unit = np.sqrt(2.0 * np.linalg.norm(scene.gravity) * scene.radius.max())
    return float(np.linalg.norm(records[0].v[-1], axis=1).max() / unit)


def _relation(name: str, tolerance: float, judge: Any) -> tuple[str, Relation]:
    return name, Relation(name, tolerance, judge)


LEDGERS = dict(
    [
        _relation("energy_is_kept", 5e-3, _kept),
        _relation("energy_never_grows", 1e-3, _grown),
        _relation("momentum_is_kept", 1e-9, _momentum),
        _relation("angular_momentum_is_kept", 5e-3, _turning),
        _relation("turning_is_kept_to_order_2", 5e-3, _turning_by_order_2),
        _relation("momentum_with_the_colliders", 1e-9, _weighed_momentum),
        _relation("energy_with_the_work", 1e-3, _work),
        _relation("friction_is_mu_while_sliding", 0.01, _friction),
        _relation("stays_below_the_friction_angle", 0.02, _stays),
        _relation("nothing_overlaps_far", 0.3, _overlap),
        _relation("no_collider_is_entered", 0.2, _entered),
        _relation("nothing_comes_back", 0.02, _comes_back),
        _relation("comes_back_with_e", 0.01, _with_e),
        _relation("what_lies_rests", 0.02, _rests),
        _relation("comes_to_rest", 0.02, _settles),
    ]
)
