"""Billiard in a rectangle.

A disc in a box with elastic walls moves along a straight line in the plane of the box's mirror images (Tabachnikov,
"Geometry and Billiards", 2005, chapter 2). After a thousand or more bounces its place follows by folding that line
back.
"""

import numpy as np

import taichi_sim as ts
from tests.published.common import refined

SIZE, RADIUS, END = np.array([1.0, 0.7]), 0.04, 100.0
START, VELOCITY = np.array([0.3, 0.2]), np.array([7.3, 4.1])


def scene():
    """One disc between four walls."""
    scene = ts.Scene(dim=2)
    ideal = scene.add_material("ideal", restitution=1.0)
    scene.add_balls([START], radius=RADIUS, velocity=[VELOCITY], material=ideal)
    for normal in np.eye(2):
        scene.add_wall(normal, 0.0, ideal)
        scene.add_wall(-normal, -normal @ SIZE, ideal)
    return scene


def measure():
    """Place and speed after 100 s; 1.4 km of way."""
    free = SIZE - 2 * RADIUS
    for row, sim in refined(scene):
        sim.run(END)
        straight = START - RADIUS + VELOCITY * sim.time
        folded = np.abs((straight + free) % (2 * free) - free)
        bounces = np.abs(np.floor(straight / free)).sum()
        off = np.linalg.norm(sim.position[0] - folded - RADIUS)
        yield row(f"distance from its place after {bounces:.0f} bounces", "m", 0.0, off, 5e-3, scale=SIZE[0])
        yield row("speed", "m/s", np.hypot(*VELOCITY), np.hypot(*sim.velocity[0]), 1e-5)
