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


def _fabric():
    return _sheet(warp=300.0, weft=120.0, shear=40.0, coupling=70.0)


def _body(**more):
    """A jelly of a material, of `bricks`, or of solids where its boxes are filled with tetrahedra."""
    scene = ts.Scene(dim=3, gravity=(0.0, -9.0, 0.0))
    given = {"size": (0.4, 0.4, 0.4), "resolution": (3, 3, 3), "density": 300.0, "young_modulus": 2e4}
    ts.shapes.jelly(scene, position=(0, 0.3, 0), **given, **more)
    scene.add_wall((0, 1, 0))
    return scene


def _solids():
    scene = ts.Scene(dim=3, gravity=(0.0, -9.0, 0.0))
    balls = scene.add_balls([[0, 1, 0], [0.2, 1, 0], [0, 1.2, 0], [0, 1, 0.2]], radius=0.02, mass=0.1)
    scene.add_solids([balls], young_modulus=2e4, poisson_ratio=0.3)
    scene.add_wall((0, 1, 0))
    return scene


def _letters():
    scene = ts.Scene(dim=2, gravity=(0.0, -9.0))
    ts.shapes.text(scene, "I", height=0.4, position=(0, 0.3))
    scene.add_wall((0, 1))
    return scene


def _shell():
    scene = _heap3()
    corners = [[-1.0, 0.0, -1.0], [1.0, 0.0, -1.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]
    scene.add_collider(ts.Mesh((corners, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])))
    return scene


def _heap3():
    scene = ts.Scene(dim=3, gravity=(0.0, -9.0, 0.0))
    scene.add_balls([[0.0, 0.3, 0.0], [0.1, 0.6, 0.0]], radius=0.14)
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
    "fabric": (_fabric, {}),
    "implicit fabric": (_fabric, {"integrator": "implicit_euler", "dt": 4e-3}),
    "body of bricks": (_body, {}),
    "implicit body": (_body, {"integrator": "tr_bdf2", "dt": 4e-3}),
    "solids": (_solids, {}),
    "letters": (_letters, {}),
    "mesh collider": (_shell, {}),
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
