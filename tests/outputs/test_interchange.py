"""Files for other programs: one small scene with cloth, jelly, balls, a rope and a moving collider, written in all formats by one
run, and read back by the libraries that people use."""

import csv
import json
import re
import sys
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest
from test_outputs import FakeSimulation

import taichi_sim as ts
from taichi_sim.analysis.frame import Placed
from taichi_sim.outputs import CODECS, OTHERS, Output, export, open_output, open_outputs
from taichi_sim.outputs.parts import Parts
from taichi_sim.outputs.rods import ROD
from taichi_sim.render.palette import to_linear
from taichi_sim.scene.document import document, fill
from taichi_sim.scene.objects import named

pytestmark = pytest.mark.once

FPS, FRAMES = 30.0, 5
RED, BLUE, GREEN = (0.9, 0.2, 0.1), (0.2, 0.4, 0.9), (0.0, 1.0, 0.0)
NAMES = ["left flag", "jelly_0", "rope_0", "balls"]
FORMATS = ("x.usdc", "x.usda", "x.glb", "x.pvd", "x.gsd", "x.csv", "x.npz", "x.ply", "x.obj")


class Seen(Output):
    """The frames as the simulation gave them."""

    needs_image = False

    def __init__(self):
        self.seen = []

    def write(self, index, frame, image):
        self.seen.append(frame)


def world():
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    flag = ts.shapes.cloth(scene, (1, 2), (3, 4), position=(0, 1, 0), colour=BLUE, pinned=[0, 3])
    scene.set_name(flag.balls, "left flag")
    ts.shapes.jelly(scene, (0.4, 0.3, 0.3), (3, 3, 3), position=(2, 0.5, 0), colour=RED)
    ts.shapes.rope(scene, (0, 2, 3), (1, 2, 3), 4)
    scene.add_balls([[0, 3, 0], [0.5, 3, 0.2]], radius=[0.1, 0.15], colour=GREEN)
    scene.add_collider(ts.Sphere((5, 0, 0), 0.3, velocity=(0, 0.6, 0), colour=RED, name="moon"))
    scene.add_collider(ts.Box((7, 0, 0), (1, 2, 3), rotation_rate=(0, 0, np.degrees(1.0))))
    scene.add_wall((0, 1, 0), -1)
    scene.add_probe("top", "position", balls=[0])
    return scene


