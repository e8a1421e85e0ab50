"""Ball on an incline.

A sphere rolls down an incline with 5/7 g sin(angle) where tan(angle) < 7/2 mu. On a steeper one it slides with g
(sin(angle) - mu cos(angle)) and spins up with 5 mu g cos(angle) / (2 r) (Galilei 1638; Landau and Lifshitz,
"Mechanics", section 38).
"""

import numpy as np

import taichi_sim as ts
from tests.published.common import refined

G, RADIUS, MU, END = 9.81, 0.05, 0.2, 0.8
ANGLES = (10, 30, 34, 37, 60)  # degrees; the threshold is 34.99


def scene(angle):
    """A ball on a tilted wall."""
    tilt = np.radians(angle)
    scene = ts.Scene(dim=3, gravity=(0, -G, 0))
    rough = scene.add_material("rough", friction=MU)
    normal = np.array([np.sin(tilt), np.cos(tilt), 0])
    scene.add_balls([RADIUS * normal], radius=RADIUS, mass=0.7, material=rough)
    scene.add_wall(normal, 0.0, rough)
    return scene


def measure():
    """Accelerations and spins after 0.8 s."""
    for angle in ANGLES:
        tilt = np.radians(angle)
        along = max(5 / 7 * G * np.sin(tilt), G * (np.sin(tilt) - MU * np.cos(tilt)))
        spin = min(along, 2.5 * MU * G * np.cos(tilt)) / RADIUS * END
        for row, sim in refined(lambda angle=angle: scene(angle)):
            sim.run(END)
            found = sim.velocity[0] @ [np.cos(tilt), -np.sin(tilt), 0] / END
            yield row(f"acceleration at {angle} degrees", "m/s^2", along, found, 1e-3)
            yield row(f"spin at {angle} degrees", "1/s", spin, -sim.angular_velocity[0, 2], 1e-3)
