"""Cloth and jelly of a material in Simulation: at rest where Newton's method finds them, and back from being squeezed flat."""

import numpy as np
import pytest
import taichi as ti
from physics_support import simulate
from statics import at_rest

from taichi_sim import Box, Scene, shapes
from taichi_sim.analysis.diagnostics import inverted
from taichi_sim.geometry.spheres import icosphere

pytestmark = pytest.mark.long_in("f32")


@ti.data_oriented
class Drag:
    """Slows every ball at the same rate [1/s]."""

    def __init__(self, rate):
        self.rate = rate

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        for i in range(model.n):
            if model.inverse_mass[i] > 0:
                impulse[i] += -h * self.rate / model.inverse_mass[i] * ball[i].v


def bar_and_strip():
    """A bar of jelly whose cells keep its volume, and a strip of cloth that bends, both held at one end."""
    scene = Scene(dim=3, gravity=(0, -10, 0))
    shapes.jelly(
        scene,
        (2.0, 0.4, 0.4),
        (11, 3, 3),
        young_modulus=2e5,
        poisson_ratio=0.4,
        density=100.0,
        pinned=list(range(9)),
    )
    shapes.cloth(
        scene,
        (0.6, 0.2),
        (10, 4),
        stretch_stiffness=100.0,
        bending_rigidity=1e-2,
        mass_per_area=0.1,
        position=(0, 2, 0),
        pinned=list(range(8)),
    )
    return scene


def test_bar_and_strip_come_to_rest_where_newton_finds_them(precision):
    scene = bar_and_strip()
    want, _ = at_rest(scene, most=1e-8)
    with simulate(scene, integrator="verlet", dt=1e-3, contacts="off", forces=[Drag(6.0)]) as sim:
        sim.run(12.0)
        off = np.linalg.norm(sim.position - want, axis=1)
    for part in (scene.body == 1, scene.body == 2):
        sag = np.linalg.norm(want - scene.position, axis=1)[part].max()
        assert sag > 0.02
        assert off[part].max() < (1e-6 if precision == "f64" else 2e-3) * sag


@pytest.mark.slow
def test_a_filled_ball_comes_back_from_being_squeezed_flat():
    """A piston presses it to a hundredth of its height, so that cells turn inside out, and leaves: after 1 s none is."""
    scene = Scene(dim=3)
    scene.add_wall((0, 1, 0))
    shapes.jelly(scene, mesh=icosphere(2), spacing=0.4, young_modulus=1e5, position=(0, 1.15, 0), radius=0.02)
    path = [(0.0, (0, 0, 0)), (0.2, (0, -2.1, 0)), (0.25, (0, -2.1, 0)), (0.35, (0, 0.8, 0)), (9.0, (0, 0.8, 0))]
    scene.add_collider(Box((0, 3.2, 0), (6, 2, 6), path=path))
    with simulate(scene, integrator="verlet", dt=1e-3) as sim:
        sim.run(0.24)
        assert np.ptp(sim.position[:, 1]) < 0.15
        assert inverted(scene, sim.position) > 0
        sim.run(1.01)
        assert inverted(scene, sim.position) == 0
        assert np.ptp(sim.position, axis=0) == pytest.approx(np.ptp(scene.position, axis=0), rel=0.3)
