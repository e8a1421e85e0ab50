"""SHA-256 of positions and velocities after 500 steps of scenes that together use every integrator, contact rule and kind of
body: run before and after a change that must not change results, on one machine.

    TAICHI_SIM_PRECISION=f32 python tests/support/reference_bits.py [NAME ...]

The hashes are not stored: they depend on how the machine multiplies and adds.
"""

import hashlib
import os
import sys
import warnings
from typing import Any

import numpy as np

import taichi_sim as ts

STEPS = 500


def _materials(scene):
    scene.add_material("rubber", restitution=0.5, friction=0.4)
    scene.add_material("ice", viscous_friction=3.0)
    scene.add_material("elastic", restitution=1.0)


def _box(scene, side, material):
    for axis in np.eye(scene.dim):
        scene.add_wall(axis, 0.0, material)
    for axis in np.eye(scene.dim)[[0, -1] if scene.dim == 3 else [0]]:
        scene.add_wall(-axis, -side, material)


def _crowd(dim, number, material="rubber", seed=0, radius=0.04):
    """Balls of unlike mass thrown about in a box."""
    rng = np.random.default_rng(seed)
    scene = ts.Scene(dim=dim, gravity=(0.0, -9.81, 0.0)[:dim])
    _materials(scene)
    _box(scene, 1.0, material)
    cells = np.stack(np.meshgrid(*[np.arange(8)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)[:number]
    x = 0.1 * (cells + 0.8) + rng.uniform(-0.01, 0.01, cells.shape)
    scene.add_balls(
        x, radius=radius, mass=rng.uniform(0.5, 2.0, len(x)), velocity=rng.normal(size=x.shape), material=material
    )
    return scene


def _network(dim, number=6, **springs):
    """A square lattice with diagonals, one row pinned."""
    scene = ts.Scene(dim=dim, gravity=(0.3, -9.81, 0.2)[:dim])
    _materials(scene)
    i, j = np.divmod(np.arange(number**2), number)
    x = np.zeros((number**2, dim))
    x[:, 0], x[:, 1] = 0.1 * i, 1.0 - 0.1 * j
    if dim == 3:
        x[:, 2] = 0.02 * np.sin(1.0 * i + 2.0 * j)
    balls = scene.add_balls(
        x, radius=0.03, mass=1.0 + 0.3 * np.sin(i + j), pinned=list(range(0, number**2, number)), material="rubber"
    )
    index = balls.reshape(number, number)
    sides = [(index[:-1], index[1:]), (index[:, :-1], index[:, 1:]), (index[:-1, :-1], index[1:, 1:])]
    pairs = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in sides])
    scene.add_springs(pairs, **{"stiffness": 2000.0, "damping": 2.0, **springs})
    return scene


def network_verlet():
    scene = _network(2)
    scene.add_wall((0, 1), 0.3, "rubber")
    return scene, {"dt": 1e-3}


def network_verlet_undamped():
    return _network(3, damping=0.0), {"dt": 5e-4}


def network_rk4():
    return _network(3), {"integrator": "rk4", "dt": 1e-3}


def network_explicit():
    return _network(2, stiffness=20.0), {"integrator": "explicit_euler", "dt": 1e-4, "contacts": "sum"}


def crowd_gauss_seidel():
    return _crowd(2, 60), {"dt": 1e-3}


def crowd_symplectic_3d():
    return _crowd(3, 120), {"dt": 1e-3, "integrator": "symplectic_euler", "spin": True}


def crowd_elastic():
    return _crowd(2, 40, "elastic", seed=2), {"dt": 1e-3}


def crowd_jacobi():
    return _crowd(3, 100, seed=3), {"dt": 1e-3, "contacts": "jacobi", "driver": "parallel"}


def crowd_sum():
    return _crowd(2, 50, "ice", seed=4), {"dt": 1e-3, "contacts": "sum"}


def sticks_and_colliders():
    scene = _crowd(2, 30, seed=5, radius=0.03)
    ends = scene.add_balls([[0.2, 0.9], [0.8, 0.95], [0.5, 0.95]], radius=0.03, mass=2.0, material="rubber")
    scene.add_springs([[ends[0], ends[1]]], stiffness=5000.0, damping=5.0, collides=True)
    scene.add_collider(ts.Box((0.5, 0.0), (0.2, 0.1), material="rubber", path=[(0, (0, 0)), (1, (0.1, 0.2))]))
    scene.add_collider(ts.Sphere((0.9, 0.1), 0.1, material="ice"))
    scene.add_collider(ts.Capsule((0.6, 0.5), (0.75, 0.4), 0.04, material="rubber"))
    return scene, {"dt": 1e-3}


