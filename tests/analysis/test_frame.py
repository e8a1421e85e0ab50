"""Frames of a simulation compute what takes long when they are asked for it, of their own moment."""

import numpy as np
import pytest

import taichi_sim as ts
from taichi_sim.analysis import diagnostics
from taichi_sim.outputs import export

pytestmark = pytest.mark.once


def scene():
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_balls([[0, 0], [1, 0], [2, 0]], radius=0.1, pinned=[0])
    scene.add_springs([[0, 1], [1, 2]], stiffness=100.0)
    return scene


@pytest.mark.slow
def test_energy_and_strain_belong_to_the_moment():
    with ts.Simulation(scene(), dt=1e-3) as sim:
        sim.step(50)
        frame, energy = sim.frame(), sim.energy()
        strain = diagnostics.strain(sim.scene, sim.position)
        sim.step(50)
        assert frame.energy == energy
        assert np.array_equal(frame.strain, strain)
        assert frame.energy is frame.energy
        assert sim.frame().energy != energy
        frame.strain = np.zeros(2)
        assert frame.strain.tolist() == [0, 0]


@pytest.mark.slow
def test_nothing_is_computed_that_nobody_asks_for(monkeypatch):
    """A summary needs the energy of the first and the last frame."""
    asked = []
    energy = diagnostics.energy
    monkeypatch.setattr(diagnostics, "energy", lambda *given: asked.append(1) or energy(*given))
    monkeypatch.setattr(diagnostics, "strain", lambda *given: pytest.fail("nobody asked for the strain"))
    with ts.Simulation(scene(), dt=1e-3) as sim:
        summary = export(sim, None, fps=100, duration=0.1)
    assert len(asked) == 2
    assert summary.energy_start[3] == 0.0
    assert summary.energy_end[0] > 0.0
