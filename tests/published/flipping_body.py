"""Flips of a free body (Dzhanibekov effect).

Six balls on stiff springs along three axes turn about the axis with the middle moment of inertia and flip over again
and again. The reference is Euler's equations of a rigid body with these moments, integrated by SciPy's DOP853 with a
tolerance of 1e-12 (Ashbaugh, Chicone and Cushman, Journal of Dynamics and Differential Equations 3, 1991, 67). Angular
velocity is found from angular momentum and positions.
"""

import numpy as np
from scipy.integrate import solve_ivp

import taichi_sim as ts
from tests.published.common import crossings, history, refined

ARMS, MASS, STIFFNESS = np.array([0.5, 0.35, 0.2]), 0.5, 1e6  # m, kg, N/m
MOMENTS = 2 * MASS * np.array([ARMS[1] ** 2 + ARMS[2] ** 2, ARMS[0] ** 2 + ARMS[2] ** 2, ARMS[0] ** 2 + ARMS[1] ** 2])
SPIN, END = np.array([0.01, 6.0, 0.02]), 15.0  # 1/s, s


def scene():
    """Six balls, each joined to all others."""
    scene = ts.Scene(dim=3)
    x = np.concatenate([np.diag(ARMS), -np.diag(ARMS)])
    balls = scene.add_balls(x, radius=0.02, mass=MASS, velocity=np.cross(SPIN, x))
    scene.add_springs([(i, j) for i in balls for j in balls if i < j], stiffness=STIFFNESS)
    return scene


def reference(time):
    """Rate of turn (n,) about the body's middle axis [1/s]."""

    def rate(_, w):
        return np.cross(MOMENTS * w, w) / MOMENTS

    return solve_ivp(rate, (0, time[-1]), SPIN, method="DOP853", t_eval=time, rtol=1e-12, atol=1e-12).y[1]


def middle_rate(sim):
    """Rate of turn about the body's middle axis [1/s]."""
    x, v = sim.position, sim.velocity
    inertia = MASS * (np.sum(x * x) * np.eye(3) - x.T @ x)
    omega = np.linalg.solve(inertia, MASS * np.cross(x, v).sum(axis=0))
    return omega @ (x[1] - x[4]) / np.linalg.norm(x[1] - x[4])


def measure():
    """Times of the flips and the least rate of turn."""
    for row, sim in refined(scene, 2):
        time, turn = history(sim, END, 5e-3, lambda sim: (middle_rate(sim),))
        exact = reference(time)
        flips, wanted = (np.sort(np.r_[crossings(time, w), crossings(time, w, False)]) for w in (turn, exact))
        yield row("number of flips", "", len(wanted), len(flips), 0.0)
        yield row("time of the first flip", "s", wanted[0], flips[0], 0.01)
        yield row("time of the last flip", "s", wanted[-1], flips[-1], 0.01)
        yield row("least rate of turn", "1/s", exact.min(), turn.min(), 0.01)
