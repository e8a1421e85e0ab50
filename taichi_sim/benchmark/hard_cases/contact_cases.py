"""Hard cases: what breaks simulators, each with a bound and a measured verdict for each rule of the contact solver; those of
springs, for each method, lie in `spring_cases`.

A case is a function of the rule and of `short` (a smaller form for quick tests): it builds a scene, runs it, and returns whether
it passed, the figure that the bound speaks of, and words. `taichi-sim report --hard-cases` prints them all.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from taichi_sim.benchmark.hard_cases import extreme_sizes, spring_cases
from taichi_sim.benchmark.hard_cases.verdicts import (
    Case,
    G,
    H,
    Verdict,
    energy_part,
    largest,
    on_floor,
    rounding,
    show,
    simulation,
)
from taichi_sim.scene.scene import Scene

RULES = ("gauss_seidel", "jacobi")
R = 0.05  # m
BULLET = 10.0  # radii a step
TRIALS = 10_000


# Balls in one place ---------------------------------------------------------------------------------------------------


def coincident(n: int, of_short: int, contacts: str, short: bool) -> Verdict:
    """Balls, n of them, in one place."""
    n, scene = of_short if short else n, Scene(dim=3)
    mass = 10 ** np.random.default_rng(0).uniform(-1, 1, n)
    scene.add_balls(np.full((n, 3), 0.3), radius=R, mass=mass)
    with simulation(scene, contacts, contact_iterations=2) as sim:
        centre = mass @ sim.position / mass.sum()
        (fastest,) = largest(sim, 0.1, 10, lambda: np.max(np.abs(sim.velocity)))
        shift = float(np.max(np.abs(mass @ sim.position / mass.sum() - centre)))
        d = np.linalg.norm(sim.position[:, None] - sim.position[None], axis=2) + 2 * R * np.eye(n)
        passed = fastest < 20 * R and shift < rounding(sim) and float(d.min()) > 0.02 * R
        return Verdict(passed, fastest, f"nearest {d.min() / R:.2g} r, centre moved {shift:.0e} m")


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
    with simulation(scene, contacts) as sim:
        (deepest,) = largest(sim, 3 * H, 3, lambda: np.max(1.0 - sim.position[:, 1] / radius, initial=0.0))
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
    with simulation(scene, contacts) as sim:
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
    with simulation(scene, contacts) as sim:
        (beyond,) = largest(sim, 3 * H, 3, lambda: np.sum((sim.position[bullets] - place) * normal, axis=1))
    crossed = int(np.sum(beyond > 0.0))
    return Verdict(crossed == 0, crossed, f"of {n} went through")


# Corners and stacks ---------------------------------------------------------------------------------------------------


def corner(contacts: str, short: bool) -> Verdict:
    """A ball pressed into a corner of three walls, 2 iterations."""
    scene = Scene(dim=3)
    for normal in np.eye(3):
        scene.add_wall(normal)
    scene.add_balls([[0.99 * R] * 3], radius=R, velocity=[-1.0, -2.0, -0.5])
    with simulation(scene, contacts, contact_iterations=2) as sim:
        sim.step()
        speed = float(np.max(np.abs(sim.velocity)))
        return Verdict(speed < rounding(sim), speed, "m/s after one step")


def wedge(contacts: str, short: bool) -> Verdict:
    """A ball thrown into a wedge of 20 degrees, gravity along its axis, 2 iterations."""
    scene = Scene(dim=2, gravity=(0.0, -G))
    angle = np.radians(10.0)
    for side in (1.0, -1.0):
        scene.add_wall((side * np.cos(angle), np.sin(angle)))
    scene.add_balls([[0.02, 0.5]], radius=R, velocity=[1.0, -3.0])
    with simulation(scene, contacts, contact_iterations=2) as sim:
        start = sim.energy().total
        (most,) = largest(sim, 1.0, 100, lambda: sim.energy().total)
        speed = float(np.max(np.abs(sim.velocity)))
        passed = speed < rounding(sim) and most <= start + rounding(sim)
        height = f"{sim.position[0, 1] / R:.3f} r of {1 / np.sin(angle):.3f} r"
    return Verdict(passed, speed, f"m/s after 1 s, height {height}")


def _stands(mass: list[float], contacts: str, seconds: float, bound: float) -> Verdict:
    """A column of balls of these masses on the floor."""
    scene = on_floor()
    scene.add_balls([[0.0, (2 * k + 1) * R] for k in range(len(mass))], radius=R, mass=mass)
    with simulation(scene, contacts) as sim:
        (deepest,) = largest(sim, seconds, 10, lambda: sim.penetration() / R)
        speed = float(np.max(np.abs(sim.velocity)))
        fallen = float(np.max(np.abs(sim.position - scene.position)))
    passed = deepest < bound and speed < 2 * G * H and fallen < R
    return Verdict(passed, deepest, f"r deep at most, {speed:.1e} m/s, top sank {fallen / R:.2f} r")


def stack(contacts: str, short: bool) -> Verdict:
    """A column of 20 balls for 10 s (short: 1 s)."""
    return _stands([1.0] * 20, contacts, 1.0 if short else 10.0, 0.02)


def heavy_on_ten(contacts: str, short: bool) -> Verdict:
    """A ball of 100 kg on a column of ten of 1 kg."""
    return _stands([1.0] * 10 + [100.0], contacts, 1.0 if short else 10.0, 0.05)


# Energy ---------------------------------------------------------------------------------------------------------------


def elastic_pack(contacts: str, short: bool) -> Verdict:
    """A hexagonal pack of touching discs, e = 1, falls on the floor at several speeds, so that it meets it anywhere in a step.

    By Gauss-Seidel some come to rest on each other meanwhile, overlap, and are pushed apart, for which a hundred thousandth is
    allowed.
    """
    scene = on_floor(restitution=1.0)
    i, j = np.divmod(np.arange(100), 10)
    x = 2 * R * np.stack([j + 0.5 * (i % 2), np.sqrt(0.75) * i], axis=1) + [0.0, 1.1 * R]
    scene.add_balls(x, radius=R, material="it")
    rng = np.random.default_rng(7)
    gain, left = -np.inf, np.inf
    with simulation(scene, contacts) as sim:
        for _ in range(2 if short else 10):
            sim.set_position(x)
            sim.set_velocity((0.0, -rng.uniform(1.0, 4.0)))
            part = energy_part(sim)
            (most,) = largest(sim, 0.3, 100, part)
            gain, left = max(gain, most - 1.0), min(left, part())
        allowed = max(rounding(sim), 1e-5) if contacts == "gauss_seidel" else rounding(sim)
        return Verdict(gain < allowed, gain, f"gained at most; {left:.3f} left after 0.3 s")


def piston(contacts: str, short: bool) -> Verdict:
    """A ball of 1e4 kg that fits a box thrown on twenty of 1 kg in it, then taken away: E is what it brought."""
    scene = on_floor(restitution=0.3, friction=0.3)
    scene.add_wall((1, 0), 0.0, "it")
    scene.add_wall((-1, 0), -8 * R, "it")
    i, j = np.divmod(np.arange(20), 4)
    small = scene.add_balls(2 * R * np.stack([j + 0.5, i + 0.5], axis=1), radius=0.99 * R, material="it")
    heavy = scene.add_balls([[4 * R, 15 * R]], radius=3.9 * R, mass=1e4, velocity=[0.0, -5.0], material="it")
    energy = 0.5 * 1e4 * 25.0 + 1e4 * G * 15 * R
    with simulation(scene, contacts) as sim:

        def fastest() -> float:
            return float(np.max(np.linalg.norm(sim.velocity[small], axis=1)))

        def outside() -> float:
            x = sim.position[small]
            return float(np.max([-x[:, 1], -x[:, 0], x[:, 0] - 8 * R]))

        pressed = largest(sim, 0.2, 40, fastest, outside)
        sim.run(0.005)
        x = sim.position
        x[heavy] = [4 * R, 10.0]  # released: the piston is lifted out of the box at once
        sim.set_position(x)
        after = [fastest(), outside()]
        speed, out = np.max([pressed, after, largest(sim, 0.295, 59, fastest, outside)], axis=0)
    share = speed / np.sqrt(2 * energy / 1.0)
    return Verdict(share <= 1.0, share, f"of sqrt(2 E / m): {speed:.1f} m/s; pressed {out / R + 1:.2f} r into walls")


# Nothing to do --------------------------------------------------------------------------------------------------------


def all_pinned(contacts: str, short: bool) -> Verdict:
    """Overlapping pinned balls on a floor, with springs and sticks."""
    scene = on_floor()
    b = scene.add_balls([[0.0, 0.0], [R, 0.0], [R, 0.0]], radius=R, pinned=True)
    scene.add_springs([b[:2], b[1:]], stiffness=100.0, damping=1.0, rest_length=1.0, collides=[False, True])
    with simulation(scene, contacts) as sim:
        x = sim.position
        sim.step(100)
        moved = float(np.max(np.abs(sim.position - x)) + np.max(np.abs(sim.velocity)))
    return Verdict(moved == 0.0, moved, "moved")


def empty(contacts: str, short: bool) -> Verdict:
    """Scene without a ball, but with walls and gravity."""
    scene = on_floor(3)
    with simulation(scene, contacts) as sim:
        sim.step(100)
        figures = [*sim.energy(), *np.ravel(sim.momentum()), sim.penetration(), sim.position.size]
    return Verdict(not np.any(figures), float(np.sum(np.abs(figures))), f"balls, energy, momentum; t = {sim.time:g} s")


CASES = (
    Case("2 coincident balls", "separate below 20 r/s, centre fixed to 1e-9 m", partial(coincident, 2, 2)),
    Case("1000 coincident balls", "separate below 20 r/s, centre fixed to 1e-9 m", partial(coincident, 1000, 50)),
    Case("bullet, 10 radii a step, at a wall", "never crosses, 1e4 trials", bullet_at_wall),
    Case("bullet, 10 radii a step, at a ball", "never crosses, 1e4 trials", bullet_at_ball),
    Case("bullet, 10 radii a step, at a stick", "never crosses, 1e4 trials", bullet_at_stick),
    Case("corner of three walls", "at rest to 1e-9 in 2 iterations", corner),
    Case("20 degree wedge", "at rest to 1e-9 in 2 iterations, not ejected", wedge),
    Case("stack of 20", "stands 10 s, overlap < 2 % r", stack),
    Case("100:1 ball on ten", "stands 10 s, overlap < 5 % r, calm", heavy_on_ten),
    Case("pack with e = 1 hits the floor", "no energy gained beyond a row's half step", elastic_pack),
    Case("crushing piston, then release", "v <= sqrt(2 E / m)", piston),
    Case("everything pinned", "no motion", all_pinned),
    Case("empty scene", "steps and does nothing", empty),
    Case("world offset by 1e6 m", "f64: the run at the origin to 1e-9; f32: warned", extreme_sizes.world_offset),
    Case("radius 1e-4 m in a 1e4 m world", "right pairs, by brute force", extreme_sizes.tiny_in_a_large_world),
    Case("radii 1:1000", "right pairs, by brute force", extreme_sizes.radii_from_1_to_1000),
    Case("negative coordinates", "right pairs, by brute force", extreme_sizes.negative_coordinates),
    Case("1e6 balls in one cell", "no wrong pair, in 10 minutes", extreme_sizes.crowded_cell),
)


def main(cases: Sequence[Case] = CASES, of_springs: Sequence[Case] = spring_cases.CASES) -> bool:
    """Run all cases in double precision and print both tables. False when a case passed in no column of its table."""
    contacts = show("Hard cases of contacts, double precision", cases, RULES)
    springs = show("Hard cases of springs and soft bodies, double precision", of_springs, spring_cases.METHODS)
    return contacts and springs
