"""Ball that leaves a sphere.

A small push sends a ball from the top of a fixed sphere. Without friction it leaves where cos(angle) = 2/3; a sphere
that rolls without slipping leaves where cos(angle) = 10/17 (a classical exercise). The energy of the push v is allowed
for: the cosine grows by v^2 / (3 g d), rolling by 7 v^2 / (17 g d), d the distance of the centres.
"""

import numpy as np
import pytest

import taichi_sim as ts
from tests.published.common import Row, hold, refined

pytestmark = pytest.mark.long

G, LARGE, SMALL, PUSH = 9.81, 1.0, 0.1, 0.15


def scene(friction):
    """A ball on top of a sphere, with a speed to the side and the spin of rolling."""
    scene = ts.Scene(dim=3, gravity=(0, -G, 0))
    material = scene.add_material("m", friction=friction)
    scene.add_balls([[0, LARGE + SMALL, 0]], radius=SMALL, velocity=[[PUSH, 0, 0]], material=material)
    scene.add_collider(ts.Sphere((0, 0, 0), LARGE, material=material))
    return scene


def measure():
    """Cosine of the angle, from the speed along the ground in free flight, sqrt(g d) times its power 3/2."""
    rows, distance = [], LARGE + SMALL
    square = PUSH**2 / (G * distance)
    # the ball starts without spin; rough enough, it loses 2/7 of its speed at once
    for name, friction, cosine in (
        ("smooth", 0.0, (2 + square) / 3),
        ("rolling", 30.0, (10 + 7 * (5 / 7) ** 2 * square) / 17),
    ):
        for settings, sim in refined(lambda friction=friction: scene(friction), 4):
            while np.linalg.norm(sim.position[0]) < distance + 0.02:
                sim.step()
            found = np.cbrt(sim.velocity[0, 0] ** 2 / (G * distance))
            rows.append(Row(f"cosine of the angle, {name}", "", cosine, found, 0.02, settings=settings))
    return rows


def test_leaves():
    hold(measure())
