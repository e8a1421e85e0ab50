"""Binary glTF: what a player shows at the times of frames is what the frames were; and its limits."""

import itertools
import json
import os
import subprocess

import exchange
import numpy as np
import pytest
from PIL import Image
from test_interchange import torn_frames, written

from taichi_sim import shapes
from taichi_sim.geometry import gltf_file, mesh_file
from taichi_sim.outputs import gltf, gltf_scene
from taichi_sim.render import Camera
from taichi_sim.render.palette import to_linear
from taichi_sim.scene.scene import Scene

pytestmark = pytest.mark.once

VALIDATOR = os.environ.get("GLTF_VALIDATOR")  # the folder of the npm package gltf-validator
VALIDATE = """
const validator = require(process.argv[1]), fs = require('fs')
validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[2]))).then(
    (report) => console.log(JSON.stringify(report.issues.messages)))
"""


class Player:
    """Contents of a file as a player shows them at a time: mixes of shapes and places of nodes, linear between their keys."""

    def __init__(self, path):
        data = path.read_bytes()
        self.json = gltf_file.header_of(data, "glb")
        self._arrays = gltf_file._Accessors(self.json, gltf_file._buffers(path, data, self.json, "glb"))
        self.nodes = {node["name"]: node for node in self.json["nodes"]}
        self.numbers = {node["name"]: k for k, node in enumerate(self.json["nodes"])}

    def array(self, number):
        return self._arrays.at(number, self.json["accessors"][number]["type"]).astype(float)

    def _property(self, name, path, time):
        (animation,) = self.json["animations"]
        for channel in animation["channels"]:
            if channel["target"] == {"node": self.numbers[name], "path": path}:
                sampler = animation["samplers"][channel["sampler"]]
                assert sampler["interpolation"] == "LINEAR"
                times = self.array(sampler["input"])[:, 0]
                rows = self.array(sampler["output"]).reshape(len(times), -1)
                return np.array([np.interp(time, times, column) for column in rows.T])
        return None

    def of_node(self, name, path, time):
        """A property of a node."""
        moved = self._property(name, path, time)
        return np.array(self.nodes[name][path]) if moved is None else moved

    def primitive(self, name):
        (part,) = self.json["meshes"][self.nodes[name]["mesh"]]["primitives"]
        return part

    def points(self, name, time, of="POSITION"):
        """Vertices of a node's mesh, or their normals."""
        part, weights = self.primitive(name), self._property(name, "weights", time)
        found = self.array(part["attributes"][of])
        for weight, shape in zip(() if weights is None else weights, part.get("targets", ())):
            found = found + weight * self.array(shape[of]) if of in shape else found
        return found

    def faces(self, name):
        part = self.primitive(name)
        return self.array(part["indices"]).astype(int).reshape(-1, 3 if part["mode"] == 4 else 2)

    def material(self, name):
        return self.json["materials"][self.primitive(name)["material"]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("gltf")


@pytest.fixture(scope="module")
def frames(folder):
    """Those of a file x.glb."""
    return exchange.write(exchange.scene(folder), folder, ["x.glb"])


@pytest.fixture(scope="module")
def player(folder, frames):
    return Player(folder / "x.glb")


def balls_of(frame, name):
    return next(one.balls for one in frame.objects if one.name == name)


def at_time(frames, time):
    """Positions at a time, linear between frames."""
    k = min(int(time * exchange.FPS), len(frames) - 2)
    share = time * exchange.FPS - k
    return frames[k].position * (1 - share) + frames[k + 1].position * share


# What it shows -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("time", [0.0, 2 / exchange.FPS, 2.4 / exchange.FPS, 6 / exchange.FPS])
def test_surfaces_and_balls_move_as_frames_do(frames, player, time):
    x = at_time(frames, time)
    flag = x[balls_of(frames[0], "left flag")]
    assert np.allclose(player.points("left flag", time), flag, atol=1e-5)
    seen = np.unique(np.round(player.points("sail", time), 3), axis=0)
    assert len(player.points("sail", time)) == 8  # six balls, two of them at a seam
    assert np.allclose(seen, np.unique(np.round(x[balls_of(frames[0], "sail")], 3), axis=0), atol=2e-3)
    for k, ball in enumerate(balls_of(frames[0], "marbles")):
        name = f"marbles_ball_{k}"
        assert np.allclose(player.of_node(name, "translation", time), x[ball], atol=1e-5)
        assert np.allclose(player.of_node(name, "scale", time), frames[0].radius[ball])
    rope = balls_of(frames[0], "rope_0")
    for k, (one, other) in enumerate(itertools.pairwise(rope)):
        name = f"rope_0_rod_{k}"
        assert np.allclose(player.of_node(name, "translation", time), 0.5 * (x[one] + x[other]), atol=1e-5)
        length = np.linalg.norm(x[other] - x[one])
        assert player.of_node(name, "scale", time)[2] == pytest.approx(length, rel=1e-3)


def test_normals_are_those_of_each_shape(frames, player):
    name, time = "pudding", 4 / exchange.FPS
    points, normals = player.points(name, time), player.points(name, time, "NORMAL")
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)
    outward = points - points.mean(axis=0)
    assert np.all(np.einsum("vi,vi->v", normals, outward) > 0)
    a, b, c = (points[player.faces(name)[:, k]] for k in range(3))
    assert np.all(np.einsum("ti,ti->t", np.cross(b - a, c - a), a + b + c - 3 * points.mean(axis=0)) > 0)


