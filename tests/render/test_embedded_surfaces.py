"""Embedded surfaces, which follow balls. What is refused, where their vertices lie, and that they are drawn in place of the
balls that they cover."""

import numpy as np
import pytest
from PIL import Image

from taichi_sim import Frame, Scene, SceneError, shapes
from taichi_sim.files.toml_reader import load_scene
from taichi_sim.geometry.mesh import read_surface
from taichi_sim.outputs.parts import Parts
from taichi_sim.render import Camera, Renderer
from taichi_sim.render.content import Content
from taichi_sim.scene.looks import Look, Subjects

pytestmark = pytest.mark.once

RED, GREEN = (0.9, 0.05, 0.05), (0.05, 0.8, 0.05)
SIZE = (160, 90)


def tetrahedron(colour=None, covers=None):
    """Four balls joined by springs, a small surface between them, and a loose ball."""
    scene = Scene(dim=3)
    scene.add_balls([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], radius=0.2, colour=GREEN)
    scene.add_balls([[3, 0, 0]], radius=0.1)
    scene.add_springs([[0, 1], [0, 2], [0, 3]], stiffness=10.0)
    scene.add_triangles([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    weights = np.full((4, 4), 0.1) + 0.6 * np.eye(4)
    corners = np.tile(np.arange(4), (4, 1))
    scene.add_embedded_surface(
        corners,
        weights,
        [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]],
        covers=covers,
        colour=colour,
        uv=None if colour is None else np.linspace(0, 1, 24).reshape(4, 3, 2),
    )
    return scene


def frame_of(scene, position=None):
    x = scene.position if position is None else position
    return Frame(
        time=0.0,
        position=x,
        velocity=np.zeros_like(x),
        radius=scene.radius,
        springs=scene.pairs,
        sticks=scene.collides,
        triangles=scene.triangles,
        colour=scene.colour,
        embedded_surfaces=tuple(scene.embedded_surfaces),
    )


@pytest.mark.parametrize(
    ("corners", "weights", "triangles", "more", "message"),
    [
        (
            [[0, 9]],
            [[0.5, 0.5]],
            [[0, 0, 0]],
            {},
            r"embedded_surfaces\[0\]\.corners\[0\]: \[0, 9\] .* a ball, from 0 to 1",
        ),
        (
            [0, 1],
            [0.5, 0.5],
            [[0, 0, 0]],
            {},
            r"embedded_surfaces\[0\]\.corners: shape \(2,\) does not fit; it must be \(s, k\)",
        ),
        ([[0, 1]], [[0.5, 0.4]], [[0, 0, 0]], {}, r"embedded_surfaces\[0\]\.weights\[0\]: \[0.5, 0.4\] .* sum up to 1"),
        ([[0, 1]], [[0.5, np.nan]], [[0, 0, 0]], {}, r"embedded_surfaces\[0\]\.weights\[0\]\[1\]: nan"),
        (
            [[0, 1]],
            [[0.5, 0.5]] * 2,
            [[0, 0, 0]],
            {},
            r"embedded_surfaces\[0\]\.weights: 2 rows do not fit; there must be 1",
        ),
        (
            [[0, 1]],
            [[0.5, 0.5]],
            [[0, 0, 1]],
            {},
            r"embedded_surfaces\[0\]\.triangles\[0\]: .* a vertex of the surface, from 0 to 0",
        ),
        (
            [[0, 1]],
            [[0.5, 0.5]],
            [[0, 0, 0]],
            {"covers": [2]},
            r"embedded_surfaces\[0\]\.covers\[0\]: 2 is not allowed",
        ),
        ([[0, 1]], [[0.5, 0.5]], [[0, 0, 0]], {"colour": (2, 0, 0)}, r"embedded_surfaces\[0\]\.colour\[0\]: 2"),
    ],
)
def test_refused(corners, weights, triangles, more, message):
    scene = Scene(dim=2)
    scene.add_balls([[0, 0], [1, 0]], radius=0.1)
    with pytest.raises(SceneError, match=message):
        scene.add_embedded_surface(corners, weights, triangles, **more)
    assert not scene.embedded_surfaces


def test_a_surface_in_a_scene_file_counts_within_its_group(tmp_path):
    text = """format = 1
[[balls]]
position = [[5.0, 5.0]]
radius = 0.1
[[balls]]
name = "pair"
position = [[0.0, 0.0], [1.0, 0.0]]
radius = 0.1
[[embedded_surfaces]]
balls = "pair"
corners = [[0, 1], [1, 0]]
weights = [[0.5, 0.5], [1.0, 0.0]]
triangles = [[0, 1, 1]]
covers = [1]
"""
    (tmp_path / "x.toml").write_text(text)
    surface = load_scene(tmp_path / "x.toml").embedded_surfaces[0]
    assert surface.corners.tolist() == [[1, 2], [2, 1]]
    assert surface.covers.tolist() == [2]
    (tmp_path / "x.toml").write_text(text.replace("[[0, 1], [1, 0]]", "[[0, 1], [1, 7]]"))
    with pytest.raises(SceneError, match=r"line 11: embedded_surfaces\[0\]\.corners\[1\]: \[1, 7\] is not allowed"):
        load_scene(tmp_path / "x.toml")


def test_what_is_drawn():
    """The surface in place of balls, springs and triangles; where its vertices are."""
    scene = tetrahedron()
    content = Content.of(frame_of(scene), 1.0)
    assert content.radius.tolist() == [0, 0, 0, 0, 0.1]
    assert len(content.rods) == 0
    assert (content.triangles >= 5).all()
    x = np.random.default_rng(3).normal(size=(5, 3))
    surface = scene.embedded_surfaces[0]
    wanted = np.einsum("sk,skd->sd", surface.weights, x[surface.corners])
    assert content.binding.apply(x) == pytest.approx(wanted, rel=1e-14)
    assert content.colour[5:] == pytest.approx(np.tile(GREEN, (4, 1)))
    assert Content.of(frame_of(tetrahedron(RED, [4])), 1.0).colour[5:] == pytest.approx(np.tile(RED, (4, 1)))
    assert Content.of(frame_of(tetrahedron(RED, [4])), 1.0).radius[4] == 0


@pytest.mark.slow
def test_vertices_on_the_device_are_the_weighted_means():
    scene = tetrahedron()
    with Renderer(frame_of(scene), size=SIZE) as renderer:
        x = scene.position + np.random.default_rng(4).normal(size=(5, 3))
        renderer.render(frame_of(scene, x))
        drawn = renderer.buffers.ball.to_numpy()[:9, :3]  # in units of the scene's size about its centre
    surface = scene.embedded_surfaces[0]
    assert np.diff(drawn[:5], axis=0) / np.diff(x, axis=0) == pytest.approx(
        (drawn[1, 0] - drawn[0, 0]) / (x[1, 0] - x[0, 0]), rel=1e-4
    )
    assert drawn[5:] == pytest.approx(np.einsum("sk,skd->sd", surface.weights, drawn[surface.corners]), abs=1e-5)


@pytest.mark.slow
def test_in_pictures():
    """A red surface half as wide as the green triangle that it stands for, in 3D and in 2D."""
    for dim in (3, 2):
        points = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]])[:, :dim]
        scene = Scene(dim=dim)
        scene.add_balls(points, radius=0.1, colour=GREEN)
        scene.add_triangles([[0, 1, 2]])
        middle = 0.5 * np.eye(3) + 0.5 / 3
        scene.add_embedded_surface(np.tile(np.arange(3), (3, 1)), middle, [[0, 1, 2]], colour=RED)
        options = {"camera": Camera(eye=(0.0, 0.0, 10.0), target=(0.0, 0.0, 0.0), fov=30.0)} if dim == 3 else {}
        with Renderer(frame_of(scene), size=SIZE, **options) as renderer:
            image = renderer.render(frame_of(scene)).astype(int)
        red = (image[:, :, 0] > 1.12 * image[:, :, 1]).sum()
        green = (image[:, :, 1] > 1.12 * image[:, :, 0]).sum()
        assert red > 100
        assert green == 0
        with Renderer(frame_of(scene), size=SIZE, **options) as renderer:
            frame = frame_of(scene)
            frame.embedded_surfaces = ()
            image = renderer.render(frame).astype(int)
        assert (image[:, :, 1] > 1.12 * image[:, :, 0]).sum() == pytest.approx(4 * red, rel=0.15)


