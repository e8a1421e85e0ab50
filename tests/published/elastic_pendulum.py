"""Elastic pendulum near its 1:2 resonance.

The energy of a ball on a soft spring goes from bouncing to swinging and back when the spring's frequency is twice that
of the pendulum (Vitt and Gorelik, 1933; Nayfeh and Mook, "Nonlinear Oscillations", chapter 6). The reference is the
equation of motion in polar coordinates, integrated by SciPy's DOP853 with a tolerance of 1e-12. The swing's largest
width, the time at which it is reached and the position after 8 s are compared.
"""

import numpy as np
from scipy.integrate import solve_ivp

import taichi_sim as ts
from tests.published.common import history, refined

G, MASS, REST, STIFFNESS = 9.81, 0.8, 0.6, 0.8 * 3 * 9.81 / 0.6  # k L0 = 3 m g: 1:2
START, END = np.array([0.05, -1.0]), 8.0


def scene():
    """One ball that hangs on a spring, lowered and pushed aside."""
    scene = ts.Scene(dim=2, gravity=(0, -G))
    pair = scene.add_balls([[0.0, 0.0], START], radius=0.02, mass=MASS, pinned=[0])
    scene.add_springs([pair], stiffness=STIFFNESS, rest_length=REST)
    return scene


def reference(time):
    """Position (2, n) by the equation of motion."""

    def rate(_, y):
        x, v = y[:2], y[2:]
        length = np.hypot(*x)
        return [*v, *(-STIFFNESS / MASS * (length - REST) / length * x + [0, -G])]

    return solve_ivp(rate, (0, time[-1]), [*START, 0, 0], method="DOP853", t_eval=time, rtol=1e-12, atol=1e-12).y[:2]


def measure():
    """Width and time of the largest swing, and the last position."""
    for row, sim in refined(scene, 4):
        time, x = history(sim, END, 4e-3, lambda sim: (sim.position[1],))
        x, exact = x.T, reference(time)
        at, wanted = np.argmax(np.abs(x[0])), np.argmax(np.abs(exact[0]))
        yield row("largest swing", "m", abs(exact[0, wanted]), abs(x[0, at]), 1e-3)
        yield row("its time", "s", time[wanted], time[at], 2e-3)
        yield row("x after 8 s", "m", exact[0, -1], x[0, -1], 5e-3, scale=np.abs(exact[0]).max())
        yield row("y after 8 s", "m", exact[1, -1], x[1, -1], 5e-3)
