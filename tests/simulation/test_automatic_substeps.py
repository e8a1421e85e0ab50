"""Substeps "auto" of a step given by hand, without a simulation: what hangs, what folds, and what needs none."""

import numpy as np
import pytest

import taichi_sim as ts
from taichi_sim.analysis.methods import named
from taichi_sim.analysis.stability import SINKING, sinking_spring, sinking_step, stability
from taichi_sim.simulation.settings import Settings

pytestmark = pytest.mark.once


def substeps(scene, **given):
    settings = Settings.resolve(scene, given)
    return settings.time_step(scene, stability(scene, settings.integrator.method))[1]


def sheet(pinned=(), surface_collision=False, side=1.0):
    scene = ts.Scene(dim=3, gravity=(0, -9.81, 0))
    cloth = {
        "mass_per_area": 0.3,
        "stretch_stiffness": 2e3,
        "shear_stiffness": 500.0,
        "bending_rigidity": 0.0,
        "damping": 0.0,
    }
    ts.shapes.cloth(
        scene,
        size=(side, side),
        resolution=(20, 20),
        radius=0.004,
        surface_collision=surface_collision,
        pinned=pinned,
        **cloth,
    )
    return scene


def test_a_hanging_sheet_of_xpbd_gets_many_substeps_and_a_loose_one_few():
    """Pins carry the weight of the sheet, a spring between free balls that of one; 1 ms is the shortest automatic step."""
    hung, loose = sheet(pinned=[0, 19]), sheet()
    assert substeps(loose, integrator="xpbd", dt=1 / 50) == 2
    assert substeps(hung, integrator="implicit_euler", dt=1 / 50) == 1
    assert substeps(hung, integrator="xpbd", dt=1 / 50, substeps=1) == 1
    many = substeps(hung, integrator="xpbd", dt=1 / 50)
    assert many == int(np.ceil(1 / 50 / max(1e-3, sinking_step(hung)))) > 4
    assert substeps(hung, integrator="xpbd", dt=1e-3) == 1


def test_what_xpbd_leaves_too_long_by_the_weight_at_a_pin():
    """A chain of four on a pin: its first spring carries three balls, F h^2 w / 2."""
    scene = ts.Scene(dim=2, gravity=(0, -10))
    b = scene.add_balls([[0, -0.1 * k] for k in range(5)], radius=0.01, mass=0.5, pinned=[0])
    scene.add_springs([(b[k], b[k + 1]) for k in range(4)], stiffness=1e6)
    found = sinking_spring(scene, 0.02)
    assert (found.spring, found.ball) == (0, 1)
    assert found.load == pytest.approx(3 * 0.5 * 10)
    assert found.depth == pytest.approx(found.load * 0.02**2 * (1 / 0.5) / 2)
    assert sinking_spring(scene, 0.98 * sinking_step(scene)) is None
    deep = sinking_spring(scene, 1.02 * sinking_step(scene))
    assert deep.depth == pytest.approx(1.02**2 * SINKING * 0.1, rel=1e-3)


def test_surfaces_that_collide_close_by_at_most_their_thickness_in_a_substep():
    """Those that may fall by 1 m at 4.4 m/s are 8 mm thick."""
    free, folding = sheet(), sheet(surface_collision=True)
    for name in ("implicit_euler", "tr_bdf2"):
        assert not named(name).limit.by_springs
        assert substeps(free, integrator=name, dt=1 / 120) == 1
        assert substeps(folding, integrator=name, dt=1 / 120) == 5
        assert substeps(folding, integrator=name, dt=1 / 120, contacts="off") == 1
        assert substeps(folding, integrator=name, dt=1e-3) == 1
