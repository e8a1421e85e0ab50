"""Cooling of a granular gas (Haff's law).

Discs that lose 1 - e^2 of the energy along the line of centres in each collision cool as T0 / (1 + t / tau)^2 while
they stay evenly spread (Haff, Journal of Fluid Mechanics 134, 1983, 401). 1 / tau = (1 - e^2) nu / 4 with Enskog's
collision rate nu = 2 sqrt(pi) n d chi sqrt(T / m), chi = (1 - 7 y / 16) / (1 - y)^2 (Henderson). Walls are elastic.
Mean over two starts.
"""

import numpy as np
import pytest

import taichi_sim as ts
from tests.published.common import DEFAULTS, Row, hold
from tests.published.gas import COUNT, SEEDS, SPEED, box

pytestmark = [pytest.mark.long, pytest.mark.once]
CHAOTIC = True

FILLED, RESTITUTION = 0.1, 0.95


def measure():
    """Temperature after one and three times tau, in that of the start."""
    chi = (1 - 7 / 16 * FILLED) / (1 - FILLED) ** 2
    rows = []
    for finer in (1, 4):
        left = []
        for seed in SEEDS:
            scene, radius = box(FILLED, seed, RESTITUTION)
            rate = 2 * np.sqrt(np.pi) * COUNT * 2 * radius * chi * SPEED
            tau = 4 / ((1 - RESTITUTION**2) * rate)
            with ts.Simulation(scene) as sim:
                sim.set_dt(sim.dt / finer)
                for part in (1, 3):
                    sim.run(part * tau - sim.time)
                    left.append(sim.energy().total / (COUNT * SPEED**2))
        for part, found in zip((1, 3), np.reshape(left, (-1, 2)).mean(axis=0)):
            name = DEFAULTS if finer == 1 else f"dt / {finer}"
            rows.append(Row(f"T / T0 after {part} tau", "", 1 / (1 + part) ** 2, found, 0.05, settings=name))
    return rows


def test_cools():
    hold(measure())
