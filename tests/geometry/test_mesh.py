"""Surface meshes: what is read, what is refused, and the edges and hinges."""

from pathlib import Path

import numpy as np
import pytest

from taichi_sim import SceneError
from taichi_sim.geometry.mesh import Surface, hinges, read_surface, surface_area, unique_edges

pytestmark = pytest.mark.once

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
STL_FACET = "facet normal 0 0 1\nouter loop\n{}endloop\nendfacet\n"
PLY_HEAD = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
"""


def write(folder: Path, name: str, text: str) -> Path:
    (folder / name).write_text(text)
    return folder / name


def square(folder: Path, kind: str) -> Path:
    """Two triangles of a unit square, in each format as that format has them."""
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    triangles = [(0, 1, 2), (0, 2, 3)]
    if kind == "obj":
        return write(folder, "square.obj", SQUARE + "f 1 2 3\nf 1 3 4\n")
    if kind == "ply":
        rows = [" ".join(map(str, c)) for c in corners] + [f"3 {a} {b} {c}" for a, b, c in triangles]
        return write(folder, "square.ply", PLY_HEAD + "\n".join(rows) + "\n")
    facets = [
        STL_FACET.format("".join("vertex {} {} {}\n".format(*corners[i]) for i in triangle)) for triangle in triangles
    ]
    return write(folder, "square.stl", "solid s\n" + "".join(facets) + "endsolid s\n")


def hinge_pairs(triangles):
    """The two vertices that face each other across each inner edge, each pair once, lower first, sorted."""
    return np.unique(np.sort(hinges(triangles)[1], axis=1), axis=0)


@pytest.mark.parametrize("kind", ["obj", "ply", "stl"])
def test_read(tmp_path, kind):
    surface = read_surface(square(tmp_path, kind))
    assert surface.vertices.shape == (4, 3)
    assert surface.triangles.shape == (2, 3)
    assert surface_area(surface) == pytest.approx(1.0)
    assert len(unique_edges(surface.triangles)) == 5
    assert len(hinge_pairs(surface.triangles)) == 1


def test_polygons_seams_and_loose_vertices(tmp_path):
    text = SQUARE + "v 9 9 9\nvt 0 0\nvt 1 1\nf 1/1 2/1 3/1 4/1\nv 0 0 0\nv 1 0 0\nv 0.5 -1 0\nf 6/2 8/2 7/2\n"
    surface = read_surface(write(tmp_path, "seam.obj", text))
    assert surface.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, -1, 0]]
    assert len(surface.triangles) == 3


def test_edges_and_hinges_of_a_tetrahedron():
    triangles = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    every_pair = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
    assert unique_edges(triangles).tolist() == every_pair
    assert hinge_pairs(triangles).tolist() == every_pair


def test_no_hinge_at_a_border_or_where_three_triangles_meet():
    assert len(hinge_pairs(np.array([[0, 1, 2]]))) == 0
    assert len(hinge_pairs(np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]))) == 0
    assert len(hinge_pairs(np.zeros((0, 3), dtype=int))) == len(unique_edges(np.zeros((0, 3), dtype=int))) == 0


BAD = [
    ("points.obj", SQUARE, "no faces"),
    ("empty.obj", "", "no faces"),
    ("empty.ply", "", "cannot be read as PLY"),
    ("empty.stl", "", "STL|no faces"),
    ("nan.obj", SQUARE.replace("v 1 1", "v nan 1") + "f 1 2 3\n", "vertex 2 .*finite"),
    ("inf.obj", SQUARE.replace("v 1 1", "v inf 1") + "f 1 2 3\n", "vertex 2 .*finite"),
    ("flat.obj", SQUARE + "f 1 1 2\n", "no face with an area"),
    ("beyond.obj", SQUARE + "f 1 2 9\n", "cannot be read as OBJ"),
    ("words.ply", "not a mesh", "cannot be read as PLY"),
    ("scene.fbx", "{}", "ends in .obj .ply .stl .glb .gltf"),
]


@pytest.mark.parametrize(("name", "text", "message"), BAD, ids=[name for name, _, _ in BAD])
def test_bad_files(tmp_path, name, text, message):
    with pytest.raises(SceneError, match=message) as caught:
        read_surface(write(tmp_path, name, text))
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_file(tmp_path):
    with pytest.raises(SceneError, match="is not there"):
        read_surface(tmp_path / "cow.obj")


def test_a_real_mesh():
    spot = Path(__file__).parents[3] / "shared" / "meshes" / "spot.obj"
    if not spot.is_file():
        pytest.skip("no meshes beside the project")
    surface = read_surface(spot)
    assert isinstance(surface, Surface)
    assert (len(surface.vertices), len(surface.triangles)) == (2930, 5856)
    edges = unique_edges(surface.triangles)
    assert len(surface.vertices) - len(edges) + len(surface.triangles) == 2  # closed, without a hole
