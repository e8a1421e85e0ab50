"""Surfaces as OBJ and PLY files: what another reader finds in them."""

import re

import numpy as np
import pytest

from taichi_sim import Scene, SceneError, shapes
from taichi_sim.analysis.frame import Frame
from taichi_sim.geometry.mesh import Surface, read_surface, volume
from taichi_sim.geometry.spheres import icosphere
from taichi_sim.outputs import open_output
from taichi_sim.outputs.parts import Parts, Together

pytestmark = pytest.mark.once


def frame(scene):
    return Frame(
        0.0,
        scene.position,
        scene.velocity,
        scene.radius,
        triangles=scene.triangles,
        embedded_surfaces=tuple(scene.embedded_surfaces),
    )


def written(folder, name, *frames):
    output = open_output(folder / name)
    with output:
        for index, one in enumerate(frames):
            assert not output.needs_image
            output.write(index, one, None)
            output.frames += 1


@pytest.mark.parametrize("kind", ["obj", "ply"])
def test_a_block_and_a_skin(tmp_path, kind):
    """The skin takes the place of the boxes below it, the block beside it has its own triangles."""
    scene, ball = Scene(dim=3), icosphere(2)
    shapes.jelly(scene, mesh=ball, spacing=0.4)
    shapes.jelly(scene, (1, 2, 3), (3, 3, 3), position=(5, 0, 0))
    written(tmp_path, f"x.{kind}", frame(scene), frame(scene))
    more = ["x_frames.mtl"] if kind == "obj" else []
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"x_00000.{kind}", f"x_00001.{kind}", *more]
    surface = read_surface(tmp_path / f"x_00001.{kind}")
    assert len(surface.triangles) == len(ball.triangles) + 2 * 6 * 4
    assert volume(surface) == pytest.approx(volume(ball) + 6.0, rel=1e-5)


def test_loose_balls_are_points_in_ply_and_spheres_in_obj(tmp_path):
    scene = Scene(dim=2)
    scene.add_balls([[0.0, 1.0], [2.0, 3.0]], radius=[0.1, 0.2])
    written(tmp_path, "x.ply", frame(scene))
    head, _, body = (tmp_path / "x_00000.ply").read_bytes().partition(b"end_header\n")
    assert b"element vertex 2" in head
    assert re.findall(rb"property float (\w+)", head) == [b"x", b"y", b"z", b"nx", b"ny", b"nz", b"radius"]
    rows = np.frombuffer(body, "u1").reshape(2, -1)[:, :28].copy().view("<f4")
    assert rows[:, [0, 1, 2, 6]] == pytest.approx(np.array([[0, 1, 0, 0.1], [2, 3, 0, 0.2]]))
    written(tmp_path, "x.obj", frame(scene))
    spheres = read_surface(tmp_path / "x_00000.obj")  # points are nothing to readers of OBJ
    for centre, radius in (((0, 1, 0), 0.1), ((2, 3, 0), 0.2)):
        away = np.linalg.norm(spheres.vertices - centre, axis=1)
        assert np.count_nonzero(np.abs(away - radius) < 1e-6) == 162
    assert volume(spheres) == pytest.approx(4 / 3 * np.pi * (0.1**3 + 0.2**3), rel=0.04)


def test_only_vertices_that_are_used():
    scene = Scene(dim=3)
    scene.add_balls([[9.0, 9, 9]], radius=0.1)
    shapes.cloth(scene, resolution=(3, 4))
    one = frame(scene)
    parts = Together.of(Parts(one), one)
    assert len(parts.points) == 12 + 1
    assert parts.triangles.max() == 11
    assert parts.loose.tolist() == [12]


def test_a_folder_that_is_missing(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"there is no folder .*make it first"):
        open_output(tmp_path / "none" / "x.ply")


def test_binary_gltf_comes_in(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    ball = icosphere(1)
    trimesh.Trimesh(ball.vertices, ball.triangles, process=False).export(tmp_path / "ball.glb")
    surface = read_surface(tmp_path / "ball.glb")
    assert isinstance(surface, Surface)
    assert volume(surface) == pytest.approx(volume(ball), rel=1e-6)
    (tmp_path / "bad.glb").write_text("no")
    with pytest.raises(SceneError, match="cannot be read as GLB"):
        read_surface(tmp_path / "bad.glb")
