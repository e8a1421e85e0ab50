"""Finer surfaces and colours by speed or strain: weights against a slow reference, pictures of what they should look like."""

from dataclasses import replace

import numpy as np
import pytest
from test_embedded_surfaces import frame_of

from taichi_sim import Frame, Scene, Simulation, shapes
from taichi_sim.render import Camera, Renderer
from taichi_sim.render.colouring import COLOUR_SCALE, Colouring
from taichi_sim.render.content import Content
from taichi_sim.render.palette import body_colours, to_linear
from taichi_sim.render.subdivision import subdivide, subdivided_corners

pytestmark = pytest.mark.once

OCTAHEDRON = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
FAN = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [4, 3, 5]])  # open; 0 is a corner of it
BOOK = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])  # an edge of three triangles


def loop(triangles, n):
    """Loop's rules, vertex by vertex and edge by edge; old vertices first, edges in order of their ends."""
    sides = {}
    for a, b, c in triangles.tolist():
        for u, v, w in ((a, b, c), (b, c, a), (c, a, b)):
            sides.setdefault((min(u, v), max(u, v)), []).append(w)
    matrix = np.zeros((n + len(sides), n))
    for v in range(n):
        near = [a + b - v for a, b in sides if v in (a, b)]
        rim = [a + b - v for (a, b), across in sides.items() if v in (a, b) and len(across) != 2]
        if not rim:
            beta = 3 / 16 if len(near) == 3 else 3 / (8 * max(len(near), 1))
            matrix[v, near] = beta
            matrix[v, v] = 1 - len(near) * beta
        elif len(rim) == 2 and len(near) > 3:
            matrix[v, rim] = 1 / 8
            matrix[v, v] = 3 / 4
        else:
            matrix[v, v] = 1
    for k, (a, b) in enumerate(sorted(sides)):
        across = sides[a, b]
        matrix[n + k, [a, b]] = 3 / 8 if len(across) == 2 else 1 / 2
        if len(across) == 2:
            matrix[n + k, across] += 1 / 8
    return matrix


@pytest.mark.parametrize(("triangles", "n"), [(OCTAHEDRON, 6), (FAN, 6), (BOOK, 5)])
def test_weights_of_a_subdivision(triangles, n):
    finer, weights = subdivide(triangles, n)
    wanted = loop(triangles, n)
    matrix = weights.toarray()
    assert matrix == pytest.approx(wanted, abs=1e-15)
    assert matrix.sum(axis=1) == pytest.approx(np.ones(len(wanted)), rel=1e-14)
    assert finer.shape == (4 * len(triangles), 3)


def test_corners_of_finer_triangles_keep_their_places():
    values = np.random.default_rng(3).uniform(size=(len(FAN), 3, 2))
    finer, weights = subdivide(FAN, 6)
    found = subdivided_corners(values)
    for k, triangle in enumerate(finer.tolist()):
        of = FAN[k % len(FAN)].tolist()
        for corner, place in zip(triangle, found[k]):
            if corner < 6:
                assert place == pytest.approx(values[k % len(FAN), of.index(corner)])
            else:  # of an edge, whose ends have the largest weights
                ends = sorted(of, key=lambda v: weights[corner, v])[1:]
                assert place == pytest.approx(values[k % len(FAN), [of.index(v) for v in ends]].mean(axis=0))


def test_a_finer_surface_is_closed_and_faces_outwards():
    points = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    triangles = OCTAHEDRON
    for _ in range(3):
        triangles, weights = subdivide(triangles, len(points))
        points = weights @ points
        directed = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
        assert len(np.unique(directed, axis=0)) == len(directed)  # each edge once in each direction
        assert np.array_equal(np.unique(directed, axis=0), np.unique(directed[:, ::-1], axis=0))
        a, b, c = (points[triangles[:, k]] for k in range(3))
        assert np.all(np.einsum("ti,ti->t", np.cross(b - a, c - a), a + b + c) > 0)
    assert np.ptp(np.linalg.norm(points, axis=1)) < 0.1  # nearly round


def cloth(colour=None, embedded=False):
    scene = Scene(dim=3, gravity=(0, -10, 0))
    sheet = shapes.cloth(scene, size=(1, 1), resolution=(5, 5), colour=colour)
    if embedded:
        shares = np.full((25, 2), 0.5)
        scene.add_embedded_surface(
            np.stack([sheet.balls, sheet.balls[::-1]], 1), shares, sheet.triangles, colour=colour
        )
    return scene


@pytest.mark.parametrize("embedded", [False, True])
@pytest.mark.parametrize("times", [1, 2])
def test_what_is_drawn_of_a_finer_surface(embedded, times):
    """Its vertices follow the balls of the cloth or of its embedded surface; with the colour that was given."""
    scene = cloth((0.2, 0.4, 0.6), embedded)
    content = Content.of(frame_of(scene), 1.0, times)
    side = 4 * 2**times + 1
    assert len(content.binding) == side**2
    assert len(content.triangles) == 32 * 4**times
    assert content.triangles.min() == 25
    assert content.colour[25:] == pytest.approx(np.tile((0.2, 0.4, 0.6), (side**2, 1)))
    x = np.random.default_rng(5).normal(size=(25, 3))
    base, n, triangles = (x + x[::-1]) / 2 if embedded else x, 25, scene.triangles
    for _ in range(times):
        matrix, triangles = loop(triangles, n), subdivide(triangles, n)[0]
        base, n = matrix @ base, len(matrix)
    assert content.binding.apply(x) == pytest.approx(base, abs=1e-13)


