"""One world with everything about sticks, run once for all tests that look at it: sticks are slow to compile.

Far from a crowd of 1000 balls, springs and sticks lie islands of one stick and one ball each, all hit in the first step.
"""

import functools
from types import SimpleNamespace

import numpy as np
import pytest
from physics_support import VARIANTS, simulate, vector

import taichi_sim as ts

CROWD, CROWD_STEPS, H = 1000, 40, 1e-3
PARAMETERS = (0.5, 0.25, 0.0)  # t of the worked numbers
RANDOM_HITS = 12
# sticks cost 10 to 20 s of compiling each, so not every pair of settings in both dimensions
STICK_CASES = [
    pytest.param((d, v), id=f"{d}d-{'-'.join(v)}", marks=marks)
    for d, v, marks in (
        (2, VARIANTS[0], pytest.mark.long),
        (2, VARIANTS[1], pytest.mark.long),
        (3, VARIANTS[0], pytest.mark.slow),
        (3, VARIANTS[3], ()),
    )
]


def _frame(rng, dim):
    """Two random unit vectors at right angles: along the stick, and away from it."""
    q, _ = np.linalg.qr(rng.normal(size=(dim, dim)))
    return q[:, 0], q[:, 1]


def _island(scene, place, along, n, t, gap, v, mass, material, pinned=False):
    """A stick of 1 m and a ball of radius 0.1 whose centre is `gap` from it at parameter t; returns (ball, one, two)."""
    x = [place + t * along + gap * n, place, place + along]
    b = scene.add_balls(x, radius=[0.1, 0.02, 0.02], velocity=v, mass=mass, material=material, pinned=pinned)
    scene.add_springs([b[1:]], stiffness=0.0, collides=True)
    return b


@functools.cache
def stick_scene(dim):
    rng = np.random.default_rng(11)
    scene = ts.Scene(dim=dim)
    at = SimpleNamespace(worked=[], random=[])
    for e in (0.0, 0.5, 1.0):
        scene.add_material(f"e{e}", restitution=e)
    scene.add_material("rough", restitution=0.5, friction=0.3)
    side = 4.0 if dim == 2 else 2.0
    x = rng.uniform(0, side, (CROWD, dim))
    at.crowd = scene.add_balls(
        x, radius=0.05, velocity=rng.normal(size=(CROWD, dim)), mass=10 ** rng.uniform(-1, 1, CROWD), material="rough"
    )
    near = [np.argsort(np.linalg.norm(x - x[i], axis=1))[1 + i % 8] for i in range(200)]
    pairs = np.array([(i, int(j)) for i, j in enumerate(near)])
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    scene.add_springs(pairs, stiffness=200.0, damping=0.5, collides=np.arange(len(pairs)) % 2 == 0)

    place = vector(dim, 10.0, -20.0, 3.0)
    step = vector(dim, 3.0)
    for t in PARAMETERS:
        along, n = _frame(rng, dim)
        at.worked.append((_island(scene, place, along, n, t, 0.09, [-n, 0 * n, 0 * n], 1.0, "e1.0"), n, t))
        place = place + step
    for k in range(RANDOM_HITS):
        along, n = _frame(rng, dim)
        t, e = rng.uniform(0.3, 0.7), (0.0, 0.5, 1.0)[k % 3]
        v = rng.normal(size=(3, dim)) - np.outer([3.0, 0, 0], n)
        b = _island(scene, place, along, n, t, 0.09, v, 10 ** rng.uniform(-2, 2, 3), f"e{e}")
        at.random.append((b, n, t, e))
        place = place + step
    along, n = _frame(rng, dim)
    at.pinned = (_island(scene, place, along, n, 0.5, 0.09, [-n, 0 * n, 0 * n], 1.0, "e1.0", [1, 2]), n)
    place = place + step
    along, n = _frame(rng, dim)  # beyond the end by more than both radii, but near the line through the stick
    at.beyond = (_island(scene, place, along, n, -0.2, 0.05, [-n, 0 * n, 0 * n], 1.0, "e1.0"), n)
    place = place + step
    along, n = _frame(
        rng, dim
    )  # three balls in an open V, two sticks meet at the middle one, which is hit from outside
    ends = [place, place + along - 0.5 * n, place - along - 0.5 * n]
    b = scene.add_balls(
        [place + 0.09 * n, *ends], radius=[0.1, 0.02, 0.02, 0.02], velocity=[-n, 0 * n, 0 * n, 0 * n], material="e1.0"
    )
    scene.add_springs([b[[1, 2]], b[[1, 3]]], stiffness=0.0, collides=True)
    at.joint = (b, n)
    return scene, at


@functools.cache
def stick_run(dim, variant):
    """States after one step and after CROWD_STEPS, and momentum."""
    scene, at = stick_scene(dim)
    with simulate(scene, variant, dt=H, contact_iterations=4) as sim:
        before = sim.velocity
        sim.step()
        one = SimpleNamespace(x=sim.position, v=sim.velocity)
        sim.step(CROWD_STEPS - 1)
        last = SimpleNamespace(x=sim.position, v=sim.velocity, p=sim.momentum(), energy=sim.energy())
        names = sim.kernels()
    return SimpleNamespace(scene=scene, at=at, before=before, one=one, last=last, names=names)
