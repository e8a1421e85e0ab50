"""Hard cases: what breaks simulators, each with a bound and a measured verdict for each rule of the contact solver.

A case is a function of the rule and of `short` (a smaller form for quick tests): it builds a scene, runs it, and returns whether
it passed, the figure that the bound speaks of, and words. `taichi-sim report --hard-cases` prints them all.
"""

import time
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.scene import Scene
from taichi_sim.simulation import Simulation

__all__ = ["CASES", "RULES", "Case", "Verdict", "judge", "main"]

RULES = ("gauss_seidel", "jacobi")
H, G, R = 1e-3, 10.0, 0.05
BULLET = 10.0  # radii a step
TRIALS = 10_000


class Verdict(NamedTuple):
    """What became of a case. figure: the number that its bound is about."""

    passed: bool
    figure: float
    words: str


class Case(NamedTuple):
    """A hard case; `bound` says what it must do to pass."""

    name: str
    bound: str
    run: Callable[[str, bool], Verdict]


def _simulation(scene: Scene, contacts: str, **settings: Any) -> Simulation:
    """On the CPU, with what the process runs or double precision; warnings are the business of the case that is about them."""
    from taichi_sim import backend

    if backend.running() is None:
        backend.start("cpu", "f64")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return Simulation(scene, **{"dt": H, "contacts": contacts, "arch": "cpu", **settings})


def _double(sim: Simulation) -> bool:
    return sim.backend.precision == "f64"


def _rounding(sim: Simulation) -> float:
    """1e-9 in double precision, what rounding leaves in single."""
    return 1e-9 if _double(sim) else 1e-5


# Balls in one place ---------------------------------------------------------------------------------------------------


def _coincident(n: int, contacts: str, seconds: float) -> Verdict:
    scene = Scene(dim=3)
    mass = 10 ** np.random.default_rng(0).uniform(-1, 1, n)
    scene.add_balls(np.full((n, 3), 0.3), radius=R, mass=mass)
    with _simulation(scene, contacts, contact_passes=2) as sim:
        fastest, centre = 0.0, mass @ sim.position / mass.sum()
        for _ in range(10):
            sim.run(seconds / 10)
            fastest = max(fastest, float(np.max(np.abs(sim.velocity))))
        shift = float(np.max(np.abs(mass @ sim.position / mass.sum() - centre)))
        d = np.linalg.norm(sim.position[:, None] - sim.position[None], axis=2) + 2 * R * np.eye(n)
        passed = fastest < 20 * R and shift < _rounding(sim) and float(d.min()) > 0.02 * R
        return Verdict(passed, fastest, f"nearest {d.min() / R:.2g} r, centre moved {shift:.0e} m")


def two_coincident(contacts: str, short: bool) -> Verdict:
    """Two balls in one place."""
    return _coincident(2, contacts, 0.1)


def thousand_coincident(contacts: str, short: bool) -> Verdict:
    """A thousand (short: 50) balls in one place."""
    return _coincident(50 if short else 1000, contacts, 0.1)


# Bullets --------------------------------------------------------------------------------------------------------------


def _directions(rng: np.random.Generator, n: int, dim: int) -> NDArray[np.float64]:
    d = rng.normal(size=(n, dim))
    return d / np.linalg.norm(d, axis=1)[:, None]


def bullet_at_wall(contacts: str, short: bool) -> Verdict:
    """Balls of one body, which do not see each other, at a wall."""
    rng, n = np.random.default_rng(1), TRIALS
    radius = rng.uniform(0.2, 1.0, n) * R
    d = _directions(rng, n, 3)
    d[:, 1] = -np.abs(d[:, 1])
    scene = Scene(dim=3)
    scene.add_wall((0, 1, 0), 0.0, scene.add_material("lively", restitution=0.5, friction=0.3))
    x = rng.uniform(-1, 1, (n, 3))
    x[:, 1] = radius * (1.0 + rng.uniform(0.0, BULLET, n) * -d[:, 1])
    scene.add_balls(x, radius=radius, velocity=BULLET * radius[:, None] / H * d, body=scene.new_body())
    with _simulation(scene, contacts) as sim:
        deepest = 0.0
        for _ in range(3):
            sim.step()
            deepest = max(deepest, float(np.max(1.0 - sim.position[:, 1] / radius)))
    return Verdict(deepest < 1.0, deepest, f"radii deep, the worst of {n}")


