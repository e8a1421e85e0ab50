"""Balls stored in another order than the scene's: nobody can tell."""

import numpy as np
import pytest
import taichi as ti
from physics_support import simulate

import taichi_sim as ts
from taichi_sim.device import spatial_sort

pytestmark = pytest.mark.long_in("f32")

H = 1e-3


@pytest.fixture
def always(monkeypatch):
    monkeypatch.setattr(spatial_sort, "FEWEST_SORTED", 1)


def test_small_scenes_and_those_with_springs_stay_as_they_are():
    scene = ts.Scene(dim=2)
    scene.add_balls(np.random.default_rng(0).uniform(size=(spatial_sort.FEWEST_SORTED - 1, 2)), radius=0.1)
    assert spatial_sort.spatial_order(scene) is None
    scene.add_balls([[0.0, 0.0]], radius=0.1)
    assert spatial_sort.spatial_order(scene) is not None
    scene.add_springs([[0, 1]], stiffness=1.0)
    assert spatial_sort.spatial_order(scene) is None


def test_neighbours_lie_near_each_other():
    rng = np.random.default_rng(1)
    x = rng.permutation(
        np.stack(np.unravel_index(np.arange(spatial_sort.FEWEST_SORTED), (200, 100)), axis=1).astype(float)
    )
    scene = ts.Scene(dim=2)
    scene.add_balls(x, radius=0.4)
    sorted_x = x[spatial_sort.spatial_order(scene)]
    assert np.median(np.linalg.norm(np.diff(sorted_x, axis=0), axis=1)) < 1.5


@pytest.mark.slow
def test_what_is_set_comes_back_and_bad_balls_are_named(always):
    rng = np.random.default_rng(2)
    n = 50
    scene = ts.Scene(dim=2)
    scene.add_balls(rng.uniform(-50, 50, (n, 2)).round(3), radius=0.01)
    with simulate(scene, dt=H) as sim:
        x, v = rng.integers(-50, 50, (n, 2)) + 0.5, rng.integers(-5, 5, (n, 2)) + 0.25
        sim.set_position(x)
        sim.set_velocity(v)
        assert np.array_equal(sim.position, x)
        assert np.array_equal(sim.velocity, v)
        v[31] = 1e11, 0.0
        sim.set_velocity(v)
        with pytest.raises(ts.UnstableError) as caught:
            sim.step(100_000)
        assert caught.value.ball == 31


@pytest.mark.long
def test_restored_with_the_same_bits(always, tmp_path):
    scene = ts.Scene(dim=2, gravity=(0.0, -9.81))
    scene.add_balls(
        np.random.default_rng(3).uniform(0, 9, (40, 2)), radius=0.005
    )  # apart: what contacts hold is not saved
    with simulate(scene, dt=H) as sim:
        sim.step(30)
        sim.save(tmp_path / "state.npz")
        sim.step(30)
        with ts.Simulation.restore(tmp_path / "state.npz") as again:
            again.step(30)
            assert np.array_equal(again.position, sim.position)


def test_own_forces_see_the_scenes_own_order(always):
    @ti.data_oriented
    class Nothing:
        @ti.func
        def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
            pass

    scene = ts.Scene(dim=2)
    scene.add_balls([[5.0, 0.0], [0.0, 0.0]], radius=0.1)
    with simulate(scene, forces=[Nothing()], dt=H) as sim:
        assert sim.parts.state.order is None
    with simulate(scene, dt=H) as sim:
        assert sim.parts.state.order.tolist() == [1, 0]
