"""Ball that rolls on a turntable.

A sphere that rolls without slipping on a table turning with W moves on a circle, whatever its start: its centre turns
with 2/7 W (Weltner, American Journal of Physics 47, 1979, 984). Started at rest in the room at a distance d from the
axis, touching the table without spin, it is first dragged along until it rolls; from then on radius and centre of the
circle stay.
"""

import numpy as np

import taichi_sim as ts
from tests.published.common import history, refined

G, RADIUS, MU, TURN, END = 9.81, 0.04, 0.8, 90.0, 40.0  # TURN in degrees per second


def scene():
    """A ball on a turning box, off its axis."""
    scene = ts.Scene(dim=3, gravity=(0, -G, 0))
    rough = scene.add_material("rough", friction=MU)
    scene.add_balls([[0.3, RADIUS, 0]], radius=RADIUS, mass=0.2, material=rough)
    scene.add_collider(ts.Box((0, -0.1, 0), (4, 0.2, 4), material=rough, rotation_rate=(0, TURN, 0)))
    return scene


def measure():
    """Angular velocity on the circle, by the turn of the ball's velocity, and the drift of its radius."""
    rate = np.radians(TURN)
    for row, sim in refined(scene, 4):
        sim.run(1.0)
        time, v = history(sim, END, 0.05, lambda sim: (sim.velocity[0, ::2],))
        speed, turned = np.linalg.norm(v, axis=1), np.unwrap(np.arctan2(-v[:, 1], v[:, 0]))
        found = np.polyfit(time, turned, 1)[0]
        yield row("angular velocity, in that of the table", "", 2 / 7, found / rate, 5e-3)
        yield row("speed after 40 s, in that after 1 s", "", 1.0, speed[-1] / speed[0], 0.01)
