"""Random scenes of cloth and jelly as continua: membranes, bricks, solids, cells, bending and gas, free, held, landing, torn and
driven, by every method."""

from itertools import permutations, product
from typing import Any

import numpy as np

import taichi_sim as ts
from taichi_sim.geometry.spheres import icosphere

from .bodies import ground
from .bounces import blank, log
from .observe import Case, auto_dt

__all__ = ["CONTINUA"]

Rng = np.random.Generator
SHEETS, VOLUMES = ("woven", "mesh", "springs"), ("bricks", "solids", "cells")
IMPLICIT = ("implicit_euler", "implicit_euler", "tr_bdf2")
MOST_STEPS = 2000


# Objects, about 0.3 m wide from the origin ----------------------------------------------------------------------------


def _threads(rng: Rng) -> dict[str, Any]:
    """A fabric."""
    warp, weft = log(rng, 20.0, 2000.0), float(rng.uniform(0.3, 1.0))
    return {
        "mass_per_area": float(log(rng, 0.1, 0.5)),
        "warp": float(warp),
        "weft": float(warp * weft),
        "shear": float(warp * log(rng, 0.02, 0.4)),
        "coupling": float(warp * np.sqrt(weft) * rng.uniform(-0.2, 0.5)),
        "warp_angle": float(rng.uniform(0.0, 90.0)),
        "bending_rigidity": float(log(rng, 1e-6, 1e-3)),
    }


def _disc(rng: Rng) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of an uneven disc in the x-z plane: one ball, five around it, ten around these."""
    turns = [np.arange(5) / 5, np.arange(10) / 10]
    flat = np.concatenate([[[0.0, 0.0]], *(r * np.stack([np.cos(a), np.sin(a)], 1) for r, a in
                                           zip((0.08, 0.16), (2 * np.pi * t for t in turns)))])  # fmt: skip
    flat[:6] += rng.uniform(-0.015, 0.015, (6, 2))
    inner = [(0, 1 + k, 1 + (k + 1) % 5) for k in range(5)]
    outer = []
    for k in range(5):
        a, b = 1 + k, 1 + (k + 1) % 5
        c, d, e = 6 + 2 * k, 7 + 2 * k, 6 + (2 * k + 2) % 10
        outer += [(a, c, d), (a, d, b), (b, d, e)]
    x = np.stack([flat[:, 0], np.zeros(len(flat)), flat[:, 1]], axis=1)
    return x, np.array([*inner, *outer])[:, ::-1]


def _lattice(scene: ts.Scene, number: tuple[int, ...], spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Places of a lattice of balls, and corners of the simplices that its boxes are cut into."""
    dim = scene.dim
    index = np.arange(int(np.prod(number))).reshape(number)
    x = np.stack(np.meshgrid(*map(np.arange, number), indexing="ij"), axis=-1).reshape(-1, dim) * spacing
    simplices = []
    for first in product(*(range(n - 1) for n in number)):
        for order in permutations(range(dim)):
            path = [np.array(first)]
            for axis in order:
                path.append(path[-1] + np.eye(dim, dtype=int)[axis])
            simplices.append([index[tuple(place)] for place in path])
    return x, np.array(simplices)


def _volume(rng: Rng, scene: ts.Scene, kind: str) -> np.ndarray:
    """A block of jelly, of so many balls along x as chance has it."""
    dim = scene.dim
    number, spacing = (int(rng.integers(2, 5)), 2, 2)[:dim], 0.1
    law = {"young_modulus": float(log(rng, 5e3, 1e6)), "poisson_ratio": float(rng.choice([0.0, 0.3, 0.45, 0.49]))}
    density = 1000.0 * spacing ** (3 - dim)
    if dim == 2:
        law["young_modulus"] *= spacing
    if kind == "bricks":
        size = [(n - 1) * spacing for n in number]
        made = ts.shapes.jelly(scene, size, number, density=density, **law, radius=0.03, material="m")
        return made.balls
    x, simplices = _lattice(scene, number, spacing)
    mass = density * spacing**dim * (len(simplices) / len(list(permutations(range(dim))))) / len(x)
    balls = scene.add_balls(x, radius=0.03, mass=mass, material="m", body=scene.new_body())
    if kind == "solids":
        viscosity = float(rng.choice([0.0, 0.01])) * law["young_modulus"]
        scene.add_solids(balls[simplices], **law, viscosity=viscosity)
        return balls
    sides = np.concatenate([simplices[:, [i, j]] for i in range(dim + 1) for j in range(i)])
    pairs = np.unique(np.sort(sides, axis=1), axis=0)
    stiffness = law["young_modulus"] * spacing ** (dim - 2)
    scene.add_springs(
        balls[pairs], stiffness=stiffness, damping=float(rng.uniform(0.0, 0.1) * np.sqrt(stiffness * mass))
    )
    bulk = law["young_modulus"] * float(log(rng, 0.3, 3.0))
    scene.add_cells(balls[simplices], bulk_modulus=bulk, crush_modulus=bulk)
    return balls


