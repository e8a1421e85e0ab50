"""Brick on a turntable.

A body that turns with a table of angular velocity W stays where r < mu g / W^2 and slides off farther out. A sliding
body is decelerated by mu g against its velocity over the table; SciPy integrates its way (tolerance 1e-10). The bodies
are pairs of balls on a stiff spring, which cannot roll; their middle is compared.
"""

import numpy as np
from scipy.integrate import solve_ivp

import taichi_sim as ts
from tests.published.common import refined

G, RADIUS, MU, TURN, END = 9.81, 0.005, 0.4, 200.0, 1.0  # TURN in degrees per second
RATE = np.radians(TURN)
LIMIT = MU * G / RATE**2  # m
PARTS = (0.5, 0.9, 1.1, 1.5)  # of it


def scene():
    """Pairs across the radius that turn with a box."""
    scene = ts.Scene(dim=3, gravity=(0, -G, 0))
    rough = scene.add_material("rough", friction=MU)
    turn = np.array([0, RATE, 0])
    for k, part in enumerate(PARTS):
        angle = np.pi / 2 * k
        out, across = np.array([np.cos(angle), 0, np.sin(angle)]), np.array([-np.sin(angle), 0, np.cos(angle)])
        x = part * LIMIT * out + RADIUS * np.array([0, 1, 0]) + 1.05 * RADIUS * np.outer([-1, 1], across)
        pair = scene.add_balls(x, radius=RADIUS, mass=0.1, velocity=np.cross(turn, x), material=rough)
        scene.add_springs([pair], stiffness=1e4, damping=5.0)
    scene.add_collider(ts.Box((0, -0.1, 0), (8, 0.2, 8), material=rough, rotation_rate=(0, TURN, 0)))
    return scene


def reference(part):
    """Distance from the axis after the time END [m], of a point that starts with the table at part of the limit."""

    def rate(_, y):
        x, v = y[:2], y[2:]
        slip = v - RATE * np.array([-x[1], x[0]])
        size = np.hypot(*slip)
        if size < 1e-9:  # about to slide: friction points inward
            return [*v, *(-MU * G * x / np.hypot(*x))]
        return [*v, *(-MU * G * slip / size)]

    if part <= 1:
        return part * LIMIT
    start = [part * LIMIT, 0, 0, part * LIMIT * RATE]
    return np.hypot(*solve_ivp(rate, (0, END), start, rtol=1e-10, atol=1e-12).y[:2, -1])


def measure():
    """Distances from the axis after a second."""
    for row, sim in refined(scene, 4):
        sim.run(END)
        middle = sim.position.reshape(-1, 2, 3).mean(axis=1)
        for k, part in enumerate(PARTS):
            found, name = np.hypot(middle[k, 0], middle[k, 2]), f"distance, started at {part:g} of the limit"
            yield row(name, "m", reference(part), found, 0.01)
