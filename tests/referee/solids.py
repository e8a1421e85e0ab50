"""Random scenes of balls on solid things that others stand for, and of colliders that move; and a bit of everything."""

from collections.abc import Iterator

import numpy as np

import taichi_sim as ts

from .agreement import PROCESSES, VIEWS
from .bounces import VERLET, blank, log, scattered, up
from .observe import Case

__all__ = ["SOLIDS"]

Rng = np.random.Generator
STEPS = {**VERLET, "dt": 2.0**-10, "substeps": 1}
FINE = {**VERLET, "dt": 2.0**-12, "substeps": 1}  # contacts of sticks and cloth are found at whole steps


def _matter(rng: Rng, dim: int, g: float, most: float = 1.0) -> ts.Scene:
    """A scene with gravity and a material m of any bounciness and friction."""
    e = float(rng.choice([0.0, most, rng.uniform(0.0, most)]))
    return blank(dim, g, e, float(rng.choice([0.0, rng.uniform(0.1, 0.8)])))


def _balls(rng: Rng, scene: ts.Scene, x: np.ndarray, v: np.ndarray) -> None:
    """Balls with radii, masses and materials of their own that do not see each other; m is what they meet."""
    scene.add_material("m", friction=1.0)
    body = scene.new_body()
    for k, (place, speed) in enumerate(zip(x, v)):
        e = float(rng.choice([0.0, 1.0, rng.uniform(0.0, 1.0)]))
        own = scene.add_material(f"b{k}", restitution=e, friction=float(rng.choice([0.0, rng.uniform(0.01, 0.6)])))
        r, mass = float(rng.uniform(0.03, 0.1)), float(log(rng, 0.1, 10.0))
        scene.add_balls([place], radius=r, velocity=speed, mass=mass, material=own, body=body)


def _thrown(rng: Rng, n: int) -> Iterator[Case]:
    """Balls thrown at a level wall, one by one; gravity pulls along it too."""
    dim = int(rng.integers(2, 4))
    gravity = up(dim, float(rng.choice([0.0, 5.0, 10.0])))
    gravity[0] = rng.uniform(-2.0, 2.0)
    for _ in range(n):
        scene = ts.Scene(dim, gravity)
        v = rng.normal(0.0, 2.0, (6, dim))
        v[:, 1] = -np.abs(v[:, 1])
        x = np.zeros((6, dim))
        x[:, 1] = rng.choice([0.0, 1.0], 6) * rng.uniform(0.0, 0.5, 6)
        _balls(rng, scene, x, v)
        scene.set_balls(position=scene.position + np.outer(scene.radius, np.eye(dim)[1]))
        scene.add_wall(np.eye(dim)[1], 0.0, "m")
        yield Case(scene, STEPS, 0.35, 14)


def _heaps(rng: Rng, n: int) -> Iterator[Case]:
    """Small crowds that come down on a level wall."""
    dim = int(rng.integers(2, 4))
    for _ in range(n):
        scene = _matter(rng, dim, 10.0, 0.5)
        k = int(rng.integers(5, 20))
        x = scattered(rng, k, dim, 0.5)
        v = rng.normal(0.0, 0.5, x.shape) + np.eye(dim)[0] * rng.uniform(0.0, 2.0)
        r = rng.uniform(0.4, 1.0, k) * 0.34 * 0.5 / np.ceil(k ** (1 / dim))
        scene.add_balls(x, radius=r, velocity=v, mass=(r / 0.05) ** dim, material="m")
        scene.add_wall(np.eye(dim)[1], 0.0, "m")
        yield Case(scene, VERLET, 0.3, 6)


def _on_sticks(rng: Rng, n: int) -> Iterator[Case]:
    """Balls that fall on a stick, a line that is pinned or moves, one by one. When a contact is noticed differs by a step, so
    that they differ from a capsule by a part of the motion that goes with the step: up to 0.033 of it at 1 / 4096 s."""
    dim, moves = int(rng.integers(2, 4)), rng.random() < 0.5
    g = float(rng.choice([0.0, 10.0]))
    for _ in range(n):
        scene = ts.Scene(dim, up(dim, g))
        x, v = np.zeros((6, dim)), np.zeros((6, dim))
        x[:, 0], x[:, 1] = rng.uniform(-0.2, 0.2, 6), 0.3
        v[:, 0], v[:, 1] = rng.uniform(-1.0, 1.0, 6), -rng.uniform(1.0, 3.0, 6)
        if dim == 3:
            x[:, 2] = rng.uniform(-0.02, 0.02, 6)
        _balls(rng, scene, x, v)
        slope, end = rng.uniform(-0.5, 0.5), np.zeros(dim)
        end[:2] = np.cos(slope), np.sin(slope)
        ends = scene.add_balls([-end, end], radius=0.001, pinned=True, material="m")
        scene.add_springs([ends], stiffness=1e3, collides=True)
        if moves:
            scene.add_moving_pins(ends, velocity=rng.uniform(-0.5, 0.5, dim))
        yield Case(scene, {**FINE, "dt": 0.5 * FINE["dt"]}, 0.35, 7)


