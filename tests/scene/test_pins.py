"""Which balls `pinned` means, where paths begin, and what shapes take alike."""

import inspect
from pathlib import Path

import numpy as np
import pytest
from scene_files import assert_refused

import taichi_sim as ts
from taichi_sim.files.toml_schema import SHAPES

pytestmark = pytest.mark.once

GRID = {"size": (2.0, 1.0), "resolution": (5, 3)}  # ball (i, j) along x and z is 3 i + j
SHELL = (
    np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1], [0.5, 0, 0.5]]),
    [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]],
)
MADE = {
    "cloth": GRID,
    "jelly": {"size": (1, 1, 1), "resolution": (3, 3, 3)},
    "rope": {"start": (0, 0, 0), "end": (1, 1, 0), "n": 5},
    "wheel": {"centre": (0, 0, 0), "radius": 1.0, "spokes": 6},
    "pile": {"resolution": (3, 2, 2), "radius": 0.1, "jitter": 0.0},
    "truss": {"size": (2, 1, 1), "cells": 2},
    "net": {"size": (1, 1), "meshes": (2, 2), "pieces": 2},
    "balloon": {"centre": (0, 0, 0), "radius": 1.0, "subdivisions": 1},
    "tower": {"levels": 2, "resolution": (2, 2, 2)},
    "text": {"text": "L", "spacing": 0.2},
    "svg": {"file": Path(__file__).parents[1] / "shapes" / "square.svg", "spacing": 0.5},
}


def pinned(name="cloth", scene=None, **given):
    scene = scene or ts.Scene(dim=3)
    shape = getattr(ts.shapes, name)(scene, **MADE[name] | given)
    return np.flatnonzero(scene.pinned[shape.balls]).tolist(), scene.position[shape.balls]


@pytest.mark.parametrize("turn", [(0, 0, 0), (20, 40, 10)])
def test_border_and_corners_are_those_of_the_shape_however_it_is_turned(turn):
    assert pinned(pinned="border", rotation=turn)[0] == [0, 1, 2, 3, 5, 6, 8, 9, 11, 12, 13, 14]
    assert pinned(pinned="corners", rotation=turn)[0] == [0, 2, 12, 14]


def test_a_list_means_all_of_its_parts():
    sides = [pinned(pinned=word)[0] for word in ("left", "right")]
    assert pinned(pinned=["left", "right"])[0] == sorted(set().union(*sides))
    _, x = pinned()
    ball = {"shape": "sphere", "center": x[7].tolist(), "radius": 0.01}
    assert pinned(pinned=["corners", ball])[0] == [0, 2, 7, 12, 14]
    with pytest.raises(ts.SceneError, match=r"cloth\.pinned\[1\]: 'lefft'"):
        pinned(pinned=["right", "lefft"])


@pytest.mark.parametrize(
    ("word", "axis", "sign"),
    [("left", 0, -1), ("right", 0, 1), ("bottom", 1, -1), ("top", 1, 1), ("back", 2, -1), ("front", 2, 1)],
)
def test_sides_are_those_of_the_placed_shape(word, axis, sign):
    for turn in ((90, 0, 0), (0, 0, 90)):
        if turn == (90, 0, 0) and axis == 2:
            continue  # flat along z
        if turn == (0, 0, 90) and axis == 0:
            continue
        held, x = pinned(pinned=word, rotation=turn, position=(3, 4, 5))
        along = sign * x[:, axis]
        assert held == np.flatnonzero(along > along.max() - 1e-9).tolist()
        assert 0 < len(held) < len(x)


@pytest.mark.parametrize(
    ("name", "word", "count"),
    [
        ("jelly", "corners", 8),
        ("jelly", "border", 20),
        ("rope", "border", 2),
        ("rope", "corners", 2),
        ("wheel", "border", 6),
        ("truss", "left", 4),
        ("net", "corners", 4),
        ("net", "border", 16),
        ("tower", "bottom", 4),
        ("pile", "bottom", 6),
        ("balloon", "top", 1),
    ],
)
def test_every_shape_knows_sides(name, word, count):
    if (name, word) == ("jelly", "border"):  # its surface is closed
        with pytest.raises(ts.SceneError, match=r"jelly.pinned: 'border' is not there: its surface is closed"):
            pinned(name, pinned=word)
        return
    assert len(pinned(name, pinned=word)[0]) == count


