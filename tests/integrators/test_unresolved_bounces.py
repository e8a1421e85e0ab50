"""Balls of elastic bodies do not bounce by themselves where a step does not resolve how they swing; all others do."""

import warnings

import numpy as np
import pytest
from physics_support import F64, simulate

import taichi_sim as ts
from taichi_sim.analysis.accuracy import Setup
from taichi_sim.analysis.methods import BUILT_IN_METHODS
from taichi_sim.analysis.preflight import cautions

LAW = {"mass_per_area": 0.25, "warp": 260.0, "weft": 230.0, "shear": 70.0, "coupling": 25.0, "bending_rigidity": 1e-5}
SPEED = 1.7  # m/s


@pytest.mark.slow
@pytest.mark.long_in("f64")  # which has no tolerance of its own
def test_a_sheet_bounces_across_itself_and_not_along():
    """An upright sheet gained half of its energy in one step, by balls thrown back against those behind them."""
    restitution, drop = 0.45, 0.55
    scene = ts.Scene(dim=3, gravity=(0.0, -9.81, 0.0))
    scene.add_material("skin", restitution=restitution)
    scene.add_wall((0.0, 1.0, 0.0), material="skin")
    sheet = {"radius": 0.01, "material": "skin", **LAW}
    ts.shapes.cloth(scene, (0.6, 0.54), (8, 7), position=(-0.3, drop, -0.3), rotation=(90, 0, 45), **sheet)
    flat = ts.shapes.cloth(scene, (0.6, 0.54), (8, 7), position=(2.0, drop, 0.0), **sheet).balls
    ball = scene.add_balls([[-2.0, drop, 0.0]], radius=0.01, mass=0.1, material="skin")
    scene.set_balls(body=1)  # none meets another
    h = 1 / 130
    with simulate(scene, integrator="tr_bdf2", dt=h, substeps=1) as sim:
        energy, height = [sim.energy()], []
        for _ in range(round(0.65 / h)):
            sim.step()
            energy.append(sim.energy())
            height.append([sim.position[one, 1].mean() for one in (flat, ball)])
    assert np.diff([one.total for one in energy]).max() < 1e-3 * max(one.kinetic for one in energy)
    risen = np.max(height[round(0.42 / h) :], axis=0) - 0.01
    assert risen == pytest.approx(restitution**2 * (drop - 0.01), rel=0.06)


def told(scene, method, h):
    """True if bodies that bounce by their elasticity alone are told of."""
    setup = Setup(BUILT_IN_METHODS[method], h, "f64", "gauss_seidel")
    return any("by their elasticity alone" in words for words in cautions(scene, setup))


@pytest.mark.once
@pytest.mark.parametrize(
    ("turned", "normal", "tells"), [(0, (0, 1, 0), False), (0, (0.3, 1, 0), True), (90, (0, 1, 0), True)]
)
def test_a_sheet_is_told_of_where_walls_press_along_it(turned, normal, tells):
    scene = ts.Scene(dim=3, gravity=(0.0, -9.81, 0.0))
    scene.add_material("skin", restitution=0.6)
    scene.add_wall(normal, material="skin")
    ts.shapes.cloth(
        scene,
        (0.6, 0.54),
        (8, 7),
        position=(2.0, 0.7, 0.0),
        rotation=(turned, 0, 0),
        radius=0.01,
        material="skin",
        **LAW,
    )
    assert told(scene, "tr_bdf2", 1 / 110) == tells
    scene.set_balls([0], velocity=(0.0, 0.1, 0.0))  # then it comes as it may
    assert told(scene, "tr_bdf2", 1 / 110)


