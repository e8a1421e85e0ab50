"""Kapitza's pendulum.

A pendulum whose pivot vibrates quickly along the vertical stands upside down where a^2 w^2 > 2 g l. It swings slowly
about the top with sqrt(a^2 w^2 / (2 l^2) - g / l) for a small (Kapitza 1951; Landau and Lifshitz, "Mechanics", section
30). The reference is the equation of a rigid pendulum, integrated by SciPy's DOP853 with a tolerance of 1e-11. With a
slower pivot it falls.
"""

import numpy as np
from scipy.integrate import solve_ivp

import taichi_sim as ts
from tests.published.common import crossings, history, refined

G, LENGTH, MASS, STIFFNESS, DAMPING = 9.81, 0.5, 0.2, 2e6, 20.0
SWING, PER_SECOND, POINTS = 0.04, 25, 40  # m, swings of the pivot per second, keyframes for each
START, END = 0.15, 3.0  # rad from the top, s
RATE = 2 * np.pi * PER_SECOND


def scene():
    """A pendulum near the top on a vibrating pivot, and one on a pivot that vibrates a third as far."""
    scene = ts.Scene(dim=2, gravity=(0, -G))
    period = 1 / PER_SECOND
    phase = np.arange(POINTS + 1) / POINTS
    for k, swing in enumerate((SWING, SWING / 3)):
        pivot = np.array([2.0 * k, 0.0])
        x = [pivot, pivot + LENGTH * np.array([np.sin(START), np.cos(START)])]
        pair = scene.add_balls(x, radius=0.01, mass=MASS, pinned=[0])
        scene.add_springs([pair], stiffness=STIFFNESS, damping=DAMPING)
        path = [(t * period, (0.0, swing * (np.cos(2 * np.pi * t) - 1))) for t in phase]
        scene.add_moving_pins([pair[0]], path=path, repeat=True)
    return scene


def reference(time, swing):
    """Angle from the top (n,) of a rigid pendulum."""

    def rate(t, y):
        return [y[1], (G - swing * RATE**2 * np.cos(RATE * t)) / LENGTH * np.sin(y[0])]

    return solve_ivp(rate, (0, time[-1]), [START, 0], method="DOP853", t_eval=time, rtol=1e-11, atol=1e-11).y[0]


def measure():
    """Slow period, largest angle on the other side, and the time at which the other one is level."""
    for row, sim in refined(scene, 4):
        time, x = history(sim, END, 1e-3, lambda sim: (sim.position,))
        found = np.arctan2(*np.moveaxis(x[:, 1::2] - x[:, ::2], 2, 0))
        exact = [reference(time, swing) for swing in (SWING, SWING / 3)]
        slow = [np.diff(crossings(time, smooth(time, a), False)[:2])[0] for a in (exact[0], found[:, 0])]
        level = [time[np.argmax(np.abs(a) > np.pi / 2)] for a in (exact[1], found[:, 1])]
        yield row("period of the slow swing", "s", *slow, 0.01)
        yield row("angle on the other side", "rad", exact[0].min(), found[:, 0].min(), 0.01)
        yield row("time at which the slower one is level", "s", *level, 0.01)


def smooth(time, angle):
    """The angle averaged over a swing of the pivot."""
    count = round(1 / PER_SECOND / (time[1] - time[0]))
    return np.convolve(angle, np.full(count, 1 / count), mode="same")
