"""Scenes that together use every kind of contact, element and integrator, run for a few steps on one device, for tests that
compare devices.

    python tests/support/device_scenes.py ARCH FILE.npz [NAME ...]

The file holds, under NAME.what, positions, velocities, energies and what the contacts found, a picture, or what
small steps come to.
"""

import itertools
import os
import sys
import warnings
from typing import Any

import numpy as np
import reference_bits as bits
from physics_support import PRECISION

import taichi_sim as ts
from taichi_sim.device import backend
from taichi_sim.integrators import TRBDF2, ImplicitEuler
from taichi_sim.render.renderer import Renderer

STEPS = 40


def pile(dim=2, friction=0.3, **balls):
    """280 balls that start in each other."""
    rng = np.random.default_rng(0)
    scene = ts.Scene(dim=dim, gravity=(0, -10, 0)[:dim])
    scene.add_material("rubber", restitution=0.3, friction=friction)
    scene.add_balls(rng.uniform(0, 0.5 if dim == 3 else 1.5, (280, dim)), radius=0.05, material="rubber", **balls)
    scene.add_wall((0, 1, 0)[:dim], 0.0, "rubber")
    return scene


def pile_2d():
    return pile(), {"dt": 5e-4, "contacts": "jacobi", "contact_iterations": 7}


def pile_3d():
    return pile(3), {"dt": 5e-4, "contacts": "jacobi", "contact_iterations": 4}


def pile_ordered():
    return pile(3), {"dt": 5e-4, "contacts": "jacobi", "contact_iterations": 4, "accumulate": "ordered"}


def crowd_plain_sum():
    """Sparse: in a crowd that starts in itself the plain sum turns a rounding error of 1e-7 m into 0.5 m."""
    return bits.crowd_sum()


def sizes_differ():
    """Balls of three sizes: levels of the grid."""
    rng = np.random.default_rng(2)
    scene = ts.Scene(dim=2, gravity=(0, -10))
    place = 0.1 * np.stack(np.meshgrid(np.arange(12), np.arange(12)), axis=-1).reshape(-1, 2) + 0.1
    radius = rng.choice([0.045, 0.012, 0.004], len(place), p=[0.2, 0.4, 0.4])
    scene.add_balls(place, radius=radius, mass=1e3 * radius**2, velocity=rng.normal(size=place.shape))
    scene.add_wall((0, 1), 0.05)
    return scene, {"dt": 1e-3, "contacts": "jacobi"}


def mesh_collider():
    scene = pile(3, velocity=(0, -4, 0))
    scene.walls.clear()
    corners = np.array([[-0.2, -0.4, -0.2], [0.8, -0.4, -0.2], [0.2, -0.4, 0.8], [0.2, -0.06, 0.2]])
    faces = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]])
    scene.add_collider(ts.Mesh((corners, faces), material="rubber", resolution=24))
    return scene, {"dt": 5e-4, "contacts": "jacobi"}


def sticks_and_colliders():
    scene, settings = bits.sticks_and_colliders()
    return scene, settings | {"contacts": "jacobi"}


def surfaces():
    """Two sheets whose triangles collide, above a moving collider; one is led by its pins."""
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.add_material("rubber", restitution=0.3, friction=0.4)
    for k in range(2):
        sheet = ts.shapes.cloth(
            scene, size=(0.4, 0.4), resolution=(6, 6), position=(0.05 * k, 0.06 + 0.03 * k, 0.03 * k),
            surface_collision=True, material="rubber", pinned=[0, 5] if k else False,
        )  # fmt: skip
    scene.add_moving_pins(sheet.balls[[0, 5]], path=[(0, (0, 0, 0)), (0.5, (0.1, -0.3, 0))])
    scene.add_collider(ts.Sphere((0.2, 0, 0.2), 0.05, material="rubber", path=[(0, (0, 0, 0)), (1, (0, 0.2, 0))]))
    return scene, {"dt": 1e-3, "contacts": "jacobi"}


def tearing_in_wind():
    scene, settings = bits.tearing_in_wind()
    scene.set_springs(break_strain=0.25 * scene.break_strain)
    return scene, settings


def network(method, dt=1e-3, **settings):
    def build():
        scene = bits._network(3)
        scene.add_wall((0, 1, 0), 0.45, "rubber")
        return scene, {"integrator": method, "dt": dt, "contacts": "jacobi", **settings}

    build.__name__ = method
    return build


