"""Vibrating beaded string.

A stretched string has beads at equal distances a and the tension T between its ends. It vibrates across at 2 sqrt(T /
(m a)) sin(p pi / (2 (N + 1))) (Lagrange 1759; Fetter and Walecka, "Theoretical Mechanics of Particles and Continua",
section 24). The string starts in mode p with an amplitude of 1e-3 of its length; its frequency is that of the zeros of
the mode's amplitude. Modes 1, 3 and 8 of 15 beads.
"""

import numpy as np

import taichi_sim as ts
from tests.published.common import crossings, history, refined

BEADS, LENGTH, MASS, STIFFNESS, REST = 15, 1.6, 0.02, 400.0, 0.08
MODES = (1, 3, 8)
TENSION = STIFFNESS * (LENGTH / (BEADS + 1) - REST)
SHAPES = np.array([np.sin(np.pi * p * np.arange(BEADS + 2) / (BEADS + 1)) for p in MODES])


def scene():
    """A string for each mode."""
    scene = ts.Scene(dim=2)
    for k, shape in enumerate(SHAPES):
        x = np.stack([np.linspace(0, LENGTH, BEADS + 2), k + 1e-3 * LENGTH * shape], axis=1)
        beads = scene.add_balls(x, radius=0.01, mass=MASS, pinned=[0, BEADS + 1])
        scene.add_springs(np.stack([beads[:-1], beads[1:]], axis=1), stiffness=STIFFNESS, rest_length=REST)
    return scene


def measure():
    """Frequencies, from the zeros of each mode's amplitude over 3 s."""
    exact = 2 * np.sqrt(TENSION * (BEADS + 1) / (MASS * LENGTH)) * np.sin(np.pi * np.array(MODES) / (2 * (BEADS + 1)))
    for row, sim in refined(scene, 4):
        time, y = history(sim, 3.0, 2e-3, lambda sim: (sim.position[:, 1].reshape(SHAPES.shape),))
        amplitude = np.sum((y - np.arange(len(MODES))[:, None]) * SHAPES, axis=2)
        for k, mode in enumerate(MODES):
            through = crossings(time, amplitude[:, k])
            found = 2 * np.pi * (len(through) - 1) / (through[-1] - through[0])
            yield row(f"angular frequency of mode {mode}", "1/s", exact[k], found, 2e-3)
