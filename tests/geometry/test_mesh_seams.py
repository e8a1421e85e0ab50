"""Meshes in pieces, polygons that are not convex, and which way is up."""

import warnings

import numpy as np
import pytest

import taichi_sim as ts
from taichi_sim.geometry.mesh import Surface, flaws, loose_seams, read_surface, surface_area
from taichi_sim.geometry.polygons import triangulated

pytestmark = pytest.mark.once


def sheet(n, m, low, high):
    """A flat sheet in x and z of n x m vertices, from `low` to `high` along x, 0.6 m wide."""
    x, z = np.meshgrid(np.linspace(low, high, n), np.linspace(0.0, 0.6, m), indexing="ij")
    index = np.arange(n * m).reshape(n, m)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[:-1, 1:], index[1:, 1:]))
    triangles = np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])
    return np.stack([x, 0 * x, z], axis=-1).reshape(-1, 3), triangles


def side_by_side(gap, more=0):
    """Two sheets with a gap [m] between them, the second one finer along the seam."""
    (x, t), (y, s) = sheet(4, 7, 0.0, 0.3), sheet(4, 7 + more, 0.3 + gap, 0.6)
    return np.concatenate([x, y]), np.concatenate([t, s + len(x)])


def written(folder, vertices, triangles, name="x.obj"):
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in vertices]
    (folder / name).write_text("\n".join([*lines, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles)]))
    return folder / name


def pieces(triangles, n):
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    sides = np.concatenate([triangles[:, :2], triangles[:, 1:]])
    return connected_components(coo_matrix((np.ones(len(sides)), sides.T), (n, n)))[0]


@pytest.mark.parametrize("gap", [0.0, 3e-7, 4e-5, 9e-4])
def test_a_seam_in_a_file_is_closed(tmp_path, gap):
    vertices, triangles = side_by_side(gap)
    found = read_surface(written(tmp_path, vertices, triangles))
    assert len(found.vertices) == len(vertices) - 7
    assert pieces(found.triangles, len(found.vertices)) == 1
    assert not len(loose_seams(found))
    assert surface_area(found) == pytest.approx(0.36, rel=3e-3)


def test_what_a_seam_is_not(tmp_path):
    """A slit that is wider, small triangles beside large ones, and closed meshes stay as they are."""
    for gap in (0.02, 0.0012):  # a fifth and 1.2 % of the shortest edge
        vertices, triangles = side_by_side(gap)
        assert len(read_surface(written(tmp_path, vertices, triangles)).vertices) == len(vertices)
        assert bool(len(loose_seams(Surface(vertices, triangles)))) == (gap < 0.01)
    thin = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1e-5, 0, 0]])  # a closed one with a short edge
    faces = [(0, 2, 4), (4, 2, 1), (0, 4, 3), (4, 1, 3), (1, 2, 3), (0, 3, 2)]
    assert len(read_surface(written(tmp_path, thin, np.array(faces))).vertices) == 5


def test_fine_parts_beside_coarse_ones_stay(tmp_path):
    """A fan whose outer edges shrink by half each: the shortest is a millionth of the longest."""
    angle = 2.0 ** -np.arange(21)
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    vertices = np.concatenate([[[0.0, 0.0, 0.0]], rim])
    fan = np.array([(0, k + 1, k) for k in range(1, 21)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = read_surface(written(tmp_path, vertices, fan))
    assert (len(found.vertices), len(found.triangles)) == (22, 20)
    assert not len(loose_seams(found))


@pytest.mark.parametrize(
    ("mesh", "where"),
    [
        (side_by_side(0.0), 14),  # a seam in arrays, whose vertices stay the user's
        (side_by_side(0.0, more=3), 17),
        (side_by_side(0.004), 14),
        ((sheet(3, 3, 0, 1)[0][sheet(3, 3, 0, 1)[1]].reshape(-1, 3), np.arange(24).reshape(8, 3)), 22),  # triangle by triangle
    ],
    ids=["twins", "T", "gap", "soup"],
)  # fmt: skip
def test_cloth_that_comes_apart_says_so(mesh, where):
    scene = ts.Scene(dim=3)
    with pytest.warns(
        UserWarning, match=r"cloth.mesh: .*vertices touch triangles that do not share them.*apart"
    ) as said:
        shape = ts.shapes.cloth(scene, mesh=mesh)
    assert len(shape.balls) == len(mesh[0])
    assert f"{where} vertices" in str(said[0].message)


def test_a_finer_seam_in_a_file_is_closed_where_it_can_be(tmp_path):
    found = read_surface(written(tmp_path, *side_by_side(1e-6, more=6)))  # every other vertex has a twin
    assert pieces(found.triangles, len(found.vertices)) == 1
    assert "6 vertices touch" in flaws(found, closed=False)[-1]


def test_a_whole_sheet_has_nothing_to_say():
    scene = ts.Scene(dim=3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ts.shapes.cloth(scene, mesh=sheet(5, 4, 0.0, 0.6))


# Polygons --------------------------------------------------------------------------------------------------------------


def area(p, t):
    a, b, c = (p[t[:, k]] for k in range(3))
    return 0.5 * np.cross(b - a, c - a)


def spiral(turns=2.0, n=60):
    """A band that winds inward: no corner sees the others."""
    angle = np.linspace(0.0, turns * 2 * np.pi, n)
    out, inner = 1.0 + 0.5 * angle, 0.8 + 0.5 * angle
    band = [np.stack([r * np.cos(angle), r * np.sin(angle)], axis=1) for r in (out, inner)]
    return np.concatenate([band[0], band[1][::-1]])


@pytest.mark.parametrize("turned", range(0, 120, 17))
def test_a_spiral_is_filled_once(turned):
    flat = np.roll(spiral(), turned, axis=0)
    tilt = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0]])  # an orthonormal pair
    p = flat @ tilt + [5.0, -3.0, 2.0]
    n = len(p)
    cut, crossing = triangulated(p, np.arange(n), np.array([n]))
    assert cut.shape == (n - 2, 3)
    assert not len(crossing)
    up = np.cross(*tilt)
    expected = 0.5 * np.sum(flat[:, 0] * np.roll(flat[:, 1], -1) - flat[:, 1] * np.roll(flat[:, 0], -1))
    each = area(p, cut) @ up
    assert (each > 0).all()
    assert each.sum() == pytest.approx(expected)
    assert np.linalg.norm(area(p, cut), axis=1).sum() == pytest.approx(expected)