# A cube of 12 triangles, each of its six sides on its own sixth of an image (2 x 3)
DIE = [f"v {x} {y} {z}" for x in (0, 1) for y in (0, 1) for z in (0, 1)]
SIDES = ((1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4))


def die(path):
    """Write it as OBJ."""
    places = [f"vt {(k % 3 + u) / 3} {(k // 3 + v) / 2}" for k in range(6) for u, v in ((0, 0), (1, 0), (1, 1), (0, 1))]
    faces = [
        "f " + " ".join(f"{corner}/{4 * k + j + 1}" for j, corner in enumerate(side)) for k, side in enumerate(SIDES)
    ]
    path.write_text("\n".join([*DIE, *places, *faces, ""]))


@pytest.mark.parametrize("fill", ["voxels", "tetrahedra"])
def test_a_jelly_of_a_mesh_keeps_its_places_on_a_texture(tmp_path, fill):
    """In pictures, also subdivided ones, and in files for other programs."""
    die(tmp_path / "die.obj")
    scene = Scene(dim=3)
    shapes.jelly(scene, mesh=tmp_path / "die.obj", spacing=0.5, fill=fill, young_modulus=1e4)
    uv = read_surface(tmp_path / "die.obj").uv
    assert np.array_equal(scene.embedded_surfaces[0].uv, uv)
    frame = frame_of(scene)
    frame.objects = tuple(scene.objects)
    Image.new("RGB", (6, 4)).save(tmp_path / "die.png")
    look = Look.of_table(
        "looks[0]", {"of": "jelly_0", "texture": tmp_path / "die.png"}, Subjects(3, ["jelly_0"], (), (), ())
    )
    for times in (0, 1):
        found = Content.of(frame, 1.0, subdivide=times, looks=[look]).styles.place.reshape(-1, 3, 3)
        assert len(found) == 12 * 4**times
        sixth = np.floor(found[..., :2].mean(axis=1) * (3, 2)).astype(int)  # no triangle reaches into two of them
        assert np.all(found[..., :2] * (3, 2) >= sixth[:, None] - 1e-5)
        assert np.all(found[..., :2] * (3, 2) <= sixth[:, None] + 1 + 1e-5)
        assert len(np.unique(sixth, axis=0)) == 6
    (surface,) = Parts(frame, ["jelly_0"]).surfaces
    assert len(surface.uv) > 8  # a vertex for each place of each corner
    assert np.allclose(surface.uv[surface.embedded], uv)
    points = surface.points(scene.position)
    mesh = read_surface(tmp_path / "die.obj")
    assert np.allclose(points[surface.embedded], mesh.vertices[mesh.triangles])


def test_places_on_a_texture_that_do_not_fit_are_refused():
    scene = Scene(dim=3)
    balls = scene.add_balls([[0, 0, 0], [1, 0, 0], [0, 1, 0]], radius=0.1)
    with pytest.raises(
        SceneError, match=r"embedded_surfaces\[0\]\.uv: shape \(3, 2\) does not fit; it must be \(1, 3, 2\)"
    ):
        scene.add_embedded_surface(balls[:, None], [[1.0]] * 3, [[0, 1, 2]], uv=np.zeros((3, 2)))
