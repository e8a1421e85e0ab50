"""Oblique impacts of unequal discs.

Two smooth discs meet off centre. The velocity along the line of centres changes by -(1 + e) m2 / (m1 + m2) times the
speed of approach, the velocity across it stays (Whittaker, "Analytical Dynamics", chapter 8). Offsets of 0 to 0.8 of
the sum of radii, mass ratios 1, 7 and 150, restitution 1 and 0.6. The line of centres of the reference is that of first
contact.
"""

import numpy as np

import taichi_sim as ts
from tests.published.common import refined

RADII, SPEED = np.array([0.06, 0.1]), 1.3
CASES = [(ratio, offset, e) for ratio in (1, 7, 150) for offset in (0.0, 0.3, 0.8) for e in (1.0, 0.6)]


def scene():
    """A pair for each case, far from the others."""
    scene = ts.Scene(dim=2)
    material = {e: scene.add_material(f"e = {e:g}", restitution=e) for e in (1.0, 0.6)}
    for k, (ratio, offset, e) in enumerate(CASES):
        x = [[-0.3137, 2.0 * k + offset * RADII.sum()], [0.0, 2.0 * k]]
        scene.add_balls(x, radius=RADII, mass=[1.0, ratio], velocity=[[SPEED, 0], [0, 0]], material=material[e])
    return scene


def reference():
    """Velocities (n, 2, 2) after the impact."""
    got = []
    for ratio, offset, e in CASES:
        normal = np.array([np.sqrt(1 - offset**2), -offset])
        impulse = (1 + e) * SPEED * normal[0] * ratio / (1 + ratio) * normal
        got.append([np.array([SPEED, 0]) - impulse, impulse / ratio])
    return np.array(got)


def measure():
    """Largest error of a velocity by offset, and of momentum."""
    exact = reference()
    for row, sim in refined(scene, 4, 16):
        sim.run(0.4)
        found = sim.velocity.reshape(exact.shape)
        off = np.linalg.norm(found - exact, axis=2).max(axis=1)
        for offset, allowed in ((0.0, 1e-5), (0.3, 0.01), (0.8, 0.02)):
            worst = max(off[k] for k, case in enumerate(CASES) if case[1] == offset)
            name = f"largest error of a velocity, offset {offset:g}"
            yield row(name, "m/s", 0.0, worst, allowed, scale=SPEED)
        masses = np.array([[1.0, case[0]] for case in CASES])
        kept = np.abs(np.sum(masses[:, :, None] * found, axis=1) - [SPEED, 0]).max()
        yield row("largest error of momentum", "kg m/s", 0.0, kept, 1e-5, scale=SPEED)
