"""The contents of a scene: equal for equal scenes, and a change shows in the part that it is of."""

import json

import numpy as np
import pytest

from taichi_sim import Box, Scene
from taichi_sim.render.camera import Camera
from taichi_sim.scene.contents import contents_of, described

pytestmark = pytest.mark.once


def scene(**change):
    made = Scene(dim=3, gravity=change.get("gravity", (0, -10, 0)))
    made.add_material("ice", friction=change.get("friction", 0.1))
    made.add_balls(np.eye(3), radius=0.1, mass=change.get("mass", 1.0), material="ice")
    made.add_springs([[0, 1]], stiffness=10.0, damping=change.get("damping", 0.0))
    made.add_wall((0, 1, 0), offset=change.get("offset", -1.0))
    made.add_collider(Box(center=(5, 0, 0), size=(1, 1, change.get("depth", 1))))
    made.add_probe("all", "energy")
    return made


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ({"gravity": (0, -1, 0)}, "gravity"),
        ({"friction": 0.2}, "materials.ice"),
        ({"mass": 2.0}, "balls.mass"),
        ({"damping": 0.5}, "springs.damping"),
        ({"offset": -2.0}, "walls[0]"),
        ({"depth": 2}, "colliders[0]"),
    ],
)
def test_a_change_shows_in_its_part(change, part):
    one, other = contents_of(scene()), contents_of(scene(**change))
    assert one == contents_of(scene())
    assert [name for name in one if one[name] != other[name]] == [part]
    assert json.loads(json.dumps(one)) == json.loads(json.dumps(contents_of(scene())))


@pytest.mark.parametrize("names", [("1.balls", "b"), ("b", "0.balls"), ("0.balls", "1.balls")])
def test_a_name_like_that_of_an_array_hides_nothing(names):
    made = Scene(dim=2)
    for k, name in enumerate(names):
        made.set_name(made.add_balls([[k, 0.0]], radius=0.1), name)
    found = contents_of(made)
    assert {f"objects.{k}.balls" for k in range(2)} <= found.keys()
    rows = [value for name, value in found.items() if name.startswith("objects") and isinstance(value, dict)]
    assert [row["name"] for row in rows] == list(names)


def test_objects_are_their_class_and_their_plain_attributes():
    class Drag:
        def __init__(self, factor):
            self.factor, self.field, self.table = factor, object(), np.arange(3)

    assert described(Drag(0.5)) == described(Drag(0.5))
    assert described(Drag(0.5)) != described(Drag(0.6))
    views = [described({"camera": Camera(eye=(1.0, 0.0, k), target=(0.0, 0.0, 0.0))}) for k in (1.0, 1.0, 2.0)]
    assert views[0] == views[1] != views[2]