def missing(name):
    return {".gsd": "gsd", ".usdc": "pxr", ".usda": "pxr"}.get(name[name.index(".") :])


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder with all files, and the frames that they hold."""
    folder = tmp_path_factory.mktemp("files")
    there = [name for name in FORMATS if missing(name) is None or _has(missing(name))]
    seen = Seen()
    method = {"integrator": "symplectic_euler", "contacts": "off"}  # which compile soonest
    with ts.Simulation(world(), dt=1e-3, arch="cpu", **method) as simulation:
        outputs = open_outputs([folder / name for name in there], fps=FPS)
        export(simulation, [*outputs, seen], fps=FPS, duration=(FRAMES - 1) / FPS, style={"camera": {"orbit": 40.0}})
    return folder, seen.seen


def _has(module):
    try:
        __import__(module)
    except ImportError:
        return False
    return True


def single(values):
    return np.asarray(values, dtype=np.float32)


@pytest.fixture(scope="module", params=["x.usdc", "x.usda"])
def stage(run, request):
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    return usd.Stage.Open(str(run[0] / request.param))


def test_usd_has_its_units_names_and_colours(stage):
    from pxr import UsdGeom, UsdShade

    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert (stage.GetTimeCodesPerSecond(), stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (FPS, 0, FRAMES - 1)
    things = [prim for prim in stage.GetDefaultPrim().GetChildren() if prim.GetName() != "materials"]
    shown = [prim.GetDisplayName() or prim.GetName() for prim in things]
    assert shown == [*NAMES, "moon", "box_0", "wall_0", "camera"]
    for path, colour in (
        ("left_flag/left_flag", BLUE),
        ("jelly_0/jelly_0", RED),
        ("balls/balls/balls_ball_0", GREEN),
        ("moon", RED),
    ):
        prim = stage.GetPrimAtPath(f"/World/{path}")
        assert np.array_equal(UsdGeom.Gprim(prim).GetDisplayColorAttr().Get(), [single(to_linear(colour))])
        material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        shader = UsdShade.Shader(stage.GetPrimAtPath(f"{material.GetPath()}/shader"))
        assert np.array_equal(shader.GetInput("diffuseColor").Get(), single(to_linear(colour)))


def test_usd_moves_as_the_simulation_does(stage, run):
    from pxr import UsdGeom

    frames = run[1]
    at = lambda path: UsdGeom.PointBased(stage.GetPrimAtPath(f"/World/{path}"))  # noqa: E731
    spheres = lambda path: UsdGeom.PointInstancer(stage.GetPrimAtPath(f"/World/{path}"))  # noqa: E731
    for k, frame in enumerate(frames):
        x = single(frame.position)
        assert np.array_equal(at("left_flag/left_flag").GetPointsAttr().Get(k), x[:12])
        shell = np.delete(np.arange(12, 39), 13)  # the ball in the middle of the jelly is not seen
        assert np.array_equal(at("jelly_0/jelly_0").GetPointsAttr().Get(k), x[shell])
        assert np.array_equal(spheres("rope_0/rope_0_balls").GetPositionsAttr().Get(k), x[39:43])
        rods = spheres("rope_0/rope_0_springs")
        ends = frame.position[[[39, 40], [40, 41], [41, 42]]]
        assert np.array_equal(rods.GetPositionsAttr().Get(k), single(single(ends).mean(axis=1)))
        for matrix, (one, other) in zip(rods.ComputeInstanceTransformsAtTime(k, k), ends):
            assert np.allclose(matrix.Transform((0.0, 0.0, 0.5)), other, atol=1e-3)
            assert np.allclose(matrix.Transform((0.0, 0.0, -0.5)), one, atol=1e-3)
            assert np.linalg.norm(matrix.TransformDir((1.0, 0.0, 0.0))) == pytest.approx(
                ROD * frame.radius[39], rel=1e-2
            )
        assert np.array_equal(spheres("balls/balls").GetPositionsAttr().Get(k), x[43:])
        assert np.abs(np.linalg.norm(at("left_flag/left_flag").GetNormalsAttr().Get(k), axis=1) - 1).max() < 1e-6
        cache = UsdGeom.XformCache(k)
        ball = cache.GetLocalToWorldTransform(stage.GetPrimAtPath("/World/moon"))
        assert np.array_equal(ball.ExtractTranslation(), frame.colliders[0].centre)
        box = np.array(cache.GetLocalToWorldTransform(stage.GetPrimAtPath("/World/box_0")))
        assert np.array_equal(box[:3, :3].T, frame.colliders[1].rotation)
        corners = np.array(at("box_0").GetPointsAttr().Get()) @ box[:3, :3] + box[3, :3]
        assert corners.min(axis=0) == pytest.approx(frame.colliders[1].box[0], abs=1e-6)
    assert [prim.GetName() for prim in stage.GetPrimAtPath("/World/jelly_0").GetChildren()] == ["jelly_0"]


def test_usd_has_widths_faces_and_places_for_textures(stage, run):
    from pxr import UsdGeom

    flag = UsdGeom.Mesh(stage.GetPrimAtPath("/World/left_flag/left_flag"))
    faces = np.array(flag.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    assert np.array_equal(faces, run[1][0].triangles[:12])
    st = np.array(UsdGeom.PrimvarsAPI(flag).GetPrimvar("st").Get())
    assert np.array_equal(st[[0, 3, 8, 11]], [[0, 0], [0, 1], [1, 0], [1, 1]])
    balls = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/balls/balls"))
    assert np.array_equal(balls.GetScalesAttr().Get(), single(np.tile([[0.1], [0.15]], 3)))
    assert balls.GetIdsAttr().Get() == [43, 44]
    shape = UsdGeom.Mesh(stage.GetPrimAtPath(balls.GetPrototypesRel().GetTargets()[0]))
    assert np.abs(np.linalg.norm(shape.GetPointsAttr().Get(), axis=1) - 1).max() < 1e-6
    rope = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/rope_0/rope_0_springs"))
    assert list(rope.GetProtoIndicesAttr().Get()) == [0, 0, 0]


def test_the_camera_of_usd_is_that_of_pictures(stage, run):
    from pxr import UsdGeom

    from taichi_sim.render.tracker import Tracker

    frames = run[1]
    tracker = Tracker(frames[0], {"orbit": 40.0}, 16 / 9)
    assert tracker.is_open
    begin = np.array(tracker.first.eye)
    tracker.fit(frames)  # all of them are shown
    assert np.linalg.norm(np.array(tracker.first.eye) - begin) > 0.001
    prim = stage.GetPrimAtPath("/World/camera")
    for k, frame in enumerate(frames):
        camera = tracker.at(frame)
        found = UsdGeom.Camera(prim).GetCamera(k)
        assert np.array(found.transform)[3, :3] == pytest.approx(np.array(camera.eye), rel=1e-5)
        assert -np.array(found.transform)[2, :3] == pytest.approx(camera.axes()[2], abs=1e-5)
        assert found.GetFieldOfView(found.FOVVertical) == pytest.approx(camera.fov, rel=1e-6)
        assert found.aspectRatio == pytest.approx(16 / 9)


def test_gsd(run):
    hoomd = pytest.importorskip("gsd.hoomd", reason="gsd is not installed")
    folder, frames = run
    with hoomd.open(str(folder / "x.gsd")) as file:
        assert len(file) == FRAMES
        for k, (one, frame) in enumerate(zip(file, frames)):
            assert one.configuration.step == k
            assert np.array_equal(one.particles.position, single(frame.position))
            assert np.array_equal(one.particles.velocity, single(frame.velocity))
            assert np.array_equal(one.particles.diameter, single(2 * frame.radius))
            assert [one.particles.types[t] for t in one.particles.typeid[[0, 12, 39, 43]]] == NAMES
            assert np.array_equal(one.bonds.group, frame.springs)
            assert np.array_equal(one.log["particles/colour"], single(Parts(frame).colour))
            assert np.array_equal(one.log["triangles"], frame.triangles)
            assert one.log["time"] == frame.time
            assert np.array_equal(one.log["energy"], frame.energy)
            assert one.log["top.y"] == frame.probes["top.y"]


def test_csv(run):
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    folder, frames = run
    table = pandas.read_csv(folder / "x.csv", index_col="frame")
    assert table.index.tolist() == list(range(FRAMES))
    assert table["time"].tolist() == [frame.time for frame in frames]
    names = ["kinetic", "spring", "gravity", "total"]
    assert np.array_equal(table[names], [frame.energy for frame in frames])
    assert table["top.y"].tolist() == [frame.probes["top.y"] for frame in frames]
    assert table["largest_speed"].tolist() == [frame.contacts.largest_speed for frame in frames]


def test_csv_without_a_library(run):
    with open(run[0] / "x.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["time"]) for row in rows] == [frame.time for frame in run[1]]


def test_npz_says_what_it_holds(run):
    folder, frames = run
    with np.load(folder / "x.npz") as file:
        data = dict(file)
    first = frames[0]
    assert data["names"].tolist() == NAMES
    assert data["colliders"].tolist() == ["moon", "box_0"]
    assert data["names"][data["object"][[0, 11, 12, 38, 39, 42, 43, 44]]].tolist() == np.repeat(NAMES, 2).tolist()
    assert np.array_equal(data["position"], [frame.position for frame in frames])
    for name in ("radius", "springs", "triangles", "pinned"):
        assert np.array_equal(data[name], getattr(first, name))
    assert np.array_equal(data["colour"][[0, 12, 43]], [BLUE, RED, GREEN])


@pytest.fixture(scope="module")
def vtp():
    """A reader of .vtp files: points, arrays of points, lines, triangles, names."""
    vtk = pytest.importorskip("vtk", reason="vtk is not installed")
    from vtk.util.numpy_support import vtk_to_numpy

    def read(path):
        reader = vtk.vtkXMLPolyDataReader()
        reader.SetFileName(str(path))
        reader.Update()
        data = reader.GetOutput()
        arrays = data.GetPointData()
        names = data.GetFieldData().GetAbstractArray("names")
        cells = lambda kind, width: vtk_to_numpy(kind.GetConnectivityArray()).reshape(-1, width)  # noqa: E731
        return {
            **{arrays.GetArrayName(k): vtk_to_numpy(arrays.GetArray(k)) for k in range(arrays.GetNumberOfArrays())},
            "points": vtk_to_numpy(data.GetPoints().GetData()),
            "triangles": cells(data.GetPolys(), 3),
            "lines": cells(data.GetLines(), 2),
            "verts": cells(data.GetVerts(), 1)[:, 0],
            "names": [names.GetValue(k) for k in range(names.GetNumberOfValues())],
            "time": vtk_to_numpy(data.GetFieldData().GetArray("TimeValue"))[0],
            "mapped": arrays.GetTCoords() is not None,
        }

    return read


def test_vtp(run, vtp):
    folder, frames = run
    for k, frame in enumerate(frames):
        data = vtp(folder / f"x_{k:05d}.vtp")
        assert data["names"] == [*NAMES, "moon", "box_0"]
        ball = data["ball"]
        mine = ball >= 0
        assert sorted(ball[mine]) == sorted(set(range(45)) - {25})  # all but the one in the middle of the jelly
        assert np.array_equal(data["points"][mine], single(frame.position[ball[mine]]))
        assert np.array_equal(data["velocity"][mine], single(frame.velocity[ball[mine]]))
        assert np.array_equal(data["radius"][data["verts"]], single(frame.radius[[39, 40, 41, 42, 43, 44]]))
        for index, colour in ((0, BLUE), (1, RED), (3, GREEN), (4, RED)):
            assert np.array_equal(
                np.unique(data["colour"][data["object"] == index], axis=0), [np.rint(np.multiply(255, colour))]
            )
        assert np.array_equal(ball[data["lines"]], [[39, 40], [40, 41], [41, 42]])
        shown = ball[data["triangles"]]
        assert np.array_equal(shown[(shown >= 0).all(axis=1)], frame.triangles)
        round_ = data["points"][data["object"] == 4]
        assert np.linalg.norm(round_ - frame.colliders[0].centre, axis=1) == pytest.approx(0.3, abs=1e-6)
        assert data["mapped"]
        assert data["time"] == frame.time


def test_the_pvd_names_all_files_and_times(run):
    from xml.etree import ElementTree

    folder, frames = run
    entries = ElementTree.parse(folder / "x.pvd").getroot().findall("./Collection/DataSet")
    assert [float(entry.get("timestep")) for entry in entries] == [frame.time for frame in frames]
    assert [entry.get("file") for entry in entries] == [f"x_{k:05d}.vtp" for k in range(FRAMES)]
    assert all((folder / entry.get("file")).is_file() for entry in entries)


@pytest.mark.parametrize("kind", ["ply", "obj"])
def test_meshes(run, kind):
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    folder, frames = run
    for k in (0, FRAMES - 1):
        mesh = trimesh.load(folder / f"x_{k:05d}.{kind}", process=False, maintain_order=True, force="mesh")
        places = set(map(tuple, single(mesh.vertices)[np.unique(mesh.faces)].tolist()))
        assert set(map(tuple, single(frames[k].position[:12]).tolist())) <= places


def test_ply_has_all_its_columns(run):
    folder, frames = run
    head, _, body = (folder / "x_00004.ply").read_bytes().partition(b"end_header\n")
    lines = head.decode().splitlines()
    names = [line.split(" ", 3)[3] for line in lines if line.startswith("comment object")]
    assert names == [*NAMES, "moon", "box_0"]
    kinds = {"float": "<f4", "uchar": "u1", "int": "<i4"}
    columns = [line.split() for line in lines[: lines.index(next(x for x in lines if x.startswith("element face")))]]
    vertex = np.dtype([(words[2], kinds[words[1]]) for words in columns if words[0] == "property"])
    count = int(next(words[2] for words in columns if words[:2] == ["element", "vertex"]))
    data = np.frombuffer(body, vertex, count)
    balls = data[data["radius"] > 0]
    assert np.array_equal(np.stack([balls[name] for name in "xyz"], axis=1), single(frames[4].position[39:]))
    assert np.array_equal(balls["radius"], single(frames[4].radius[39:]))
    assert np.array_equal(balls[["red", "green", "blue", "object"]][-1].tolist(), (0, 255, 0, 3))
    flag = data[data["object"] == 0]
    assert np.hypot(flag["nx"], np.hypot(flag["ny"], flag["nz"])) == pytest.approx(1.0, abs=1e-6)
    assert (flag["s"].min(), flag["s"].max(), flag["t"].min(), flag["t"].max()) == (0, 1, 0, 1)


def test_obj_has_objects_by_name(run):
    text = (run[0] / "x_00000.obj").read_text()
    assert [line[2:] for line in text.splitlines() if line.startswith("o ")] == [
        "left_flag",
        "jelly_0",
        "rope_0",
        "balls",
        "moon",
        "box_0",
    ]
    assert not re.search(r"^p ", text, re.MULTILINE)  # points are nothing to most readers
    assert sum(line.startswith("l ") for line in text.splitlines()) == 3


# Where something tears, and where there is nothing --------------------------------------------------------------------


def torn_frames():
    """A strip of two squares, a third ball row on springs, and what is left of it when an edge has torn."""
    scene = ts.Scene(dim=3)
    scene.add_balls([[x, y, 0.0] for x in range(3) for y in range(2)], radius=0.1)
    scene.add_balls([[5.0, 0, 0], [6.0, 0, 0], [7.0, 0, 0]], radius=0.1)
    triangles = np.array([[0, 2, 1], [1, 2, 3], [2, 4, 3], [3, 4, 5]])
    springs = np.array([[6, 7], [7, 8]], dtype=np.int32)
    given = {"velocity": scene.velocity, "radius": scene.radius}
    for time, faces, bonds in ((0.0, triangles, springs), (0.5, triangles, springs), (1.0, triangles[:2], springs[:1])):
        yield ts.Frame(time, scene.position + time, **given, springs=bonds, triangles=faces.astype(np.int32))


def written(path, frames, **options):
    output = open_output(path, fps=2, **options)
    with output:
        for index, frame in enumerate(frames):
            output.write(index, frame, None)
            output.frames += 1
    return output


@pytest.mark.parametrize("name", ["x.usda", "x.usdc"])
def test_what_tears_in_usd(tmp_path, name):
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    written(tmp_path / name, torn_frames())
    stage = usd.Stage.Open(str(tmp_path / name))
    faces = stage.GetPrimAtPath("/World/balls/balls_surface").GetAttribute("faceVertexCounts")
    assert [len(faces.Get(k)) for k in range(3)] == [4, 4, 2]
    rods = stage.GetPrimAtPath("/World/balls/balls_springs")
    for one in ("protoIndices", "positions", "orientations", "scales"):
        assert [len(rods.GetAttribute(one).Get(k)) for k in range(3)] == [2, 2, 1]
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_what_tears_in_gsd_and_vtp(tmp_path, vtp):
    hoomd = pytest.importorskip("gsd.hoomd", reason="gsd is not installed")
    written(tmp_path / "x.gsd", torn_frames())
    with hoomd.open(str(tmp_path / "x.gsd")) as file:
        assert [one.bonds.N for one in file] == [2, 2, 1]
    written(tmp_path / "x.pvd", torn_frames())
    assert [len(vtp(tmp_path / f"x_{k:05d}.vtp")["triangles"]) for k in range(3)] == [4, 4, 2]


@pytest.mark.parametrize("name", FORMATS)
def test_flat_scenes(tmp_path, name):
    pytest.importorskip(missing(name) or "numpy", reason="its library is not installed")
    scene = ts.Scene(dim=2)
    scene.add_balls([[0.0, 1.0], [2.0, 3.0]], radius=[0.1, 0.2])
    scene.add_collider(ts.Box((0, 0), (2, 1), hollow=0.1))
    scene.add_collider(ts.Capsule((0, 0), (1, 1), 0.2))
    colliders = tuple(Placed(one, *(part[0] for part in one.motion.at(0.0))) for one in scene.colliders)
    given = {"colliders": colliders, "walls": np.array([[0.0, 1.0, -1.0]])}
    written(tmp_path / name, [ts.Frame(0.0, scene.position, scene.velocity, scene.radius, **given)])
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]
    if name == "x.usda":
        from pxr import Usd, UsdGeom

        stage = Usd.Stage.Open(str(tmp_path / name))
        camera = UsdGeom.Camera(stage.GetPrimAtPath("/World/camera")).GetCamera(0)
        assert camera.projection == camera.Orthographic
        assert camera.verticalAperture * camera.APERTURE_UNIT > 2.0
        sides = UsdGeom.PointBased(stage.GetPrimAtPath("/World/box_0")).GetPointsAttr().Get()
        assert np.abs(sides).max(axis=0).tolist() == pytest.approx([1.1, 0.6, 0.0])


# Names ----------------------------------------------------------------------------------------------------------------


def test_names_come_from_scene_files_and_go_back(tmp_path):
    (tmp_path / "a.toml").write_text(
        'format = 1\ndim = 3\n[[balls]]\nname = "stones"\nposition = [[9.0, 0.0, 0.0], [9.0, 1.0, 0.0]]\nradius = 0.1\n'
        '[[rope]]\nstart = [0.0, 0.0, 0.0]\nend = [1.0, 0.0, 0.0]\nn = 4\nname = "line"\n'
        "[[rope]]\nstart = [0.0, 1.0, 0.0]\nend = [1.0, 1.0, 0.0]\nn = 4\n"
        '[[colliders]]\nshape = "sphere"\ncenter = [0.0, 5.0, 0.0]\nradius = 1.0\nname = "moon"\n'
    )
    scene = ts.load_scene(tmp_path / "a.toml")
    number, names = named(scene.n_balls, scene.objects)
    assert names == ["stones", "line", "rope_0"]
    assert number.tolist() == [0, 0, 1, 1, 1, 1, 2, 2, 2, 2]
    scene.save(tmp_path / "b.toml")
    again = ts.load_scene(tmp_path / "b.toml")
    assert document(again)[0] == document(scene)[0]
    assert named(again.n_balls, again.objects)[1] == names
    assert [one.label for one in again.colliders] == ["moon"]
    kept = ts.Scene(dim=3)  # as a state file has it
    values, arrays = document(scene)
    fill(kept, json.loads(json.dumps(values)), arrays)
    assert named(kept.n_balls, kept.objects)[1] == names
    with pytest.raises(ts.SceneError, match=r"objects\[0\].balls"):
        fill(ts.Scene(dim=3), values, arrays | {"objects.0.balls": np.array([99])})
    values["objects"][0]["uv"] = [[0, 0, 0]]
    with pytest.raises(ts.SceneError, match=r"objects\[0\].uv"):
        fill(ts.Scene(dim=3), values, arrays)


def test_a_name_that_a_shape_took_by_itself_can_be_given():
    scene = ts.Scene(dim=3)
    ropes = [ts.shapes.rope(scene, (0, k, 0), (1, k, 0), 3) for k in range(3)]
    scene.set_name(ropes[2].balls, "rope_0")
    assert [one.name for one in scene.objects] == ["rope_3", "rope_1", "rope_0"]
    scene.set_name(ropes[2].balls, "line")  # another name for the same
    scene.set_name(np.concatenate([ropes[0].balls, ropes[1].balls]), "pair")
    assert named(9, scene.objects)[1] == ["line", "pair"]


def test_names_of_many_objects_are_found_soon():
    scene = ts.Scene(dim=2)
    scene.add_balls(np.stack([np.arange(20_000.0), np.zeros(20_000)], axis=1), radius=0.1)
    begin = perf_counter()
    for k in range(10_000):
        scene.new_object("rope", np.array([k], dtype=np.int32))
        scene.set_name([10_000 + k], f"ball {k}")
    assert perf_counter() - begin < 5.0  # some 0.3 s; each looking at all others would take minutes
    with pytest.raises(AttributeError), scene.all_or_nothing():
        scene.new_object("rope", np.array([3], dtype=np.int32)).none  # noqa: B018
    scene.new_object("rope", np.array([3], dtype=np.int32))
    assert [scene.objects[k].name for k in (0, -3, -2, -1)] == ["rope_0", "rope_9999", "ball 9999", "rope_10000"]


def test_places_on_textures_come_back_from_a_file(tmp_path):
    scene = ts.Scene(dim=3)
    ts.shapes.cloth(scene, (1, 1), (12, 12))
    scene.save(tmp_path / "a.toml")
    again = ts.load_scene(tmp_path / "a.toml")
    assert again.objects[0].name == "cloth_0"
    assert np.array_equal(again.objects[0].uv, scene.objects[0].uv)
    (tmp_path / "a.toml").write_text((tmp_path / "a.toml").read_text().replace("cloth_0", ""))
    with pytest.raises(
        ts.SceneError, match=r"a.toml, line \d+: objects\[0\].name: '' is not allowed; it must be a text"
    ):
        ts.load_scene(tmp_path / "a.toml")


def test_bad_names_are_refused():
    scene = world()
    before = [one.name for one in scene.objects]
    for name, says in (
        ("left flag", "name: 'left flag' exists already"),
        ("", "must be a text"),
        (3, "must be a text"),
    ):
        with pytest.raises(ts.SceneError, match=says):
            scene.set_name([43], name)
    with pytest.raises(ts.SceneError, match="balls"):
        scene.set_name([45], "new")
    for name, says in (("moon", r"colliders\[2\].name: 'moon' exists already"), (3, "must be a text")):
        with pytest.raises(ts.SceneError, match=says):
            scene.add_collider(ts.Sphere((0, 0, 0), 1.0, name=name))
    assert [one.name for one in scene.objects] == before


# What is refused -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "module", "extra"), [("x.usdc", "pxr", "usd"), ("x.usda", "pxr", "usd"), ("x.gsd", "gsd.hoomd", "gsd")]
)
def test_a_missing_package_is_one_sentence(tmp_path, monkeypatch, name, module, extra):
    monkeypatch.setitem(sys.modules, module, None)
    says = rf'{name}: \.\w+ needs one more package: pip install "taichi-sim\[{extra}\]"'
    with pytest.raises(ValueError, match=says):
        open_outputs([tmp_path / "first.npz", tmp_path / "first.mp4", tmp_path / name])
    assert not list(tmp_path.iterdir())


def test_two_outputs_with_one_name_are_refused(tmp_path):
    (tmp_path / "sub").mkdir()
    for names in (["x.npz", "x.npz"], ["frames", "frames/"], ["x.npz", "x.csv", "sub/../x.csv"]):
        with pytest.raises(ValueError, match=rf"{names[-1]}: is given twice; give every output a name of its own"):
            open_outputs([f"{tmp_path}/{name}" for name in names])
    assert [path.name for path in tmp_path.iterdir()] == ["sub"]


@pytest.mark.parametrize("library", ["gsd", "pandas"])
def test_the_examples_of_the_page_run(run, monkeypatch, library):
    pytest.importorskip(library, reason=f"{library} is not installed")
    monkeypatch.chdir(run[0])
    monkeypatch.setenv("MPLBACKEND", "agg")
    page = (Path(__file__).parents[2] / "docs" / "files.md").read_text()
    blocks = [code for code in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if f"import {library}" in code]
    assert len(blocks) == 1
    exec(compile(blocks[0], "files.md", "exec"), {})


def test_the_page_names_every_format():
    page = (Path(__file__).parents[2] / "docs" / "files.md").read_text()
    for ending in (*CODECS, *OTHERS):
        assert f"`x{ending}`" in page, ending


def test_what_grows_replaces_a_file_at_its_first_frame(tmp_path):
    (tmp_path / "x.csv").write_text("old")
    output = open_output(tmp_path / "x.csv")
    with pytest.raises(RuntimeError):
        export(FakeSimulation(0, RuntimeError()), output, duration=0.1)
    assert (tmp_path / "x.csv").read_text() == "old"
    with pytest.raises(RuntimeError):
        export(FakeSimulation(3, RuntimeError()), open_output(tmp_path / "x.csv"), duration=0.1)
    assert len((tmp_path / "x.csv").read_text().splitlines()) == 1 + 3
    assert [path.name for path in tmp_path.iterdir()] == ["x.csv"]
