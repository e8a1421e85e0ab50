"""What fills bodies: lattices with given moduli, meshes filled with boxes or tetrahedra, and their surfaces. No Taichi."""

import itertools
import warnings

import numpy as np
import pytest
from scene_files import assert_unchanged
from statics import at_rest

from taichi_sim import Scene, SceneError, shapes
from taichi_sim.analysis import diagnostics
from taichi_sim.geometry.mesh import Surface, flaws, holes, volume
from taichi_sim.geometry.spheres import icosphere
from taichi_sim.scene.bricks import corner_volumes
from taichi_sim.scene.cells import cell_volumes
from taichi_sim.scene.neo_hookean import lame
from taichi_sim.shapes import jelly_material
from taichi_sim.shapes.jelly_material import box_surface, connected, inside, simplices, skin_of_tetrahedra

pytestmark = pytest.mark.once

CUBE = np.array(list(itertools.product((0.0, 1.0), repeat=3)))


def tube(rings=24, around=16, radius=0.35, thick=0.15):
    """A closed ring of radius `radius`, `thick` half across: a mesh with a hole through it."""
    u, v = (2 * np.pi * np.arange(n) / n for n in (rings, around))
    u, v = (k.ravel() for k in np.meshgrid(u, v, indexing="ij"))
    away = radius + thick * np.cos(v)
    points = np.stack([away * np.cos(u), thick * np.sin(v), -away * np.sin(u)], axis=1)
    here = np.arange(rings * around).reshape(rings, around)
    next_u, next_v = np.roll(here, -1, axis=0), np.roll(here, -1, axis=1)
    both = np.roll(next_u, -1, axis=1)
    faces = [np.stack([k.ravel() for k in three], axis=1) for three in ((here, next_u, both), (here, both, next_v))]
    surface = Surface(points, np.concatenate(faces).astype(np.int32))
    return surface if volume(surface) > 0 else Surface(points, surface.triangles[:, ::-1])


def block(dim, ratio, size, resolution, **more):
    scene = Scene(dim=dim)
    made = shapes.jelly(scene, size, resolution, young_modulus=1000.0, poisson_ratio=ratio, **more)
    return scene, made


def strain_energy(dim, ratio, e):
    """E = 1000: lambda tr(e)^2 / 2 + mu e:e per volume; in 2D Poisson's ratio is lambda / (lambda + 2 mu)."""
    mu = 1000 / (2 * (1 + ratio))
    lame = 2 * mu * ratio / (1 - (dim - 1) * ratio)
    return 0.5 * lame * np.trace(e) ** 2 + mu * np.sum(e * e)


@pytest.mark.parametrize(
    ("dim", "ratio", "size", "resolution"),
    [
        (2, 1 / 3, (1, 1.5), (5, 9)),
        (2, 0.6, (1, 1), (4, 4)),
        (2, 0.0, (3, 1), (4, 9)),
        (3, 1 / 4, (1, 1, 1), (4, 4, 4)),
        (3, 0.1, (1, 1.1, 3), (3, 4, 3)),
        (3, 0.4999, (1, 1, 1), (3, 4, 3)),
    ],
)
def test_a_block_has_its_moduli_at_any_resolution(dim, ratio, size, resolution):
    scene, made = block(dim, ratio, size, resolution, density=30.0)
    whole, small = float(np.prod(size)), 1e-6
    assert scene.mass.sum() == pytest.approx(30 * whole)
    assert scene.mass.min() == pytest.approx(30 * whole / np.prod(np.array(resolution) - 1) / 2**dim)
    assert len(made.bricks) == np.prod(np.array(resolution) - 1)
    assert len(made.springs) == len(made.cells) == 0
    generator = np.random.default_rng(1)
    for _ in range(5):
        e = generator.normal(size=(dim, dim))
        e = small * (e + e.T)
        want = strain_energy(dim, ratio, e) * whole
        x = scene.position @ (np.eye(dim) + e)
        assert diagnostics.energy(scene, x, 0 * x).spring == pytest.approx(want, rel=1e-3)