def test_random_star_shapes_and_straight_corners():
    random = np.random.default_rng(5)
    for n in (4, 5, 6, 9, 20):
        for _ in range(10):
            angle = np.sort(random.uniform(0.0, 2 * np.pi, n))
            if np.diff([*angle, angle[0] + 2 * np.pi]).max() > 3.0:
                continue
            p = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1) * random.uniform(0.1, 1.0, (n, 1))
            p = np.stack([p, 0.5 * (p + np.roll(p, -1, axis=0))], axis=1).reshape(-1, 3)  # a corner on each side
            cut, crossing = triangulated(p, np.arange(2 * n), np.array([2 * n]))
            assert len(cut) == 2 * n - 2
            assert not len(crossing)
            assert (area(p, cut)[:, 2] > 0).all()


def test_a_polygon_that_crosses_itself_is_told(tmp_path):
    text = "v 0 0 0\nv 2 2 0\nv 2 0 0\nv 0 1 0\nv 5 0 0\nf 3 5 2\nf 1 2 3 4\n"
    (tmp_path / "x.obj").write_text(text)
    with pytest.warns(
        UserWarning, match=r"x.obj' has 1 polygons that cross themselves, the first at \[0.0, 0.0, 0.0\]"
    ):
        assert len(read_surface(tmp_path / "x.obj").triangles) == 3


# Up --------------------------------------------------------------------------------------------------------------------

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
STOOD = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, -2], [0, 3, 0]])  # z goes up, y away from who looks


def stl(folder):
    rows = ["vertex {} {} {}".format(*CORNERS[k]) for face in FACES for k in face]
    text = "".join("facet\n" + "\n".join(rows[k : k + 3]) + "\nendfacet\n" for k in range(0, 12, 3))
    (folder / "x.stl").write_text(f"solid x\n{text}endsolid x\n")
    return str(folder / "x.stl")


def as_set(points):
    return {tuple(p) for p in np.round(points, 9).tolist()}


def test_up_in_python(tmp_path):
    for mesh in (stl(tmp_path), (CORNERS, FACES)):
        scene = ts.Scene(dim=3)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            ts.shapes.cloth(scene, mesh=mesh, up="z")
            scene.add_collider(ts.Mesh(mesh, up="z"))
            ts.shapes.jelly(scene, mesh=mesh, up="z", spacing=0.4)
        assert as_set(scene.position[:4]) == as_set(STOOD)
        assert as_set(scene.colliders[0].vertices) == as_set(STOOD)
        skin = scene.embedded_surfaces[0]
        shown = np.einsum("vk,vki->vi", skin.weights, scene.position[skin.corners])
        assert np.ptp(shown, axis=0) == pytest.approx([1, 3, 2])


def test_a_file_that_does_not_tell_is_pointed_at(tmp_path):
    file, scene = stl(tmp_path), ts.Scene(dim=3)
    for add, where in (
        (lambda **up: ts.shapes.cloth(scene, mesh=file, **up), "cloth"),
        (lambda **up: ts.shapes.jelly(scene, mesh=file, spacing=0.4, **up), "jelly"),
        (lambda **up: scene.add_collider(ts.Mesh(file, **up)), r"colliders\[0\]"),
    ):
        with pytest.warns(UserWarning, match=rf'{where}.mesh: .*x.stl\' is read with y up.*up = "z", or up = "y"'):
            add()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            add(up="y")
        with pytest.raises(ts.SceneError, match=r"up: 'x' is not allowed"):
            add(up="x")
    written(tmp_path, CORNERS, FACES)
    (tmp_path / "own.ply").write_bytes(b"ply\nformat ascii 1.0\ncomment up y\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 0 1\n3 0 2 1\n")  # fmt: skip  # noqa: E501
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ts.shapes.cloth(scene, mesh=tmp_path / "x.obj")
        ts.shapes.cloth(scene, mesh=tmp_path / "own.ply")
    for shape in (ts.shapes.cloth, ts.shapes.jelly):
        with pytest.raises(ts.SceneError, match=r"up: is for a mesh"):
            shape(scene, up="z")


def test_up_in_a_scene_file_and_back(tmp_path):
    stl(tmp_path)
    text = 'format = 1\ndim = 3\n[[cloth]]\nmesh = "x.stl"\nup = "z"\n[[colliders]]\nshape = "mesh"\nmesh = "x.stl"\nup = "z"\n'
    (tmp_path / "a.toml").write_bytes(b"\xef\xbb\xbf" + text.encode())
    scene = ts.load_scene(tmp_path / "a.toml")
    scene.save(tmp_path / "b.toml")
    for one in (scene, ts.load_scene(tmp_path / "b.toml")):
        assert as_set(one.position) == as_set(STOOD)
        assert as_set(one.colliders[0].vertices) == as_set(STOOD)
