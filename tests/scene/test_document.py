"""Scenes come back as they were from scene files and from their documents, which state files hold, whatever is in them."""

import dataclasses
import json
from collections.abc import Mapping

import numpy as np
import pytest
from element_blocks import add_block, blocks
from physics_support import box_mesh
from trajectories import muscle

import taichi_sim as ts
from taichi_sim.scene.document import document, fill
from taichi_sim.scene.parts import LISTS

pytestmark = pytest.mark.once

TETRAHEDRON = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
CUBE = box_mesh()


def elements(dim):
    """Bodies of each kind of element, and further ones without damping: columns that are in part what a file assumes."""
    scene, _ = blocks(dim, damping=0.4)
    for kind in ("bricks", "solids"):
        add_block(scene, kind, 0.05)
    scene.add_cells(scene.cells[:2], bulk_modulus=3.0, rest_volume=0.2)
    return scene


def four():
    """A tetrahedron of balls and one beside it."""
    scene = ts.Scene(dim=3, gravity=(0.1, -9.81, 0.0))
    scene.add_balls([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], radius=0.2, colour=(0.05, 0.8, 0.05))
    scene.add_balls([[3, 0, 0]], radius=0.1)
    return scene


def fabric():
    scene = ts.Scene(dim=3)
    law = {"warp": 30.0, "weft": 12.0, "shear": 4.0, "coupling": 7.0}
    ts.shapes.cloth(scene, (1.0, 1.0), (4, 5), warp_angle=20.0, break_strain=0.2, **law)
    return scene


def colliders():
    scene = ts.Scene(dim=3)
    scene.add_material("rubber", friction=0.3)
    scene.add_balls([[0.0, 3.0, 0.0]], radius=0.1)
    path = [(0.0, (0, 0, 0), (0, 0, 0)), (0.7, (0.1, 0.3, 0), (0, 40, 0))]
    scene.add_collider(ts.Box((3, 0, 0), (1, 0.3, 2), rotation=(0, 30, 0), colour=(0.1, 0.2, 0.3), path=path))
    scene.add_collider(ts.Sphere((0, 0, 0), 1.0, hollow=0.1, material="rubber", rotation_rate=(0, 90, 0)))
    scene.add_collider(ts.Mesh(CUBE, scale=1 / 3, rotation=(10, 20, 30), velocity=(0, 0.1, 0), resolution=8))
    scene.add_collider(ts.Capsule((0, 0, 0), (1 / 3, 1, 2), 0.1, rotation=np.eye(3)[[1, 2, 0]]))
    many = np.concatenate([CUBE[0] + 3 * k for k in range(9)]), np.concatenate([CUBE[1] + 8 * k for k in range(9)])
    scene.add_collider(ts.Mesh(many, position=(9, 0, 0), resolution=8))
    return scene


def groups():
    scene = ts.Scene()
    scene.add_balls([[0.0, 0.0], [1.0, 0.0]], radius=0.1, group=["net", "rope"], collides_with="fish")
    scene.add_balls([[2.0, 0.0]], radius=0.1, group="fish", collides_with=[])
    scene.add_wall((0, 1), -1.0, collides_with=["net"])
    scene.add_collider(ts.Box((0.0, -3.5), (4.0, 1.0), group="net"))
    return scene


def walls():
    """Normals that are normalised once more come back as they were."""
    scene = ts.Scene()
    scene.add_balls([[0.0, 1.0]], radius=0.1)
    for angle in np.linspace(0.05, 6.2, 12):
        scene.add_wall((np.sin(angle), np.cos(angle)), offset=-1.0)
    return scene


def gas():
    """A gas that is squeezed before the start keeps the volume at which it has its pressure."""
    scene = four()
    scene.add_gas(TETRAHEDRON, pressure=7.0)
    scene.set_balls(3, position=[0.1, 0.2, 1.7])
    assert scene.gases[0].volume == 1 / 6
    return scene


def pins():
    scene = ts.Scene(dim=3)
    sheet = ts.shapes.cloth(scene, resolution=(21, 21))
    scene.add_moving_pins(sheet.balls[:250], path=[(t, (0.0, 0.0, 0.1 * t), None) for t in np.arange(3)])
    scene.add_wind((1.0, 0.0, 0.5), gust=0.3)
    return scene


def probes():
    scene = four()
    scene.add_springs([[0, 1]], stiffness=1.0)
    scene.add_wall((0, 1, 0), -5.0)
    scene.add_probe("many", "position", balls=np.tile(np.arange(scene.n_balls), 300))
    scene.add_probe("load", "tension", spring=0)
    scene.add_probe("all", "strain")
    scene.add_probe("through", "flux", normal=(1, 2, 0), offset=0.5, balls=[0])
    scene.add_probe("e", "energy")
    scene.add_probe("floor", "impulse", wall=0)
    return scene


def surface(coloured):
    scene = four()
    weights = np.full((4, 4), 0.1) + 0.6 * np.eye(4)
    more = {"covers": [4], "colour": (0.9, 0.05, 0.05), "uv": np.linspace(0, 1, 24).reshape(4, 3, 2)}
    scene.add_embedded_surface(np.tile(np.arange(4), (4, 1)), weights, TETRAHEDRON, **(more if coloured else {}))
    return scene


SCENES = {
    "elements": lambda: elements(2),
    "elements in 3D": lambda: elements(3),
    "motors": lambda: muscle(5),
    "surface": lambda: surface(False),
    "coloured surface": lambda: surface(True),
    **{build.__name__: build for build in (fabric, colliders, groups, walls, gas, pins, probes)},
}


def assert_alike(one, other, where):
    """Assert that two values are equal all the way down: arrays, lists, mappings and dataclasses."""
    if dataclasses.is_dataclass(one):
        for name in (field.name for field in dataclasses.fields(one)):
            if name != "kind" or not where.startswith("objects"):  # a name that was chosen by it is then a given one
                assert_alike(getattr(one, name), getattr(other, name), f"{where}.{name}")
    elif isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, other, err_msg=where)
    elif isinstance(one, Mapping):
        assert one.keys() == other.keys(), where
        for key in one:
            assert_alike(one[key], other[key], f"{where}.{key}")
    elif isinstance(one, (list, tuple)):
        assert len(one) == len(other), where
        for k, both in enumerate(zip(one, other)):
            assert_alike(*both, f"{where}[{k}]")
    else:
        assert one == other, where


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_comes_back_as_it_was(name, tmp_path):
    scene = SCENES[name]()
    values, arrays = document(scene)
    assert json.loads(json.dumps(values)) == values  # as a state file keeps them
    scene.save(tmp_path / "scene.toml")
    again = ts.Scene(scene.dim, scene.gravity)
    fill(again, values, arrays)
    for one in (ts.load_scene(tmp_path / "scene.toml"), again, scene.frozen()):
        assert_alike(scene.gravity, one.gravity, "gravity")
        assert_alike(scene.groups.names, one.groups.names, "groups")
        for table, columns in scene.tables.items():
            for column in columns.names:
                assert_alike(columns[column], one.tables[table][column], f"{table}.{column}")
        for part in LISTS:
            assert_alike(list(getattr(scene, part)), list(getattr(one, part)), part)
        assert_alike(document(scene), document(one), "document")
