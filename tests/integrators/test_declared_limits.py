"""What an integrator declares of itself: its stability limit, and what a simulation does where it declares none."""

import warnings

import numpy as np
import pytest
from own_methods import Declared, Silent
from physics_support import PRECISION

import taichi_sim as ts
from taichi_sim.analysis.methods import BUILT_IN_METHODS
from taichi_sim.analysis.stability import stability
from taichi_sim.integrators import BUILT_IN
from taichi_sim.reports import check


def pair(damping=0.0):
    """Two balls of 1 kg on a spring of 1e6 N/m: omega^2 = 2e6 / s^2."""
    scene = ts.Scene(dim=2)
    b = scene.add_balls([[0.0, 0.0], [1.1, 0.0]], radius=0.1)
    scene.add_springs([b], stiffness=1e6, damping=damping, rest_length=1.0)
    return scene


def simulation(scene, integrator, **settings):
    return ts.Simulation(scene, integrator=integrator, arch="cpu", precision=PRECISION, contacts="off", **settings)


@pytest.mark.parametrize("settings", [{}, {"dt": "auto"}, {"tolerance": 1e-3}], ids=str)
def test_without_a_declared_limit_no_step_is_chosen(settings):
    with pytest.raises(ValueError, match=r"silent declares no stability limit.*limit=StabilityLimit\(") as said:
        simulation(pair(), Silent(), **settings)
    assert "\n" not in str(said.value)


def test_without_a_declared_limit_a_given_step_is_taken_and_nothing_said_of_a_bound():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with simulation(pair(), Silent(), dt=1e-4) as sim:
            sim.step(300)
            assert 0.7 < np.ptp(sim.position[:, 0]) < 1.11
            found = sim.stability()
            report = "\n".join(check.lines(sim))
            with pytest.raises(ValueError, match="declares no stability limit"):
                sim.set_dt("auto")
    assert "declares no stability limit" in found.reason
    assert found.spring is None
    assert "declares no stability limit" in report
    assert "no spring limits the step" not in report


def test_a_declared_limit_is_the_bound_and_the_automatic_step():
    with simulation(pair(), Declared()) as sim:
        bound = 2.0 / np.sqrt(2e6)
        assert sim.stability().dt_any_shape == pytest.approx(bound)
        assert sim.dt == pytest.approx(0.4 * bound)  # undamped, and symplectic
        sim.step(300)
        assert np.isfinite(sim.position).all()
    with pytest.warns(UserWarning, match="above the safe bound"):
        simulation(pair(), Declared(), dt=2e-3).close()
    assert stability(pair(500.0), Declared.method) == stability(
        pair(500.0), BUILT_IN_METHODS["symplectic_euler"]
    )._replace(reason=stability(pair(500.0), Declared.method).reason)


@pytest.mark.parametrize("limit", [(0.0, 2.0), (2.0, -1.0), (float("nan"), 1.0)])
def test_a_limit_is_positive(limit):
    with pytest.raises(ValueError, match="limit: "):
        ts.StabilityLimit(*limit)


@pytest.mark.parametrize("method", BUILT_IN_METHODS.values(), ids=str)
def test_declarations_belong_to_the_classes(method):
    """Each built-in method is declared once, by the class that carries it out."""
    assert [kind.method for kind in BUILT_IN].count(method) == 1
    assert method.limit is not None


@pytest.mark.parametrize("method", [m for m in BUILT_IN_METHODS.values() if m.limit.by_springs], ids=str)
@pytest.mark.parametrize("damping", [0.0, 20.0, 500.0])
def test_the_bound_is_where_the_declared_amplification_grows(method, damping):
    """Of one spring, undamped, weakly and strongly damped, limit and amplification say the same."""
    scene = pair(damping)
    h = stability(scene, method).dt_any_shape
    if h == 0.0:
        h, growth = 1e-6, 1.0
    else:
        growth = np.abs(np.linalg.eigvals(method.amplification(scene, np.sqrt(2e6), 2.0 * damping, 0.99 * h))).max()
        assert growth <= 1.0 + 1e-9
    beyond = np.abs(np.linalg.eigvals(method.amplification(scene, np.sqrt(2e6), 2.0 * damping, 1.5 * h))).max()
    assert beyond > growth