@pytest.mark.parametrize(
    ("pins", "held"),
    [
        ("start", [0]),
        ("end", [6]),
        ("ends", [0, 6]),
        ("border", [0, 6]),
        (["border"], [0, 6]),
        (["end", "start"], [0, 6]),
    ],
)
def test_a_rope_is_held_at_its_ends_however_it_hangs(pins, held, tmp_path):
    hanging = {"start": (0, 0, 0), "end": (1, 0.4, 0), "n": 7, "length": 2.0}
    assert pinned("rope", pinned=pins, **hanging)[0] == held
    rope = 'name = "cable"\nstart = [0, 0, 0]\nend = [1, 0.4, 0]\nn = 7\nlength = 2.0'
    probe = f'name = "a"\nkind = "position"\nballs = "cable"\nmembers = {pins!r}'
    file = tmp_path / "a.toml"
    file.write_text(f"format = 1\ndim = 3\n[[cloth]]\nresolution = [3, 3]\n[[rope]]\n{rope}\n[[probes]]\n{probe}\n")
    assert ts.load_scene(file).probes[0].given["balls"].tolist() == [9 + k for k in held]


def test_a_mesh_has_the_border_that_its_triangles_have():
    scene = ts.Scene(dim=3)
    sheet = ts.shapes.cloth(scene, mesh=SHELL, pinned="border")
    assert scene.pinned[sheet.balls].tolist() == [True, True, True, True, False]


def test_within_a_solid():
    held, x = pinned(pinned=ts.Sphere((0, 0, 0), 0.6), position=(0.1, 0, 0))
    assert held == np.flatnonzero(np.linalg.norm(x, axis=1) <= 0.6).tolist()
    table = {"shape": "box", "center": (1, 0, 0.5), "size": (1.1, 0.2, 0.1), "rotation": (0, 0, 0)}
    assert pinned(pinned=table)[0] == [4, 7, 10]


def test_balls_by_hand_and_in_files(tmp_path):
    flat = ts.Scene(dim=2)
    flat.add_balls([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5]], radius=0.1, pinned="border")
    assert flat.pinned.tolist() == [True] * 4 + [False]
    flat.set_balls(pinned="left")
    assert flat.pinned.tolist() == [True, False, False, True, False]
    block = ts.shapes.jelly(flat, size=(1, 1), resolution=(3, 3), pinned="border", velocity=(1, 2))
    assert flat.pinned[block.balls].tolist() == [True] * 4 + [False] + [True] * 4
    assert flat.velocity[block.balls[4]].tolist() == [1, 2]
    file = tmp_path / "a.toml"
    text = "format = 1\ndim = 3\n[[cloth]]\nresolution = [3, 3]\npinned = {}\n"
    file.write_text(text.format("'border'"))
    assert ts.load_scene(file).pinned.tolist() == [True] * 4 + [False] + [True] * 4
    file.write_text(text.format('{ shape = "sphere", center = [0.5, 0.0, 0.5], radius = 0.1 }'))
    assert ts.load_scene(file).pinned.tolist() == [False] * 4 + [True] + [False] * 4


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("edge", "cloth.pinned: 'edge' is not allowed; it must be one of 'border', 'corners', 'left', 'right', 'bottom',"
            " 'top', 'front', 'back', a list of ball numbers from 0 to 14, or a box or sphere"),
        ("top", "cloth.pinned: 'top' is no side of it: all of its balls lie at y = 0 m"),
        (ts.Sphere((9, 9, 9), 0.1), "cloth.pinned: holds no ball; it must hold the centre of one"),
        ({"shape": "box", "center": (0, 0, 0)}, "cloth.pinned.size: is missing; a box needs it"),
        ({"shape": "box", "centre": (0, 0, 0)}, "cloth.pinned.centre: is not a key of a box; did you mean 'center'?"),
        ({"shape": "cone"}, "cloth.pinned.shape: 'cone' is not allowed"),
        ([[1], [2, 3]], "cloth.pinned: [[1], [2, 3]] is not a bool, a bool per ball, a list of ball numbers, the name of a side"),
    ],
)  # fmt: skip
def test_what_names_no_ball_is_refused(given, message):
    scene = ts.Scene(dim=3)
    with pytest.raises(ts.SceneError) as caught:
        pinned(scene=scene, pinned=given)
    assert str(caught.value).startswith(message)
    assert scene.n_balls == 0