def test_colliders_camera_and_floor(frames, player):
    time = 3 / exchange.FPS
    assert np.allclose(player.of_node("moon", "translation", time), (5, 0.6 * time, 0), atol=1e-6)
    half = np.radians(60.0 * time) / 2
    assert np.allclose(player.of_node("box_0", "rotation", time), (0, 0, np.sin(half), np.cos(half)), atol=1e-6)
    square = player.points("wall_0", 0.0)
    assert np.allclose(square[:, 1], -1.0)
    assert np.cross(square[1] - square[0], square[2] - square[1])[1] > 0  # counter-clockwise from above
    camera = Camera.fit(frames, 16 / 9)
    node = player.nodes["camera"]
    about = player.json["cameras"][node["camera"]]["perspective"]
    assert about["yfov"] == pytest.approx(np.radians(camera.fov))
    x, y, z, w = node["rotation"]
    forward = -np.array([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)])
    ahead = np.subtract(frames[0].position.mean(axis=0), node["translation"])
    assert forward @ ahead / np.linalg.norm(ahead) > 0.9


def test_names_colours_places_and_rate(folder, player):
    shown = {player.json["nodes"][k]["name"] for k in player.json["scenes"][0]["nodes"]}
    assert shown == {"left flag", "sail", "pudding", "rope_0", "marbles", "moon", "box_0", "wall_0", "camera"}
    assert player.json["extras"] == {"fps": exchange.FPS}
    red = player.material("pudding")["pbrMetallicRoughness"]
    assert np.allclose(red["baseColorFactor"], [*to_linear(np.array(exchange.RED)), 1.0])
    tints = {tuple(player.material(f"marbles_ball_{k}")["pbrMetallicRoughness"]["baseColorFactor"]) for k in range(4)}
    assert len(tints) == 2
    part = player.primitive("left flag")
    uv = player.array(part["attributes"]["TEXCOORD_0"]) * [1, -1] + [0, 1]
    assert np.allclose(np.sort(uv[:, 0])[[0, -1]], [0, 2])  # the image repeats twice
    image = player.json["images"][0]
    view = player.json["bufferViews"][image["bufferView"]]
    start = (folder / "x.glb").read_bytes().index(b"\x89PNG")
    assert (folder / "x.glb").read_bytes()[start : start + view["byteLength"]] == (folder / "flag.png").read_bytes()


def test_an_image_of_another_kind_is_held_as_png(tmp_path):
    Image.new("RGB", (4, 4), (9, 99, 9)).save(tmp_path / "a.bmp")
    made = Scene(dim=3)
    sheet = shapes.cloth(made, (1, 1), (3, 3))
    made.set_name(sheet.balls, "sheet")
    made.output = {"looks": [{"of": "sheet", "texture": tmp_path / "a.bmp"}]}
    exchange.write(made, tmp_path, ["x.glb"])
    assert Player(tmp_path / "x.glb").json["images"][0]["mimeType"] == "image/png"
    assert (tmp_path / "x.glb").read_bytes().count(b"\x89PNG") == 1


# Other readers ------------------------------------------------------------------------------------------------------------


def test_it_is_read_as_a_mesh(folder, frames):
    """By this program: the first frame."""
    found = mesh_file.load(folder / "x.glb").vertices
    flag = frames[0].position[balls_of(frames[0], "left flag")]
    apart = np.linalg.norm(found[:, None] - flag, axis=2).min(axis=0)
    assert np.all(apart < 1e-5)


def test_trimesh_reads_it(folder, frames):
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    found = trimesh.load(folder / "x.glb")
    assert {"left flag", "pudding", "marbles_ball_3", "moon"} <= set(found.graph.nodes)
    flag = frames[0].position[balls_of(frames[0], "left flag")]
    assert np.allclose(np.sort(found.geometry["left flag"].vertices, axis=0), np.sort(flag, axis=0), atol=1e-5)


@pytest.mark.skipif(not VALIDATOR, reason="GLTF_VALIDATOR names no folder of gltf-validator")
def test_the_validator_finds_nothing(folder, frames, tmp_path):
    written(tmp_path / "torn.glb", torn_frames())
    for path in (folder / "x.glb", tmp_path / "torn.glb"):
        command = ["node", "-e", VALIDATE, str(VALIDATOR), str(path)]
        found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        assert [one for one in found if one["severity"] < 2] == []


# Limits -----------------------------------------------------------------------------------------------------------------------