def _sheet(rng: Rng, scene: ts.Scene, kind: str, **more: Any) -> np.ndarray:
    if kind == "springs":
        law = {"mass_per_area": 0.2, "stretch_stiffness": float(log(rng, 20.0, 1000.0)), "bending_rigidity": 1e-4}
    else:
        law = _threads(rng)
    cut = {"mesh": _disc(rng)} if kind == "mesh" else {"size": (0.3, 0.25), "resolution": (4, 4)}
    return ts.shapes.cloth(scene, **cut, **law, radius=0.02, material="m", **more).balls


def _skin(rng: Rng, scene: ts.Scene) -> np.ndarray:
    """A ball of membranes, whose gas has about the pressure that is outside."""
    surface = icosphere(0)
    mesh = (0.15 * surface.vertices, surface.triangles)
    law = _threads(rng) | {"bending_rigidity": 1e-5}
    made = ts.shapes.cloth(scene, mesh=mesh, **law, radius=0.02, material="m")
    scene.add_gas(
        made.triangles, pressure=float(rng.uniform(0.0, 0.5) * law["warp"]), outside=float(rng.choice([0.0, 1e3]))
    )
    return made.balls


def _object(rng: Rng, scene: ts.Scene, kind: str, **more: Any) -> np.ndarray:
    """The balls of one such thing; more: what a sheet alone takes."""
    if kind == "skin":
        return _skin(rng, scene)
    return _volume(rng, scene, kind) if kind in VOLUMES else _sheet(rng, scene, kind, **more)


def _moved(rng: Rng, scene: ts.Scene, balls: np.ndarray, height: float, tilt: float) -> None:
    """Turn what has just been made about its middle, by about `tilt` [rad], and put it with its lowest ball at a height [m]."""
    x = scene.position[balls]
    x = x - x.mean(axis=0)
    angle = rng.normal(0.0, tilt, 1 if scene.dim == 2 else 3)
    for k, axes in enumerate(((0, 1), (0, 2), (1, 2))[: len(angle)]):
        c, s = np.cos(angle[k]), np.sin(angle[k])
        turn = np.eye(scene.dim)
        turn[np.ix_(axes, axes)] = [[c, -s], [s, c]]
        x = x @ turn.T
    x[:, 1] += height - x[:, 1].min()
    scene.set_balls(balls, position=x)


# Scenes ---------------------------------------------------------------------------------------------------------------


def _kinds(rng: Rng, dim: int) -> list[str]:
    """The kinds of a batch: two, for all that a scene has is compiled."""
    known = VOLUMES if dim == 2 else (*SHEETS, *VOLUMES, "skin")
    return rng.choice(known, 2, replace=False).tolist()


def _timed(
    rng: Rng, scenes: list[ts.Scene], method: str, duration: float, samples: int = 6, coarsest: int = 6, **how: Any
) -> list[Case]:
    """Cases of all these, by one step: what is stable with all of them, or as long as a frame, of an implicit method."""
    settings: dict[str, Any] = {"integrator": method}
    if method == "auto":
        pass
    elif method not in IMPLICIT and not (method == "xpbd" and all(scene.n_springs == 0 for scene in scenes)):
        longest = 0.5 * min(auto_dt(Case(scene, settings, duration)) for scene in scenes)
        settings |= {"dt": float(2.0 ** np.floor(np.log2(longest))), "substeps": 1}
        duration = min(duration, MOST_STEPS * settings["dt"])
    else:
        settings["dt"] = 2.0 ** -float(rng.integers(coarsest, 10))
    return [Case(scene, settings, duration, samples, **how) for scene in scenes]