def bullet_at_ball(contacts: str, short: bool) -> Verdict:
    """Pairs of balls, a bullet aimed at less than half of the sum of radii beside the centre of the other."""
    rng, n = np.random.default_rng(2), 100 if short else TRIALS
    place = np.stack([*np.divmod(np.arange(n), 100), np.zeros(n)], axis=1) * 40 * R
    d = _directions(rng, n, 3)
    side = np.cross(d, _directions(rng, n, 3))
    aim = side / np.linalg.norm(side, axis=1)[:, None] * rng.uniform(0.0, R, n)[:, None]
    start = place + aim - d * rng.uniform(2.2, 2.0 + BULLET, n)[:, None] * R
    scene = Scene(dim=3)
    held = np.arange(n)[np.arange(n) % 2 == 0]
    scene.add_balls(place, radius=R, mass=10 ** rng.uniform(-2, 2, n), pinned=held)
    scene.add_balls(start, radius=R, velocity=BULLET * R / H * d)
    with _simulation(scene, contacts) as sim:
        sim.step(3)
        kept = np.linalg.norm(sim.velocity[n:] - scene.velocity[n:], axis=1) < 1e-3 * BULLET * R / H
    return Verdict(not kept.any(), float(kept.sum()), f"of {n} went through")


def bullet_at_stick(contacts: str, short: bool) -> Verdict:
    """Pairs of a pinned stick of 10 radii and a bullet that meets it somewhere between its ends, in the plane."""
    rng, n = np.random.default_rng(3), 100 if short else TRIALS
    place = np.stack(np.divmod(np.arange(n), 100), axis=1) * 40 * R
    along, slant = _directions(rng, n, 2), rng.uniform(-1.0, 1.0, n)[:, None]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    d = normal + slant * along
    d /= np.linalg.norm(d, axis=1)[:, None]
    meet = place + along * rng.uniform(-4.0, 4.0, n)[:, None] * R
    start = meet - d * rng.uniform(2.0, 2.0 + BULLET, n)[:, None] * R
    scene = Scene(dim=2)
    ends = scene.add_balls(np.concatenate([place - 5 * R * along, place + 5 * R * along]), radius=0.1 * R, pinned=True)
    bullets = scene.add_balls(start, radius=R, velocity=BULLET * R / H * d)
    scene.add_springs(ends.reshape(2, n).T, stiffness=0.0, collides=True)
    with _simulation(scene, contacts) as sim:
        crossed = np.zeros(n, dtype=bool)
        for _ in range(3):
            sim.step()
            crossed |= np.sum((sim.position[bullets] - place) * normal, axis=1) > 0.0
    return Verdict(not crossed.any(), float(crossed.sum()), f"of {n} went through")


# Corners and stacks ---------------------------------------------------------------------------------------------------


def corner(contacts: str, short: bool) -> Verdict:
    """A ball pressed into a corner of three walls, 2 passes."""
    scene = Scene(dim=3)
    for normal in np.eye(3):
        scene.add_wall(normal)
    scene.add_balls([[0.99 * R] * 3], radius=R, velocity=[-1.0, -2.0, -0.5])
    with _simulation(scene, contacts, contact_passes=2) as sim:
        sim.step()
        speed = float(np.max(np.abs(sim.velocity)))
        return Verdict(speed < _rounding(sim), speed, "m/s after one step")


def wedge(contacts: str, short: bool) -> Verdict:
    """A ball thrown into a wedge of 20 degrees, gravity along its axis, 2 passes."""
    scene = Scene(dim=2, gravity=(0.0, -G))
    angle = np.radians(10.0)
    for side in (1.0, -1.0):
        scene.add_wall((side * np.cos(angle), np.sin(angle)))
    scene.add_balls([[0.02, 0.5]], radius=R, velocity=[1.0, -3.0])
    with _simulation(scene, contacts, contact_passes=2) as sim:
        start, most = sim.energy().total, -np.inf
        for _ in range(100):
            sim.step(10)
            most = max(most, sim.energy().total)
        speed = float(np.max(np.abs(sim.velocity)))
        passed = speed < _rounding(sim) and most <= start + _rounding(sim)
        return Verdict(
            passed, speed, f"m/s after 1 s, height {sim.position[0, 1] / R:.3f} r of {1 / np.sin(angle):.3f} r"
        )


def _column(mass: NDArray[np.float64]) -> Scene:
    scene = Scene(dim=2, gravity=(0.0, -G))
    scene.add_wall((0.0, 1.0))
    scene.add_balls([[0.0, (2 * k + 1) * R] for k in range(len(mass))], radius=R, mass=mass)
    return scene


