"""Precession of a spherical pendulum.

The ellipse in which a pendulum swings turns with about 3/8 of its frequency times the angles of its half axes (Airy
1851; Olsson, American Journal of Physics 46, 1978, 1118). At large angles the angle between two outermost points is an
integral over the polar angle; the equation of motion of a rigid pendulum, integrated by SciPy with a tolerance of
1e-12, gives the reference.
"""

import numpy as np
from scipy.integrate import solve_ivp

import taichi_sim as ts
from tests.published.common import crossings, history, refined

G, LENGTH, MASS, STIFFNESS = 9.81, 0.9, 0.6, 1e6
OUT, ASIDE = np.radians(50.0), 0.8  # rad, m/s across


def scene():
    """A pendulum pulled aside and pushed across."""
    scene = ts.Scene(dim=3, gravity=(0, -G, 0))
    start = LENGTH * np.array([np.sin(OUT), -np.cos(OUT), 0])
    pair = scene.add_balls([[0, 0, 0], start], radius=0.02, mass=MASS, velocity=[[0, 0, 0], [0, 0, ASIDE]], pinned=[0])
    scene.add_springs([pair], stiffness=STIFFNESS)
    return scene


def reference():
    """Time [s] and angle [rad] from one outermost point to the next."""
    momentum = ASIDE * np.sin(OUT) / LENGTH  # per mass and length^2: sin^2 times the rate of the azimuth

    def rate(_, y):
        polar, speed, _ = y
        turn = momentum / np.sin(polar) ** 2
        return [speed, turn**2 * np.sin(polar) * np.cos(polar) - G / LENGTH * np.sin(polar), turn]

    def outermost(_, y):
        return y[1]

    outermost.direction = -1
    got = solve_ivp(rate, (0, 9), [OUT, -1e-15, 0], method="DOP853", events=outermost, rtol=1e-12, atol=1e-13)
    times, states = got.t_events[0], got.y_events[0]
    return times[times > 0.1][0], states[times > 0.1][0][2]


def measure():
    """Period and turn of the orbit, the mean over 8 s."""
    period, angle = reference()
    for row, sim in refined(scene, 4):
        time, x, v = history(sim, 8.0, 2e-3, lambda sim: (sim.position[1, ::2], sim.velocity[1, ::2]))
        times = crossings(time, np.sum(x * v, axis=1), rising=False)
        angles = np.abs(np.interp(times, time, np.unwrap(np.arctan2(-x[:, 1], x[:, 0]))))
        yield row("time between outermost points", "s", period, np.diff(times).mean(), 1e-3)
        yield row("precession", "rad", angle - np.pi, np.diff(angles).mean() - np.pi, 5e-3)
