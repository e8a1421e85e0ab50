"""Relations between runs: mirror and turn, units, a moving frame, other methods, steps, drivers, precision; and closed forms."""

from collections.abc import Callable
from typing import Any

import numpy as np

import taichi_sim as ts
from taichi_sim.scene.materials import used_materials

from .observe import Case, Record, auto_dt
from .relations import Relation
from .scenes import Change, NoSuchSceneError, changed, components, embedded, renumbered

__all__ = ["AGREEMENTS", "PROCESSES", "VIEWS", "apart", "slack", "slowest"]

TOLERANCES = {"implicit_euler": 0.03, "tr_bdf2": 1e-3, "xpbd": 1e-3}  # of their solutions; by the order of springs
Runs = Callable[[Case], "list[Case] | None"]
VIEWS = (  # what every scene obeys that is far from chaos
    "mirror",
    "quarter_turn",
    "in_a_moving_frame",
    "elsewhere",
    "in_other_units",
    "in_other_masses",
    "renumbered",
    "steps_in_other_groups",
    "fused_is_parallel",
)
PROCESSES = ("one_thread_is_two", "single_is_near_double")  # each starts one


def _moved(r: Record) -> float:
    """Metres: the farthest that anything went."""
    return max(float(np.linalg.norm(r.x - r.x[0], axis=2).max(initial=0.0)), 1e-300)


def slack(case: Case) -> float:
    """By how much more two runs may differ where a method solves equations to a tolerance of its own."""
    return 1e6 * TOLERANCES.get(str(case.settings.get("integrator")), 1e-6)


def apart(a: Record, b: Record, x: Any = None) -> float:
    """The largest distance of b's (or x's) positions from a's, in units of how far things went in a."""
    other = b.x if x is None else x
    if len(other) != len(a.x):
        return np.inf
    return float(np.linalg.norm(other - a.x, axis=2).max(initial=0.0)) / _moved(a)


# The same scene, seen otherwise ---------------------------------------------------------------------------------------


def _seen(name: str, tolerance: float, choose: Callable[[Case], Change | None], back: Any = None) -> Relation:
    """The scene changed, and its positions compared with the changed positions."""

    def runs(case: Case) -> list[Case] | None:
        change = choose(case)
        if change is None:
            return None
        try:
            scene = changed(case.scene, change)
        except NoSuchSceneError:
            return None
        other = case.of(scene)
        if change.time != 1.0:
            other = other.but(dt=case.settings["dt"] * change.time)
            other.duration = case.duration * change.time
        return [case, other]

    def judge(case: Case, records: list[Record]) -> float | None:
        change = choose(case)
        a, b = records
        expected = change.place(a.x)
        if change.velocity is not None:
            expected = expected + a.time[:, None, None] * np.asarray(change.velocity)
        return float(np.linalg.norm(b.x - expected, axis=2).max()) / (_moved(a) * change.length * slack(case))

    return Relation(name, tolerance, judge, runs)


def _mirror(case: Case) -> Change:
    turn = np.eye(case.scene.dim)
    turn[0, 0] = -1.0
    return Change(turn=turn)


def _turn(case: Case) -> Change:
    """A quarter turn, about gravity in 3D; in 2D gravity turns too."""
    if case.scene.dim == 2:
        return Change(turn=np.array([[0.0, -1.0], [1.0, 0.0]]))
    return Change(turn=np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]))


def _frame(case: Case) -> Change | None:
    spins = any(m.viscous_friction for m in used_materials(case.scene))
    return None if case.scene.walls or spins else Change(velocity=np.array([0.75, -0.5, 0.25])[: case.scene.dim])


def _elsewhere(case: Case) -> Change:
    return Change(shift=np.array([256.0, -128.0, 64.0])[: case.scene.dim])


def _numeric(case: Case) -> bool:
    return isinstance(case.settings.get("dt"), float)


def _small(case: Case) -> Change | None:
    """2^-10 of the lengths, 2^-5 of the time: the same gravity."""
    return Change(length=2.0**-10, time=2.0**-5) if _numeric(case) else None


def _heavy(case: Case) -> Change:
    return Change(mass=2.0**6)


def _order(case: Case) -> np.ndarray:
    return np.random.default_rng(case.scene.n_balls).permutation(case.scene.n_balls)


def _renumbered(case: Case, records: list[Record]) -> float:
    return apart(records[0], records[1], records[1].x[:, np.argsort(_order(case))]) / slack(case)