def _stands(scene: Scene, contacts: str, seconds: float, bound: float) -> Verdict:
    with _simulation(scene, contacts) as sim:
        deepest = 0.0
        for _ in range(10):
            sim.run(seconds / 10)
            deepest = max(deepest, sim.penetration() / R)
        speed = float(np.max(np.abs(sim.velocity)))
        fallen = float(np.max(np.abs(sim.position - scene.position)))
    passed = deepest < bound and speed < 2 * G * H and fallen < R
    return Verdict(passed, deepest, f"r deep at most, {speed:.1e} m/s, top sank {fallen / R:.2f} r")


def stack(contacts: str, short: bool) -> Verdict:
    """A column of 20 balls for 10 s (short: 1 s)."""
    return _stands(_column(np.ones(20)), contacts, 1.0 if short else 10.0, 0.02)


def heavy_on_ten(contacts: str, short: bool) -> Verdict:
    """A ball of 100 kg on a column of ten of 1 kg."""
    return _stands(_column(np.array([1.0] * 10 + [100.0])), contacts, 1.0 if short else 10.0, 0.05)


# Energy ---------------------------------------------------------------------------------------------------------------


def elastic_pack(contacts: str, short: bool) -> Verdict:
    """A hexagonal pack of touching discs, e = 1, falls on the floor at 3 m/s."""
    scene = Scene(dim=2, gravity=(0.0, -G))
    ideal = scene.add_material("ideal", restitution=1.0)
    scene.add_wall((0.0, 1.0), 0.0, ideal)
    i, j = np.divmod(np.arange(100), 10)
    x = 2 * R * np.stack([j + 0.5 * (i % 2), np.sqrt(0.75) * i], axis=1) + [0.0, 1.1 * R]
    scene.add_balls(x, radius=R, velocity=(0.0, -3.0), material=ideal)
    with _simulation(scene, contacts) as sim:
        start, most = sim.energy().total, -np.inf
        for _ in range(100):
            sim.step(3)
            most = max(most, sim.energy().total)
        gain = most / start - 1.0
        return Verdict(
            gain < _rounding(sim), gain, f"gained at most; {sim.energy().total / start:.3f} left after 0.3 s"
        )


def piston(contacts: str, short: bool) -> Verdict:
    """A ball of 1e4 kg that fits a box thrown on twenty of 1 kg in it, then taken away: E is what it brought."""
    scene = Scene(dim=2, gravity=(0.0, -G))
    lively = scene.add_material("lively", restitution=0.3, friction=0.3)
    for normal, offset in (((0, 1), 0.0), ((1, 0), 0.0), ((-1, 0), -8 * R)):
        scene.add_wall(normal, offset, lively)
    i, j = np.divmod(np.arange(20), 4)
    x = 2 * R * np.stack([j + 0.5, i + 0.5], axis=1)
    scene.add_balls(x, radius=0.99 * R, material=lively)
    heavy = int(scene.add_balls([[4 * R, 15 * R]], radius=3.9 * R, mass=1e4, velocity=[0.0, -5.0], material=lively)[0])
    energy = 0.5 * 1e4 * 25.0 + 1e4 * G * 15 * R
    with _simulation(scene, contacts) as sim:
        fastest, outside = 0.0, -R
        for k in range(100):
            sim.step(5)
            if k == 40:  # released: the piston is lifted out of the box at once
                x = sim.position
                x[heavy] = [4 * R, 10.0]
                sim.set_position(x)
            small = np.arange(20)
            fastest = max(fastest, float(np.max(np.linalg.norm(sim.velocity[small], axis=1))))
            x = sim.position[small]
            outside = max(outside, float(np.max([-x[:, 1], -x[:, 0], x[:, 0] - 8 * R])))
    share = fastest / np.sqrt(2 * energy / 1.0)
    return Verdict(
        share <= 1.0, share, f"of sqrt(2 E / m): {fastest:.1f} m/s; pressed {outside / R + 1:.2f} r into walls"
    )


# Nothing to do --------------------------------------------------------------------------------------------------------


def all_pinned(contacts: str, short: bool) -> Verdict:
    """Overlapping pinned balls on a floor, with springs and sticks."""
    scene = Scene(dim=2, gravity=(0.0, -G))
    scene.add_wall((0.0, 1.0))
    b = scene.add_balls([[0.0, 0.0], [R, 0.0], [R, 0.0]], radius=R, pinned=True)
    scene.add_springs([b[:2], b[1:]], stiffness=100.0, damping=1.0, rest_length=1.0, collides=[False, True])
    with _simulation(scene, contacts) as sim:
        sim.step(100)
        moved = float(np.max(np.abs(sim.position - scene.position)) + np.max(np.abs(sim.velocity)))
    return Verdict(moved == 0.0, moved, "moved")


