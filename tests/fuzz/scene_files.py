"""Scene files: every table there is, then something else."""

import json
import warnings

import numpy as np
import tomlkit
from hypothesis import strategies as st

import taichi_sim as ts
from taichi_sim.analysis.collider_checks import check_colliders
from taichi_sim.analysis.stability import stability
from taichi_sim.files.source import checked_output
from taichi_sim.scene.document import document, fill
from taichi_sim.simulation.settings import Settings

from .documents import changed, damaged, mostly

TETRAHEDRON = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
CORNERS = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]

PLANE = {
    "format": 1,
    "dim": 2,
    "gravity": [0.0, -10.0],
    "simulation": {"dt": 1e-3, "integrator": "verlet", "precision": "f32", "substeps": 1},
    "output": {"fps": 30, "duration": 1.0, "size": [64, 64], "colour": "strain", "colour_range": [0.0, 1.0]},
    "materials": [{"name": "rubber", "restitution": 0.5, "friction": 0.1, "colour": [0.1, 0.2, 0.3]}],
    "balls": [
        {"name": "pair", "position": [[0.0, 1.0], [1.0, 1.0]], "radius": [0.1, 0.2], "mass": 1.0, "material": "rubber"},
        {"position": [[3.0, 1.0]], "velocity": [1.0, 0.0], "radius": 0.1, "group": ["a"], "collides_with": ["a"], "body": 3},
        {"name": "far", "file": "arrays.npz", "prefix": "far_"},
    ],
    "rope": [{"start": [0.0, 3.0], "end": [1.0, 3.0], "n": 5, "bending_stiffness": 1.0, "pinned": [0]}],
    "wheel": [{"centre": [0.0, 9.0], "radius": 0.5, "spokes": 5, "name": "wheel"}],
    "pile": [{"resolution": [3, 3], "radius": 0.1, "position": [5.0, 0.0], "seed": 1}],
    "truss": [{"size": [1.0, 0.2], "cells": 3, "rotation": 20.0}],
    "jelly": [{"size": [1.0, 1.0], "resolution": [3, 3], "position": [9.0, 0.0], "young_modulus": 1e4, "poisson_ratio": 0.5}],
    "tower": [{"levels": 2, "resolution": [2, 2], "position": [20.0, 0.0]}],
    "springs": [{"balls": "pair", "pairs": [[0, 1]], "stiffness": 10.0, "damping": [0.1], "break_strain": 0.5}],
    "attachments": [{"one": "pair", "one_members": [0], "other": [2], "stiffness": 5.0}],
    "moving_pins": [{"balls": "wheel", "members": [0], "path": [[0.0, [0.0, 0.0]], [1.0, [1.0, 0.0], 30.0]]}],
    "walls": [{"normal": [0.0, 1.0], "offset": -1.0, "material": "rubber"}],
    "colliders": [
        {"shape": "sphere", "center": [50.0, 0.0], "radius": 1.0, "hollow": 0.1, "rotation_rate": 60.0},
        {"shape": "box", "center": [60.0, 0.0], "size": [1.0, 1.0], "path": [[0.0, [0.0, 0.0]], [1.0, [9.0, 0.0]]]},
        {"shape": "capsule", "start": [70.0, 0.0], "end": [71.0, 0.0], "radius": 0.2, "velocity": [1.0, 0.0]},
    ],
    "probes": [{"name": "load", "kind": "tension", "spring": 0}, {"name": "up", "kind": "flux", "normal": [0.0, 1.0]}],
}  # fmt: skip
SPACE = {
    "format": 1,
    "dim": 3,
    "gravity": [0.0, -10.0, 0.0],
    "simulation": {"tolerance": 1e-3, "contacts": "jacobi", "contact_iterations": 4, "threads": 1},
    "output": {"camera": {"azimuth": 20.0, "distance": 3.0, "follow": "skin"}},
    "balls": [{"name": "skin", "position": CORNERS, "radius": 0.01}],
    "cloth": [
        {"size": [1.0, 1.0], "resolution": [4, 4], "position": [0.0, 5.0, 0.0], "surface_collision": True},
        {"size": [1.0, 1.0], "resolution": [3, 4], "position": [0.0, 7.0, 0.0], "stretch_stiffness": 100.0, "pinned": [0]},
        {"mesh": "mesh.obj", "position": [0.0, 9.0, 0.0], "stiffness": 10.0},
    ],
    "jelly": [
        {"size": [1.0, 1.0, 1.0], "resolution": [3, 3, 3], "position": [0.0, 12.0, 0.0]},
        {"mesh": "mesh.obj", "spacing": 0.2, "position": [0.0, 15.0, 0.0], "density": 100.0},
    ],
    "net": [{"size": [1.0, 1.0], "meshes": [2, 2], "pieces": 2, "position": [0.0, 20.0, 0.0]}],
    "balloon": [{"centre": [0.0, 25.0, 0.0], "radius": 0.5, "subdivisions": 1, "pressure": 1.0}],
    "cells": [{"corners": [[0, 1, 2, 3]], "bulk_modulus": 10.0}],
    "bending": [{"corners": [[0, 1, 2, 3]], "weights": [[1.0, -1.0, 1.0, -1.0]], "stiffness": 1.0}],
    "gases": [{"triangles": TETRAHEDRON, "pressure": 1.0, "outside": 1.0, "balls": "skin"}],
    "moving_pins": [{"balls": [5], "velocity": [1.0, 0.0, 0.0], "rotation_rate": [0.0, 60.0, 0.0], "pivot": [0.0, 0.0, 0.0]}],
    "wind": {"velocity": [1.0, 0.0, 0.0], "gust": 0.5, "gust_length": 1.0},
    "colliders": [
        {"shape": "mesh", "mesh": "mesh.obj", "position": [90.0, 0.0, 0.0], "resolution": 8},
        {"shape": "mesh", "vertices": CORNERS, "triangles": TETRAHEDRON, "position": [80.0, 0.0, 0.0], "resolution": 8},
        {"shape": "box", "center": [60.0, 0.0, 0.0], "size": [1.0, 1.0, 1.0], "rotation": [10.0, 20.0, 30.0]},
    ],
    "triangles": [{"triangles": TETRAHEDRON, "collides": [True, True, False, True]}],
    "embedded_surfaces": [
        {"corners": [[0, 1], [1, 2], [2, 3]], "weights": [[0.5, 0.5]] * 3, "triangles": [[0, 1, 2]], "covers": [3]}
    ],
    "probes": [{"name": "where", "kind": "position", "balls": "skin", "members": [0, 1]}, {"name": "e", "kind": "energy"}],
}  # fmt: skip


def prepare(folder):
    """What the scene files name, beside them."""
    np.savez(folder / "arrays.npz", far_position=[[90.0, 9.0], [95.0, 9.0]], far_radius=[0.1, 0.2], odd=np.arange(3))
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in TETRAHEDRON]
    (folder / "mesh.obj").write_text("\n".join(lines))


def _toml(document):
    try:
        return tomlkit.dumps(document).encode(errors="replace")
    except (TypeError, ValueError, AttributeError):  # what TOML has no word for
        return json.dumps(document, default=str).encode()


cases = changed([PLANE, SPACE]).map(_toml)
cases = mostly(cases, st.sampled_from([PLANE, SPACE]).map(_toml).flatmap(damaged))


def judge(folder, data):
    """Read it, and all that is said about it before anything is compiled."""
    file = folder / "scene.toml"
    file.write_bytes(data)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        scene = ts.load_scene(file)
        checked_output(scene)
        scene.has_groups()
        settings = Settings.resolve(scene, {})
        safe = stability(scene, settings.integrator.method)
        seconds, parts = settings.time_step(scene, safe)
        check_colliders(scene, seconds / parts)
    fill(ts.Scene(scene.dim, scene.gravity), *document(scene))
    return scene
