"""Pressure of a gas of hard discs.

Discs that fill a share y of the area have the pressure n k T (1 + y^2 / 8) / (1 - y)^2 (Henderson, Molecular Physics
30, 1975, 971), n their number per area. In a box, centres keep a radius away from walls and gather near them; n is the
density of the middle. Mean over two starts, on the middle of each wall, from the impulses of balls that turn around
there. At the default step discs move a thirtieth of a radius.
"""

import numpy as np

import taichi_sim as ts
from tests.published.common import DEFAULTS, Row
from tests.published.gas import SEEDS, SPEED, box

CHAOTIC = True

END = 12.0  # s
MIDDLE = 0.3  # m to each side of the centre


def run(filled, finer):
    """Pressure [N/m] and density [1/m^2] of the middle, and the radius [m]."""
    middle, counted, given, inside, samples, time = 0.0, 0.0, 0.0, 0.0, 0, 0.0
    for seed in SEEDS:
        scene, radius = box(filled, seed)
        with ts.Simulation(scene) as sim:
            sim.set_dt(sim.dt / finer)
            sim.run(1.0)
            start = wall_impulse(sim)
            for count in range(round(END / sim.dt)):
                sim.step()
                x, v = sim.position, sim.velocity
                back = x - sim.dt * v  # behind a wall: it was reflected in this step
                ball, axis = np.nonzero(((v > 0) & (back < radius)) | ((v < 0) & (back > 1 - radius)))
                own = 2 * np.abs(v[ball, axis])
                counted += own.sum()
                middle += own[np.abs(x[ball, 1 - axis] - 0.5) < MIDDLE].sum()
                if count % 10 == 0:
                    inside += np.sum(np.all(np.abs(x - 0.5) < MIDDLE, axis=1))
                    samples += 1
            given += wall_impulse(sim) - start
            time += END
    seen = counted / given  # the rest met another disc in the same step
    return middle / seen / (time * 4 * 2 * MIDDLE), inside / (samples * (2 * MIDDLE) ** 2), radius


def wall_impulse(sim):
    """Impulse that all walls have received [N s]."""
    return sum(value for name, value in sim.probes().items() if name.endswith("magnitude"))


def measure():
    """Pressure over n k T at two densities."""
    rows = []
    for filled, finer in ((0.1, 1), (0.3, 1), (0.3, 4)):
        pressure, density, radius = run(filled, finer)
        share = density * np.pi * radius**2
        exact = (1 + share**2 / 8) / (1 - share) ** 2
        found = pressure / (density * SPEED**2)
        name, allowed = (DEFAULTS, 0.05) if finer == 1 else (f"dt / {finer}", 0.03)
        rows.append(Row(f"p / (n k T), share {filled:g}", "", exact, found, allowed, settings=name))
    return rows
