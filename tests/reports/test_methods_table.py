"""The table of methods in `check`: the step that each takes, and what it costs."""

import pytest
from physics_support import simulate

import taichi_sim as ts
from taichi_sim.analysis.methods import BUILT_IN_METHODS
from taichi_sim.reports import check

pytestmark = pytest.mark.once


def rows(scene, **given):
    """By method: its safe step, that at present, the one that it takes, and its passes."""
    with simulate(scene, contacts="off", **given) as sim:
        lines = list(check.lines(sim))
    found = (line.replace(" s ", " ").split() for line in lines)
    return {words[0]: words[1:] for words in found if words and words[0] in BUILT_IN_METHODS and len(words) >= 5}


def pendulum():
    scene = ts.Scene(dim=2, gravity=(0, -9.0))
    scene.add_springs([scene.add_balls([[0, 0], [0.8, 0]], radius=0.04, pinned=[0])], stiffness=2e3)
    return scene


def test_it_has_the_same_rows_with_the_steps_that_methods_take():
    """Whichever is in use; a step that is given is of that one alone."""
    by_default = rows(pendulum())
    assert set(by_default) == set(BUILT_IN_METHODS)
    for name in ("symplectic_euler", "rk4", "tr_bdf2"):
        assert rows(pendulum(), integrator=name) == by_default
        with simulate(pendulum(), contacts="off", integrator=name) as sim:
            assert f"{sim.dt / sim.substeps:.4g}" in by_default[name]
    given = rows(pendulum(), dt=3e-4)
    assert given.pop("verlet") != by_default.pop("verlet")
    assert given == by_default


def test_it_is_there_and_says_what_implicit_methods_cost_where_auto_takes_one():
    scene = ts.Scene(dim=3, gravity=(0, -9.0, 0))
    ts.shapes.net(scene, size=(0.9, 0.8), meshes=(11, 12), stiffness=6e5, pinned="corners")
    found = rows(scene, integrator="auto")
    assert set(found) == set(BUILT_IN_METHODS)
    assert "0.008333" in found["implicit_euler"]
    for name in ("implicit_euler", "tr_bdf2", "xpbd"):
        assert found[name][-2] == "about"
    assert float(found["implicit_euler"][-1]) < float(found["verlet"][-1])
