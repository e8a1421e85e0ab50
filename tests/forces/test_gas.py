"""Gas and the methods for stiff springs: both act at the places where a step ends."""

from dataclasses import replace

import numpy as np
import pytest
from physics_support import F64, simulate
from test_elements import elastic_forces

import taichi_sim as ts
from taichi_sim.analysis.element_rates import Declared
from taichi_sim.analysis.methods import named
from taichi_sim.analysis.stability import explicit_parts, stability
from taichi_sim.device.engine import ti
from taichi_sim.integrators.implicit_euler import ImplicitEuler
from taichi_sim.reports.check import _limited

pytestmark = pytest.mark.long_in("f32")

STIFF = ("implicit_euler", "xpbd", pytest.param("tr_bdf2", marks=pytest.mark.long))


def balloon(subdivisions: int, radius: float, **settings) -> ts.Scene:
    scene = ts.Scene(dim=3)
    ts.shapes.balloon(scene, (0, 0, 0), radius, subdivisions, **settings)
    return scene


def test_a_gas_resists_by_its_pressure_over_its_volume():
    """p V is kept, so that -dp / dV is (p + outside) / V, which methods that solve for gas take for its stiffness."""
    scene = balloon(1, 0.3)
    scene.gases[0] = replace(scene.gases[0], outside=35.0)
    volume = scene.gases[0].volume
    with simulate(scene, dt=1e-4, integrator="symplectic_euler", contacts="off") as sim:
        sim.step()
        (gases,) = sim.parts.forces.elements
        pressure, rate = gases.pressure.to_numpy()[0], gases.rate.to_numpy()[0]
    assert pressure > 1.0
    assert rate == pytest.approx((pressure + 35.0) / volume, rel=1e-9 if F64 else 1e-5)


@ti.kernel
def choose_step(solver: ti.template()):
    solver._choose_step(0)


def test_only_the_first_direction_of_negative_curvature_is_followed():
    """Down its slope, which others of the search need not lead; either ends it."""
    with simulate(balloon(0, 0.2), dt=1e-3, integrator="implicit_euler", contacts="off") as sim:
        solver = sim.parts.integrator.solver
        for searches, curvature, step in ((0, -2.0, 1.5), (1, -2.0, 0.0), (1, 4.0, 0.75)):
            solver.number[0].searches = searches
            solver.part.descent.fill(0.0)
            solver.part.curvature.fill(0.0)
            solver.part[0].descent, solver.part[0].curvature = 3.0, curvature
            choose_step(solver)
            assert (solver.number[0].step, solver.number[0].saddle) == (step, curvature < 0.0)


@pytest.mark.parametrize("method", STIFF)
@pytest.mark.slow_where(method="implicit_euler")
def test_a_turning_balloon_keeps_its_angular_momentum(method):
    """But for what the method itself takes: turning at W, implicit Euler leaves 1 / (1 + h^2 W^2) of it in a step. Gas that acts
    at old places took 1 / (1 + 3 h^2 p R / (M R^2 / (4 pi R^2))), nine tenths of it in half a second."""
    spin, scene = 4.0, balloon(1, 0.25, pressure=120.0, mass=0.06)
    scene.set_balls(velocity=np.cross([0.0, spin, 0.0], scene.position))
    with simulate(scene, integrator=method, contacts="off") as sim:
        start, h = sim.angular_momentum()[1], sim.dt / sim.substeps
        sim.run(0.5)
        kept = sim.angular_momentum()[1] / start
    own = (1.0 + (h * spin) ** 2) ** (-0.5 / h)
    assert h > 2e-4
    assert (0.999 if method == "tr_bdf2" else own - 0.003) < kept < 1.003


@pytest.mark.slow
@pytest.mark.parametrize("method", STIFF)
@pytest.mark.long_where(method="implicit_euler")
def test_a_balloon_held_at_its_side_falls_as_by_verlet(method):
    """A quarter of a turn about the ball that is held."""
    lowest = {}
    for name in ("verlet", method):
        scene = balloon(1, 0.12, pressure=500.0, mass=0.004)
        scene.gravity = np.array([0.0, -9.81, 0.0])
        scene.set_balls(np.argmax(scene.position[:, 0]), pinned=True)
        with simulate(scene, integrator=name, contacts="off") as sim:
            sim.run(0.2)
            lowest[name] = float(sim.position[:, 1].mean())
    assert lowest["verlet"] < -0.07
    assert lowest[method] == pytest.approx(lowest["verlet"], rel=0.02)


@pytest.mark.slow
def test_a_step_of_implicit_euler_solves_its_equations_with_gas():
    """m (v' - v) = h F(x'), springs and gas at the new places, h far beyond what explicit gas would bear; two gases in one."""
    scene = balloon(0, 0.2, pressure=300.0, mass=0.002)
    faces = scene.gases[0].triangles
    scene.add_gas(faces, pressure=50.0, outside=1e4)
    scene.set_springs(damping=0.0)  # no part of the energy
    rng = np.random.default_rng(3)
    scene.set_balls(velocity=rng.normal(size=scene.velocity.shape))
    h = 10.0 * stability(scene, named("verlet")).dt_any_shape
    v = scene.velocity.copy()
    with simulate(scene, integrator=ImplicitEuler(1e-9 if F64 else 1e-4), dt=h, substeps=1, contacts="off") as sim:
        sim.step()
        x, change = sim.position, scene.mass[:, None] * (sim.velocity - v)
        found = sim.solver()
    force = elastic_forces(scene, x)
    scale = np.abs(change).max()
    assert scale > 0.1 * np.abs(scene.mass[:, None] * v).max()
    np.testing.assert_allclose(change, h * force, atol=scale * (1e-5 if F64 else 1e-2))
    assert found.misses == 0
    assert found.passes < 400


@pytest.mark.once
def test_gas_limits_the_methods_that_leave_it_where_it_was():
    scene = balloon(1, 0.12, pressure=500.0, mass=0.004)
    for name in ("implicit_euler", "tr_bdf2"):
        assert stability(scene, named(name)).dt_any_shape == np.inf
    assert stability(scene, named("verlet")).dt_any_shape < 2e-3


@pytest.mark.once
def test_what_limits_a_step_is_named_wherever_it_is_limited():
    """Of one part and of several, and of gas that a method solves for but lets push only once in a step."""
    scene = balloon(1, 0.12, pressure=700.0, mass=0.004)
    for method, parts in (("xpbd", "the push of the gases"), ("verlet", "gases"), ("rk4", "gases")):
        assert explicit_parts(scene, named(method), Declared()) == parts
    assert "xpbd takes the push of the gases explicitly, which allows it steps of " in "\n".join(
        _limited(scene, Declared())
    )
    with simulate(scene, integrator="xpbd", contacts="off", dt=1e-4) as sim:
        assert (
            sim._stepper.checks.limiting(-1, 0.5)
            == "xpbd takes the push of the gases explicitly, which limits it to 0.5 s"
        )