def _embedding(case: Case) -> list[Case] | None:
    try:
        return [case, case.of(embedded(case.scene))]
    except NoSuchSceneError:
        return None


def _flat(case: Case, records: list[Record]) -> float:
    out = float(np.abs(records[1].x[..., 2]).max(initial=0.0)) / _moved(records[0])
    return max(out, apart(records[0], records[1], records[1].x[..., :2]))


# Another way to the same result ---------------------------------------------------------------------------------------


def _how(how: str, **settings: Any) -> Runs:
    def runs(case: Case) -> list[Case]:
        other = case.but(**settings)
        other.how = how
        return [case, other]

    return runs


def _same(case: Case, records: list[Record]) -> float:
    return apart(*records)


def _near(case: Case, records: list[Record]) -> float:
    """The same, but that pairs may meet a step sooner or later."""
    r = records[0]
    step = float(np.linalg.norm(r.v, axis=2).max(initial=0.0)) * r.dt / r.substeps
    hits = step if case.scene.n_balls > 1 and case.settings.get("contacts") != "off" else 0.0
    return max(0.0, apart(*records) - hits / _moved(r))


def _threads(case: Case) -> list[Case]:
    pair = [case.but(driver="parallel"), case.but(driver="parallel")]
    pair[0].how, pair[1].how = "threads1", "threads2"
    return pair


PARTNER = {
    "implicit_euler": "verlet",
    "xpbd": "verlet",
    "tr_bdf2": "rk4",
    "rk4": "verlet",
    "symplectic_euler": "verlet",
}


def _methods(case: Case) -> list[Case] | None:
    """Another method, at the same step or its own where that is shorter."""
    partner = PARTNER.get(case.settings.get("integrator", "verlet"))
    if partner is None:
        return None
    other = case.but(integrator=partner)
    if _numeric(case):
        longest = auto_dt(other)
        other = other.but(dt=case.settings["dt"] / max(1, int(np.ceil(case.settings["dt"] / longest))))
    return [case, other]


def _finer(case: Case) -> list[Case]:
    return [case, case.but(dt=auto_dt(case) / 16, substeps=1)]


def _centres(case: Case, records: list[Record]) -> float:
    """Distance of the centres of mass of what hangs together: what it does inside is another matter. In parts of their motion,
    or, where balls move far more than their centre does, of a tenth of theirs."""
    m = case.scene.mass
    worst = 0.0
    for balls in components(case.scene):
        a, b = (np.einsum("n,sni->si", m[balls], r.x[:, balls]) / m[balls].sum() for r in records)
        inside = float(np.linalg.norm(records[0].x[:, balls] - records[0].x[0, balls], axis=2).max())
        far = max(float(np.linalg.norm(a - a[0], axis=1).max()), 0.1 * inside, 1e-300)
        worst = max(worst, float(np.linalg.norm(a - b, axis=1).max()) / far)
    return worst


def _promise(case: Case) -> list[Case] | None:
    if "tolerance" not in case.settings:
        return None
    exact = Case(case.scene, {**case.settings}, case.duration, case.samples)
    del exact.settings["tolerance"]
    finest = min(auto_dt(case) / 16, 0.02 * case.settings["tolerance"] * case.duration)
    return [case, exact.but(dt=float(finest), substeps=1)]


def _within(case: Case, records: list[Record]) -> float:
    """Largest error at the end, in units of what was allowed till then."""
    a, b = records
    allowed = case.settings["tolerance"] * a.size * float(a.time[-1])
    return float(np.linalg.norm(a.x[-1] - b.x[-1], axis=1).max()) / allowed


# Closed forms ---------------------------------------------------------------------------------------------------------