def test_cells_are_of_positive_volume_and_share_the_block():
    for dim in (2, 3):
        scene = Scene(dim=dim)
        shapes.jelly(scene, (1.0,) * dim, (4,) * dim, stiffness=100.0)
        assert (cell_volumes(scene.position, scene.solids) > 0).all()
        assert cell_volumes(scene.position, scene.cells) == pytest.approx(scene.rest_volume)
        share = 1.5 if dim == 3 else 0.5
        assert scene.rest_volume.sum() * share == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("dim", "length", "ratio", "high"),
    [(2, 12, 1 / 3, 1), (2, 9, 0.92, 2), (2, 9, 0.97, 4), (3, 10, 1 / 4, 1), (3, 10, 0.45, 2)],
)
def test_a_bar_sags_as_a_slender_beam(dim, length, ratio, high):
    """Under its own weight, clamped at one end: q L^4 / (8 E I) + q L^2 / (2 kappa G A), one or a few boxes high, 1 wide.

    The clamp keeps its end from narrowing, which theory leaves out and large ratios show."""
    side = 1.0 / high
    size, resolution = (float(length), 1.0, side)[:dim], (length * high + 1, high + 1, 2)[:dim]
    scene, _ = block(dim, ratio, size, resolution, density=1.0)
    scene.gravity = (0.0, -1e-5, 0.0)[:dim]
    scene.set_balls(scene.position[:, 0] == 0, pinned=True)
    x, _ = at_rest(scene, most=1e-5)
    tip = scene.position[:, 0] > length - 1e-9
    sag = (scene.position - x)[tip, 1].mean()
    q, shear = 1e-5, 1000 / (2 * (1 + ratio))  # per width
    kappa = 5 / 6 if dim == 2 else 10 * (1 + ratio) / (12 + 11 * ratio)
    want = q * length**4 / (8 * 1000 / 12) + q * length**2 / (2 * kappa * shear)
    assert sag == pytest.approx(want, rel=0.03 if ratio < 0.4 else 0.06)
    assert sag < 0.01 * length


def test_ratios_that_no_body_has():
    for dim, ratio, allowed in ((3, -0.2, "0"), (3, 0.5, "0.4999"), (2, 1.0, "0.9996")):
        with pytest.raises(SceneError, match=rf"jelly\.poisson_ratio: {ratio} .*{allowed}"):
            block(dim, ratio, (1.0,) * dim, (4,) * dim)


def test_what_is_inside():
    ball = icosphere(3)
    turned = Surface(
        ball.vertices,
        np.where(np.arange(len(ball.triangles))[:, None] % 7 == 0, ball.triangles[:, ::-1], ball.triangles),
    )
    torn = Surface(ball.vertices, ball.triangles[ball.vertices[ball.triangles].mean(axis=1)[:, 1] < 0.97])
    number, side = (21, 22, 23), 0.1
    low = np.array([-1.05, -1.1, -1.15])
    centre = low + side * (np.stack(np.meshgrid(*map(np.arange, number), indexing="ij"), axis=-1) + 0.5)
    away = np.linalg.norm(centre, axis=-1)
    for surface in (ball, turned, Surface(ball.vertices, ball.triangles[:, ::-1])):
        found = inside(surface, low, side, number)
        assert found[away < 0.98].all()
        assert not found[away > 1].any()
    assert len(torn.triangles) < len(ball.triangles)
    found = inside(torn, low, side, number)
    assert found[away < 0.98].all()
    assert not found[away > 1].any()
    ring = inside(tube(), np.array([-0.6, -0.2, -0.6]), 0.05, (24, 8, 24))
    assert not ring[11:13, :, 11:13].any()
    assert ring.sum() * 0.05**3 == pytest.approx(volume(tube()), rel=0.05)


