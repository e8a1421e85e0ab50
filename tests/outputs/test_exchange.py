"""Files for other programs: names, rates, materials, images, places on them across seams; read without Blender."""

import re

import exchange
import numpy as np
import pytest
from PIL import Image
from test_outputs import FakeRenderer, FakeSimulation, draw_with

import taichi_sim as ts
from taichi_sim.analysis.frame import Frame
from taichi_sim.geometry import obj_file
from taichi_sim.outputs import open_output, open_outputs
from taichi_sim.outputs.parts import Parts, few_colours
from taichi_sim.render.palette import to_linear

pytestmark = pytest.mark.once


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder with all files, and the frames that they hold."""
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    folder = tmp_path_factory.mktemp("exchange")
    return folder, exchange.write(exchange.scene(folder), folder, ["x.usda", "x.obj", "x.ply"])


@pytest.fixture(scope="module")
def stage(made):
    from pxr import Usd

    return Usd.Stage.Open(str(made[0] / "x.usda"))


def linear(colour):
    return to_linear(np.array(colour))


# The rate ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("given", "shown"), [({}, 24.0), ({"fps": 48.0}, 48.0)])
def test_a_file_is_shown_at_the_rate_of_its_frames(tmp_path, monkeypatch, given, shown):
    import av

    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    draw_with(monkeypatch, FakeRenderer)
    outputs = open_outputs([tmp_path / f"x.{ending}" for ending in ("usda", "npz", "webp", "mp4")], **given)
    ts.export(FakeSimulation(), outputs, fps=24.0, duration=0.25, size=(64, 48))
    stage = usd.Stage.Open(str(tmp_path / "x.usda"))
    assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == shown
    with np.load(tmp_path / "x.npz") as file:
        assert file["fps"] == [shown]
    with av.open(str(tmp_path / "x.mp4")) as file:
        assert file.streams.video[0].average_rate == shown
    with Image.open(tmp_path / "x.webp") as file:
        file.load()
        assert file.info["duration"] == pytest.approx(1000 / shown, abs=1)


def test_rates_that_films_cannot_have(tmp_path):
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    for ending in ("mp4", "webm", "gif", "webp", "usda", "glb"):
        with pytest.raises(ts.SceneError, match="fps: 1e-05 is not allowed"):
            open_output(tmp_path / f"x.{ending}", fps=1e-5)
        with pytest.raises(ts.SceneError, match="fps: 1e-05 is not allowed"):
            ts.export(FakeSimulation(), open_output(tmp_path / f"x.{ending}"), fps=1e-5, duration=2e5)
    assert not list(tmp_path.iterdir())


# Names and materials -----------------------------------------------------------------------------------------------------


def test_each_part_of_usd_has_the_name_of_its_object(stage):
    found = {
        prim.GetName(): [child.GetName() for child in prim.GetChildren()]
        for prim in stage.GetDefaultPrim().GetChildren()
        if prim.GetTypeName() == "Xform"
    }
    assert found == {
        "left_flag": ["left_flag"],
        "sail": ["sail"],
        "pudding": ["pudding"],
        "rope_0": ["rope_0_balls", "rope_0_springs"],
        "marbles": ["marbles"],
    }


def test_all_that_is_drawn_has_a_material(stage):
    from pxr import UsdGeom, UsdShade

    drawn = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Gprim)]
    names = [UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0].GetPrim().GetName() for prim in drawn]
    assert names == [prim.GetName() for prim in drawn]
    assert {"marbles_ball_0", "marbles_ball_1", "moon", "rope_0_rod"} <= set(names)


def test_marbles_are_spheres_of_their_colours(stage, made):
    from pxr import UsdGeom, UsdShade

    marbles = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/marbles/marbles"))
    frames = made[1]
    balls = np.array(marbles.GetIdsAttr().Get())
    kinds = marbles.GetPrototypesRel().GetTargets()
    for number, ball in zip(marbles.GetProtoIndicesAttr().Get(), balls):
        shader = UsdShade.Shader(stage.GetPrimAtPath(f"/World/materials/{kinds[number].name}/shader"))
        assert shader.GetInput("diffuseColor").Get() == pytest.approx(linear(frames[0].colour[ball]), abs=1e-6)
    assert np.allclose(marbles.GetScalesAttr().Get(), frames[0].radius[balls][:, None])
    for k in (0, 3, 6):
        assert np.array_equal(marbles.GetPositionsAttr().Get(k), frames[k].position[balls].astype("f4"))
        low, high = marbles.GetExtentAttr().Get(k)
        assert np.all(low <= frames[k].position[balls].min(axis=0) - 0.1)
        assert np.all(high >= frames[k].position[balls].max(axis=0) + 0.1)


def test_many_colours_become_few():
    random = np.random.default_rng(0)
    colour = random.uniform(size=(5000, 3))
    few, kind = few_colours(colour)
    assert len(few) <= 128
    assert np.abs(few[kind] - colour).mean() < 0.08
    few, kind = few_colours(colour[:100])
    assert np.abs(few[kind] - colour[:100]).max() < 1 / 255
    assert len(few_colours(colour[:0])[0]) == 0


def test_an_obj_has_materials_and_its_library(made):
    folder, frames = made
    library = (folder / "x_frames.mtl").read_text()
    known = dict(re.findall(r"newmtl (\S+)\nKd (.+)", library))
    for name, colour in (
        ("pudding", exchange.RED),
        ("marbles_ball_0", exchange.GREEN),
        ("marbles_ball_1", exchange.RED),
        ("moon", exchange.RED),
    ):
        assert [float(word) for word in known[name].split()] == pytest.approx(linear(colour), abs=1e-4)
    for name in ("left_flag", "sail"):  # readers multiply the image by both
        assert [float(word) for word in known[name].split()] == [1.0] * 3
    text = (folder / "x_00000.obj").read_text()
    colour = np.array([line.split()[3:] for line in re.findall(r"^v (.+)", text, re.MULTILINE)], dtype=float)
    for name, shown in (("left_flag", (1, 1, 1)), ("sail", (1, 1, 1)), ("pudding", exchange.RED)):
        own = text.partition(f"\no {name}\n")[2].partition("\no ")[0]
        corners = np.array(re.findall(r" (\d+)/", own), dtype=int) - 1
        assert colour[corners] == pytest.approx(np.broadcast_to(shown, (len(corners), 3)), abs=1e-3)
    assert re.findall(r"map_Kd (.+)", library) == ["-s 2 2 1 flag.png", "sail.png"]
    for index in range(len(frames)):
        text = (folder / f"x_{index:05d}.obj").read_text()
        assert text.startswith("mtllib x_frames.mtl\n")
        assert set(re.findall(r"^usemtl (\S+)", text, re.MULTILINE)) == set(known)


# Images and seams --------------------------------------------------------------------------------------------------------


def corners_of(points, faces, uv):
    """Place and place on the image of each corner, sorted."""
    rows = np.column_stack([points[faces], uv]).round(5) + 0.0
    return np.unique(rows, axis=0)


def expected(frame, scene_uv):
    """Of the sail: its vertices as the frame has them."""
    own = frame.triangles[np.isin(frame.triangles, range(12, 18)).all(axis=1)]
    return corners_of(frame.position, own.ravel(), scene_uv.reshape(-1, 2))


def test_a_seam_is_kept_from_obj_to_obj_and_usd(stage, made):
    from pxr import UsdGeom

    folder, frames = made
    uv = next(one for one in frames[0].objects if one.name == "sail").uv
    assert uv.shape == (4, 3, 2)
    sail = UsdGeom.Mesh(stage.GetPrimAtPath("/World/sail/sail"))
    st = np.array(UsdGeom.PrimvarsAPI(sail).GetPrimvar("st").Get())
    faces = np.array(sail.GetFaceVertexIndicesAttr().Get())
    assert len(st) == 8  # of six vertices, two of them on the seam
    for k in (0, 3, 6):
        points = np.array(sail.GetPointsAttr().Get(k))
        assert np.allclose(corners_of(points, faces, st[faces]), expected(frames[k], uv), atol=2e-5)
        found = obj_file.read((folder / f"x_{k:05d}.obj").read_bytes())
        whole = np.isfinite(found.uv).all(axis=1)
        of_sail = whole & (found.vertices[found.corners][:, 0] < -0.5)
        rows = corners_of(found.vertices, found.corners[of_sail], found.uv[of_sail])
        assert np.allclose(rows, expected(frames[k], uv), atol=2e-5)
        normals = np.array(sail.GetNormalsAttr().Get(k))
        _, twins = np.unique(points, axis=0, return_inverse=True)
        assert all(
            np.ptp(normals[twins.reshape(-1) == j], axis=0).max() < 1e-6 for j in range(6)
        )  # no crease at the seam


def test_images_are_named_from_the_file(stage):
    from pxr import UsdShade

    for name, repeat in (("left_flag", 2.0), ("sail", None)):
        shader = UsdShade.Shader(stage.GetPrimAtPath(f"/World/materials/{name}/texture"))
        assert shader.GetInput("file").Get().path == f"{name.split('_')[-1]}.png"
        assert shader.GetInput("file").Get().resolvedPath.endswith(f"{name.split('_')[-1]}.png")
        scaled = UsdShade.Shader(stage.GetPrimAtPath(f"/World/materials/{name}/repeat"))
        assert (scaled.GetInput("scale").Get()[0] if scaled else None) == repeat


def test_bodies_with_an_image_have_places_on_it(tmp_path):
    """A drawing as jelly: its front is the image from side to side, upright, as in pictures; also of an embedded surface."""
    pytest.importorskip("shapely")
    usd_geom = pytest.importorskip("pxr.UsdGeom", reason="usd-core is not installed")
    from pxr import Usd

    Image.new("RGB", (4, 2), (10, 200, 30)).save(tmp_path / "house.png")
    (tmp_path / "house.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg"><rect width="8" height="4"/></svg>')
    scene = ts.Scene(dim=3)
    house = ts.shapes.svg(scene, tmp_path / "house.svg", height=1.0, spacing=0.5, position=(3, 2, 1))
    scene.set_name(house.balls, "house")
    plain = ts.shapes.jelly(scene, (1, 1, 1), (2, 2, 2))
    scene.set_name(plain.balls, "plain")
    scene.output = {"looks": [{"of": "house", "texture": tmp_path / "house.png"}]}
    exchange.write(scene, tmp_path, ["x.usda", "x.obj"])
    stage = Usd.Stage.Open(str(tmp_path / "x.usda"))
    mesh = usd_geom.Mesh(stage.GetPrimAtPath("/World/house/house"))
    st = np.array(usd_geom.PrimvarsAPI(mesh).GetPrimvar("st").Get())
    points = np.array(mesh.GetPointsAttr().Get(0))
    assert st == pytest.approx((points[:, :2] - points[:, :2].min(axis=0)) / 2.0, abs=2e-3)
    assert stage.GetPrimAtPath("/World/materials/house/texture")
    other = usd_geom.Mesh(stage.GetPrimAtPath("/World/plain/plain"))
    assert not usd_geom.PrimvarsAPI(other).GetPrimvar("st").HasValue()
    assert "house.png" in (tmp_path / "x_frames.mtl").read_text()


def test_a_seam_in_what_tears(tmp_path):
    """Triangles that are left keep their places on the image."""
    scene = exchange.scene(tmp_path)
    first, *_ = exchange.frames(scene)
    parts = Parts(first)
    k = next(k for k, one in enumerate(parts.surfaces) if one.name == "sail")
    whole = parts.triangles(first)[k]
    less = Frame(0.0, first.position, first.velocity, first.radius, triangles=np.delete(first.triangles, 13, axis=0))
    assert np.array_equal(parts.triangles(less)[k], np.delete(whole, 1, axis=0))


def test_seams_come_back_from_a_scene_file(tmp_path):
    scene = exchange.scene(tmp_path)
    scene.output = {}
    scene.save(tmp_path / "a.toml")
    again = ts.load_scene(tmp_path / "a.toml")
    assert np.array_equal(again.objects[1].uv, scene.objects[1].uv)
    with pytest.raises(ts.SceneError, match=r"objects.uv: \(3, 3, 2\) .*shape \(4, 3, 2\)"):
        scene.set_name(scene.objects[1].balls, "sail", np.zeros((3, 3, 2)))


def test_the_library_of_a_resumed_run_knows_what_has_torn_away(tmp_path):
    scene = exchange.scene(tmp_path)
    first, *_, last = exchange.frames(scene)
    less = Frame(0.0, last.position, last.velocity, last.radius, triangles=last.triangles[:0])
    written = []
    for index, frame in ((0, first), (1, less)):
        with open_output(tmp_path / "x.obj") as output:
            output.prepare(first, (64, 48), {})
            output.write(index, frame, None)
            output.frames += 1
        written.append((tmp_path / "x_frames.mtl").read_text())
    assert written[0] == written[1]
