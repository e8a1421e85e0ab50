"""Candidates of surfaces hold for some steps, and nothing depends on how long: a skin of 0 looks for them in every step."""

import hashlib

import numpy as np
import pytest
from physics_support import simulate

import taichi_sim as ts
from taichi_sim.contacts import triangles

pytestmark = pytest.mark.long_in("f64")

H, STEPS = 1e-3, 400


def scene(thrown):
    """A cloth that slides off a ball and folds on the floor: common motion, rest and fast motion come in turn. thrown: with a
    stick and balls thrown at it."""
    rng = np.random.default_rng(11)
    out = ts.Scene(dim=3, gravity=(0.0, -10.0, 0.0))
    out.add_material("cotton", friction=0.3)
    out.add_wall((0, 1, 0), offset=-0.12, material="cotton")
    out.add_collider(ts.Sphere((0.1, 0.0, 0.05), 0.1, material="cotton"))
    cloth = ts.shapes.cloth(
        out, size=(0.5, 0.5), resolution=(11, 11), surface_collision=True, material="cotton", stiffness=20.0
    )
    out.set_balls(cloth.balls, position=out.position[cloth.balls] + [-0.25, 0.13, -0.25])
    if thrown:
        _throw(out, rng)
    return out


def _throw(out, rng):
    stick = out.add_balls([[-0.2, 0.2, 0.0], [-0.2, 0.22, 0.1]], radius=0.01, mass=0.01)
    out.add_springs([stick], stiffness=100.0, collides=True)
    x = rng.uniform([-0.2, 0.3, -0.2], [0.2, 0.7, 0.2], (8, 3))
    out.add_balls(x, radius=0.015, mass=2e-3, velocity=[0.0, -3.0, 0.0])


@pytest.mark.parametrize("thrown", [True, False], ids=["beside-a-grid", "alone"])
@pytest.mark.long
def test_bits_do_not_depend_on_the_skin(monkeypatch, thrown):
    what = scene(thrown)
    runs, searches = [], []
    for skin in (triangles.SURFACE_SKIN, 0.0):
        monkeypatch.setattr(triangles, "SURFACE_SKIN", skin)
        with simulate(what, dt=H) as sim:
            bits = []
            for _ in range(STEPS // 50):
                sim.step(50)
                bits.append(hashlib.sha256(sim.position.tobytes() + sim.velocity.tobytes()).hexdigest())
            runs.append(bits)
            searches.append(sim.contacts().searches)
            assert sim.contacts().number > 20
    assert runs[0] == runs[1]
    if not thrown:  # else the grid, which is made in each step, is counted
        assert searches[0] < 0.6 * STEPS
        assert searches[1] >= STEPS
