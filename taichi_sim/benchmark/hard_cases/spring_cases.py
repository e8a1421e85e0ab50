"""Hard cases of springs and soft bodies, each with a verdict for each method.

All methods get the same scene and, where a case names one, the same step. A method that says before the first step that this one
is not safe, and which one is, has refused.
"""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from taichi_sim import shapes
from taichi_sim.benchmark.hard_cases.verdicts import (
    Case,
    G,
    H,
    Verdict,
    energy_part,
    heeding,
    largest,
    on_floor,
    rounding,
)
from taichi_sim.scene.scene import Scene
from taichi_sim.simulation.simulation import Simulation

METHODS = ("explicit_euler", "symplectic_euler", "verlet", "rk4", "xpbd", "implicit_euler", "tr_bdf2")
LONG_STEP = 0.01  # s
Floats = NDArray[np.float64]


# A free net ------------------------------------------------------------------------------------------------------------


def _net(stiffness: float, damping: float) -> Scene:
    """Twenty unequal balls in the plane, each joined to five near ones by springs a fifth too long or too short, all moving."""
    rng, n = np.random.default_rng(7), 20
    x = rng.uniform(-1.0, 1.0, (n, 2))
    scene = Scene(dim=2)
    scene.add_balls(x, radius=0.01, velocity=rng.normal(0.0, 1.0, (n, 2)), mass=rng.uniform(0.2, 5.0, n))
    near = np.argsort(np.linalg.norm(x[:, None] - x[None], axis=2), axis=1)[:, 1:6]
    pairs = np.unique([sorted((i, int(j))) for i in range(n) for j in near[i]], axis=0)
    length = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    rest = length * rng.uniform(0.8, 1.2, len(pairs))
    scene.add_springs(pairs, stiffness=stiffness, damping=damping, rest_length=rest)
    return scene


def _lost_momentum(sim: Simulation, before: Floats) -> float:
    """Largest change of the momentum, as a part of sum m |v| at the start."""
    scene = sim.scene
    whole = float(np.sum(scene.mass * np.linalg.norm(scene.velocity, axis=1)))
    return float(np.max(np.abs(sim.momentum() - before))) / whole


def stiff(power: int, method: str, short: bool) -> Verdict:
    """K h^2 of each spring is ten to that power for balls of 1 kg; 50 steps."""
    with heeding(_net(10.0**power / LONG_STEP**2, 0.0), method, dt=LONG_STEP, contacts="off") as sim:
        momentum, energy = sim.momentum(), [sim.energy().total]
        for _ in range(50):
            sim.step()
            energy.append(sim.energy().total)
        kept = _lost_momentum(sim, momentum) < rounding(sim)
    rise, most = np.max(np.diff(energy)) / energy[0], np.max(energy) / energy[0]
    return Verdict(
        kept and most <= 1.0, rise, f"largest rise in a step, {energy[-1] / energy[0]:.1e} of the energy left"
    )


def _closing_speed(scene: Scene, x: Floats, v: Floats) -> float:
    """RMS of the speeds along springs [m/s]."""
    i, j = scene.pairs.T
    r = x[j] - x[i]
    return float(np.sqrt(np.mean((np.sum((v[j] - v[i]) * r, axis=1) / np.linalg.norm(r, axis=1)) ** 2)))


def viscous(power: int, method: str, short: bool) -> Verdict:
    """C h of each spring is ten to that power for balls of 1 kg; 50 steps."""
    scene = _net(1.0, 10.0**power / LONG_STEP)
    with heeding(scene, method, dt=LONG_STEP, contacts="off") as sim:
        momentum, before = sim.momentum(), _closing_speed(scene, sim.position, sim.velocity)
        sim.step(50)
        left = _closing_speed(scene, sim.position, sim.velocity) / before
        lost = _lost_momentum(sim, momentum)
        return Verdict(left < 0.05 and lost < rounding(sim), left, f"of the speed left; momentum off by {lost:.0e}")


# Chains and pairs ------------------------------------------------------------------------------------------------------


def heavy_end(method: str, short: bool) -> Verdict:
    """Twenty balls below a pin, of 1 kg but for the last, near critical damping for that one; 20 s in steps of 20 ms."""
    n, k, heavy = 20, 1e7, 1e4
    mass = np.ones(n + 1)
    mass[-1] = heavy
    scene = Scene(dim=2, gravity=(0.0, -G))
    place = np.stack([np.zeros(n + 1), -0.1 * np.arange(n + 1)], axis=1)
    b = scene.add_balls(place, radius=0.01, mass=mass, pinned=[0])
    scene.add_springs(np.stack([b[:-1], b[1:]], axis=1), stiffness=k, damping=np.sqrt(k * heavy))
    exact = G * sum(mass[i:].sum() for i in range(1, n + 1)) / k
    with heeding(scene, method, dt=0.02, contacts="off") as sim:
        sim.run(20.0)
        off = abs((place[-1, 1] - sim.position[-1, 1]) / exact - 1.0)
        return Verdict(off < 0.01, off, f"of the stretch of {exact:.3f} m off, {np.abs(sim.velocity).max():.0e} m/s")


