"""Small scenes of many kinds, each with a picture, whose kernels a later process should find.

    python -m tests.support.kept_scenes [SCENE ...]

runs them one after another, each on an engine that is started anew.
"""

import os
import sys
import warnings

import taichi_sim as ts


def _heap():
    scene = ts.Scene(dim=2, gravity=(0.0, -9.0))
    scene.add_material("rubber", restitution=0.4, friction=0.2)
    scene.add_balls([[0.0, 0.3], [0.1, 0.6], [-0.1, 0.9]], radius=0.14, material="rubber")
    scene.add_wall((0, 1), material="rubber")
    return scene


def _sheet(**more):
    scene = ts.Scene(dim=3, gravity=(0.0, -9.0, 0.0))
    ts.shapes.cloth(scene, size=(0.8, 0.8), resolution=(7, 7), position=(0, 1, 0), pinned="left", **more)
    scene.add_wall((0, 1, 0))
    return scene


def _hung():
    scene = ts.Scene(dim=3, gravity=(0.0, -9.0, 0.0))
    ts.shapes.rope(scene, start=(0, 2, 0), end=(1, 2, 0), n=9)
    scene.add_moving_pins([0], velocity=(0.0, 0.2, 0.0))
    return scene


def _jelly():
    scene = ts.Scene(dim=3, gravity=(0.0, -9.0, 0.0))
    ts.shapes.jelly(scene, size=(0.4, 0.4, 0.4), resolution=(4, 4, 4), position=(0, 0.3, 0))
    scene.add_collider(ts.Sphere(center=(0.2, 0.0, 0.2), radius=0.2))
    return scene


def _sticks():
    scene = _heap()
    a, b = scene.add_balls([[0.5, 0.5], [1.0, 0.5]], radius=0.05)
    scene.add_springs([(a, b)], stiffness=200.0, collides=True)
    return scene


SCENES = {
    "heap": (_heap, {}),
    "sheet": (_sheet, {"driver": "parallel"}),
    "hung": (_hung, {}),
    "heap of split masses": (_heap, {"contacts": "jacobi", "driver": "parallel"}),
    "jelly": (_jelly, {}),
    "jelly on threads": (_jelly, {"driver": "parallel"}),
    "sticks": (_sticks, {}),
    "colliding sheet": (lambda: _sheet(surface_collision=True), {}),
    "tearing sheet": (lambda: _sheet(break_strain=0.3), {}),
    "implicit sheet": (_sheet, {"integrator": "implicit_euler", "dt": 4e-3}),
    "implicit sheet on threads": (_sheet, {"integrator": "tr_bdf2", "dt": 4e-3, "driver": "parallel"}),
    "xpbd": (_sheet, {"integrator": "xpbd"}),
    "rk4": (_heap, {"integrator": "rk4", "spin": False}),
}


def run(name: str) -> None:
    """Some steps of a scene, its energy and a picture."""
    make, settings = SCENES[name]
    precision = os.environ.get("TAICHI_SIM_PRECISION", "f32")
    with ts.Simulation(make(), arch="cpu", precision=precision, **settings) as sim:
        sim.step(3)
        sim.energy()
        ts.picture(sim, size=(64, 48))


if __name__ == "__main__":
    from taichi_sim.device import backend

    warnings.simplefilter("ignore")
    for name in sys.argv[1:] or SCENES:
        run(name)
        backend.stop()