def _free(rng: Rng, n: int) -> list[Case]:
    """Thrown, turning, deformed; nothing else is there."""
    dim = int(rng.choice([2, 3, 3]))
    kinds, g = _kinds(rng, dim), float(rng.choice([0.0, 10.0]))
    method = str(rng.choice(["verlet", "rk4", "xpbd", *IMPLICIT]))
    scenes = []
    for k in range(n):
        scene = blank(dim, g)
        balls = _object(rng, scene, kinds[k % 2])
        _moved(rng, scene, balls, 0.0, 1.0)
        x = scene.position[balls]
        x = x - x.mean(axis=0)
        spin = rng.normal(0.0, 3.0, 3)
        turning = spin[0] * np.stack([-x[:, 1], x[:, 0]], axis=1) if dim == 2 else np.cross(spin, x)
        bent = 0.3 * rng.normal(0.0, 1.0, (dim, dim)) @ x.T
        scene.set_balls(balls, velocity=turning + bent.T * 3.0 + rng.normal(0.0, 0.5, dim))
        scenes.append(scene)
    return _timed(rng, scenes, method, 0.4, coarsest=8)  # so that tr_bdf2 resolves how they turn


def _held(rng: Rng, n: int) -> list[Case]:
    """Pinned at some balls, one of which may be led; wind."""
    dim = int(rng.choice([2, 3, 3]))
    kinds = _kinds(rng, dim)
    method = str(rng.choice(["verlet", "xpbd", *IMPLICIT]))
    windy, led = dim == 3 and rng.random() < 0.3, rng.random() < 0.4
    scenes = []
    for k in range(n):
        scene = blank(dim, 10.0)
        balls = _object(rng, scene, kinds[k % 2])
        pinned = balls[: int(rng.integers(1, 5))]
        scene.set_balls(pinned, pinned=True)
        if led:
            scene.add_moving_pins(pinned[:1], velocity=rng.normal(0.0, 0.2, dim))
        if windy:
            scene.add_wind((1.0, 0.5, 2.0))
        scenes.append(scene)
    return _timed(rng, scenes, method, 0.3)


def _landing(rng: Rng, n: int, two: bool = False) -> list[Case]:
    """One thing, or two that meet, that come down on a wall, a box, a mesh or a ball."""
    dim = int(rng.choice([2, 3, 3]))
    kinds = _kinds(rng, dim)
    kind = str(rng.choice(["wall", "box", "sphere"] if dim == 2 else ["wall", "box", "mesh", "sphere"]))
    method = str(rng.choice(["verlet", "xpbd", "auto", *IMPLICIT]))
    e = float(rng.choice([0.0, 0.5]))
    scenes = []
    for k in range(n if kind != "mesh" else 3):
        scene = blank(dim, 10.0, e, float(rng.choice([0.0, 0.5])))
        first = _object(rng, scene, kinds[k % 2])
        _moved(rng, scene, first, 0.03 + rng.uniform(0.0, 0.05), 0.3)
        scene.set_balls(first, velocity=np.r_[rng.normal(0.0, 0.5), -rng.uniform(0.0, 2.0), np.zeros(dim - 2)])
        if two:
            top = float(scene.position[first, 1].max())
            _moved(rng, scene, _object(rng, scene, kinds[k % 2]), top + 0.08, 0.3)
        if kind == "sphere":
            scene.add_collider(ts.Sphere(-0.3 * np.eye(dim)[1], 0.3, material="m"))
        else:
            ground(scene, kind, "m")
        scenes.append(scene)
    return _timed(rng, scenes, method, 0.3, weighed=kind != "wall")


def _meeting(rng: Rng, n: int) -> list[Case]:
    return _landing(rng, n, two=True)