def jelly():
    scene, settings = bits.jelly_on_floor()
    in_by = 0.03 + scene.position[:, 1].min()  # m, into the floor
    scene.set_balls(position=scene.position - in_by * np.eye(scene.dim)[1])
    return scene, settings | {"contacts": "jacobi"}


def solids():
    """Tetrahedra that hang by a side."""
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    number = (5, 3, 3)
    points, boxes = (np.argwhere(np.ones(np.array(number) - less)) for less in (0, 1))
    ways = [np.cumsum(np.eye(4, 3, -1, dtype=int)[:, list(axes)], axis=0) for axes in itertools.permutations(range(3))]
    corners = [np.ravel_multi_index(np.moveaxis(boxes[:, None] + way, 2, 0), number) for way in ways]
    scene.add_balls(0.1 * points, radius=0.02, mass=0.5, pinned=points[:, 0] == 0)
    scene.add_solids(np.concatenate(corners), young_modulus=2e4, poisson_ratio=0.45, viscosity=5.0)
    return scene, {"contacts": "off", "dt": 1e-3}


def balloon():
    scene, settings = bits.balloon_xpbd()
    return scene, settings | {"integrator": "verlet", "contacts": "jacobi"}


def many_springs():
    """More than run in one thread: blocks of the half list."""
    return bits.blocks_parallel()


def with_a_tolerance():
    return bits.adaptive()[0], {"tolerance": 1e-3, "contacts": "off"}


SCENES = (
    pile_2d, pile_3d, pile_ordered,
    crowd_plain_sum, sizes_differ, mesh_collider, sticks_and_colliders, surfaces, tearing_in_wind,
    network("explicit_euler", 1e-4), network("symplectic_euler"), network("verlet"), network("rk4"), network("implicit_euler"),
    network("tr_bdf2"), network("xpbd", accumulate="atomic"), jelly, solids, balloon, many_springs, with_a_tolerance,
)  # fmt: skip
BY_NAME = {build.__name__: build for build in SCENES}


# Where a rounding error grows ten thousand times within STEPS: what a device may be off is what the CPU is, from itself.
SENSITIVE = ("surfaces",)
STARTS = 8  # each coordinate off by a rounding error at most
ROUNDING = 2.0**-24
COMPARED = ("position", "velocity", "energy", "contacts", "depth")


def run_from_other_starts(name):
    """What comes out on the CPU from starts that are off by rounding: "others_" and what, to an array with a row for each."""
    rng = np.random.default_rng(0)
    others = []
    for _ in range(STARTS):
        scene, settings = BY_NAME[name]()
        x = scene.position
        scene.set_balls(np.arange(len(x)), position=x * (1.0 + ROUNDING * rng.uniform(-1.0, 1.0, x.shape)))
        others.append(run(name, "cpu", scene, settings))
    return {f"others_{what}": np.stack([other[what] for other in others]) for what in COMPARED}


def from_other_starts(found):
    """What `run_from_other_starts` has put into a result, one after another; nothing where it did not."""
    number = len(found.get("others_position", ()))
    return [{what: found[f"others_{what}"][k] for what in COMPARED} for k in range(number)]


def run(name, arch, scene=None, settings=None):
    """What came out, name to array. scene, settings: those of this name unless given."""
    if scene is None:
        scene, settings = BY_NAME[name]()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        simulation = ts.Simulation(scene, arch=arch, precision=PRECISION, driver="parallel", **settings)
    with simulation:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            simulation.step(4 if "tolerance" in settings else STEPS)
            contacts = simulation.contacts()
        torn = simulation.torn
        return {
            "position": simulation.position,
            "velocity": simulation.velocity,
            "spin": simulation.angular_velocity,
            "energy": np.array(simulation.energy()),
            "contacts": np.array([contacts.number, contacts.searches]),
            "depth": np.array([contacts.penetration, contacts.residual]),
            "torn": np.zeros(0) if torn is None else torn,
        }


def swinging_cloth():
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    corners: dict[str, Any] = {"pinned": [0, 90], "stiffness": 2000, "damping": 0.2}
    ts.shapes.cloth(scene, size=(0.6, 0.6), resolution=(10, 10), **corners)
    return scene


def hanging_beam():
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    ts.shapes.jelly(scene, size=(0.6, 0.2, 0.2), resolution=(7, 3, 3), mass=2.0, pinned=list(range(9)))
    return scene


SWINGING = {"swinging_cloth": swinging_cloth, "hanging_beam": hanging_beam}