def cloth_on_sphere():
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    _materials(scene)
    ts.shapes.cloth(
        scene,
        size=(0.6, 0.6),
        resolution=(12, 12),
        position=(-0.3, 0.42, -0.3),
        bending_stiffness=0.02,
        material="rubber",
    )
    scene.add_collider(ts.Sphere((0, 0.15, 0), 0.25, material="rubber"))
    scene.add_wall((0, 1, 0), 0.0, "rubber")
    return scene, {"dt": 1e-3}


def cloth_implicit():
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    ts.shapes.cloth(scene, size=(0.6, 0.6), resolution=(10, 10), stiffness=5000, damping=0.5, pinned=[0, 90])
    return scene, {"dt": 4e-3, "integrator": "implicit_euler"}


def jelly_on_floor():
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    _materials(scene)
    scene.add_wall((0, 1, 0), 0.0, "rubber")
    solid: dict[str, Any] = {"size": (0.4, 0.3, 0.3), "resolution": (5, 4, 4), "mass": 5.0, "material": "rubber"}
    ts.shapes.jelly(scene, position=(0, 0.1, 0), rotation=(10, 20, 30), **solid)
    return scene, {"dt": 1e-3}


def jelly_tr_bdf2():
    scene, _ = jelly_on_floor()
    return scene, {"dt": 2e-3, "integrator": "tr_bdf2"}


def balloon_xpbd():
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    _materials(scene)
    ts.shapes.balloon(scene, (0, 0.4, 0), 0.3, material="rubber")
    scene.add_wall((0, 1, 0), 0.0, "rubber")
    return scene, {"dt": 1e-3, "integrator": "xpbd"}


def surfaces():
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    _materials(scene)
    for k in range(2):
        ts.shapes.cloth(
            scene, size=(0.4, 0.4), resolution=(6, 6), position=(0.05 * k, 0.08 + 0.06 * k, 0.03 * k),
            self_collision=True, material="rubber",
        )  # fmt: skip
    scene.add_wall((0, 1, 0), 0.0, "rubber")
    return scene, {"dt": 1e-3}


def tearing_in_wind():
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    flag = ts.shapes.cloth(scene, size=(0.6, 0.4), resolution=(13, 9), rotation=(90, 0, 0), pinned=np.arange(9))
    scene.set_springs(flag.springs, break_strain=np.random.default_rng(7).uniform(0.02, 0.3, len(flag.springs)))
    scene.add_wind((12, 0, 2), gust=0.8, gust_length=1.0)
    return scene, {"dt": 1e-3}


def blocks_parallel():
    """More springs than run in one thread: blocks of the half list."""
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    ts.shapes.cloth(scene, size=(2, 2), resolution=(80, 80), pinned=[0, 79])
    return scene, {"dt": 1e-3, "contacts": "off"}


def adaptive():
    scene = _network(2, damping=1.0)
    return scene, {"tolerance": 1e-3}


SCENES = (
    network_verlet, network_verlet_undamped, network_rk4, network_explicit, crowd_gauss_seidel, crowd_symplectic_3d,
    crowd_elastic, crowd_jacobi, crowd_sum, sticks_and_colliders, cloth_on_sphere, cloth_implicit, jelly_on_floor,
    jelly_tr_bdf2, balloon_xpbd, surfaces, tearing_in_wind, blocks_parallel, adaptive,
)  # fmt: skip


def digest(build, precision, steps=STEPS):
    """SHA-256 of position and velocity after so many steps."""
    scene, settings = build()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with ts.Simulation(scene, arch="cpu", precision=precision, threads=2, **settings) as sim:
            sim.step(steps if "tolerance" not in settings else 20)
            x, v = sim.position, sim.velocity
    assert np.isfinite(x).all()
    return hashlib.sha256(x.tobytes() + v.tobytes()).hexdigest()


if __name__ == "__main__":
    precision = os.environ.get("TAICHI_SIM_PRECISION", "f32")
    for build in SCENES:
        if len(sys.argv) == 1 or build.__name__ in sys.argv[1:]:
            print(build.__name__, precision, digest(build, precision), flush=True)