def _resting(rng: Rng, n: int) -> list[Case]:
    """Let go just above a rough floor, for long."""
    dim = int(rng.choice([2, 3, 3]))
    kinds = _kinds(rng, dim)
    kind = str(rng.choice(["wall", "box"]))
    scenes = []
    for k in range(n):
        scene = blank(dim, 10.0, 0.0, 0.5)
        balls = _object(rng, scene, kinds[k % 2])
        _moved(rng, scene, balls, 0.035, 0.0)
        ground(scene, kind, "m")
        scenes.append(scene)
    return _timed(rng, scenes, "implicit_euler", 3.0, weighed=kind == "box")


def _torn(rng: Rng, n: int) -> list[Case]:
    """Sheets held at one side, with a load, that tear."""
    kind, method = str(rng.choice(SHEETS)), str(rng.choice(["verlet", *IMPLICIT]))
    scenes = []
    for _ in range(n):
        scene = blank(3, 10.0)
        balls = _object(rng, scene, kind, break_strain=float(rng.uniform(0.02, 0.2)))
        scene.set_balls(balls[:2], pinned=True)
        heavy = scene.add_balls(
            [scene.position[balls[-1]] + (0.0, -0.1, 0.0)], radius=0.02, mass=float(log(rng, 0.1, 3.0))
        )
        scene.add_springs([[balls[-1], heavy[0]]], stiffness=300.0)
        scenes.append(scene)
    return _timed(rng, scenes, method, 0.3)


def _driven(rng: Rng, n: int) -> list[Case]:
    """Muscles of springs beside a continuum that they pull at, on a collider that moves on."""
    dim = int(rng.choice([2, 3, 3]))
    kind, method = str(rng.choice(_kinds(rng, dim))), str(rng.choice(["verlet", *IMPLICIT]))
    moves = rng.random() < 0.6
    scenes = []
    for _ in range(n):
        scene = blank(dim, 10.0, 0.0, 0.4)
        balls = _object(rng, scene, kind)
        _moved(rng, scene, balls, 0.035, 0.0)
        pairs = np.stack([balls[:2], balls[-2:]], axis=1)
        muscles = scene.add_springs(pairs, stiffness=float(log(rng, 50.0, 500.0)), damping=0.5)
        scene.add_motor(muscles, amplitude=0.2, frequency=float(rng.uniform(1.0, 4.0)), phase=rng.uniform(0, 360, 2))
        how = {"velocity": 0.5 * rng.normal(0.0, 1.0, dim) * (np.arange(dim) != 1)} if moves else {}
        scene.add_collider(
            ts.Box(np.array([0.0, -0.5, 0.0])[:dim], np.array([3.0, 1.0, 3.0])[:dim], material="m", **how)
        )
        scenes.append(scene)
    return _timed(rng, scenes, method, 0.3, weighed=True)


SEEN = ("mirror", "quarter_turn", "elsewhere", "in_other_masses", "renumbered")  # all in one simulation
AGAIN = ("in_other_units", "steps_in_other_groups", "restored_goes_on", "fused_is_parallel")
LEDGERS = ("momentum_with_the_colliders", "energy_never_grows")

CONTINUA = {
    "free_continuum": (
        _free,
        (*SEEN, "in_a_moving_frame", "momentum_is_kept", "turning_is_kept_to_order_2", "energy_never_grows"),
        8,
    ),
    "held_continuum": (_held, (*SEEN, "in_a_moving_frame", "energy_never_grows"), 8),
    "landing_continuum": (_landing, (*SEEN, *LEDGERS), 8),
    "meeting_continuum": (_meeting, ("steps_in_other_groups", "fused_is_parallel", *LEDGERS), 8),
    "resting_continuum": (_resting, ("comes_to_rest", LEDGERS[0]), 12),
    "torn_continuum": (_torn, (*SEEN, *AGAIN[1:3]), 8),
    "driven_continuum": (_driven, ("elsewhere", "renumbered", "momentum_with_the_colliders", *AGAIN), 6),
    "landing_again": (_landing, AGAIN, 6),
    "held_again": (_held, AGAIN, 8),
}
