"""Flow out of a hopper (Beverloo's law).

In two dimensions the number of discs that leave a flat-bottomed silo per second grows as (D - k d)^(3/2) with the width
D of a wide opening, d the diameter. It does not depend on the height of the filling (Beverloo, Leniger and van de Velde
1961). A narrow one lets less through, as discs get in each other's way. For all widths the flow grows as (1 - exp(-b (R
- 1)) / 2) (R - 1)^(3/2), R = D / d, b a number that is fitted (Mankoc et al., Granular Matter 9, 2007, 407,
arXiv:0707.4550). b = 0.23 is taken here for discs, and was not compared with the paper. From 0.1 to 0.4 it moves the
exponent from 1.45 to 1.58. Here R is 5.4 to 10.8, and the exponent of R - 1 is fitted to the flow over the first
factor, mean of four starts. An arch may close the narrowest opening for good (To, Lai and Pak, Phys. Rev. Lett. 86, 2001,
71). Such a start has no flow to speak of: it is left out.
"""

import numpy as np

import taichi_sim as ts
from tests.published.common import DEFAULTS, Row

CHAOTIC = True

G, RADIUS, WIDTH, ROWS, COLUMNS = 9.81, 0.01, 0.8, 42, 36
DIAMETER = 2 * RADIUS
OPENINGS = (5, 6, 8, 10)  # diameters of the largest
MEAN = 0.925 * DIAMETER
HINDRANCE = 0.23
SEEDS = (7, 1, 2, 3)
CLOGGED = 0.5  # of the largest count of an opening: less leaves where an arch closes it
SETTLED, FROM, TO = 1.0, 0.3, 1.1  # s, the last two after the opening


def scene(opening, seed):
    """A box of discs over a floor of two halves that are drawn apart."""
    scene = ts.Scene(dim=2, gravity=(0, -G))
    grain = scene.add_material("grain", restitution=0.3, friction=0.4)
    start = (-WIDTH / 2 + 1.1 * RADIUS, 1.2 * RADIUS)
    ts.shapes.pile(
        scene,
        (COLUMNS, ROWS),
        RADIUS,
        smallest_radius=0.85 * RADIUS,
        mass=0.01,
        position=start,
        material=grain,
        seed=seed,
    )
    scene.add_wall((1, 0), -WIDTH / 2, grain)
    scene.add_wall((-1, 0), -WIDTH / 2, grain)
    half = opening * DIAMETER / 2
    for side in (-1, 1):
        path = [(0, (0, 0)), (SETTLED, (0, 0)), (SETTLED + 0.02, (side * half, 0))]
        scene.add_collider(ts.Box((side * 0.5, -0.05), (1.0, 0.1), material=grain, path=path))
    scene.add_probe("out", "flux", normal=(0, -1), offset=0.05)
    return scene


def counts(opening, seed):
    """Discs that have left at three times after the opening."""
    with ts.Simulation(scene(opening, seed)) as sim:
        left = []
        for time in (FROM, (FROM + TO) / 2, TO):
            sim.run(SETTLED + time - sim.time)
            left.append(sim.probes()["out.count"])
        return left


def measure():
    """Exponent of the flow, and its change with the height of the filling."""
    left = np.array([[counts(opening, seed) for opening in OPENINGS] for seed in SEEDS])
    first, second = left[:, :, 1] - left[:, :, 0], left[:, :, 2] - left[:, :, 1]
    flows = second > CLOGGED * first.max(axis=0)
    rates = (first + second).mean(axis=0, where=flows)
    halves = (second / np.maximum(first, 1.0))[flows]
    wider = np.array(OPENINGS) * DIAMETER / MEAN - 1.0
    free = rates / (1.0 - 0.5 * np.exp(-HINDRANCE * wider))
    exponent = np.polyfit(np.log(wider), np.log(free), 1)[0]
    return [
        Row("exponent of D / d - 1", "", 1.5, exponent, 0.05, settings=DEFAULTS),
        Row(
            "flow of the second half of the time, in that of the first",
            "",
            1.0,
            np.mean(halves),
            0.05,
            settings=DEFAULTS,
        ),
    ]
