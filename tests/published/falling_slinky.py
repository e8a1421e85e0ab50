"""Falling slinky.

A hanging spring of mass M and stiffness K is let go at its top. Its lower end stays where it is until the wave from the
top arrives after sqrt(M / K) (Calkin, American Journal of Physics 61, 1993, 261). A chain of springs of rest length 0
is linear: its exact motion follows from the eigenvectors of its stiffness matrix. The turns may pass each other here.
"""

import numpy as np

import taichi_sim as ts
from tests.published.common import refined

G, N, MASS, STIFFNESS = 9.81, 60, 0.3, 1.2  # balls; kg and N/m of the whole
M, K = MASS / N, STIFFNESS * (N - 1)
MATRIX = K / M * (np.diag([1.0, *[2.0] * (N - 2), 1.0]) - np.eye(N, k=1) - np.eye(N, k=-1))
RELEASED = -np.concatenate([[0.0], np.cumsum(M * G / K * np.arange(N - 1, 0, -1))])  # m, hanging at rest


def scene():
    """The chain in the moment of its release."""
    scene = ts.Scene(dim=2, gravity=(0, -G))
    balls = scene.add_balls(np.stack([np.zeros(N), RELEASED], axis=1), radius=1e-4, mass=M, body=scene.new_body())
    scene.add_springs(np.stack([balls[:-1], balls[1:]], axis=1), stiffness=K, rest_length=0.0)
    return scene


def reference(time):
    """Heights (n,) of the free chain at a time [s]."""
    squared, mode = np.linalg.eigh(MATRIX)
    omega = np.sqrt(np.maximum(squared, 0.0))
    return mode @ (np.cos(omega * time) * (mode.T @ RELEASED)) - G * time**2 / 2


def measure():
    """Heights of both ends at 0.5 and 0.9 of the time that the wave takes."""
    arrival, length = np.sqrt(MASS / STIFFNESS), RELEASED[0] - RELEASED[-1]
    for row, sim in refined(scene, 4):
        for part in (0.5, 0.9):
            sim.run(part * arrival - sim.time)
            exact, found = reference(sim.time), sim.position[:, 1]
            for end, name in ((0, "top"), (-1, "bottom")):
                yield row(
                    f"fall of its {name} at {part:g} sqrt(M/K)",
                    "m",
                    RELEASED[end] - exact[end],
                    RELEASED[end] - found[end],
                    1e-3,
                    scale=length,
                )