def test_of_torn_cloth_only_triangles_are_drawn():
    """No ball that lost them, and no thread of it."""
    frame = Frame(0.0, np.eye(3)[[0, 1, 2, 0, 1]] * 2.0, np.zeros((5, 3)), np.full(5, 0.1))
    frame.triangles = np.array([[0, 1, 2]], dtype=np.int32)
    frame.springs = np.array([[3, 4]], dtype=np.int32)
    assert np.flatnonzero(Content.of(frame, 1.0).radius).tolist() == [3, 4]
    frame.torn_triangles = np.array([[2, 3, 4]], dtype=np.int32)
    content = Content.of(frame, 1.0)
    assert not content.radius.any()
    assert len(content.rods) == 0
    assert content.triangles.tolist() == [[0, 1, 2]]


def test_colours_stay_when_springs_tear():
    """Also those of bodies that come after what is now in pieces."""
    whole = Frame(0.0, np.random.default_rng(0).normal(size=(6, 3)), np.zeros((6, 3)), np.full(6, 0.1))
    whole.springs = np.array([[0, 1], [1, 2], [3, 4]], dtype=np.int32)
    torn = replace(whole, springs=whole.springs[1:], torn_springs=whole.springs[:1])
    assert len(np.unique(body_colours(whole), axis=0)) == 3
    assert np.array_equal(body_colours(torn), body_colours(whole))
    sheet = replace(whole, springs=whole.springs[:0], triangles=np.array([[0, 1, 2], [2, 3, 4]], dtype=np.int32))
    torn = replace(sheet, triangles=sheet.triangles[:1], torn_triangles=sheet.triangles[1:])
    assert np.array_equal(body_colours(torn), body_colours(sheet))


def test_what_a_closed_surface_holds_is_not_drawn():
    """Inner balls of a jelly and their springs; but what hangs on it, and all of it where the surface is torn."""
    scene = Scene(dim=3)
    block = shapes.jelly(scene, size=(1, 1, 1), resolution=(4, 4, 4))
    loose = scene.add_balls([[2, 0, 0], [3, 0, 0]], radius=0.1)
    scene.attach(block.balls[:1], loose[:1], stiffness=10.0)
    frame = frame_of(scene)
    inner = np.setdiff1d(block.balls, frame.triangles)
    assert len(inner) == 8
    assert np.count_nonzero(Content.of(frame, 1.0).radius) == 8 + 2  # nothing says what is one thing
    frame.objects = tuple(scene.objects)
    content = Content.of(frame, 1.0)
    assert np.flatnonzero(content.radius).tolist() == loose.tolist()
    assert len(content.rods) == 0
    frame.triangles = frame.triangles[1:]
    assert not content.matches(frame)
    assert np.count_nonzero(Content.of(frame, 1.0).radius) == 8 + 2


@pytest.mark.slow
def test_a_finer_surface_in_a_picture():
    """A coarse ring of cloth, seen from its side, gets a smoother outline; a still picture repeats."""
    scene = Scene(dim=3)
    angle = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], 1)
    scene.add_balls(
        np.concatenate([np.c_[ring, -np.ones(6)], np.c_[ring, np.ones(6)]]), radius=0.1, colour=(0.8, 0.1, 0.1)
    )
    k = np.arange(6)
    j = (k + 1) % 6
    scene.add_triangles(np.concatenate([np.stack([k, j, k + 6], 1), np.stack([j, j + 6, k + 6], 1)]))
    frame, camera = frame_of(scene), Camera((0.0, 0.0, 9.0), (0.0, 0.0, 0.0))
    areas = []
    for times in (0, 1, 2):
        with Renderer(frame, size=(96, 96), camera=camera, shadow=False, subdivide=times) as renderer:
            image = renderer.render(frame)
            assert np.array_equal(image, renderer.render(frame))
        areas.append(np.count_nonzero(image[:, :, 0] > 1.3 * image[:, :, 2]))
        painter_sides = image[:, :, 0] > 1.3 * image[:, :, 2]
        assert painter_sides.any()
    assert areas[0] > areas[1] > areas[2]  # Loop's surface lies within the hull


# Colours -----------------------------------------------------------------------------------------------------------


def oklab(srgb):
    """B. Ottosson, A perceptual color space for image processing, 2020."""
    to_cone = [[0.4122214708, 0.5363325363, 0.0514459929], [0.2119034982, 0.6806995451, 0.1073969566]]
    to_cone.append([0.0883024619, 0.2817188376, 0.6299787005])
    to_lab = [[0.2104542553, 0.7936177850, -0.0040720468], [1.9779984951, -2.4285922050, 0.4505937099]]
    to_lab.append([0.0259040371, 0.7827717662, -0.8086757660])
    return np.cbrt(to_linear(srgb) @ np.array(to_cone).T) @ np.array(to_lab).T


