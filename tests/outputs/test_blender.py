"""Files as Blender itself sees them: `make test-blender`, which names a Python that has bpy as BLENDER_PYTHON."""

import json
import os
import subprocess
from pathlib import Path

import exchange
import numpy as np
import pytest

from taichi_sim.geometry.mesh import given_surface, surface_area, volume
from taichi_sim.geometry.mesh_file import SUFFIXES
from taichi_sim.render.palette import to_linear

PYTHON = os.environ.get("BLENDER_PYTHON")
pytestmark = [pytest.mark.once, pytest.mark.skipif(not PYTHON, reason="BLENDER_PYTHON names no Python that has bpy")]

VIEW = Path(__file__).parents[1] / "support" / "blender_view.py"
SHOWN = (0, 3, 6)  # frames
OBJECTS = {"left_flag": 12, "sail": 8, "pudding": 26}  # surfaces by name, and their vertices
MARBLES = slice(len(range(12 + 6 + 27 + 4)), None)


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """The view of each file by its name, and the frames."""
    folder = tmp_path_factory.mktemp("blender")
    frames = exchange.write(exchange.scene(folder), folder, ["x.usdc", "x.usda", "x.obj", "x.ply"])
    names = ["x.usdc", "x.usda", *(f"x_{k:05d}.{kind}" for kind in ("obj", "ply") for k in SHOWN)]
    assert PYTHON is not None
    command = [str(Path(PYTHON).absolute()), "-W", "ignore", str(VIEW), "view.json", *names]
    subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    return json.loads((folder / "view.json").read_text()), frames


def z_up(points):
    """Where Blender, whose z is up, has points whose y is."""
    x, y, z = np.asarray(points).T
    return np.stack([x, -z, y], axis=1)


def same(one, other):
    """Points in any order."""
    one, other = (np.unique(np.round(np.asarray(part), 4) + 0.0, axis=0) for part in (one, other))
    return one.shape == other.shape and np.allclose(one, other, atol=2e-4)


def balls_of(frame, name):
    return next(one.balls for one in frame.objects if one.name == name)


@pytest.mark.parametrize("name", ["x.usdc", "x.usda"])
def test_usd_has_names_counts_and_frames(seen, name):
    view = seen[0][name]
    assert view["frames"] == [0, exchange.FRAMES - 1]
    objects = view["objects"]
    drawn = {key for key, one in objects.items() if one["type"] not in ("EMPTY", "CAMERA")}
    marbles = {"marbles", "marbles_ball_0", "marbles_ball_1"}
    rope = {f"rope_0_{part}" for part in ("balls", "ball_0", "springs", "rod")}
    assert drawn == {*OBJECTS, *marbles, *rope, "moon", "box_0", "wall_0"}
    assert objects["camera"]["type"] == "CAMERA"
    for key, count in OBJECTS.items():
        for k in SHOWN:
            assert len(objects[key]["at"][str(k)]["points"]) == count
    assert [objects[key]["at"]["0"]["faces"] for key in OBJECTS] == [12, 4, 48]


def test_usd_has_the_rate_of_the_frames(tmp_path):
    """Blender keeps its own rate: a frame of the file is a frame of its time line, whatever the rate."""
    exchange.write(exchange.scene(tmp_path), tmp_path, ["x.usda"])
    text = (tmp_path / "x.usda").read_text()
    assert f"timeCodesPerSecond = {exchange.FPS:g}\n" in text
    assert f"framesPerSecond = {exchange.FPS:g}\n" in text


@pytest.mark.parametrize("name", ["x.usdc", "x.usda"])
def test_usd_moves(seen, name):
    view, frames = seen[0][name], seen[1]
    for k in SHOWN:
        for key, one in (("left_flag", "left flag"), ("sail", "sail")):
            there = frames[k].position[balls_of(frames[k], one)]
            assert same(view["objects"][key]["at"][str(k)]["points"], z_up(there))
        moon = np.array(view["objects"]["moon"]["at"][str(k)]["points"])
        middle = z_up(frames[k].colliders[0].centre[None])[0]
        assert np.abs(np.linalg.norm(moon - middle, axis=1) - 0.3).max() < 1e-5
        shown = [one for one in view["instances"][str(k)] if one["of"] == "marbles"]
        assert same([one["place"] for one in shown], z_up(frames[k].position[MARBLES]))
        rope = frames[k].position[balls_of(frames[k], "rope_0")]
        rods = [one["place"] for one in view["instances"][str(k)] if one["of"] == "rope_0_springs"]
        assert same(rods, z_up(0.5 * (rope[1:] + rope[:-1])))
        assert sorted(one["scale"] for one in shown) == pytest.approx(sorted(frames[k].radius[MARBLES]))