def through_zero(method: str, short: bool) -> Verdict:
    """Two balls that run through each other, and two that start in one place, on springs with a length; 1 s."""
    scene = Scene(dim=2)
    x, v = [[-0.5, 0.0], [0.5, 0.0], [3.0, 0.0], [3.0, 0.0]], [[9.0, 0.0], [-3.0, 0.0], [0.0, 0.0], [0.0, 0.0]]
    b = scene.add_balls(x, radius=0.01, velocity=v, mass=[1.0, 3.0, 1.0, 3.0])
    scene.add_springs([b[:2], b[2:]], stiffness=100.0, rest_length=0.5)
    with heeding(scene, method, dt=H, contacts="off") as sim:
        centre, between = scene.mass @ sim.position, lambda: sim.position[[1, 3]] - sim.position[[0, 2]]
        most, crossed, apart = largest(
            sim, 1.0, 200, energy_part(sim), lambda: between()[0, 0] < 0.0, lambda: np.linalg.norm(between()[1])
        )
        still = float(np.max(np.abs(scene.mass @ sim.position - centre))) < rounding(sim)
    passed = still and crossed and 0.1 < apart < 2.0 and most < 1.1
    return Verdict(passed, most, f"of the energy at most; those in one place came {apart:.2f} m apart")


# Soft bodies -----------------------------------------------------------------------------------------------------------


def _inverted(x: Floats, number: tuple[int, int]) -> int:
    """Cells of a plane lattice whose corners run round the other way."""
    p = x.reshape(*number, 2)
    a, b = p[1:, 1:] - p[:-1, :-1], p[:-1, 1:] - p[1:, :-1]
    return int(np.sum(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0] < 0.0))


def inverted(method: str, short: bool) -> Verdict:
    """A plane jelly whose last column of balls has been pushed through the next; 1 s."""
    number = (7, 5)
    scene = Scene(dim=2)
    shapes.jelly(scene, size=(0.6, 0.4), resolution=number)
    scene.set_balls(slice(-5, None), position=scene.position[-5:] - [0.15, 0.0])
    with heeding(scene, method, contacts="off") as sim:
        before = _inverted(sim.position, number)
        (most,) = largest(sim, 1.0, 20, energy_part(sim))
        left = _inverted(sim.position, number)
    return Verdict(
        most <= 1.0 and left == 0, left, f"of {before} cells still inverted, {most:.3f} of the energy at most"
    )


def cloth_on_ball(method: str, short: bool) -> Verdict:
    """A square metre of 1e5 balls (short: 144) falls on a pinned ball; 0.25 s, of which it falls 0.1 s."""
    side, size = 12 if short else 316, 0.2
    scene = Scene(dim=3, gravity=(0.0, -G, 0.0))
    rough = scene.add_material("rough", friction=0.5)
    sheet = shapes.cloth(scene, size=(1, 1), resolution=(side, side), position=(-0.5, 0.0, -0.5), material=rough)
    gap = 0.05 + size + scene.radius[0]
    ball = int(scene.add_balls([[0.0, -gap, 0.0]], radius=size, pinned=True, material=rough)[0])
    middle = int(sheet.balls[np.argmin(np.linalg.norm(scene.position[sheet.balls], axis=1))])
    with heeding(scene, method) as sim:
        start = sim.energy()

        def gained() -> float:
            now = sim.energy()
            return (now.total - start.total) / (start.gravity - now.gravity)

        def deep() -> float:
            r = sim.position[sheet.balls] - sim.position[ball]
            return 1.0 - float(np.min(np.linalg.norm(r, axis=1))) / (gap - 0.05)

        gain, depth = largest(sim, 0.25, 5, gained, deep)
        on_top = sim.position[middle, 1] > sim.position[ball, 1] + 0.9 * size
    words = f"of what gravity gave gained at most; {max(0.0, depth):.0e} of the ball deep"
    return Verdict(on_top and depth < 0.01 and gain < 0.01, gain, words)


def jelly_at_50(method: str, short: bool) -> Verdict:
    """A jelly cube (short: a square) thrown at a floor four times faster than its own sound."""
    dim, fast = 2 if short else 3, 50.0
    scene = on_floor(dim, restitution=0.5, friction=0.3)
    shapes.jelly(scene, resolution=(6,) * dim, position=(0.0, 0.1, 0.0)[:dim], material="it")
    scene.set_balls(velocity=[0.0, -fast, 0.0][:dim])
    with heeding(scene, method) as sim:
        part = energy_part(sim)
        most, sunk = largest(sim, 0.1, 50, part, lambda: -np.min(sim.position[:, 1]) / scene.radius[0])
        left = part()
    words = f"of the energy in the end, {most:.3f} at most; lowest {-sunk:.2f} r"
    return Verdict(sunk < 0.0 and most <= 1.0, left, words)


CASES = (
    *(Case(f"K h^2 = 1e{p}", "energy at most that at the start, momentum kept", partial(stiff, p)) for p in (2, 4, 6)),
    *(
        Case(f"C h = 1e{p}", "less than 5 % of the speed along springs left, momentum kept", partial(viscous, p))
        for p in (2, 4, 6)
    ),
    Case("chain of 20, the last 1e4 times heavier", "static stretch within 1 %", heavy_end),
    Case("spring through zero length", "finite, energy < 1.1, centre of mass fixed", through_zero),
    Case("inverted jelly cells", "no energy gained, and none left", inverted),
    Case(
        "cloth dropped on a ball",
        "overlap < 1 % of the ball, energy gained < 1 % of what gravity gave",
        cloth_on_ball,
    ),
    Case("jelly at 50 m/s", "no ball below the floor, no energy gained", jelly_at_50),
)
