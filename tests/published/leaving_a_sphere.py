"""Ball that leaves a sphere.

A small push sends a ball from the top of a fixed sphere. Without friction it leaves where cos(angle) = 2/3, with the speed
of the fall (a classical exercise). With friction it rolls, then slides, and leaves where nothing presses it any more;
SciPy integrates its speed and spin up to there (tolerance 1e-9).
"""

import numpy as np
from scipy.integrate import solve_ivp

import taichi_sim as ts
from tests.published.common import refined

G, LARGE, SMALL, PUSH = 9.81, 1.0, 0.1, 0.15


def scene(friction):
    """A ball on top of a sphere, with a speed to the side and the spin of rolling."""
    scene = ts.Scene(dim=3, gravity=(0, -G, 0))
    material = scene.add_material("m", friction=friction)
    scene.add_balls([[0, LARGE + SMALL, 0]], radius=SMALL, velocity=[[PUSH, 0, 0]], material=material)
    scene.add_collider(ts.Sphere((0, 0, 0), LARGE, material=material))
    return scene


def reference(friction):
    """Cosine of the angle and speed along the ground [m/s] at which nothing presses the ball any more."""
    distance = LARGE + SMALL

    def pressing(y):
        return G * np.cos(y[0]) - y[1] ** 2 / distance

    def rate(_, y):  # angle, speed, speed of the surface by its spin
        needed, most = 2 / 7 * G * np.sin(y[0]), friction * pressing(y)
        grip = min(needed, most) if y[1] - y[2] < 1e-9 else most
        return [y[1] / distance, G * np.sin(y[0]) - grip, 2.5 * grip]

    def leaves(_, y):
        return pressing(y)

    leaves.terminal = True
    push = PUSH * (5 / 7 if friction else 1.0)  # it starts without spin, and rolls at once
    start = [0.0, push, push if friction else 0.0]
    end = solve_ivp(rate, (0, 9), start, events=leaves, rtol=1e-9, atol=1e-12, max_step=1e-3).y[:, -1]
    return np.cos(end[0]), end[1] * np.cos(end[0])


def measure():
    """Speed along the ground in free flight; without friction also the cosine, which follows from it."""
    distance = LARGE + SMALL
    for name, friction in (("smooth", 0.0), ("rolling", 0.5), ("gripping", 10.0)):
        cosine, speed = reference(friction)
        for row, sim in refined(lambda friction=friction: scene(friction), 4):
            while np.linalg.norm(sim.position[0]) < distance + 0.02:
                sim.step()
            found = sim.velocity[0, 0]
            yield row(f"speed along the ground, {name}", "m/s", speed, found, 5e-3)
            if not friction:
                angle = np.cbrt(found**2 / (G * distance))
                yield row(f"cosine of the angle, {name}", "", cosine, angle, 5e-3)