@pytest.mark.parametrize("name", SHAPES)
def test_every_shape_takes_these(name):
    parameters = inspect.signature(SHAPES[name]).parameters
    assert {"position", "velocity", "pinned", "material", "colour"} <= set(parameters)
    here, there = ts.Scene(dim=3), ts.Scene(dim=3)
    shape = SHAPES[name](here, **MADE[name])
    SHAPES[name](there, **MADE[name], position=(1, 2, 3), velocity=(4, 5, 6), pinned=[0])
    assert there.position == pytest.approx(here.position + np.array([1, 2, 3]), abs=1e-9)
    assert there.velocity[1:] == pytest.approx(np.tile([4, 5, 6], (len(shape.balls) - 1, 1)))
    assert there.pinned.tolist() == [True] + [False] * (len(shape.balls) - 1)
    assert there.rest_length == pytest.approx(here.rest_length)


# Paths --------------------------------------------------------------------------------------------------------------

KEYS = [{"time": 0.5, "position": (0, 0), "rotation": 0}, {"time": 1.5, "position": (1, 2), "rotation": 90.0}]


def test_a_path_means_the_same_for_a_collider_and_for_pins():
    scene = ts.Scene(dim=2)
    scene.add_balls([[4, 1], [6, 1]], radius=0.1)
    scene.add_moving_pins([0, 1], path=KEYS)
    scene.add_collider(ts.Box((5, 1), (0.2, 0.2), rotation=30, path=KEYS))
    pins, box = scene.moving_pins[0].motion, scene.colliders[0].motion
    for time in (0.0, 0.5, 1.0, 1.5, 9.0):
        (x, turn), (y, other) = pins.at(time), box.at(time)
        assert x == pytest.approx(y)
        assert turn[0] @ box.at(0.0)[1][0] == pytest.approx(other[0])
    assert box.at(9.0)[0][0].tolist() == [6, 3]
    assert np.degrees(np.arctan2(*box.at(9.0)[1][0][::-1, 0])) == pytest.approx(120)


def test_a_path_that_repeats_waits_for_its_first_keyframe():
    scene = ts.Scene(dim=2)
    path = [(1.0, (0, 0)), (2.0, (1, 0)), (3.0, (0, 0))]
    scene.add_collider(ts.Sphere((5, 1), 0.2, path=path, repeat=True))
    x = scene.colliders[0].motion.at([0.0, 0.9, 1.5, 2.5, 3.5])[0][:, 0]
    assert x == pytest.approx([5, 5, 5.5, 5.5, 5.5])
    velocities = scene.colliders[0].motion.steps(0.8, 0.1, 0, 4)[2][:, 0]
    assert velocities == pytest.approx([0, 0, 1, 1, 1])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"path": [(0, (5, 1)), (1, (6, 1))]}, r"path\[0\].position: \(5, 1\) is where the path begins, and it would jump"),
        ({"path": [(0, (0, 0), 30), (1, (1, 0), 60)]}, r"path\[0\].rotation: 30 is where the path begins, and it would jump"),
        ({"path": [{"time": 0}, (1, (6, 1))]}, r"path\[0\].position: is missing: keyframes .* begin with position 0"),
        (
            {"rotation": 20, "path": [(0, (0, 0)), (1, (6, 1), 50)]},
            r"path\[0\].rotation: is missing: keyframes say .* begin with rotation 0",
        ),
        ({"path": [(-1, (0, 0)), (1, (6, 1))]}, r"path\[0\].time: -1.0 is such that the path is on its way at time 0"),
    ],
)  # fmt: skip
def test_a_path_that_jumps_at_the_start_is_refused(given, message):
    scene = ts.Scene(dim=2)
    with pytest.raises(ts.SceneError, match=rf"^colliders\[0\]\.{message}"):
        scene.add_collider(ts.Box((5, 1), (1, 1), **given))
    assert not scene.colliders