def test_the_scale_is_even_to_the_eye():
    lab = oklab(COLOUR_SCALE)
    step = np.linalg.norm(np.diff(lab, axis=0), axis=1)
    assert np.all(np.diff(lab[:, 0]) > 0.02)  # ever lighter: it survives grey print
    assert np.ptp(step) < 0.1 * step.mean()


def moving(dim):
    """Three loose balls, of speed 0, 1 and 2 m/s, and a spring stretched by 0.2 between two more."""
    points = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0]], dtype=float)[:, :dim]
    velocity = np.zeros((5, dim))
    velocity[1:3, 0] = 1.0, 2.0
    springs = np.array([[3, 4]], dtype=np.int32)
    return Frame(
        time=0.0,
        position=points,
        velocity=velocity,
        radius=np.full(5, 0.3),
        springs=springs,
        sticks=np.zeros(1, dtype=bool),
        strain=np.array([-0.2]),
        gravity=np.zeros(dim),
    )


def test_values_on_the_scale():
    frame = moving(3)
    assert Colouring.of(frame, "object", None) is None
    speed = Colouring.of(frame, "speed", (1.0, 3.0))
    assert speed.values(frame).tolist() == [0, 0, 0.5, 0, 0]
    assert Colouring.of(frame, "speed", None).high == pytest.approx(np.quantile([0, 0, 0, 1, 2], 0.98))
    frame.gravity = np.array([0, -10.0, 0])
    size = np.linalg.norm([2.6, 1.6, 0.6])
    assert Colouring.of(frame, "speed", None).high == pytest.approx(np.sqrt(10 * size))
    assert Colouring.of(frame, "strain", (0, 0.8)).values(frame) == pytest.approx([0, 0, 0, 0.25, 0.25])
    assert Colouring.of(frame, "strain", None).values(frame).tolist() == [0, 0, 0, 1, 1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"colour": "heat"}, "colour: 'heat' is not allowed; it must be object, strain or speed"),
        (
            {"colour_range": (1.0, 1.0)},
            r"colour_range: \(1.0, 1.0\) is not allowed; it must be two numbers, the lower first",
        ),
        ({"colour_range": (0.0, np.inf)}, "colour_range"),
        ({"subdivide": 3}, "subdivide: 3 is not allowed; it must be 0, 1 or 2"),
    ],
)
def test_bad_arguments(options, message):
    with pytest.raises(ValueError, match=message):
        Renderer(moving(3), size=(32, 32), **options)


@pytest.mark.parametrize("dim", [2, 3])
def test_balls_by_speed_in_pictures(dim):
    """The slow ball dark purple, the fast one yellow."""
    frame = moving(dim)
    frame.springs, frame.sticks, frame.strain = np.zeros((0, 2), dtype=np.int32), np.zeros(0, dtype=bool), np.zeros(0)
    camera = {"camera": Camera((1.0, 0.5, 8.0), (1.0, 0.5, 0.0), fov=30.0), "shadow": False} if dim == 3 else {}
    with Renderer(frame, size=(160, 96), colour="speed", colour_range=(0.0, 2.0), **camera) as renderer:
        image = renderer.render(frame).astype(int)
        frame.velocity = frame.velocity[::-1].copy()
        other = renderer.render(frame).astype(int)
    red, green, blue = image[..., 0], image[..., 1], image[..., 2]
    yellow, purple = (red > 1.4 * blue) & (green > 1.4 * blue), (blue > 1.2 * red) & (red > 1.4 * green)
    assert yellow.sum() > 80
    assert purple.sum() > 80
    assert np.nonzero(yellow)[1].mean() > np.nonzero(purple)[1].mean()
    assert not np.array_equal(image, other)  # colours follow the frame


@pytest.mark.slow
def test_a_surface_by_strain_in_a_picture():
    """The stretched half of a cloth is yellow, the other dark, on the finer mesh as on the balls' own."""
    scene = cloth()
    scene.set_group(np.arange(25), "cloth")
    for times in (0, 1):
        with Simulation(scene) as sim:
            x = sim.position
            x[x[:, 0] > 0.6, 0] += 0.3
            sim.set_position(x)
            frame = sim.frame()
        camera = Camera((0.6, 4.0, 0.5), (0.6, 0.0, 0.5), up=(0.0, 0.0, -1.0))
        with Renderer(frame, size=(96, 96), camera=camera, shadow=False, colour="strain", subdivide=times) as renderer:
            image = renderer.render(frame).astype(int)
        yellow = (image[..., 0] > 1.4 * image[..., 2]) & (image[..., 1] > 1.4 * image[..., 2])
        dark = (image[..., 2] > 1.2 * image[..., 1]) & (image.sum(axis=2) < 380)
        assert yellow.sum() > 40
        assert dark.sum() > 40
        assert np.nonzero(yellow)[1].mean() > np.nonzero(dark)[1].mean()
