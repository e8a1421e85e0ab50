"""A scene's arrays are read-only, what changes them is checked, and a simulation's copy stays as it is."""

import json
import pickle
from copy import deepcopy

import numpy as np
import pytest
from physics_support import simulate
from scene_files import assert_unchanged

import taichi_sim as ts
from taichi_sim.scene.document import document, fill

pytestmark = pytest.mark.once


def world():
    scene = ts.Scene(dim=3, gravity=(0, -9, 0))
    sheet = ts.shapes.cloth(scene, size=(1, 1), resolution=(3, 4), mass_per_area=0.2, pinned=[0])
    scene.add_cells([[0, 1, 4, 5]], bulk_modulus=3.0, rest_volume=0.1)
    scene.add_material("ice", friction=0.01)
    scene.add_collider(ts.Sphere((0, -3, 0), 0.4))
    scene.add_moving_pins([1, 2], velocity=(0, 1, 0))
    scene.add_motor([0], path=[(0, 0), (1, 0.2)])
    surface = sheet.triangles[:1]
    scene.add_embedded_surface(surface.T, np.ones((3, 1)), [[0, 1, 2]])
    return scene


def arrays_of(scene):
    yield from ((name, array) for name, array in document(scene)[1].items())
    yield "gravity", scene.gravity
    held = [
        *scene.colliders,
        *(c.motion for c in scene.colliders),
        *scene.moving_pins,
        *scene.motors,
        *scene.embedded_surfaces,
    ]
    for one in held:
        for name in one.__dataclass_fields__:
            if isinstance(array := getattr(one, name), np.ndarray):
                yield f"{type(one).__name__}.{name}", array


def test_no_array_of_a_scene_can_be_written_to():
    scene = world()
    named = dict(arrays_of(scene))
    assert {
        "balls.mass",
        "cells.corners",
        "bending.weights",
        "Motion.times",
        "MovingPins.balls",
        "Motor.springs",
    } <= set(named)
    for name, array in named.items():
        with pytest.raises(ValueError, match="read-only"):
            array[...] = array
        if "." in name and name.split(".")[0] in ("balls", "springs", "triangles", "cells", "bending"):
            with pytest.raises(ValueError, match="WRITEABLE"):
                array.flags.writeable = True


def test_the_arrays_given_stay_the_callers():
    scene, x, pairs = ts.Scene(dim=2), np.array([[0.0, 2.0], [1.0, 2.0]]), np.array([[0, 1]], dtype=np.int32)
    scene.add_balls(x, radius=0.1)
    scene.add_springs(pairs, stiffness=3.0)
    x[:], pairs[:] = 7.0, 0
    assert scene.position[1, 0] == 1.0
    assert scene.pairs[0, 1] == 1
    values, columns = document(scene)
    columns = {name: array.copy() for name, array in columns.items()}
    other = ts.Scene(dim=2)
    fill(other, values, columns)
    columns["balls.mass"][:] = -1.0
    assert np.all(other.mass == 1.0)


def test_what_balls_and_springs_are_can_be_changed():
    scene = world()
    before = scene.mass
    scene.set_balls([3, 4], mass=[2.0, 5.0], velocity=(1, 2, 3), material="ice", body=[7, 8])
    scene.set_balls(scene.position[:, 0] > 0.9, radius=0.03)
    scene.set_balls(slice(0, 1), pinned=False)
    scene.set_springs([1], stiffness=11.0, damping=0.5, rest_length=0.2, break_strain=0.3)
    scene.set_bending(damping=0.25)
    scene.gravity = (0, 0, -2)
    assert scene.mass[3:5].tolist() == [2.0, 5.0]
    assert before[4] != 5.0
    assert scene.velocity[4].tolist() == [1.0, 2.0, 3.0]
    assert scene.material[4] == 1
    assert scene.body[4] == 8
    assert (scene.radius == 0.03).sum() == (scene.position[:, 0] > 0.9).sum() > 0
    assert not scene.pinned[0]
    assert scene.pinned[1]
    assert [getattr(scene, name)[1] for name in ("stiffness", "damping", "rest_length", "break_strain")] == [
        11,
        0.5,
        0.2,
        0.3,
    ]
    assert np.all(scene.bend_damping == 0.25)
    assert scene.gravity.tolist() == [0.0, 0.0, -2.0]
    scene.set_balls(3, pinned=True)
    assert not scene.velocity[3].any()


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (lambda s: s.set_balls(mass=-1.0), "balls.mass"),
        (lambda s: s.set_balls([0, 99], mass=1.0), "balls"),
        (lambda s: s.set_balls([0, 1], radius=[1.0, 0.0]), "balls.radius"),
        (lambda s: s.set_balls(position=np.nan), "balls.position"),
        (lambda s: s.set_balls(material="snow"), "balls.material"),
        (lambda s: s.set_balls(1, body=0.5), "balls.body"),
        (lambda s: s.set_balls(pinned=False), "balls.pinned"),
        (lambda s: s.set_springs(stiffness=[1.0, 2.0]), "springs.stiffness"),
        (lambda s: s.set_springs(0, rest_length=0.0, break_strain=0.1), "springs.break_strain"),
        (lambda s: s.set_bending(stiffness=-2.0), "bending.stiffness"),
        (lambda s: setattr(s, "gravity", (0.0, np.inf, 0.0)), "gravity"),
    ],
)
def test_a_change_is_checked_and_a_bad_one_changes_nothing(change, place):
    assert_unchanged(world(), change, place.replace(".", r"\."))