def thinned(folder, what):
    """Frames of a file that holds every second one, which is said; its player, which shows these; balls of the flag."""
    with pytest.warns(UserWarning, match=f"x.glb: holds the {what} at 4 of 7 frames, evenly spread"):
        frames = exchange.write(exchange.scene(folder), folder, ["x.glb"])
    player, flag = Player(folder / "x.glb"), balls_of(frames[0], "left flag")
    for k in (0, 2, 4, 6):
        assert np.allclose(player.points("left flag", k / exchange.FPS), frames[k].position[flag], atol=1e-5)
    return frames, player, flag


def test_more_frames_than_shapes(tmp_path, monkeypatch):
    monkeypatch.setattr(gltf, "MOST_SHAPES", 4)
    frames, player, flag = thinned(tmp_path, "surfaces")
    assert len(player.primitive("sail")["targets"]) == 3
    between = 0.5 * (frames[2].position + frames[4].position)[flag]
    assert np.allclose(player.points("left flag", 3 / exchange.FPS), between, atol=1e-5)
    ball = balls_of(frames[0], "marbles")[1]
    assert np.allclose(player.of_node("marbles_ball_1", "translation", 3 / exchange.FPS), frames[3].position[ball])


def test_more_frames_than_room_for_the_motion(tmp_path, monkeypatch):
    """Every second frame is there: all of the file is whole, and what moves is where it was at these."""
    monkeypatch.setattr(gltf, "MOST_MOTION_BYTES", 4 * 400)
    monkeypatch.setattr(gltf_scene.GltfScene, "frame_bytes", 400)
    frames, player, _ = thinned(tmp_path, "motion")
    ball = balls_of(frames[0], "marbles")[1]
    for k in (0, 2, 4, 6):
        assert np.allclose(player.of_node("marbles_ball_1", "translation", k / exchange.FPS), frames[k].position[ball])


def test_the_room_for_the_motion_is_that_of_the_file(tmp_path):
    exchange.write(exchange.scene(tmp_path), tmp_path, ["x.glb"])
    player = Player(tmp_path / "x.glb")
    (animation,) = player.json["animations"]
    outputs = [
        s["output"] for s, c in zip(animation["samplers"], animation["channels"]) if c["target"]["path"] != "weights"
    ]
    written = sum(player.array(one).size for one in outputs) * 4 / 7
    made = gltf_scene.GltfScene(exchange.write(exchange.scene(tmp_path), tmp_path, ["y.npz"])[0], {}, tmp_path)
    assert 0 < written <= made.frame_bytes


def test_many_balls_are_one_mesh_and_springs_are_lines(tmp_path, monkeypatch):
    monkeypatch.setattr(gltf_scene, "MOST_NODES", 10)
    frames = exchange.write(exchange.scene(tmp_path), tmp_path, ["x.glb"])
    player, time = Player(tmp_path / "x.glb"), 5 / exchange.FPS
    balls = balls_of(frames[0], "marbles")
    points = player.points("marbles", time).reshape(4, 12, 3)
    assert np.allclose(points.mean(axis=1), frames[5].position[balls], atol=1e-4)
    apart = np.linalg.norm(points - frames[5].position[balls][:, None], axis=2)
    assert np.allclose(apart, frames[0].radius[balls][:, None], atol=1e-4)
    colour = player.array(player.primitive("marbles")["attributes"]["COLOR_0"])
    assert np.allclose(colour[0, :3], to_linear(np.array(exchange.GREEN)), atol=1e-4)
    assert player.faces("rope_0_springs").shape == (3, 2)
    rope = frames[5].position[balls_of(frames[0], "rope_0")]
    assert np.allclose(player.points("rope_0_springs", time), rope, atol=1e-5)


@pytest.mark.parametrize("most", [2000, 0])
def test_what_tears(tmp_path, monkeypatch, most):
    """Triangles and springs that tear are shown until then, and have no size afterwards."""
    monkeypatch.setattr(gltf_scene, "MOST_NODES", most)
    written(tmp_path / "x.glb", torn_frames())
    player = Player(tmp_path / "x.glb")
    for time, area, length in ((0.0, 2.0, 2.0), (0.5, 2.0, 2.0), (1.0, 1.0, 1.0)):
        points = player.points("balls_surface", time)
        a, b, c = (points[player.faces("balls_surface")[:, k]] for k in range(3))
        assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(area, abs=1e-5)
        if most:
            found = sum(player.of_node(f"balls_rod_{k}", "scale", time)[2] for k in range(2))
        else:
            ends = player.points("balls_springs", time)[player.faces("balls_springs")]
            found = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum()
        assert found == pytest.approx(length, abs=1e-5)


def test_too_many_vertices_are_refused_before_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr(gltf, "MOST_BYTES", 1000)
    says = r"x.glb: \d+ moving vertices are too many for .glb; at most 20 are allowed; write x.usdc"
    with pytest.raises(ValueError, match=says):
        exchange.write(exchange.scene(tmp_path), tmp_path, ["x.glb"])
    assert not (tmp_path / "x.glb").exists()
