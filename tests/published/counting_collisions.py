"""Digits of pi by counting collisions.

A heavy ball of mass M pushes a light one of mass m against a wall. Without losses they collide with each other and with
the wall floor(pi / arctan(sqrt(m / M))) times. That is 3, 31 and 314 times for M / m = 1, 100 and 10000 (Galperin,
Regular and Chaotic Dynamics 8, 2003, 375; one less where pi / arctan is whole). Each pair of collisions turns the point
(v sqrt(M), u sqrt(m)) by 2 arctan(sqrt(m / M)), which gives the velocities at the end.
"""

import numpy as np

import taichi_sim as ts
from tests.published.common import history, refined

RADIUS, SPEED = 0.02, 0.5
RATIOS = (1, 16, 100)


def scene():
    """A light ball between a wall and a heavy one that comes, for each ratio."""
    scene = ts.Scene(dim=2)
    ideal = scene.add_material("ideal", restitution=1.0)
    scene.add_wall((1, 0), 0.0, ideal)
    for k, ratio in enumerate(RATIOS):
        x = [[1.0, 0.3 * k], [1.5, 0.3 * k]]
        scene.add_balls(x, radius=RADIUS, mass=[1.0, ratio], velocity=[[0, 0], [-SPEED, 0]], material=ideal)
    return scene


def reference(ratio):
    """Number of collisions and velocities at the end, by the laws of elastic impact."""
    light, heavy, count = 0.0, -SPEED, 0
    while light < 0 or light > heavy:
        if light < 0:
            light = -light
        else:
            common = (light + ratio * heavy) / (1 + ratio)
            light, heavy = 2 * common - light, 2 * common - heavy
        count += 1
    return count, light, heavy


def measure():
    """Number of collisions, counted by changes of velocity, and speeds at the end."""
    for row, sim in refined(scene, 4):
        _, light = history(sim, 7.0, 0, lambda sim: (sim.velocity[::2, 0],))
        counts = np.sum(np.abs(np.diff(light, axis=0)) > 1e-6, axis=0)
        v = sim.velocity[:, 0].reshape(-1, 2)
        for k, ratio in enumerate(RATIOS):
            count, light, heavy = reference(ratio)
            yield row(f"collisions, ratio {ratio}", "", count, counts[k], 0.0)
            yield row(f"last speed of the heavy ball, ratio {ratio}", "m/s", heavy, v[k, 1], 1e-3, scale=SPEED)
            yield row(f"last speed of the light ball, ratio {ratio}", "m/s", light, v[k, 0], 1e-3, scale=SPEED)
