"""Flow out of a hopper (Beverloo's law).

In two dimensions the number of discs that leave a flat-bottomed silo per second grows as (D - k d)^(3/2) with the width
D of the opening, d the diameter and k about 1 to 1.5, and does not depend on the height of the filling (Beverloo,
Leniger and van de Velde 1961; Mankoc et al., Granular Matter 9, 2007, 407). The prefactor is C sqrt(g) / d^2 times the
packing; the exponent is fitted with k = 1.3.
"""

import numpy as np
import pytest

import taichi_sim as ts
from tests.published.common import DEFAULTS, Row, hold

pytestmark = [pytest.mark.long, pytest.mark.once]
CHAOTIC = True

G, RADIUS, WIDTH, ROWS, COLUMNS = 9.81, 0.01, 0.8, 42, 36
DIAMETER = 2 * RADIUS
OPENINGS = (5, 6, 8, 10)  # diameters
SETTLED, FROM, TO = 1.0, 0.3, 1.1  # s, the last two after the opening


def scene(opening):
    """A box of discs over a floor of two halves that are drawn apart."""
    scene = ts.Scene(dim=2, gravity=(0, -G))
    grain = scene.add_material("grain", restitution=0.3, friction=0.4)
    start = (-WIDTH / 2 + 1.1 * RADIUS, 1.2 * RADIUS)
    ts.shapes.pile(
        scene, (COLUMNS, ROWS), RADIUS, smallest_radius=0.85 * RADIUS, mass=0.01, position=start, material=grain, seed=7
    )
    scene.add_wall((1, 0), -WIDTH / 2, grain)
    scene.add_wall((-1, 0), -WIDTH / 2, grain)
    half = opening * DIAMETER / 2
    for side in (-1, 1):
        path = [(0, (0, 0)), (SETTLED, (0, 0)), (SETTLED + 0.02, (side * half, 0))]
        scene.add_collider(ts.Box((side * 0.5, -0.05), (1.0, 0.1), material=grain, path=path))
    scene.add_probe("out", "flux", normal=(0, -1), offset=0.05)
    return scene


def measure():
    """Exponent of the flow, and its change with the height of the filling."""
    rates, halves = [], []
    for opening in OPENINGS:
        with ts.Simulation(scene(opening)) as sim:
            counts = []
            for time in (FROM, (FROM + TO) / 2, TO):
                sim.run(SETTLED + time - sim.time)
                counts.append(sim.probes()["out.count"])
            rates.append((counts[2] - counts[0]) / (TO - FROM))
            halves.append((counts[2] - counts[1]) / (counts[1] - counts[0]))
    mean = 0.925 * DIAMETER
    exponent = np.polyfit(np.log(np.array(OPENINGS) * DIAMETER - 1.3 * mean), np.log(rates), 1)[0]
    return [
        Row("exponent of D - 1.3 d", "", 1.5, exponent, 0.05, settings=DEFAULTS),
        Row(
            "flow of the second half of the time, in that of the first",
            "",
            1.0,
            np.mean(halves),
            0.05,
            settings=DEFAULTS,
        ),
    ]


def test_flow():
    hold(measure())