def empty(contacts: str, short: bool) -> Verdict:
    """No ball at all, but walls and gravity."""
    scene = Scene(dim=3, gravity=(0.0, -G, 0.0))
    scene.add_wall((0.0, 1.0, 0.0))
    with _simulation(scene, contacts) as sim:
        sim.step(100)
        figures = [*sim.energy(), *np.ravel(sim.momentum()), sim.penetration(), sim.position.size]
    return Verdict(not np.any(figures), float(np.sum(np.abs(figures))), f"balls, energy, momentum; t = {sim.time:g} s")


# Sizes and places -----------------------------------------------------------------------------------------------------


def _offset_scene(shift: float) -> Scene:
    scene = Scene(dim=2, gravity=(0.0, -G))
    lively = scene.add_material("lively", restitution=0.5, friction=0.2)
    scene.add_wall((0.0, 1.0), shift, lively)
    x = np.array([[0.0, 1.25], [3.0, 1.0], [3.0, 3.0], [6.0, 4.0], [8.5, 4.0]])  # falls; one on another; two meet
    v = [[1.0, 0.0], [0.0, 0.0], [0.0, 0.0], [0.97, 0.0], [-0.91, 0.0]]
    scene.add_balls(shift + x, radius=1.0, velocity=v, material=lively)
    return scene


def world_offset(contacts: str, short: bool) -> Verdict:
    """Balls of 1 m fall, slide, meet and rest on each other for 0.5 s, at the origin and 1e6 m away."""
    ends, shift = [], 1e6
    for at in (0.0, shift):
        with _simulation(_offset_scene(at), contacts) as sim:
            sim.run(0.5)
            ends.append(sim.position - at)
            double = _double(sim)
    if double:
        far = float(np.max(np.abs(ends[1] - ends[0])))
        return Verdict(far < 1e-9 * 10.0, far / 10.0, "of the scene's 10 m")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        Simulation(_offset_scene(shift), arch="cpu", dt=H, contacts=contacts).close()
    return Verdict(
        any("precision" in str(w.message) for w in caught), float(len(caught)), "warnings in single precision"
    )


def _right_pairs(scene: Scene, contacts: str) -> Verdict:
    """What one pass changed, against pairs found by brute force.

    Of two balls that touch and approach at least one must change; no ball may that has no such pair in its group of balls that
    touch each other, for impulses go no further.
    """
    with _simulation(scene, contacts, integrator="symplectic_euler", contact_passes=1) as sim:
        x, v = sim.position, sim.velocity
        sim.step()
        changed = np.any(sim.velocity != v, axis=1)
    approach, group, touching = [], np.arange(len(x)), []
    for i in range(len(x) - 1):
        r = x[i + 1 :] - x[i]
        for k in np.flatnonzero(np.sum(r * r, axis=1) < (scene.radius[i + 1 :] + scene.radius[i]) ** 2):
            j = i + 1 + int(k)
            touching.append((i, j))
            if (v[j] - v[i]) @ r[k] < 0.0:
                approach.append((i, j))
    for _ in range(len(x)):
        before = group.copy()
        for i, j in touching:
            group[[i, j]] = min(group[i], group[j])
        if np.array_equal(before, group):
            break
    missed = sum(not (changed[i] or changed[j]) for i, j in approach)
    false = int(np.sum(changed & ~np.isin(group, [group[i] for i, _ in approach])))
    return Verdict(missed + false == 0 < len(approach), missed + false, f"wrong; {len(touching)} pairs touch")


def tiny_in_a_large_world(contacts: str, short: bool) -> Verdict:
    """Radius 1e-4 m, groups of three scattered over 1e4 m."""
    rng, n = np.random.default_rng(4), 500
    x = np.repeat(rng.uniform(-5e3, 5e3, (n, 3)), 3, axis=0) + rng.uniform(-1.2e-4, 1.2e-4, (3 * n, 3))
    scene = Scene(dim=3)
    scene.add_balls(x, radius=1e-4, velocity=rng.normal(size=x.shape) * 1e-3)
    return _right_pairs(scene, contacts)


def radii_from_1_to_1000(contacts: str, short: bool) -> Verdict:
    """Large balls among a thousand small ones."""
    rng, n = np.random.default_rng(5), 1500
    radius = np.where(np.arange(n) < 5, 1.0, 10 ** rng.uniform(-3, -1.5, n))
    scene = Scene(dim=2)
    scene.add_balls(rng.uniform(-1.5, 1.5, (n, 2)), radius=radius, velocity=rng.normal(size=(n, 2)))
    return _right_pairs(scene, contacts)


