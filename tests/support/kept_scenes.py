"""Some steps, the energy and a picture of scenes of all kinds, whose kernels a later process should find.

    python tests/support/kept_scenes.py [NAME ...]

runs them one after another, each on an engine that is started anew.
"""

import os
import sys
import warnings

from trajectories import BY_NAME

import taichi_sim as ts
from taichi_sim.device import backend


def run(name: str) -> None:
    """Run a scene for three steps."""
    scene, settings = BY_NAME[name]()
    precision = os.environ.get("TAICHI_SIM_PRECISION", "f32")
    with ts.Simulation(scene, arch="cpu", precision=precision, **settings) as sim:
        sim.step(3)
        sim.energy()
        ts.picture(sim, size=(64, 48))


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    for name in sys.argv[1:] or BY_NAME:
        run(name)
        backend.stop()
