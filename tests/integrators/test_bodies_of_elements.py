"""Bodies that elements join, in an implicit stage."""

import warnings

import numpy as np
import pytest
from physics_support import F64, simulate
from test_implicit_elements import Curve

import taichi_sim as ts

FABRIC = {"weft": 700.0, "shear": 60.0, "coupling": 100.0, "bending_rigidity": 5e-4, "mass_per_area": 0.3}
OTHERS = ({}, {"warp": 1e8, "speed": 30.0}, {"mass_per_area": 1e3, "speed": 0.0})


def sheets(other):
    """A sheet of triangles and, unless None, another one; elements join both to one pinned ball, which they list first."""
    scene = ts.Scene(dim=3, gravity=(0.0, -9.81, 0.0))
    scene.add_balls([(0.0, 0.0, 0.9)], radius=0.01, pinned=True)
    threes, stiffness = [], []
    for k, own in enumerate([{}] if other is None else [{}, other]):
        fabric = {"warp": 900.0, "speed": 1.0, **FABRIC, **own}
        speed, place = fabric.pop("speed"), (0.0, 0.0, k * 1.0)
        balls = ts.shapes.cloth(scene, (0.6, 0.8), (6, 6), position=place, damping=1e-3, **fabric).balls
        scene.set_balls(balls, velocity=speed * np.random.default_rng(k).normal(size=(len(balls), 3)))
        threes.append([0, *balls[:2]])
        stiffness.append(1e4 if k == 0 else 1e-2 * fabric["warp"])
    return scene, Curve(threes, stiffness)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_sheet_does_not_depend_on_another():
    """The bits are equal beside any other that hangs on the same ball, however stiff, heavy or fast that is, and alone."""
    found = []
    for other in (None, *OTHERS):
        scene, curve = sheets(other)
        with simulate(scene, forces=[curve], integrator="implicit_euler", dt=1 / 60, substeps=1, contacts="off") as sim:
            for kick in np.random.default_rng(9).normal(
                size=(5, 36, 3)
            ):  # the change of the step before is a bad guess now
                sim.set_velocity(np.concatenate([np.zeros((1, 3)), kick, sim.velocity[37:]]))
                sim.step(4)
            found.append(sim.position[:37])
    alone, first, *rest = found
    assert np.isfinite(alone).all()
    for other in rest:
        assert np.array_equal(other, first)
    assert first == pytest.approx(alone, rel=1e-10 if F64 else 1e-4)


@pytest.mark.once
def test_elements_join_their_free_balls_whichever_is_pinned():
    scene = ts.Scene(dim=3)
    scene.add_balls([(i, 0, 0) for i in range(8)], radius=0.1, pinned=[0, 6])
    curve = Curve([[0, 1, 2], [3, 0, 4], [5, 6, 0]], 1.0)  # ball 7 is lone
    with ts.Simulation(scene, forces=[curve], arch="cpu", integrator="implicit_euler", contacts="off") as sim:
        solver = sim.parts.integrator.solver
        held = solver.elements.held[0]
        start, corner = held.start.to_numpy(), held.corner.to_numpy()
    assert solver.bodies.body.tolist() == [0, 0, 0, 1, 1, 2, 2, 3]
    assert not solver.bodies.free.any()
    assert solver.bodies.joined.tolist() == [True, True, True, False]
    assert np.diff(start).tolist()[:8] == [0, 1, 0, 1, 0, 2, 0, 0]
    assert corner["ball"].tolist() == [0, 0, 0, 6]
    assert corner["entry"].tolist() == [0, 1, 2, 0]


@pytest.mark.slow
def test_compiling_says_nothing(capfd):
    scene = ts.Scene(dim=3, gravity=(0.0, -9.81, 0.0))
    ts.shapes.cloth(scene, (0.5, 0.4), (9, 7), position=(-0.25, 0.32, -0.2), damping=1e-3, warp=400.0, **FABRIC)
    scene.add_collider(ts.Sphere(center=(0.0, 0.2, 0.0), radius=0.1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with simulate(scene, integrator="implicit_euler", dt=0.01) as sim:
            sim.step(2)
    assert capfd.readouterr() == ("", "")