def _on_cloth(rng: Rng, n: int) -> Iterator[Case]:
    """Balls that fall on a flat sheet that is pinned everywhere, however it is cut into triangles, level or not, one by one."""
    g = float(rng.choice([0.0, 10.0]))
    for _ in range(n):
        scene = ts.Scene(3, up(3, g))
        x, v = rng.uniform(-0.1, 0.1, (4, 3)), rng.uniform(-0.6, 0.6, (4, 3))
        x[:, 1], v[:, 1] = 0.3, -rng.uniform(1.0, 2.5, 4)
        _balls(rng, scene, x, v)
        k = int(rng.integers(2, 6))
        u, w = np.meshgrid(np.linspace(-0.6, 0.6, k + 1), np.linspace(-0.6, 0.6, k + 1), indexing="ij")
        flat = np.stack([u, np.zeros_like(u), w], axis=-1)
        flat[1:-1, 1:-1, ::2] += rng.uniform(-0.3, 0.3, (k - 1, k - 1, 2)) / k
        slope = rng.uniform(-0.4, 0.4)
        turn = np.array([[np.cos(slope), -np.sin(slope), 0], [np.sin(slope), np.cos(slope), 0], [0, 0, 1]])
        sheet = scene.add_balls(
            flat.reshape(-1, 3) @ turn.T, radius=0.01, pinned=True, material="m", body=scene.new_body()
        ).reshape(k + 1, k + 1)
        a, b, c, d = (sheet[i : k + i, j : k + j].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
        scene.add_triangles(np.concatenate([np.stack([a, c, b], axis=1), np.stack([a, d, c], axis=1)]), collides=True)
        yield Case(scene, FINE, 0.3, 6)


def _driven(rng: Rng, n: int) -> Iterator[Case]:
    """A few balls, far from chaos, and a collider that moves on, of any shape."""
    dim = int(rng.integers(2, 4))
    g = float(rng.choice([0.0, 10.0]))
    for _ in range(n):
        scene = _matter(rng, dim, g)
        velocity = rng.normal(0.0, 1.0, dim)
        kind = str(rng.choice(["box", "sphere", "capsule", "room", "shell"]))
        how = {"velocity": velocity, "material": "m"}
        inside = kind in ("room", "shell")
        origin, r = np.zeros(dim), rng.uniform(0.03, 0.08, 2)
        if kind == "box":
            scene.add_collider(ts.Box(origin, rng.uniform(0.2, 0.5, dim), **how))
        elif kind == "sphere":
            scene.add_collider(ts.Sphere(origin, float(rng.uniform(0.1, 0.3)), **how))
        elif kind == "capsule":
            end = rng.uniform(0.1, 0.2, dim)
            scene.add_collider(ts.Capsule(-end, end, float(rng.uniform(0.05, 0.1)), **how))
        elif kind == "room":
            scene.add_collider(ts.Box(origin, rng.uniform(0.6, 1.0, dim), hollow=0.2, **how))
        else:
            scene.add_collider(ts.Sphere(origin, float(rng.uniform(0.35, 0.5)), hollow=0.2, **how))
        if inside:  # thrown about
            x = np.array([[-0.12, 0.0, 0.0], [0.12, 0.05, 0.02]])[:, :dim]
            v = velocity + rng.normal(0.0, 1.0, (2, dim))
        else:  # from either side, at what comes along
            x = np.array([[-0.7, 0.0, 0.0], [0.7, 0.05, 0.02]])[:, :dim] + rng.uniform(-0.05, 0.05, (2, dim))
            v = velocity - 2.5 * x
        scene.add_balls(x, radius=r, velocity=v, mass=log(rng, 0.3, 3.0, 2), material="m")
        yield Case(scene, STEPS, 0.3, 12, weighed=True)


def _mixed(rng: Rng, n: int) -> Iterator[Case]:
    """Jelly, cloth, sticks and balls that fall together on a floor and a ball that turns."""
    for _ in range(n):
        scene = _matter(rng, 3, 10.0, 0.5)
        bounce = float(rng.uniform(0.0, 0.5))
        scene.add_material("jelly", restitution=bounce, friction=0.3)
        ts.shapes.jelly(scene, (0.2, 0.2, 0.2), (3, 3, 3), material="jelly", position=(0.0, 0.1, 0.0))
        ts.shapes.cloth(scene, (0.4, 0.4), (5, 5), mass_per_area=0.5, radius=0.02, position=(0.0, 0.5, 0.0))
        scene.add_balls(
            scattered(rng, 8, 3, 0.4) + np.array([-0.2, 0.6, -0.2]),
            radius=0.04,
            velocity=rng.normal(0, 0.5, (8, 3)),
            material="m",
        )
        ends = scene.add_balls([[0.4, 0.2, -0.2], [0.4, 0.3, 0.2]], radius=0.03, body=scene.new_body(), material="m")
        scene.add_springs([ends], stiffness=1e4, damping=1.0, collides=True)
        scene.add_wall((0, 1, 0), 0.0, "m")
        scene.add_collider(ts.Sphere((0.4, 0.0, 0.0), 0.12, rotation_rate=np.degrees((0.0, 3.0, 0.0)), material="m"))
        yield Case(scene, {**VERLET, "dt": 2.0**-10, "substeps": 2}, 0.25, 4)


# name: (draw, relations, scenes at once)
SOLIDS = {
    "thrown": (_thrown, ("wall_is_box_is_mesh", "wall_is_a_solid_that_moves"), 5),
    "heap": (_heaps, ("crowd_on_wall_box_mesh", "energy_never_grows"), 5),
    "on_a_stick": (_on_sticks, ("stick_is_a_thin_capsule",), 5),
    "on_pinned_cloth": (_on_cloth, ("pinned_cloth_is_a_mesh",), 4),
    "driven": (_driven, (*VIEWS, "momentum_with_the_colliders", "energy_with_the_work", *PROCESSES), 16),
    "mixed": (_mixed, ("fused_is_parallel", "one_thread_is_two"), 3),
}