def thrown(kind, scene=None, x=0.0):
    """A square of springs or of bricks that falls level on a wall."""
    if scene is None:
        scene = ts.Scene(dim=2)
        scene.add_material("gel", restitution=0.7)
        scene.add_wall((0, 1), material="gel")
    if kind == "springs":
        place = 0.12 * np.stack(np.meshgrid(*[np.arange(3.0)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
        i, j = np.triu_indices(9, 1)
        near = np.linalg.norm(place[i] - place[j], axis=1) < 0.18
        balls = scene.add_balls(place + np.array((x, 0.2)), mass=0.1, radius=0.02, material="gel")
        scene.add_springs(balls[np.stack([i, j], axis=1)[near]], stiffness=3e4)
    else:
        law = {"density": 25.0, "young_modulus": 3e4, "damping": 0.0}
        balls = ts.shapes.jelly(scene, (0.2, 0.2), (3, 3), position=(x, 0.2), radius=0.02, material="gel", **law).balls
    scene.set_balls(balls, velocity=(0.0, -SPEED))
    return scene, balls


@pytest.mark.slow
@pytest.mark.long_in("f64")
@pytest.mark.filterwarnings("ignore::UserWarning")  # springs gain energy in such steps, and a run says so
def test_by_xpbd_springs_keep_their_restitution_and_elements_do_not():
    """Its stages solve for elements alone, and so know of no other stiffness."""
    h, springs = 1 / 90, thrown("springs")[0]
    assert not told(springs, "xpbd", h)
    assert told(springs, "implicit_euler", h)
    bricks, jelly = thrown("bricks")
    assert told(bricks, "xpbd", h)
    scene, truss = thrown("springs", bricks, 2.0)
    with simulate(scene, integrator="xpbd", dt=h, substeps=1) as sim:
        fastest = np.full(2, -np.inf)
        for _ in range(round(0.15 / h)):
            sim.step()
            struck = sim.velocity[:, 1] > -0.99 * SPEED
            for k, balls in enumerate((truss, jelly)):
                if np.isinf(fastest[k]) and struck[balls].any():
                    fastest[k] = sim.velocity[balls, 1].max()
            if np.isfinite(fastest).all():
                break
    assert fastest[0] == pytest.approx(0.7 * SPEED, rel=1e-3)
    assert abs(fastest[1]) < 0.02 * SPEED


@pytest.mark.slow
def test_a_gain_without_restitution_is_told():
    """It was looked for where something bounces alone. An undamped jelly that landed flat gains when it lifts off."""
    scene = ts.Scene(dim=2)
    scene.add_wall((0, 1))
    law = {"density": 25.0, "young_modulus": 3e4, "damping": 0.0}
    ts.shapes.jelly(scene, (0.2, 0.2), (3, 3), position=(0.0, 0.02 + 2.1 * SPEED / 90), radius=0.02, **law)
    scene.set_balls(velocity=(0.0, -SPEED))
    with simulate(scene, integrator="tr_bdf2", dt=1 / 90, substeps=1) as sim:
        stored = [sim.energy()]
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            for _ in range(8):
                sim.step()
                stored.append(sim.energy())
        gain = np.diff([one.total for one in stored]).max() / max(one.kinetic for one in stored)
        assert sim.scales().gained == pytest.approx(gain, rel=0.05)
    assert gain > 0.05
    assert any("largest kinetic energy in one step" in str(one.message) for one in said)


@pytest.mark.long_in("f64")
@pytest.mark.slow_where(method="tr_bdf2")
@pytest.mark.parametrize("method", ["implicit_euler", "tr_bdf2"])
def test_a_light_ball_comes_back_from_a_stiff_block(method):
    """The step does not resolve the balls of the block, but these hardly move."""
    restitution, speed, h = 0.6, 2.0, 1 / 100
    place = 0.09 * np.stack(np.meshgrid(*[np.arange(3.0)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    i, j = np.triu_indices(9, 1)
    near = np.linalg.norm(place[i] - place[j], axis=1) < 0.13
    scene = ts.Scene(dim=2, gravity=(0.0, 0.0))
    scene.add_material("steel", restitution=restitution)
    balls = scene.add_balls(place, mass=0.1, radius=0.02, material="steel")
    scene.add_springs(balls[np.stack([i, j], axis=1)[near]], stiffness=3e4)
    struck = scene.add_balls([[0.09, 0.3]], velocity=(0.0, -speed), mass=1e-5, radius=0.02, material="steel")
    with simulate(scene, integrator=method, dt=h, substeps=1) as sim:
        stored = [sim.energy().total]
        for _ in range(12):
            sim.step()
            stored.append(sim.energy().total)
        after = sim.velocity[struck, 1]
    assert (
        np.diff(stored).max() < (1e-6 if F64 else 1e-3) * stored[0]
    )  # what rounding makes of places, times a stiffness
    assert after == pytest.approx(restitution * speed, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["implicit_euler", "tr_bdf2"])
def test_blocks_in_a_hollow_and_on_a_box_gain_no_energy(method):
    scene = ts.Scene(dim=2, gravity=(0.0, -9.81))
    scene.add_material("gel", restitution=0.5)
    scene.add_collider(ts.Sphere((0.0, 0.0), 0.6, hollow=0.1, material="gel"))
    scene.add_collider(ts.Box((3.0, -0.5), (2.0, 0.2), material="gel"))
    for x in (-0.1, 2.9):
        ts.shapes.jelly(
            scene, (0.3, 0.2), (5, 4), density=350.0, young_modulus=3.5e4, poisson_ratio=0.3, damping=0.0,
            position=(x, 0.0), rotation=25.0, material="gel",
        )  # fmt: skip
    h = 1 / 80
    with simulate(scene, integrator=method, dt=h, substeps=1) as sim:
        energy = [sim.energy()]
        for _ in range(round(0.8 / h)):
            sim.step()
            energy.append(sim.energy())
    assert np.diff([one.total for one in energy]).max() < 3e-3 * max(one.kinetic for one in energy)


@pytest.mark.slow
@pytest.mark.long_in("f64")
def test_a_gain_of_bodies_that_meet_is_told():
    """It was looked for where something bounces alone. Contacts stop balls of a cube after the stage, which strains it."""
    scene = ts.Scene(dim=3, gravity=(0.0, 0.0, 0.0))
    law = {"density": 800.0, "young_modulus": 2e5, "poisson_ratio": 0.3, "radius": 0.03}
    for k in range(2):
        balls = ts.shapes.jelly(scene, (0.1, 0.1, 0.1), (2, 2, 2), position=(0.0, 0.18 * k, 0.0), **law).balls
        scene.set_balls(balls, velocity=(0.0, 0.8 - 1.6 * k, 0.0))
    with simulate(scene, integrator="implicit_euler", dt=1 / 80, substeps=1) as sim:
        stored = [sim.energy()]
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            for _ in range(6):
                sim.step()
                stored.append(sim.energy())
        gain = np.diff([one.total for one in stored]).max() / max(one.kinetic for one in stored)
        assert sim.scales().gained == pytest.approx(gain, rel=0.05)
        momentum = scene.mass @ sim.velocity
    assert gain > 0.05
    assert np.abs(momentum).max() < 1e-5 * scene.mass.sum()
    told = [str(one.message) for one in said if "largest kinetic energy in one step" in str(one.message)]
    assert len(told) == 1
    assert "contacts between balls" in told[0]