def test_angular_velocity_is_now_called_rotation_rate(tmp_path):
    says = "angular_velocity: is now called 'rotation_rate', in degrees per second"
    with pytest.raises(ts.SceneError, match=f"colliders.{says}"):
        ts.Sphere((0, 0), 1.0, angular_velocity=2.0)
    file = tmp_path / "a.toml"
    text = "format = 1\n[[balls]]\nposition = [0, 0]\nradius = 0.1\n"
    file.write_text(f"{text}[[colliders]]\nshape = 'sphere'\ncenter = [5, 0]\nradius = 1\nangular_velocity = 2.0\n")
    with pytest.raises(ts.SceneError, match=rf"line 9: colliders\[0\].{says}"):
        ts.load_scene(file)
    file.write_text(f"{text}[[moving_pins]]\nballs = [0]\nangular_velocity = 2.0\n")
    with pytest.raises(ts.SceneError, match=rf"line 7: moving_pins\[0\].{says}"):
        ts.load_scene(file)


MEMBERS = """
format = 1
dim = 3
[[cloth]]
name = "flag"
size = [1.0, 0.5]
resolution = [5, 3]
position = [0.0, 2.0, 0.0]
[[jelly]]
name = "block"
size = [0.2, 0.2, 0.2]
resolution = [2, 2, 2]
position = [0.0, 1.0, 0.0]
[[attachments]]
one = "flag"
one_members = "corners"
other = "block"
other_members = "top"
stiffness = 10.0
[[moving_pins]]
balls = "flag"
members = "left"
velocity = [1.0, 0.0, 0.0]
[[moving_pins]]
balls = "block"
members = ["bottom", { shape = "sphere", center = [0.2, 1.2, 0.2], radius = 0.05 }]
velocity = [0.0, 1.0, 0.0]
[[motors]]
balls = "flag"
members = "border"
amplitude = 0.1
frequency = 1.0
"""


def test_members_of_a_shape_by_words_and_places(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text(MEMBERS)
    scene = ts.load_scene(file)
    flag, block = (one.balls for one in scene.objects)
    x = scene.position
    assert scene.moving_pins[0].balls.tolist() == flag[np.isclose(x[flag, 0], 0.0)].tolist()
    driven = set(block[np.isclose(x[block, 1], 1.0)]) | {block[np.argmax(x[block].sum(axis=1))]}
    assert set(scene.moving_pins[1].balls) == driven
    joined = scene.pairs[-4:]
    assert np.isin(x[joined[:, 0]][:, [0, 2]], [[0.0, 0.0], [1.0, 0.5]]).all()
    assert np.allclose(x[joined[:, 1], 1], 1.2)
    inside = x[flag[(x[flag, 0] % 1.0 > 0.1) & (x[flag, 2] % 0.5 > 0.1)]]
    ends = x[scene.pairs[scene.motors[0].springs]].reshape(-1, 3)
    assert len(ends) >= 2 * 12
    assert not (ends[:, None] == inside[None]).all(axis=2).any()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('members = "left"', 'members = "lift"', r"line 22: moving_pins\[0\].members: 'lift' .*'corners', 'left'"),
        ('members = "left"', "members = [99]", r"line 22: moving_pins\[0\].members\[0\]: 99"),
        (
            'members = "left"',
            'members = { shape = "sphere", center = [9, 9, 9], radius = 1 }',
            r"members: holds no ball",
        ),
        ('one_members = "corners"', 'one_members = "left"', r"attachments\[0\].other: names 4 balls"),
    ],
)
def test_mistakes_in_members_are_named(tmp_path, old, new, words):
    assert_refused(tmp_path, MEMBERS, old, new, words)