def test_crumbs_go():
    filled = np.zeros((6, 6, 6), dtype=bool)
    filled[:5, :5, :5] = True
    filled[5, 5, 5] = True
    assert connected(filled).sum() == 125
    filled[5, 5, :5] = True  # hangs on by an edge alone, but is large enough
    assert connected(filled).sum() == 131
    assert len(box_surface(connected(filled))) == 2 * (6 * 25 + 26)


@pytest.mark.parametrize("surface", [tube(), icosphere(2)], ids=["ring", "sphere"])
def test_a_mesh_filled_with_boxes(surface):
    scene = Scene(dim=3)
    made = shapes.jelly(
        scene, mesh=surface, spacing=0.05 if len(surface.vertices) > 300 else 0.15, density=500.0, scale=2.0
    )
    assert scene.mass.sum() == pytest.approx(500 * 8 * volume(surface))
    assert (corner_volumes(scene.position, scene.bricks) > 0).all()
    assert len(made.bricks) == len(scene.bricks)
    assert not len(holes(made.triangles))
    assert volume(Surface(scene.position, made.triangles)) == pytest.approx(8 * volume(surface), rel=0.08)
    skin = scene.embedded_surfaces[0]
    for x in (scene.position, scene.position @ np.array([[1, 0.2, 0], [0, 1.5, 0], [0.1, 0, 0.7]]) + [1, 2, 3]):
        here = np.einsum("sk,ski->si", skin.weights, x[skin.corners])
        want = 2 * surface.vertices
        want = want if x is scene.position else want @ np.array([[1, 0.2, 0], [0, 1.5, 0], [0.1, 0, 0.7]]) + [1, 2, 3]
        assert here == pytest.approx(want, abs=1e-12)
    assert skin.covered(scene.n_balls).all()


def five(number):
    """A block of cubes of side 1, each cut in five, at random places near the lattice: irregular tetrahedra that tile."""
    index = np.arange(int(np.prod(number))).reshape(number)
    cells = []
    for place in itertools.product(*(range(n - 1) for n in number)):
        even = sum(place) % 2
        middle = [c for c in itertools.product((0, 1), repeat=3) if sum(c) % 2 == even]
        rest = [c for c in itertools.product((0, 1), repeat=3) if sum(c) % 2 != even]
        near = [[c, *(m for m in middle if sum(abs(a - b) for a, b in zip(c, m)) == 1)] for c in rest]
        cells += [[index[tuple(np.add(place, c))] for c in four] for four in (middle, *near)]
    points = np.stack(np.unravel_index(np.arange(index.size), number), axis=1) + 0.0
    points += np.random.default_rng(3).uniform(-0.1, 0.1, points.shape)
    cells = np.array(cells)
    turned = cell_volumes(points, cells) < 0
    cells[turned] = cells[turned][:, [1, 0, 2, 3]]
    return points, cells


def test_a_body_of_tetrahedra_has_their_volume_and_surface():
    points, cells = five((4, 4, 4))
    body = simplices(points, cells)
    whole = cell_volumes(points, cells).sum()
    assert body.volume.sum() == pytest.approx(whole)
    assert not len(holes(body.triangles))
    assert volume(Surface(points, body.triangles)) == pytest.approx(whole)


def test_a_skin_follows_tetrahedra():
    points, cells = five((4, 4, 4))
    vertices = np.random.default_rng(1).uniform(-0.2, 3.2, (200, 3))
    corners, weights = skin_of_tetrahedra(points, cells, vertices)
    assert np.einsum("sk,ski->si", weights, points[corners]) == pytest.approx(vertices, abs=1e-12)
    within = (vertices > 0.2).all(axis=1) & (vertices < 2.8).all(axis=1)
    assert weights[within].min() > -1e-9
    assert weights.min() > -1.0


# Meshes that cannot be filled ----------------------------------------------------------------------------------------


