"""Random scenes of loose balls: crowds, rows, columns, neighbours, unequal ones, glancing ones."""

from collections.abc import Iterator

import numpy as np

import taichi_sim as ts

from .agreement import PROCESSES, VIEWS
from .observe import Case

__all__ = ["BOUNCES"]

Rng = np.random.Generator
VERLET = {"integrator": "verlet"}


def up(dim: int, g: float) -> np.ndarray:
    """Gravity (dim,) [m/s^2], downward along y."""
    out = np.zeros(dim)
    out[1] = -g
    return out


def blank(dim: int, g: float, restitution: float = 0.0, friction: float = 0.0) -> ts.Scene:
    """A scene with gravity downward along y [m/s^2] and a material m."""
    scene = ts.Scene(dim, up(dim, g))
    scene.add_material("m", restitution=restitution, friction=friction)
    return scene


def log(rng: Rng, low: float, high: float, n: int | None = None):
    """Between low and high, every decade alike."""
    return np.exp(rng.uniform(np.log(low), np.log(high), n))


def room(scene: ts.Scene, material: str, size: float = 1.0) -> None:
    """Walls around a cube from 0 to size."""
    for axis in np.eye(scene.dim):
        scene.add_wall(axis, 0.0, material)
        scene.add_wall(-axis, -size, material)


