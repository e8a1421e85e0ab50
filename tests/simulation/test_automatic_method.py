"""A simulation whose integrator is "auto" says what it took, and goes on with it from a file."""

import pytest
from physics_support import simulate

import taichi_sim as ts
from taichi_sim.reports import check


@pytest.mark.slow
@pytest.mark.once
def test_it_says_what_it_took_and_a_state_keeps_it(tmp_path) -> None:
    scene = ts.Scene(dim=2, gravity=(0.0, -10.0))
    scene.add_balls([[0.0, 0.0], [0.7, 0.0]], radius=0.05, pinned=[0])
    scene.add_springs([[0, 1]], stiffness=1e6)
    with simulate(scene, integrator="auto", dt=0.01, contacts="off") as sim:
        words = sim.decisions()
        assert len(words) == 1
        assert words[0].startswith("implicit_euler by auto: the step of 0.01 s is beyond the bound of verlet, ")
        assert next(check.lines(sim)) == f"method                {words[0]}"
        sim.step(2)
        sim.save(tmp_path / "state.npz")
        with ts.Simulation.restore(tmp_path / "state.npz") as again:
            assert again.settings.integrator.method.name == "implicit_euler"
            assert again.dt == sim.dt
            sim.step(1)
            again.step(1)
            assert (again.position == sim.position).all()