def test_flaws_of_a_mesh():
    ball = icosphere(1)
    assert flaws(ball) == []
    t = ball.triangles
    torn = flaws(Surface(ball.vertices, t[1:]))
    assert torn[0].startswith("3 edges have a triangle on one side only (")
    i, j = sorted(t[0][:2])
    assert f"{i}-{j} at " in torn[0]
    turned = flaws(Surface(ball.vertices, np.concatenate([t[:1, ::-1], t[1:]])))
    assert turned[0].startswith("3 edges lie between triangles that face opposite ways")
    double = flaws(Surface(ball.vertices, np.concatenate([t, t[4:5]])))
    assert double[0].startswith("3 edges have more than two triangles")
    assert double[1] == "1 triangles are there more than once (4)"
    thin = ball.vertices.copy()
    thin[t[7, 0]] = 0.5 * (thin[t[7, 1]] + thin[t[7, 2]])
    assert "1 triangles have next to no area (7)" in flaws(Surface(thin, t))
    assert flaws(Surface(ball.vertices, t[1:]), closed=False) == []
    assert flaws(Surface(ball.vertices, np.concatenate([t[:1, ::-1], t[1:]])), closed=False) == []
    assert flaws(Surface(ball.vertices, np.concatenate([t, t[4:5]])), closed=False) == double


def test_a_long_body_in_plane_strain():
    """Its stress along a strain is that of the solid, whose other strain along the plane and that across it are 0."""
    scene = Scene(dim=2)
    shapes.jelly(scene, (1, 1), (3, 3), young_modulus=1000.0, poisson_ratio=0.3, plane="strain")
    e = np.array([[2e-6, 1e-6], [1e-6, -3e-6]])
    stored = diagnostics.energy(scene, scene.position @ (np.eye(2) + e), 0 * scene.position).spring
    mu, lam = lame(3, 1000.0, 0.3)
    assert stored == pytest.approx(mu * np.sum(e * e) + 0.5 * lam * np.trace(e) ** 2, rel=1e-4)
    shapes.jelly(scene, (1, 1), (2, 2), young_modulus=1000.0, poisson_ratio=0.4999, plane="strain")
    with pytest.raises(SceneError, match=r"jelly\.plane: 'air' .*'stress', 'strain'"):
        shapes.jelly(scene, (1, 1), (2, 2), plane="air")
    with pytest.raises(SceneError, match=r"jelly\.plane: needs a scene with dim = 2"):
        shapes.jelly(Scene(dim=3), (1, 1, 1), (2, 2, 2), plane="strain")


REFUSED = [
    (
        {"mesh": Surface(CUBE, np.array([[0, 1, 2]], dtype=np.int32)), "fill": "tetrahedra"},
        "cannot be filled .*0-1 at .*voxels",
    ),
    ({"mesh": icosphere(1), "size": (1, 1, 1)}, r"jelly\.size: is for a block"),
    ({"mesh": icosphere(1), "stiffness": 1.0}, r"jelly\.stiffness: is for a block"),
    ({"mesh": icosphere(1), "fill": "water"}, r"jelly\.fill: 'water' .*'voxels', 'tetrahedra'"),
    ({"mesh": icosphere(1), "spacing": 1.0, "position": (0, 0)}, r"jelly\.position"),
    ({"mesh": icosphere(1), "spacing": 9.0}, r"jelly\.spacing: 9\.0 is not allowed; it must be at most 2, the length"),
    ({"mesh": Surface(CUBE * [1, 0, 1], np.array([[0, 1, 2]], dtype=np.int32))}, r"jelly\.mesh: is flat"),
    (
        {"mesh": Surface(CUBE * 1e-3 + [0, 0, 0], np.array([[0, 1, 2]], dtype=np.int32))},
        r"jelly\.mesh: encloses nothing that could be filled: 3 edges",
    ),
    ({"mesh": icosphere(1), "spacing": 1e-6}, r"jelly\.spacing: 1e-06 .*GB of memory.*coarser"),
    ({"resolution": (20000, 20000, 20000)}, r"jelly\.resolution: \(20000.* 8e\+12 balls .*GB of memory.*coarser"),
    ({"spacing": 1.0}, r"jelly\.spacing: is for a mesh"),
    ({"fill": "tetrahedra"}, r"jelly\.fill: .*is for a mesh"),
    ({"fill": "tetrahedra", "young_modulus": 1e4}, r"jelly\.fill: .*is for a mesh"),
    ({"young_modulus": 1.0, "stiffness": 1.0}, r"jelly\.young_modulus: does not go with stiffness"),
    ({"density": 1.0, "mass": 1.0}, r"jelly\.density: does not go with mass"),
]


