"""Substeps "auto" of a step given by hand, without a simulation: what hangs, what folds, and what needs none."""

import numpy as np
import pytest

import taichi_sim as ts
from taichi_sim.analysis.accuracy import Setup, findings
from taichi_sim.analysis.frame import Contacts
from taichi_sim.analysis.late_impacts import late_rate
from taichi_sim.analysis.methods import named
from taichi_sim.analysis.stability import SINKING, sinking_spring, sinking_step, stability
from taichi_sim.outputs.summary import Summary
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


def test_what_damping_of_a_spring_adds_to_what_xpbd_leaves_it_too_long():
    """F (h^2 + h c / k) W / 2; a heavy ball under a light one on damped springs at rest."""
    scene = ts.Scene(dim=2, gravity=(0, -10))
    b = scene.add_balls([[0, 0], [0, -0.4], [0, -0.8]], radius=0.01, mass=[1.0, 0.04, 1.5], pinned=[0])
    scene.add_springs([(b[0], b[1]), (b[1], b[2])], stiffness=600.0, damping=15.0)
    h = 1 / 200
    found = sinking_spring(scene, h)
    assert found.spring == 1
    assert found.depth == pytest.approx(15.0 * (h**2 + h * 15.0 / 600.0) * (1 / 0.04 + 1 / 1.5) / 2)
    assert sinking_spring(scene, 0.98 * sinking_step(scene)) is None
    assert sinking_spring(scene, 1.02 * sinking_step(scene)) is not None
    with pytest.warns(UserWarning, match="too long"):
        sim = ts.Simulation(scene, integrator="xpbd", dt=h, substeps=1)
    with sim:
        sim.run(8.0)
        extra = sim.position[1, 1] - sim.position[2, 1] - 0.4 - 15.0 / 600.0
    assert extra == pytest.approx(found.depth, rel=0.15)


def test_surfaces_that_collide_close_by_at_most_their_thickness_in_a_substep():
    """Those that may fall by 1 m at 4.4 m/s are 8 mm thick."""
    free, folding = sheet(), sheet(surface_collision=True)
    for name in ("implicit_euler", "tr_bdf2"):
        assert not named(name).limit.by_springs
        assert substeps(free, integrator=name, dt=1 / 120) == 1
        assert substeps(folding, integrator=name, dt=1 / 120) == 5
        assert substeps(folding, integrator=name, dt=1 / 120, contacts="off") == 1
        assert substeps(folding, integrator=name, dt=1e-3) == 1


def crowd(speed, dim=2, radius=0.012, bullet=0.0, drift=0.0, count=64):
    """Balls with Gaussian velocities of this speed [m/s] of each component on a lattice in a world without gravity."""
    rng = np.random.default_rng(5)
    v = rng.normal(size=(count, dim))
    v -= v.mean(axis=0)
    v *= speed / max(1e-300, np.sqrt(np.mean(v**2)))
    v[0, 0] += bullet
    x = np.stack(np.unravel_index(np.arange(count), (count,) * dim), axis=1) * 3.0 * radius
    scene = ts.Scene(dim=dim)
    scene.add_balls(x, radius=radius, velocity=v + drift)
    return scene


@pytest.mark.parametrize(("dim", "wanted"), [(2, 3), (3, 5)])
def test_fast_crowds_get_substeps_in_which_they_move_little(dim, wanted):
    """1.6 m/s, 1 ms and 12 mm are 0.133 radii a step; a common velocity, and one fast ball, change nothing."""
    assert substeps(crowd(1.6, dim)) == wanted
    assert substeps(crowd(1.6, dim, drift=50.0)) == wanted
    assert substeps(crowd(1.6, dim), contacts="off") == 1
    assert substeps(crowd(1.6, dim), substeps=1) == 1
    assert substeps(crowd(1.6, dim), dt=1e-4) == 1
    assert substeps(crowd(0.3 / dim, dim)) == 1
    assert substeps(crowd(40.0, dim)) == 8
    assert substeps(crowd(0.0, dim, bullet=4.0, count=20_000 if dim == 2 else 4000)) == 1


def test_balls_that_meet_no_other_need_no_substeps():
    scene = crowd(1.6)
    for others, wanted in (("dust", 3), ("wall", 1), ([], 1)):
        dust = ts.Scene(dim=2)
        dust.add_balls(scene.position, radius=0.012, velocity=scene.velocity, group="dust", collides_with=others)
        dust.add_balls([[-1, -1]], radius=0.012, group="wall", pinned=[0])
        assert substeps(dust) == wanted


def test_check_and_summary_report_the_energy_that_impacts_miss():
    """0.133 radii a step in 2D: 0.442 of that, and a step for a hundredth."""
    scene, h = crowd(1.6), 1e-3
    (found,) = (
        one for one in findings(scene, Setup(named("verlet"), h, "f64", "gauss_seidel")) if "energy" in one.subject
    )
    assert "exchange 0.059 less" in found.what
    assert found.cure == "take substeps of 0.00017 s for 0.01"
    share = h * late_rate(scene, scene.velocity)
    run = Summary(contacts=Contacts(*(1,) * len(Contacts._fields)), most_contacts=1, late=(share, h))
    assert f"impacts      {found.what}; {found.cure}" in run.lines()
    run.late = 0.1 * share, h
    assert not any(line.startswith("impacts") for line in run.lines())