@pytest.mark.parametrize("name", ["x.usdc", "x.usda", "x_00003.obj"])
def test_what_is_drawn_has_its_colour_or_image(seen, name):
    view = seen[0][name]
    objects = view["objects"]
    for key, colour in (("pudding", exchange.RED), ("moon", exchange.RED)):
        (material,) = objects[key]["materials"]
        assert material["colour"] == pytest.approx(to_linear(np.array(colour)), abs=1e-3)
    for key, image in (("left_flag", "flag.png"), ("sail", "sail.png")):
        (material,) = objects[key]["materials"]
        assert material["from"] == "ShaderNodeTexImage"
        assert image in view["images"]
    assert all(view["found"])
    marbles = {tuple(np.round(to_linear(np.array(c)), 3)) for c in (exchange.GREEN, exchange.RED)}
    if name.endswith("obj"):
        found = objects["marbles"]["materials"]
    else:
        found = [one["materials"][0] for one in view["instances"]["0"] if one["of"] == "marbles"]
        assert len(found) == 4
    assert {tuple(np.round(one["colour"], 3)) for one in found} == marbles


@pytest.mark.parametrize("name", ["x.usdc", "x.usda", "x_00003.obj", "x_00003.ply"])
def test_places_on_images(seen, name):
    view, frames = seen[0][name], seen[1]
    k = 3
    key = "x_00003" if name.endswith("ply") else "sail"
    one = view["objects"][key]["at"]
    one = one.get(str(k)) or next(iter(one.values()))
    points, corners = np.array(one["points"]), np.array(one["corners"])
    rows = np.column_stack([points[corners], one["uv"]])
    frame = frames[k]
    own = frame.triangles[np.isin(frame.triangles, balls_of(frame, "sail")).all(axis=1)]
    uv = next(thing.uv for thing in frame.objects if thing.name == "sail")
    there = frame.position if name.endswith("ply") else z_up(frame.position)
    expected = np.column_stack([there[own.ravel()], uv.reshape(-1, 2)])
    if name.endswith("ply"):
        rows = rows[rows[:, 0] < -0.5]
    assert same(rows, expected)


@pytest.mark.parametrize("k", SHOWN)
def test_obj_has_names_and_moves(seen, k):
    objects, frame = seen[0][f"x_{k:05d}.obj"]["objects"], seen[1][k]
    assert set(objects) == {*OBJECTS, "rope_0", "marbles", "moon", "box_0"}
    for key, one in (("left_flag", "left flag"), ("sail", "sail")):
        points = next(iter(objects[key]["at"].values()))["points"]
        assert same(points, z_up(frame.position[balls_of(frame, one)]))
    marbles = next(iter(objects["marbles"]["at"].values()))
    away = np.array(marbles["points"])[:, None] - z_up(frame.position[MARBLES])
    on = np.abs(np.linalg.norm(away, axis=2) - frame.radius[MARBLES]) < 1e-4
    assert np.count_nonzero(on.any(axis=1)) == 4 * 162
    assert marbles["faces"] == 4 * 320


@pytest.mark.parametrize("k", SHOWN)
def test_ply_is_one_mesh_with_colours(seen, k):
    objects, frame = seen[0][f"x_{k:05d}.ply"]["objects"], seen[1][k]
    assert list(objects) == [f"x_{k:05d}"]
    one = next(iter(objects[f"x_{k:05d}"]["at"].values()))
    assert {"object", "radius"} <= set(one["attributes"])
    points = np.array(one["points"])
    for name in ("left flag", "marbles"):
        balls = frame.position[balls_of(frame, name)]
        assert np.abs(points[:, None] - balls).max(axis=2).min(axis=0).max() < 1e-5
    found = np.array(one["colours"])
    for colour in (exchange.RED, exchange.BLUE, exchange.GREEN):
        assert np.abs(found - to_linear(np.array(colour))).max(axis=1).min() < 0.01


def test_what_blender_writes_is_read(tmp_path):
    assert PYTHON is not None
    command = [str(Path(PYTHON).absolute()), "-W", "ignore", str(VIEW), "--write", str(tmp_path)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    files = sorted(path for path in tmp_path.iterdir() if path.suffix in SUFFIXES)
    assert len(files) == 7
    for file in files:
        surface = given_surface("cloth", str(file), up="z" if file.suffix in (".stl", ".ply") else None)
        assert surface_area(surface) == pytest.approx(2 * 4 + 10 * 0.5, rel=1e-6), file.name
        assert volume(surface) == pytest.approx(4 * 0.5, rel=1e-6), file.name
        assert np.ptp(surface.vertices, axis=0) == pytest.approx([3, 0.5, 2], rel=1e-6), file.name
        assert surface.vertices.min(axis=0) == pytest.approx([0, 0, -2], abs=1e-6), file.name