def swung(name, arch, integrator="xpbd", parts=1):
    """Positions after 0.2 s by steps of 1 ms / parts."""
    settings = {"driver": "auto" if arch == "cpu" else "parallel", "contacts": "off", "precision": PRECISION}
    with ts.Simulation(SWINGING[name](), arch=arch, integrator=integrator, dt=1e-3 / parts, **settings) as sim:
        sim.step(200 * parts)
        return {"position": sim.position, "kernels": np.array(sim.kernels())}


STIFF = {"stiff_implicit_euler": ImplicitEuler, "stiff_tr_bdf2": TRBDF2}


def stiff(name, arch, **tolerance):
    """Positions of a cloth after 0.2 s, in steps that do not resolve its springs: slow modes are what is hard to solve for."""
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    ts.shapes.cloth(scene, size=(1.2, 1), resolution=(24, 20), mass=0.4, stiffness=6e4, damping=0.1, pinned="left")
    settings = {"driver": "auto" if arch == "cpu" else "parallel", "contacts": "off", "precision": PRECISION}
    with ts.Simulation(scene, arch=arch, integrator=STIFF[name](**tolerance), dt=5e-3, **settings) as sim:
        sim.step(40)
        return {"position": sim.position}


def solids_and_cloth():
    """Of all that is drawn in 3D: balls, sticks, triangles, colliders, ground."""
    scene, _ = surfaces()
    scene.add_balls([[-0.1, 0.1, 0.1], [-0.1, 0.2, 0.2]], radius=0.03, colour=(0.9, 0.4, 0.1))
    scene.add_springs([[scene.n_balls - 2, scene.n_balls - 1]], stiffness=100.0, collides=True)
    scene.add_collider(ts.Box((0.5, 0.1, 0.1), (0.1, 0.2, 0.1), material="rubber"))
    scene.add_wall((0, 1, 0), 0.0, "rubber")
    return scene


def looks_at_dusk():
    """A woven cloth with a hem, and jelly that light comes through."""
    scene = ts.Scene(dim=3)
    ts.shapes.cloth(
        scene, size=(1, 1), resolution=(9, 9), rotation=(60, 0, 0), position=(0, 1, 0), colour=(0.2, 0.4, 0.7)
    )
    ts.shapes.jelly(scene, size=(0.3, 0.3, 0.3), resolution=(3, 3, 3), position=(0.6, 0, 0.4), colour=(0.9, 0.5, 0.2))
    scene.add_wall((0, 1, 0))
    looks = [{"of": "cloth_0", "pattern": "weave", "repeat": 30, "hem": 0.05}, {"of": "jelly_0", "translucency": 0.5}]
    scene.output = {"stage": "dusk", "looks": looks}
    return scene


PICTURES = {
    "drawn_3d": solids_and_cloth,
    "drawn_looks": looks_at_dusk,
    "drawn_crowd": lambda: pile(3),
    "drawn_2d": lambda: bits.sticks_and_colliders()[0],
}


def picture(name, arch):
    """(height, width, 3) of a scene at its start."""
    with ts.Simulation(
        PICTURES[name](), arch=arch, precision=PRECISION, contacts="off", driver="parallel", dt=1e-4
    ) as sim:
        frame, output = sim.frame(), sim.scene.output
    renderer = Renderer(frame, size=(480, 270), **{key: output[key] for key in ("stage", "looks") if key in output})
    return renderer.render(frame)


if __name__ == "__main__":
    arch, file, *names = sys.argv[1:]
    if arch == "cpu":  # scenes are small, and each worker of pytest has such a process
        backend.start(arch, PRECISION, threads=min(2, os.cpu_count() or 1))
    found: dict[str, Any] = {}
    for name in names or (*PICTURES, *BY_NAME, *SWINGING, *STIFF):
        if name in STIFF:
            made = stiff(name, arch)
            if PRECISION == "f64":
                made |= {"exact": stiff(name, arch, tolerance=1e-9)["position"]}
        elif name in SWINGING:
            made = swung(name, arch) | {"exact": swung(name, arch, "verlet", 20)["position"]}
        else:
            made = {"picture": picture(name, arch)} if name in PICTURES else run(name, arch)
            if name in SENSITIVE and arch == "cpu":
                made |= run_from_other_starts(name)
        found |= {f"{name}.{what}": array for what, array in made.items()}
        print(name, flush=True)
    np.savez(file, **found)