def negative_coordinates(contacts: str, short: bool) -> Verdict:
    """Balls on all sides of the origin and far on the negative side."""
    rng, n = np.random.default_rng(6), 1000
    x = rng.uniform(-1.0, 1.0, (n, 2)) - np.where(np.arange(n) % 2, 0.0, 100.0)[:, None]
    scene = Scene(dim=2)
    scene.add_balls(x, radius=0.03, velocity=rng.normal(size=x.shape))
    return _right_pairs(scene, contacts)


def crowded_cell(contacts: str, short: bool) -> Verdict:
    """A million (short: 1e4) small balls, none touching another, in the cell of one large ball."""
    n = 10_000 if short else 1_000_000
    side = round(n ** (1 / 2))
    scene = Scene(dim=2)
    i, j = np.divmod(np.arange(n), side)
    scene.add_balls(np.stack([i, j], axis=1) / side, radius=0.4 / side, velocity=(0.0, 1e-3))
    scene.add_balls([[10.0, 0.0]], radius=1.0, pinned=True)
    start = time.perf_counter()
    with _simulation(scene, contacts, contact_passes=1) as sim:
        sim.step()
        still = np.array_equal(sim.velocity, scene.velocity.astype(np.float64 if _double(sim) else np.float32))
    took = time.perf_counter() - start
    return Verdict(still and took < 600.0, took, "s, compiling included")


CASES = (
    Case("2 coincident balls", "separate below 20 r/s, centre fixed to 1e-9 m", two_coincident),
    Case("1000 coincident balls", "separate below 20 r/s, centre fixed to 1e-9 m", thousand_coincident),
    Case("bullet, 10 radii a step, at a wall", "never crosses, 1e4 trials", bullet_at_wall),
    Case("bullet, 10 radii a step, at a ball", "never crosses, 1e4 trials", bullet_at_ball),
    Case("bullet, 10 radii a step, at a stick", "never crosses, 1e4 trials", bullet_at_stick),
    Case("corner of three walls", "at rest to 1e-9 in 2 passes", corner),
    Case("20 degree wedge", "at rest to 1e-9 in 2 passes, not ejected", wedge),
    Case("stack of 20", "stands 10 s, overlap < 2 % r", stack),
    Case("100:1 ball on ten", "stands 10 s, overlap < 5 % r, calm", heavy_on_ten),
    Case("pack with e = 1 hits the floor", "no energy gained", elastic_pack),
    Case("crushing piston, then release", "v <= sqrt(2 E / m)", piston),
    Case("everything pinned", "no motion", all_pinned),
    Case("empty scene", "steps and does nothing", empty),
    Case("world offset by 1e6 m", "f64: the run at the origin to 1e-9; f32: warned", world_offset),
    Case("radius 1e-4 m in a 1e4 m world", "right pairs, by brute force", tiny_in_a_large_world),
    Case("radii 1:1000", "right pairs, by brute force", radii_from_1_to_1000),
    Case("negative coordinates", "right pairs, by brute force", negative_coordinates),
    Case("1e6 balls in one cell", "no wrong pair, in 10 minutes", crowded_cell),
)


def judge(case: Case, contacts: str, short: bool = False) -> Verdict:
    """The verdict on a case; one that ends with an error has failed."""
    try:
        verdict = case.run(contacts, short)
    except Exception as error:
        return Verdict(False, float("nan"), f"{type(error).__name__}: {error}")
    if not np.isfinite(verdict.figure):
        return Verdict(False, verdict.figure, verdict.words)
    return verdict


def main(cases: Sequence[Case] = CASES) -> bool:
    """Run all cases in double precision and print the table. False when a case failed with every rule."""
    from rich.console import Console
    from rich.live import Live
    from rich.table import Table

    table = Table("case", "must", *RULES, title="Hard cases of contacts, double precision", show_lines=True)
    good = True
    with Live(table, console=Console(), auto_refresh=False) as live:
        for case in cases:
            verdicts = [judge(case, contacts) for contacts in RULES]
            cells = []
            for verdict in verdicts:
                mark = "[green]pass[/]" if verdict.passed else "[red]FAIL[/]"
                cells.append(f"{mark} {verdict.figure:.3g} {verdict.words}")
            table.add_row(case.name, case.bound, *cells)
            live.refresh()
            good = good and any(verdict.passed for verdict in verdicts)
    return good