def test_what_a_frozen_copy_says_of_its_pictures_stays():
    scene = world()
    scene.settings = {"dt": 1e-3}
    scene.output = {"fps": 30.0, "size": (640, 360), "camera": {"eye": [1, 2, 3]}}
    held = scene.frozen()
    again = pickle.loads(pickle.dumps(held))
    for one in (held, again):
        for change in (
            lambda one=one: one.output.update(fps="x"),
            lambda one=one: one.output.__setitem__("fps", "x"),
            lambda one=one: one.output.pop("fps"),
            lambda one=one: one.output["camera"].clear(),
            lambda one=one: one.output["camera"]["eye"].append(4),
            lambda one=one: one.output["camera"]["eye"].__setitem__(0, 4),
            lambda one=one: one.settings.setdefault("contacts", "off"),
            lambda one=one: setattr(one, "output", {}),
            lambda one=one: setattr(one, "settings", {}),
        ):
            with pytest.raises(
                ts.SceneError, match=r"^(output|settings)(\.camera.*)?: this scene belongs to a simulation"
            ):
                change()
        assert one.output == scene.output
        assert one.settings == scene.settings
        mine = deepcopy(one.output)
        mine["camera"]["eye"].append(4)
        assert one.output["camera"]["eye"] == [1, 2, 3]
    assert json.loads(json.dumps(held.output)) == {"fps": 30.0, "size": [640, 360], "camera": {"eye": [1, 2, 3]}}


def test_a_frozen_copy_stays_as_it_is():
    scene = world()
    held = scene.frozen()
    before = document(held)[1]
    scene.add_balls([[5, 5, 5]], radius=0.1)
    scene.set_balls(mass=9.0)
    scene.gravity = (1, 0, 0)
    scene.add_wall((0, 1, 0))
    scene.add_material("new")
    scene.settings["dt"] = 1.0
    assert held.n_balls == 12
    assert not held.walls
    assert len(held.materials) == 2
    assert not held.settings
    assert held.gravity[1] == -9.0
    assert held.frozen() is held
    for refused in (
        lambda: held.add_balls([[0, 0, 0]], radius=1.0),
        lambda: held.add_wall((0, 1, 0)),
        lambda: held.set_balls(mass=1.0),
        lambda: held.set_group([0], "a"),
        lambda: held.new_body(),
        lambda: setattr(held, "gravity", (0, 0, 0)),
        lambda: fill(held, *document(scene)),
        lambda: ts.shapes.cloth(held, size=(1, 1), resolution=(3, 3)),
    ):
        with pytest.raises(ts.SceneError, match="belongs to a simulation"):
            refused()
    again = pickle.loads(pickle.dumps(held))
    with pytest.raises(ts.SceneError):
        again.add_balls([[0, 0, 0]], radius=1.0)
    for one in (held, again):
        assert all(np.array_equal(array, before[name], equal_nan=True) for name, array in document(one)[1].items())


def test_later_changes_of_a_scene_do_not_reach_its_simulation(tmp_path):
    scene = ts.Scene(dim=2, gravity=(0, -8))
    scene.add_balls([[0, 2], [0.5, 3]], radius=0.1)
    with simulate(scene, dt=1e-3, contacts="off") as sim:
        sim.step(10)
        before = sim.energy()
        scene.add_balls([[3, 3], [4, 4], [5, 5]], radius=0.2)
        scene.add_springs([[0, 1]], stiffness=10.0)
        scene.set_balls(mass=7.0)
        scene.add_wall((0, 1))
        scene.gravity = (0, 3)
        assert sim.energy() == before
        assert sim.frame().radius.shape == (2,)
        sim.save(tmp_path / "state.npz")
        with ts.Simulation.restore(tmp_path / "state.npz") as again:
            assert np.array_equal(again.position, sim.position)
            again.step(10)
            assert np.allclose(again.velocity[:, 1], -8 * 0.02, rtol=1e-5)
        with pytest.raises(
            ts.SceneError, match=r"^scene: got more balls, springs, walls after this simulation was made"
        ):
            sim.step(10)
        with pytest.raises(ts.SceneError, match="belongs to a simulation"):
            sim.scene.set_balls(mass=-1.0)
        with pytest.raises(ValueError, match="read-only"):
            sim.scene.mass[:] = -1.0
