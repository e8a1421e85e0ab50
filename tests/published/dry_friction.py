"""Oscillator with dry friction.

A body on a spring slides on a floor with friction mu. Each half swing is one of sqrt(k / m) about a place shifted by mu
m g / k. So turning points come nearer by 2 mu m g / k, until one lies within mu m g / k, where the body stays (Lorenz
1924; Marchewka, Abbott and Beichner, American Journal of Physics 72, 2004, 477).
"""

import numpy as np

import taichi_sim as ts
from tests.published.common import history, refined

G, MASS, STIFFNESS, MU, START, RADIUS = 9.81, 0.5, 80.0, 0.12, 0.1, 0.02
SHIFT = MU * MASS * G / STIFFNESS


def scene():
    """A ball on a floor, joined to a pinned one by a stretched spring."""
    scene = ts.Scene(dim=2, gravity=(0, -G))
    dry = scene.add_material("dry", friction=MU)
    pair = scene.add_balls([[-1.0, RADIUS], [START, RADIUS]], radius=RADIUS, mass=MASS, pinned=[0], material=dry)
    scene.add_springs([pair], stiffness=STIFFNESS, rest_length=1.0)
    scene.add_wall((0, 1), 0.0, dry)
    return scene


def reference():
    """Turning points [m], the last of them the place of rest."""
    points, side = [START], 1
    while abs(points[-1]) > SHIFT:
        points.append(2 * side * SHIFT - points[-1])
        side = -side
    return points


def measure():
    """Turning points, the place of rest and its time."""
    points = reference()
    rest = (len(points) - 1) * np.pi * np.sqrt(MASS / STIFFNESS)
    for row, sim in refined(scene, 4):
        time, x, v = history(sim, 1.5 * rest, 0, lambda sim: (sim.position[1, 0], sim.velocity[1, 0]))
        turn = np.flatnonzero((v[:-1] * v[1:] < 0) | ((v[:-1] != 0) & (v[1:] == 0)))
        for k in (1, 4):
            yield row(f"turning point {k}", "m", points[k], x[turn[k - 1]], 5e-3, scale=START)
        still = time[np.flatnonzero(np.abs(x - x[-1]) > 1e-5)[-1] + 1]
        yield row("place of rest", "m", points[-1], x[-1], 5e-3, scale=START)
        yield row("time of rest", "s", rest, still, 0.02)
