"""Simulations that are made, stepped and closed one after the other leave no memory behind, and compile once."""

import gc

import numpy as np
import pytest
from physics_support import simulate

import taichi_sim as ts
from taichi_sim.device.engine import ENGINE, ti

pytestmark = [pytest.mark.once, pytest.mark.skipif(ENGINE != "taichi", reason="it shares no kernels")]


def falling(k):
    scene = ts.Scene(dim=2, gravity=(0, -8))
    scene.add_wall((0, 1))
    scene.add_balls([[0, 1], [0.3 + 0.01 * k, 1.5]], radius=0.1, velocity=(0.1 * k, 0.0))
    return scene


def ends(k):
    with simulate(falling(k), dt=1e-3) as sim:
        sim.step(5)
        return sim.position, sim.velocity


def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1])


@pytest.mark.slow
def test_a_second_simulation_of_the_same_structure_compiles_nothing():
    ends(0)
    first, _ = ends(1), ends(2)  # the second sets fields to zero, by kernels of its own
    runtime = ti.lang.impl.get_runtime()
    before, pages = runtime.get_num_compiled_functions(), resident()
    for k in range(3, 40):
        ends(k)
    again = ends(1)
    assert runtime.get_num_compiled_functions() == before
    assert resident() <= 1.02 * pages
    for a, b in zip(first, again):
        assert np.array_equal(a, b)
    x, v = ends(7)
    assert np.allclose(v, [[0.7, -0.04]] * 2, atol=1e-6)
    assert np.isclose(x[1, 0], 0.37 + 0.7 * 0.005)


@pytest.mark.slow
def test_memory_of_a_simulation_that_was_dropped_serves_the_next_one():
    ends(0)
    runtime = ti.lang.impl.get_runtime()
    before = runtime.prog.get_snode_tree_size()
    for k in range(3):
        sim = simulate(falling(k), dt=1e-3)
        sim.step(5)
        del sim
        gc.collect()
    assert runtime.prog.get_snode_tree_size() == before


@pytest.mark.slow
def test_what_was_placed_once_is_not_placed_again(monkeypatch):
    """It would stay in the engine's memory until the process ends."""
    ends(0)

    def refuse():
        raise AssertionError("placed again")

    monkeypatch.setattr(ti, "FieldsBuilder", refuse)
    ends(1)
