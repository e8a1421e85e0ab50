"""Filled areas of flat jelly: where their sides are, and that pictures show them in place of balls."""

import numpy as np
import pytest

import taichi_sim as ts
from taichi_sim.analysis.lazy_frame import MomentsOf
from taichi_sim.geometry.polygon_mesh import outer_edges
from taichi_sim.render.content import Content
from taichi_sim.render.palette import body_colours
from taichi_sim.shapes.filling import filling

pytestmark = pytest.mark.once


def area(points, triangles):
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return 0.5 * np.sum((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def test_sides_lie_beyond_the_outline():
    """Of an L with a corner that is turned in; its inner point stays."""
    points = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2], [0.5, 0.5]], dtype=float)
    triangles = np.array([[0, 1, 6], [1, 2, 3], [1, 3, 6], [3, 4, 5], [3, 5, 6], [5, 0, 6]])
    corners, weights = filling(points, triangles, 0.25)
    assert np.allclose(weights.sum(axis=1), 1.0)
    found = np.einsum("vk,vki->vi", weights, points[corners])
    wider = [[-0.25, -0.25], [2.25, -0.25], [2.25, 1.25], [1.25, 1.25], [1.25, 2.25], [-0.25, 2.25], [0.5, 0.5]]
    assert np.allclose(found, wider)


def test_a_sharp_corner_is_not_drawn_out_far():
    points = np.array([[0, 0], [5, -0.2], [5, 0.2]])
    corners, weights = filling(points, np.array([[0, 1, 2]]), 0.3)
    found = np.einsum("vk,vki->vi", weights, points[corners])
    assert np.linalg.norm(found[0]) == pytest.approx(0.6)  # twice the reach


@pytest.mark.parametrize(
    "given",
    [
        {"size": (1, 0.5), "resolution": (5, 3), "young_modulus": 1e4},
        {"size": (1, 0.5), "resolution": (5, 3), "poisson_ratio": 0.3, "position": (3, 2), "rotation": 30, "scale": 2},
    ],
)
def test_flat_jelly_of_a_material_is_drawn_filled(given):
    scene = ts.Scene(dim=2)
    jelly = ts.shapes.jelly(scene, **given)
    (surface,) = scene.embedded_surfaces
    found = np.einsum("vk,vki->vi", surface.weights, scene.position[surface.corners])
    radius, scale = scene.radius[0], given.get("scale", 1)
    assert area(found, surface.triangles) == pytest.approx((scale + 2 * radius) * (0.5 * scale + 2 * radius))
    frame = ts.Frame(0.0, scene.position, scene.velocity, scene.radius, embedded_surfaces=(surface,))
    content = Content.of(frame, 1.0)
    assert not content.radius.any()
    assert len(content.triangles) == len(surface.triangles) == 2 * len(scene.bricks)
    assert len(jelly.balls) == 15


def test_a_radius_asks_for_balls():
    scene = ts.Scene(dim=2)
    ts.shapes.jelly(scene, (1, 0.5), (5, 3), young_modulus=1e4, radius=0.1)
    ts.shapes.jelly(scene, (1, 0.5), (5, 3))  # of springs, which show
    assert not scene.embedded_surfaces


def test_letters_are_drawn_filled():
    pytest.importorskip("shapely", reason="shapely is not installed")
    scene = ts.Scene(dim=2)
    ts.shapes.text(scene, "OI", 1.0, spacing=0.06)
    assert len(scene.embedded_surfaces) == 2
    for one in scene.embedded_surfaces:
        found = np.einsum("vk,vki->vi", one.weights, scene.position[one.corners])
        edges, radius = outer_edges(one.triangles), scene.radius[one.corners[0, 0]]
        length = np.linalg.norm(np.diff(found[edges], axis=1)[:, 0], axis=1).sum()
        inner = area(scene.position[one.corners[np.arange(len(found)), np.argmax(one.weights, axis=1)]], one.triangles)
        assert 0.5 * length * radius < area(found, one.triangles) - inner < 1.5 * length * radius
    assert not len(scene.embedded_surfaces[0].covers)
    bold = ts.Scene(dim=2)
    ts.shapes.text(bold, "OI", 1.0, spacing=0.06, radius=0.02)
    assert not bold.embedded_surfaces


@pytest.mark.parametrize("dim", [2, 3])
def test_bodies_of_elements_have_one_colour_each(dim):
    scene = ts.Scene(dim=dim)
    for place in (0.0, 2.0):
        ts.shapes.jelly(scene, (1, 0.5, 0.5)[:dim], (4,) * dim, young_modulus=1e4, position=(place, 0, 0)[:dim])
    frame = MomentsOf(scene).at(0.0, scene.position, scene.velocity, np.zeros((scene.n_balls, 3)), None)
    first, second = np.split(body_colours(frame), 2)
    assert not np.ptp(first, axis=0).any()
    assert not np.ptp(second, axis=0).any()
    assert np.any(first[0] != second[0])
