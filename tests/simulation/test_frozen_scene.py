"""What is done to a scene after a simulation was made of it does not act on the simulation, and it says so."""

import numpy as np
import pytest
from physics_support import simulate

import taichi_sim as ts

pytestmark = pytest.mark.once


def test_later_changes_of_a_scene_do_not_reach_its_simulation(tmp_path):
    scene = ts.Scene(dim=2, gravity=(0, -8))
    scene.add_balls([[0, 2], [0.5, 3]], radius=0.1)
    with simulate(scene, dt=1e-3, contacts="off") as sim:
        sim.step(10)
        before = sim.energy()
        scene.add_balls([[3, 3], [4, 4], [5, 5]], radius=0.2)
        scene.add_springs([[0, 1]], stiffness=10.0)
        scene.set_balls(mass=7.0)
        scene.add_wall((0, 1))
        scene.gravity = (0, 3)
        assert sim.energy() == before
        assert sim.frame().radius.shape == (2,)
        sim.save(tmp_path / "state.npz")
        with ts.Simulation.restore(tmp_path / "state.npz") as again:
            assert np.array_equal(again.position, sim.position)
            again.step(10)
            assert np.allclose(again.velocity[:, 1], -8 * 0.02, rtol=1e-5)
        with pytest.raises(
            ts.SceneError, match=r"^scene: got more balls, springs, walls after this simulation was made"
        ):
            sim.step(10)
        with pytest.raises(ts.SceneError, match="belongs to a simulation"):
            sim.scene.set_balls(mass=-1.0)
        with pytest.raises(ValueError, match="read-only"):
            sim.scene.mass[:] = -1.0