def slowest(scene: ts.Scene, balls: np.ndarray) -> tuple[complex, np.ndarray, np.ndarray] | None:
    """Of a net of springs at rest, linear about now: the decaying eigenvalue next to 0 [1/s], and its left and right vectors
    (2 n dim,) of displacements [m] and velocities [m/s]. None where nothing decays."""
    dim, n = scene.dim, len(balls)
    at = {int(b): k for k, b in enumerate(balls)}
    K, C = np.zeros((n, dim, n, dim)), np.zeros((n, dim, n, dim))
    for (i, j), k, c, rest in zip(scene.pairs, scene.stiffness, scene.damping, scene.rest_length):
        if int(i) not in at or int(j) not in at:
            continue
        side = scene.position[j] - scene.position[i]
        length = float(np.linalg.norm(side))
        along = np.outer(side, side) / length**2
        stiff = k * along + k * (1 - rest / length) * (np.eye(dim) - along)
        for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            K[at[int(a)], :, at[int(b)]] += sign * stiff
            C[at[int(a)], :, at[int(b)]] += sign * c * along
    free = np.repeat(~scene.pinned[balls], dim)
    index = np.flatnonzero(free)
    w = np.repeat(1.0 / scene.mass[balls], dim)[index]
    K, C = (a.reshape(n * dim, n * dim)[np.ix_(index, index)] for a in (K, C))
    f = len(index)
    A = np.block([[np.zeros((f, f)), np.eye(f)], [-w[:, None] * K, -w[:, None] * C]])
    values, right = np.linalg.eig(A)  # defective where nothing holds across: so the left vectors are not its inverse
    decays = -values.real > 1e-9 * np.abs(values).max()
    if not decays.any():
        return None
    k = int(np.flatnonzero(decays)[np.argmin(-values.real[decays])])
    mirrored, left_vectors = np.linalg.eig(A.T)
    left = left_vectors[:, np.argmin(np.abs(mirrored - values[k]))]
    full = np.concatenate([index, n * dim + index])
    out = np.zeros((2, 2 * n * dim), dtype=complex)
    out[0, full], out[1, full] = left, right[:, k]
    return values[k], out[0], out[1]


def _decay(case: Case, records: list[Record]) -> float | None:
    """The slowest mode's decay per second against that of the linear system, over the time in which it is well seen."""
    scene, r = case.scene, records[0]
    if not scene.damping.any() or scene.gravity.any() or scene.walls or scene.colliders:
        return None
    worst = None
    for balls in components(scene):
        mode = slowest(scene, balls)
        if mode is None:
            continue
        value, left, _ = mode
        start = (r.x - scene.position)[:, balls].reshape(len(r.x), -1)
        state = np.concatenate([start, r.v[:, balls].reshape(len(r.x), -1)], axis=1)
        size = np.abs(state @ left)
        seen = np.flatnonzero((value.real * r.time > -2.0) & (size > 0))
        if size[0] == 0.0 or seen[-1] == 0 or value.real * r.time[seen[-1]] > -0.05:
            continue
        rate = np.log(size[seen[-1]] / size[0]) / r.time[seen[-1]]
        off = abs(float(rate / value.real) - 1.0)
        worst = off if worst is None else max(worst, off)
    return worst


ORDER = {"verlet": 2.0, "tr_bdf2": 2.0, "rk4": 4.0, "symplectic_euler": 1.0, "implicit_euler": 1.0}


def _halved(case: Case) -> list[Case] | None:
    if not _numeric(case) or case.scene.walls or case.scene.colliders:
        return None
    return [case.but(dt=case.settings["dt"] / k) for k in (1, 2, 4)]


def _lost_order(case: Case, records: list[Record]) -> float | None:
    a, b, c = (r.x[-1] for r in records)
    coarse, fine = float(np.linalg.norm(a - b)), float(np.linalg.norm(b - c))
    if fine < 1e-12 * _moved(records[0]):
        return None
    return min(2.0, ORDER[case.settings["integrator"]]) - float(np.log2(coarse / fine))


def _relations() -> list[Relation]:
    return [
        _seen("mirror", 1e-6, _mirror),
        _seen("quarter_turn", 1e-6, _turn),
        _seen("in_a_moving_frame", 1e-6, _frame),
        _seen("elsewhere", 1e-6, _elsewhere),
        _seen("in_other_units", 1e-6, _small),
        _seen("in_other_masses", 1e-6, _heavy),
        Relation("renumbered", 1e-6, _renumbered, lambda c: [c, c.of(renumbered(c.scene, _order(c)))]),
        Relation("flat_in_3d", 1e-6, _flat, _embedding),
        Relation("steps_in_other_groups", 0.0, _same, _how("grouped")),
        Relation("restored_goes_on", 0.0, _same, _how("restored")),
        Relation("fused_is_parallel", 1e-9, _same, _how("plain", driver="parallel")),
        Relation("one_thread_is_two", 0.0, _same, _threads),
        Relation("single_is_near_double", 1e-3, _near, _how("single")),
        Relation("methods_agree", 0.05, _centres, _methods),
        Relation("default_step_is_near_a_small_one", 0.05, _same, _finer),
        Relation("tolerance_is_kept", 1.0, _within, _promise),
        Relation("decays_as_the_linear_network", 0.05, _decay),
        Relation("order_is_kept", 0.3, _lost_order, _halved),
    ]


AGREEMENTS = {relation.name: relation for relation in _relations()}