@pytest.mark.parametrize(("arguments", "message"), REFUSED, ids=[message for _, message in REFUSED])
def test_refused_and_the_scene_unchanged(arguments, message):
    assert_unchanged(Scene(dim=3), lambda scene: shapes.jelly(scene, **arguments), message)


def test_cloth_of_a_mesh_that_is_no_sheet_is_reported():
    three = Surface(CUBE[[0, 1, 2, 4, 6]], np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]], dtype=np.int32))
    with pytest.warns(UserWarning, match=r"cloth\.mesh: 1 edges have more than two triangles \(0-1 at .*mend") as told:
        shapes.cloth(Scene(dim=3), mesh=three)
    assert told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        shapes.cloth(Scene(dim=3), mesh=Surface(three.vertices[:4], three.triangles[:2]))


def test_a_mesh_with_a_hole_is_filled_with_boxes_and_reported():
    ball = icosphere(2)
    whole, scene = Scene(dim=3), Scene(dim=3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        shapes.jelly(whole, mesh=ball, spacing=0.3)
    with pytest.warns(
        UserWarning, match=r"jelly\.mesh: 3 edges have a triangle on one side only \(.*look at the"
    ) as told:
        shapes.jelly(scene, mesh=Surface(ball.vertices, ball.triangles[1:]), spacing=0.3)
    assert told[0].filename == __file__
    assert scene.n_balls == whole.n_balls


@pytest.mark.long
def test_a_mesh_filled_with_tetrahedra(tmp_path, monkeypatch):
    pytest.importorskip("pytetwild")
    monkeypatch.chdir(tmp_path)
    ball, scene = icosphere(2), Scene(dim=3)
    made = shapes.jelly(scene, mesh=ball, fill="tetrahedra", spacing=0.4, density=10.0)
    assert scene.mass.sum() == pytest.approx(10 * volume(ball))
    assert (cell_volumes(scene.position, scene.solids) > 0).all()
    assert volume(Surface(scene.position, made.triangles)) == pytest.approx(volume(ball), rel=0.02)
    skin = scene.embedded_surfaces[0]
    assert np.einsum("sk,ski->si", skin.weights, scene.position[skin.corners]) == pytest.approx(ball.vertices, abs=1e-9)
    assert not list(tmp_path.iterdir())  # fTetWild writes a file where it runs


@pytest.mark.parametrize(
    ("ends", "says"),
    [("import os; os.abort()", "ended with status -6"), ("raise ValueError('no box')", "ValueError: no box")],
)
def test_a_filler_that_ends_its_process_is_a_mistake_of_the_mesh(monkeypatch, ends, says):
    monkeypatch.setattr(jelly_material.importlib.util, "find_spec", lambda name: True)
    monkeypatch.setattr(jelly_material, "FILL", ends)
    with pytest.raises(SceneError, match=rf"jelly\.mesh: cannot be filled with tetrahedra: .*{says}"):
        shapes.jelly(Scene(dim=3), mesh=icosphere(1), fill="tetrahedra")


def test_an_open_mesh_without_an_inside_is_not_blamed_on_the_spacing():
    corners = np.array([(0, 0, 0), (2, 0, 0), (2, 0, 2), (0, 0, 2), (0, 1, 0), (2, 1, 0)], dtype=float)
    two_sides = (corners, np.array([(0, 1, 2), (0, 2, 3), (0, 5, 1), (0, 4, 5)]))
    with pytest.raises(SceneError, match=r"jelly\.mesh: encloses nothing .*: 6 edges have a triangle on one side only"):
        shapes.jelly(Scene(dim=3), mesh=two_sides, spacing=0.3)
