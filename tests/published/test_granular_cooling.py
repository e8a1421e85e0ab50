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


def temperatures(parts, speed=SPEED, finer=1, seeds=SEEDS):
    """Temperature (n,) after these multiples of tau, in that of the start; mean over the starts."""
    chi = (1 - 7 / 16 * FILLED) / (1 - FILLED) ** 2
    left = []
    for seed in seeds:
        scene, radius = box(FILLED, seed, RESTITUTION, speed)
        rate = 2 * np.sqrt(np.pi) * COUNT * 2 * radius * chi * speed
        tau = 4 / ((1 - RESTITUTION**2) * rate)
        with ts.Simulation(scene) as sim:
            sim.set_dt(sim.dt / finer)
            for part in parts:
                sim.run(part * tau - sim.time)
                left.append(sim.energy().total / (COUNT * speed**2))
    return np.reshape(left, (-1, len(parts))).mean(axis=0)


def slow_gas():
    """Rows of a gas whose discs move a twentieth of a radius in a step."""
    rows = []
    for finer in (1, 4):
        for part, found in zip((1, 3), temperatures((1, 3), finer=finer)):
            name = DEFAULTS if finer == 1 else f"dt / {finer}"
            rows.append(Row(f"T / T0 after {part} tau", "", 1 / (1 + part) ** 2, found, 0.05, settings=name))
    return rows


def fast_gas():
    """Rows of one whose discs move 0.45 of a radius in 1 ms, which automatic substeps divide: 1 / tau from the temperature
    after tau."""
    rows = []
    for finer in (1, 4, 16):
        (left,) = temperatures((1,), 8 * SPEED, finer, seeds=(1, 2, 3, 4))
        name = DEFAULTS if finer == 1 else f"dt / {finer}"
        rows.append(Row("rate of cooling at 0.45 radii a ms, in Haff's", "", 1.0, left**-0.5 - 1, 0.05, settings=name))
    return rows


def measure():
    """Temperatures of a slow gas, and the rate of cooling of a fast one."""
    return slow_gas() + fast_gas()


def test_cools():
    hold(slow_gas())


def test_cools_where_discs_move_far_in_a_step():
    hold(fast_gas())