def scattered(rng: Rng, n: int, dim: int, size: float = 1.0) -> np.ndarray:
    """(n, dim) places in a cube, at least .7 of a lattice's spacing apart."""
    side = int(np.ceil(n ** (1 / dim)))
    lattice = np.stack(np.meshgrid(*[np.arange(side)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    chosen = lattice[rng.permutation(len(lattice))[:n]]
    return (chosen + 0.5 + rng.uniform(-0.15, 0.15, (n, dim))) * (size / side)


def crowd(
    rng: Rng, dim: int, g: float, e: float, masses: float = 1.0, radii: float = 1.0, n=None, speed=1.0
) -> ts.Scene:
    """Balls in a room of 1 m; masses and radii: by how much they differ."""
    scene = blank(dim, g, restitution=e)
    n = int(rng.integers(50, 201)) if n is None else n
    side = np.ceil(n ** (1 / dim))
    filled = rng.uniform(0.05, 0.3)
    unit = np.pi / 4 if dim == 2 else np.pi / 6
    radius = min(0.34 / side, 0.5 * (filled / (n * unit)) ** (1 / dim))
    x = scattered(rng, n, dim)
    v = rng.normal(0.0, speed, (n, dim))
    size = radius / radii * radii ** rng.uniform(0.0, 1.0, n)
    scene.add_balls(x, radius=size, velocity=v, mass=log(rng, 1.0, masses, n) if masses > 1 else 1.0, material="m")
    room(scene, "m")
    return scene


def _elastic_crowd(rng: Rng, n: int) -> list[Case]:
    dim = int(rng.integers(2, 4))
    g = float(rng.choice([0.0, log(rng, 1e-3, 10.0), log(rng, 1e-3, 10.0)]))
    scenes = [crowd(rng, dim, g, 1.0) for _ in range(n)]
    if rng.random() < 0.5:  # some balls on springs
        for scene in scenes:
            pairs = rng.permutation(scene.n_balls)[: 2 * int(rng.integers(1, 9))].reshape(-1, 2)
            scene.add_springs(pairs, stiffness=float(log(rng, 5.0, 200.0)))
    return [Case(scene, VERLET, 2.0, 8) for scene in scenes]


def _elastic_rows(rng: Rng, n: int) -> Iterator[Case]:
    """Balls that touch, in a row on a floor, hit by one at the end."""
    dim = int(rng.integers(2, 4))
    g = float(log(rng, 0.5, 20.0))
    for _ in range(n):
        scene = blank(dim, g, restitution=1.0)
        k, r = int(rng.integers(2, 8)), float(rng.uniform(0.02, 0.1))
        x = np.zeros((k + 1, dim))
        x[:, 0], x[:, 1] = 2 * r * np.arange(k + 1), r
        x[0, 0] -= rng.uniform(0.5, 3.0) * r
        v = np.zeros_like(x)
        v[0, 0] = rng.uniform(0.5, 3.0)
        scene.add_balls(x, radius=r, velocity=v, material="m")
        scene.add_wall(np.eye(dim)[1], 0.0, "m")
        yield Case(scene, VERLET, 0.4, 4)


def _heavy_crowd(rng: Rng, n: int) -> list[Case]:
    dim = int(rng.integers(2, 4))
    speed, g = float(log(rng, 3.0, 30.0)), float(rng.choice([0.0, 10.0]))
    return [
        Case(
            crowd(rng, dim, g, 1.0, masses=float(log(rng, 1e2, 1e4)), n=int(rng.integers(10, 60)), speed=speed),
            VERLET,
            0.1,
            20,
        )
        for _ in range(n)
    ]


def _columns(rng: Rng, n: int) -> Iterator[Case]:
    """Balls above each other that come down together on a floor; they do not bounce."""
    dim = int(rng.integers(2, 4))
    g = float(rng.choice([0.0, 10.0]))
    for _ in range(n):
        scene = ts.Scene(dim, up(dim, g))
        k = int(rng.integers(2, 4))
        r = rng.uniform(0.03, 0.1, k)
        gaps = rng.uniform(0.0, 0.5, k) * r
        x = np.zeros((k, dim))
        x[:, 1] = np.cumsum(2 * r + gaps) - r
        v = np.zeros((k, dim))
        v[:, 1] = -rng.uniform(0.5, 5.0)
        mass = np.cumprod(np.concatenate([[1.0], log(rng, 1.0, 100.0 ** (1 / (k - 1)), k - 1)]))
        scene.add_balls(x, radius=r, velocity=v, mass=mass)
        scene.add_wall(np.eye(dim)[1], 0.0)
        yield Case(scene, VERLET, 0.2, 50)


def _clusters(rng: Rng, n: int) -> Iterator[Case]:
    """A few balls that meet at once, most on a floor."""
    dim = 2 if rng.random() < 0.7 else 3
    e, g = float(rng.choice([0.0, 0.5])), float(rng.choice([1.0, 10.0]))
    floor = rng.random() < 0.6
    for _ in range(n):
        scene = blank(dim, g, restitution=e, friction=float(rng.choice([0.0, 0.3])))
        k, r = int(rng.integers(3, 11)), 0.07
        side = np.arange(4) * 2.0 * r
        lattice = np.stack(np.meshgrid(*[side] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
        if dim == 2:
            lattice = lattice * [1.0, np.sqrt(3) / 2] + np.where(np.round(lattice[:, 1:] / (2 * r)) % 2, r, 0.0) * [
                1,
                0,
            ]
        x = lattice[np.argsort(np.linalg.norm(lattice - lattice.mean(axis=0) - rng.normal(0, r, dim), axis=1))[:k]]
        x = (x - x.mean(axis=0)) * float(rng.choice([1.0, rng.uniform(1.0, 1.1)]))
        v = -3.0 * x / np.linalg.norm(x, axis=1).max() + rng.normal(0, 1.0, x.shape)
        if floor:
            v[:, 1] -= 3.0
            scene.add_wall(np.eye(dim)[1], -0.5, "m")
            x[:, 1] += r - 0.5 - x[:, 1].min() + float(rng.choice([0.0, 0.01]))
        scene.add_balls(x, radius=r, velocity=v, mass=log(rng, 1.0, 100.0, k), material="m")
        yield Case(scene, VERLET, 0.1, 100)


def _neighbours(rng: Rng, n: int) -> Iterator[Case]:
    """Spheres side by side that slide or roll along a floor into a wall."""
    g = float(rng.choice([0.0, 2.0]))
    most = float(rng.choice([0.5, 1.0]))  # the max_restitution of a simulation chooses how often contacts are solved
    settings = {**VERLET, "contacts": str(rng.choice(["auto", "jacobi"]))}
    for _ in range(n):
        friction = float(rng.choice([0.0, rng.uniform(0.05, 0.6)]))
        scene = blank(3, g, float(rng.uniform(0.2, most)), friction)
        k, r = int(rng.integers(2, 5)), 0.1
        x = np.zeros((k, 3))
        x[:, 1], x[:, 2] = 0.9999 * r, 1.999 * r * np.arange(k)  # they touch, without a doubt
        x[:, 0] = -r - rng.uniform(0.05, 0.4)
        scene.add_balls(x, radius=r, velocity=(rng.uniform(1.0, 3.0), 0.0, 0.0), material="m")
        scene.add_wall((0, 1, 0), 0.0, "m")
        scene.add_wall((-1, 0, 0), 0.0, "m")
        yield Case(scene, settings, 0.5, 500)


def _hollow_boxes(rng: Rng, n: int) -> Iterator[Case]:
    """Balls in a hollow box that land on one face and meet the next within the same step, or a little later."""
    dim = int(rng.integers(2, 4))
    mu = float(rng.choice([0.0, 0.3]))
    g = float(rng.choice([0.0, 10.0, 10.0]))
    for _ in range(n):
        scene = blank(dim, g, restitution=float(rng.choice([0.0, 0.5])), friction=mu)
        size = rng.uniform(0.6, 1.5, dim)
        r, h = float(rng.uniform(0.02, 0.05)), 1e-3
        x, v = np.zeros((1, dim)), np.zeros((1, dim))
        v[0, 0], v[0, 1] = log(rng, 0.02, 10.0), -log(rng, 0.05, 5.0)
        lands = rng.uniform(0.0, 10.0) * h
        x[0, 1] = r - size[1] / 2 - v[0, 1] * lands
        x[0, 0] = size[0] / 2 - r - v[0, 0] * (lands + rng.uniform(0.0, 1.0) * h)
        scene.add_balls(x, radius=r, velocity=v, material="m")
        scene.add_collider(ts.Box(np.zeros(dim), size, hollow=0.2, material="m"))
        yield Case(scene, {**VERLET, "dt": h}, 0.03, 30)


def _unequal(rng: Rng, n: int) -> list[Case]:
    """Crowds of 1:100 in mass and 1:3 in radius."""
    e = float(rng.choice([0.0, 0.5]))
    return [Case(crowd(rng, 2, 10.0, e, 100.0, 3.0, n=60, speed=2.0), VERLET, 0.6, 30) for _ in range(n)]


def _held(rng: Rng, n: int) -> Iterator[Case]:
    """A heavy ball on a loose stick, a line without thickness, that lies on two pinned balls."""
    for _ in range(n):
        scene = ts.Scene(2, up(2, 10.0))  # in 3D it would fall off
        half, r = float(rng.uniform(0.4, 0.6)), 0.05
        x = np.zeros((5, 2))
        x[0, 0], x[1, 0] = -0.8 * half, 0.8 * half  # what it lies on
        x[2], x[3] = (-half, r), (half, r)
        x[4] = rng.uniform(-0.1, 0.1) * half, 2 * r
        heavy = float(log(rng, 1.0, 30.0))
        scene.add_balls(x, radius=[r, r, 0.01, 0.01, r], mass=[1, 1, 1, 1, heavy], pinned=[0, 1])
        scene.add_springs([[2, 3]], stiffness=1e5, damping=50.0, collides=True)
        yield Case(scene, VERLET, 1.0, 10)


def _glancing(rng: Rng, n: int) -> list[Case]:
    """Elastic balls, each of which glances off another one; a tolerance is asked for."""
    tolerance = float(rng.choice([1e-2, 1e-3]))
    dim = int(rng.integers(2, 4))
    scene = blank(dim, 0.0, restitution=1.0)
    for k in range(n):
        r = float(rng.uniform(0.02, 0.06))
        x, v = np.zeros((2, dim)), np.zeros((2, dim))
        x[:, 0] = 1.0 * (k % 4)
        x[:, 1] = 1.0 * (k // 4)
        x[1, 0] += rng.uniform(2.5, 4.0) * r
        x[1, 1] += rng.uniform(0.3, 1.8) * r
        v[0, 0] = rng.uniform(0.5, 2.0)
        scene.add_balls(x, radius=r, velocity=v, material="m")
    return [Case(scene, {**VERLET, "tolerance": tolerance}, 0.25, 1, alone=True)]


def _few(rng: Rng, n: int) -> Iterator[Case]:
    """A few balls of any kind that bounce, far from chaos, at one step: what every point of view must see alike."""
    dim = int(rng.integers(2, 4))
    g = float(rng.choice([0.0, 2.0, 10.0]))
    settings = {**VERLET, "dt": 2.0**-10, "substeps": 1}
    for _ in range(n):
        mu = float(rng.choice([0.0, rng.uniform(0.1, 0.8)]))
        scene = blank(dim, g, float(rng.choice([0.0, 1.0, rng.uniform(0, 1)])), mu)
        k = int(rng.integers(2, 5))
        r = rng.uniform(0.03, 0.08, k)
        x = scattered(rng, k, dim, 0.6) - 0.3
        scene.add_balls(x, radius=r, velocity=rng.normal(0, 1.5, x.shape), mass=log(rng, 0.3, 3.0, k), material="m")
        scene.add_wall(np.eye(dim)[1], -0.4, "m")
        yield Case(scene, settings, 0.35, 4)


def _slow(rng: Rng, n: int) -> Iterator[Case]:
    """Balls in no gravity, in metres a second or millimetres."""
    dim = int(rng.integers(2, 4))
    for _ in range(n):
        scene = blank(dim, 0.0, restitution=float(rng.uniform(0.5, 1.0)))
        r, speed = 0.05, float(log(rng, 0.02, 0.3))
        x, v = np.zeros((2, dim)), np.zeros((2, dim))
        x[1, 0], v[0, 0] = 2 * r + speed * 0.2, speed
        scene.add_balls(x, radius=r, velocity=v, material="m", mass=log(rng, 0.3, 3.0, 2))
        yield Case(scene, {**VERLET, "dt": 2.0**-10, "substeps": 1}, 0.5, 2)


# name: (draw, relations, scenes at once)
BOUNCES = {
    "elastic_crowd": (_elastic_crowd, ("energy_is_kept", "nothing_overlaps_far"), 6),
    "elastic_row": (_elastic_rows, ("energy_is_kept",), 60),
    "heavy_crowd": (_heavy_crowd, ("energy_is_kept", "nothing_overlaps_far"), 16),
    "column": (_columns, ("nothing_comes_back", "energy_never_grows"), 60),
    "cluster": (_clusters, ("energy_never_grows", "momentum_is_kept", "angular_momentum_is_kept"), 40),
    "neighbours": (_neighbours, ("comes_back_with_e", "energy_never_grows"), 28),
    "hollow_box": (_hollow_boxes, ("no_collider_is_entered", "energy_never_grows"), 60),
    "unequal_crowd": (_unequal, ("nothing_overlaps_far", "energy_never_grows"), 12),
    "held_by_a_stick": (_held, ("nothing_overlaps_far", "what_lies_rests"), 60),
    "glancing": (_glancing, ("tolerance_is_kept",), 12),
    "few_balls": (_few, (*VIEWS, "flat_in_3d", "energy_never_grows", "momentum_is_kept", *PROCESSES), 24),
    "slow_balls": (_slow, ("in_other_units", "energy_never_grows"), 60),
}
