"""Colliders on the host: shapes and motions against closed forms, bad input, and scene files."""

import inspect
import re

import numpy as np
import pytest
from physics_support import PRECISION, box_mesh

import taichi_sim as ts
from taichi_sim.geometry.mesh import Surface, holes, mesh_distance, volume
from taichi_sim.scene.motion import turn_matrix, turn_vector

pytestmark = pytest.mark.long_in("f64")

CUBE = box_mesh()


def collider(shape, dim=2):
    scene = ts.Scene(dim=dim)
    scene.add_material("rubber", friction=0.3)
    scene.add_collider(shape)
    return scene.colliders[0]


def box_distance(p, half):
    q = np.abs(p) - half
    return np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)


def test_distances_of_turned_and_hollow_shapes():
    x = np.array([[3.0, 0.0], [0.0, 0.0], [1.0, 1.0]])
    assert collider(ts.Sphere((0, 0), 2.0)).distance(x, 0.0) == pytest.approx([1.0, -2.0, np.sqrt(2) - 2.0])
    assert collider(ts.Sphere((0, 0), 2.0, hollow=0.5)).distance(x, 0.0) == pytest.approx([0.5, 2.0, 2.0 - np.sqrt(2)])
    assert collider(ts.Box((1, 0), (2, 4), rotation=90)).distance(x, 0.0) == pytest.approx([0.0, -1.0, 0.0])
    assert collider(ts.Box((0, 0), (8, 4), hollow=0.5)).distance(x, 0.0) == pytest.approx([1.0, 2.0, 1.0])
    assert collider(ts.Capsule((-1, 0), (1, 0), 0.5)).distance(x, 0.0) == pytest.approx([1.5, -0.5, 0.5])
    capsule = collider(ts.Capsule((0, 0, 0), (0, 2, 0), 0.5), 3)
    assert capsule.distance(np.array([[0.0, 3.0, 0.0], [1.0, 1.0, 0.0]]), 0.0) == pytest.approx([0.5, 0.5])


def test_distance_of_a_mesh():
    surface = Surface(CUBE[0], CUBE[1])
    assert len(holes(surface.triangles)) == 0
    assert volume(surface) == pytest.approx(1.0)
    assert volume(Surface(surface.vertices, surface.triangles[:, ::-1])) == -volume(surface)
    assert len(holes(surface.triangles[1:])) == 3
    assert len(holes(np.concatenate([surface.triangles[1:], surface.triangles[:1, ::-1]]))) == 3  # one faces inward
    p = np.random.default_rng(0).uniform(-1.5, 1.5, (300, 3))
    assert mesh_distance(surface, p) == pytest.approx(box_distance(p, 0.5), abs=1e-12)
    turned = ts.Mesh((CUBE[0], CUBE[1][:, ::-1]), position=(1, 2, 3), scale=2.0, rotation=(0, 0, 45))
    assert collider(turned, 3).distance(np.array([[1.0, 2.0, 3.0], [1.0, 5.0, 3.0]]), 0.0) == pytest.approx(
        [-1.0, 3 - np.sqrt(2)]
    )


def test_the_grid_of_a_mesh_holds_the_exact_distances():
    from taichi_sim.contacts.distance_grid import distance_grid
    from taichi_sim.device import backend

    backend.start(arch="cpu", precision=PRECISION)
    mesh = collider(ts.Mesh(CUBE, resolution=12), 3)
    grid = distance_grid(mesh, 0.3, 0.1)
    k, j, i = np.meshgrid(*(np.arange(n) for n in grid.value.shape), indexing="ij")
    p = grid.low + grid.cell * np.stack([i, j, k], -1).reshape(-1, 3)
    assert grid.value.ravel() == pytest.approx(box_distance(p, 0.5), abs=1e-12)
    assert p.min() < -0.75


def by_tree(tree, p):
    """Signed distances (n) of places p (n, 3) from a mesh, and directions (n, 3) from it, by the tables of its tree."""
    from taichi_sim.kernels.contacts.triangle_tree import signed_distance

    from taichi_sim.device.engine import ti

    real = np.float32 if PRECISION == "f32" else np.float64

    @ti.kernel
    def measure(
        box: ti.types.ndarray(),
        link: ti.types.ndarray(ti.i32, 1),
        triangle: ti.types.ndarray(),
        p: ti.types.ndarray(),
        d: ti.types.ndarray(),
        n: ti.types.ndarray(),
    ):
        for i in range(p.shape[0]):
            at = ti.Vector([p[i, 0], p[i, 1], p[i, 2]])
            d[i], way, _ = signed_distance(box, link, triangle, 0, link[0], 0, at)
            for a in ti.static(range(3)):
                n[i, a] = way[a]

    tables = [np.ascontiguousarray(a.ravel(), t) for a, t in zip(tree[:3], (real, np.int32, real))]
    d, n = np.zeros(len(p), dtype=real), np.zeros((len(p), 3), dtype=real)
    measure(*tables, np.ascontiguousarray(p, dtype=real), d, n)
    return d, n


def test_a_tree_tells_the_distance_and_the_side_of_a_mesh():
    """A spiky cup whose wall is thin, and apart from it a cube with a cubic hole, of which the surface of either part is given
    the wrong way around or not: solid where its windings say so, as the plain distance has it. So do the lists of cells, which
    hold all triangles that count in them: those of whole cells, and of eighths."""
    from taichi_sim.kernels.contacts.colliders import CUT
    from taichi_sim.kernels.contacts.triangle_tree import distance_by_list

    from taichi_sim.contacts.distance_grid import distance_grid
    from taichi_sim.device import backend
    from taichi_sim.device.engine import ti

    backend.start(arch="cpu", precision=PRECISION)
    real = np.float32 if PRECISION == "f32" else np.float64

    @ti.kernel
    def measure_in_cells(
        triangle: ti.types.ndarray(),
        listed: ti.template(),
        row: ti.types.ndarray(ti.i32, 2),
        out: ti.types.ndarray(),
        p: ti.types.ndarray(),
        d: ti.types.ndarray(),
    ):
        for i in range(p.shape[0]):
            at = ti.Vector([p[i, 0], p[i, 1], p[i, 2]])
            d[i], _ = distance_by_list(triangle, listed, row[i, 0], row[i, 0] + row[i, 1], at, out[i])

    angle = np.arange(14) * 2 * np.pi / 14
    out = [0.01, 0.01, 0.4, 0.41, 0.44, 0.43], [0.0, 0.02, 0.02, 0.5, 0.5, 0.0]
    spiky = 1.0 + 0.5 * (np.arange(14) % 2)
    around = np.stack([spiky * np.cos(angle), 0 * angle, spiky * np.sin(angle)], axis=-1)
    cup = np.concatenate([r * around + [0, y, 0] for r, y in zip(*out)])
    k, j = np.arange(14), np.roll(np.arange(14), -1)
    walls = [np.stack([a + k, b + k, a + j, b + k, b + j, a + j], 1).reshape(-1, 3) for a, b in
             ((14 * m, 14 * ((m + 1) % 6)) for m in range(6))]  # fmt: skip
    rng, cube = np.random.default_rng(3), CUBE[0] + [2.0, 0.3, 0.0]
    hole = 0.5 * CUBE[0] + [2.0, 0.3, 0.0]
    vertices = np.concatenate([cup, cube, hole])
    for turned in (slice(None), slice(None, None, -1)):
        parts = [*walls, CUBE[1][:, turned] + 84, CUBE[1][:, ::-1][:, turned] + 92]
        mesh = collider(ts.Mesh((vertices, np.concatenate(parts)), resolution=32), 3)
        grid = distance_grid(mesh, 0.1, 0.1)
        p = rng.uniform([-0.8, -0.2, -0.8], [2.7, 0.9, 0.8], (1500, 3))
        d, _ = by_tree(grid.tree, p)
        expected = mesh.distance(p, 0.0)
        assert np.sum(expected < 0) > 100
        assert d == pytest.approx(expected, abs=1e-12 if PRECISION == "f64" else 1e-6)
        at = (p - grid.low) / grid.cell
        i, j, k = np.floor(at).astype(int).T
        number = grid.exact[k, j, i]
        listed = np.flatnonzero(number >= 0)
        row = grid.cells[number[listed]]
        upper = (at[listed] % 1.0 >= 0.5).astype(int)
        eighth = row[:, 0] + upper @ [1, 2, 4]
        cut = row[:, 1] == CUT
        row[cut] = grid.cells[eighth[cut]]
        assert np.sum(cut) > 50
        assert np.sum(~cut) > 50
        centre = np.where(cut[:, None], 0.25 + 0.5 * upper, 0.5)
        out = grid.cell * np.linalg.norm(at[listed] % 1.0 - centre, axis=1)
        out, listed, row = out[row[:, 1] > 0], listed[row[:, 1] > 0], row[row[:, 1] > 0].astype(np.int32)
        assert len(listed) > 200
        few = np.zeros(len(listed), dtype=real)
        columns = {"triangle": ti.i32, "away": ti.f32 if PRECISION == "f32" else ti.f64}
        lists = ti.Struct.field(columns, shape=len(grid.away))
        lists.from_numpy({"triangle": grid.listed, "away": grid.away.astype(real)})
        measure_in_cells(
            np.ascontiguousarray(grid.tree[2].ravel(), real),
            lists,
            row,
            out.astype(real),
            np.ascontiguousarray(p[listed], dtype=real),
            few,
        )
        assert few == pytest.approx(expected[listed], abs=1e-12 if PRECISION == "f64" else 1e-6)


def test_directions_close_to_a_large_triangle_are_its_normal():
    """To the rounding of a unit vector; the way to a place so close, by which they were taken, is rounded as its coordinates."""
    from taichi_sim.contacts.distance_grid import distance_grid
    from taichi_sim.device import backend

    backend.start(arch="cpu", precision=PRECISION)
    real = np.float32 if PRECISION == "f32" else np.float64

    turn, rng = turn_matrix(np.array([[0.4, -0.3, 0.7]]))[0], np.random.default_rng(5)
    mesh = collider(ts.Mesh((24.0 * CUBE[0] @ turn.T, CUBE[1]), resolution=8), 3)
    p = rng.uniform(-11.0, 11.0, (60, 3))
    d = rng.choice([-0.03, 0.02, 0.3], 60)
    p[:, 1] = 12.0 + d
    distance, direction = by_tree(distance_grid(mesh, 0.1, 0.1).tree, p @ turn.T)
    eps = np.finfo(real).eps
    assert np.abs(direction - turn[:, 1]).max() < 2 * eps
    assert np.abs(distance - d).max() < 2 * 24.0 * eps


def test_turns_of_any_size():
    rng = np.random.default_rng(0)
    turn = rng.normal(size=(50, 3))
    turn *= (np.linspace(0.0, 3.1, 50) / np.linalg.norm(turn, axis=1))[:, None]
    matrix = turn_matrix(turn)
    assert matrix @ matrix.swapaxes(1, 2) == pytest.approx(np.broadcast_to(np.eye(3), matrix.shape))
    assert turn_vector(matrix) == pytest.approx(turn)
    half = turn_vector(turn_matrix(np.array([[0.0, np.pi, 0.0]])))[0]
    assert np.abs(half) == pytest.approx([0, np.pi, 0], abs=1e-7)


def test_constant_motion_about_a_pivot():
    motion = collider(ts.Box((1, 0), (1, 1), velocity=(0, 1), rotation_rate=180.0, pivot=(0, 0))).motion
    x, turn = motion.at([0.0, 0.5, 1.0])
    assert x == pytest.approx(np.array([[1, 0], [0, 1.5], [-1, 1]]))
    assert turn[1] == pytest.approx(np.array([[0, -1], [1, 0]]))
    assert motion.fastest(0.5) == pytest.approx((1 + 1.5 * np.pi, 0))


def test_a_path_holds_still_before_and_after_and_may_repeat():
    keys = [(1.0, (0, 0)), {"time": 2.0, "position": (2, 0), "rotation": 360}, (4.0, (0, 0), 0)]
    motion = collider(ts.Box((0, 0), (1, 1), path=keys)).motion
    x, turn = motion.at([0.0, 1.25, 2.0, 3.0, 9.0])
    assert x[:, 0] == pytest.approx([0, 0.5, 2, 1, 0])
    assert turn[1] == pytest.approx(np.array([[0, -1], [1, 0]]), abs=1e-12)  # a quarter of a full turn
    again = collider(ts.Box((0, 0), (1, 1), path=keys, repeat=True)).motion
    assert again.at([4.25, 7.25])[0][:, 0] == pytest.approx([0.5, 0.5])
    _, _, v, w = motion.steps(1.9, 0.1, 0, 2)
    assert v[:, 0] == pytest.approx([2, -1, -1])
    assert w[:, 0] == pytest.approx([2 * np.pi, -np.pi, -np.pi])
    assert collider(ts.Sphere((0, 0), 1.0)).motion.moves is False
    one, other = motion.steps(0.0, 1e-3, 0, 5), motion.steps(2e-3, 1e-3, 0, 3)
    assert all(np.array_equal(a[2:], b) for a, b in zip(one, other))  # the same bits wherever a run is divided


FLAT = {"center": (0, 0), "size": (1, 1)}
BAD = [
    (ts.Sphere((0, 0), 0.0), "colliders[0].radius: 0.0 is not allowed; it must be greater than 0"),
    (ts.Sphere((0, 0), 1.0, hollow=-1.0), "colliders[0].hollow: -1.0 is not allowed; it must be at least 0"),
    (ts.Sphere((0, 0, 0), 1.0), "colliders[0].center: shape (3,) does not fit"),
    (ts.Box((0, 0), (1, 0)), "colliders[0].size[1]: 0.0 is not allowed; it must be greater than 0"),
    (ts.Capsule((1, 0), (1, 0), 0.1), "colliders[0].end: [1.0, 0.0] is not allowed; it must be another point than start"),
    (ts.Box(**FLAT, material="ice"), "colliders[0].material: 'ice' is not a material of this scene"),
    (ts.Box(**FLAT, rotation=((1, 1), (0, 1))), "colliders[0].rotation: [[1.0, 1.0], [0.0, 1.0]] is no rotation"),
    (ts.Box(**FLAT, rotation=((1, 0), (0, -1))), "is no rotation"),
    (ts.Box(**FLAT, rotation="x"), "colliders[0].rotation: 'x' is not a number"),
    (ts.Box(**FLAT, velocity=(1,)), "colliders[0].velocity: shape (1,) does not fit"),
    (ts.Box(**FLAT, repeat=True), "colliders[0].repeat: there is no path to repeat"),
    (ts.Box(**FLAT, path=[(0, (0, 0))]), "colliders[0].path: has one keyframe"),
    (ts.Box(**FLAT, path=[(0, (0, 0)), (0, (1, 0))]), "path[1].time: 0.0 is not allowed; it must be later than 0 s"),
    (ts.Box(**FLAT, path=[(0, (0, 0)), (1, (1, 0))], repeat=True), "path[1]: a path that repeats must end where it begins"),
    (ts.Box(**FLAT, path=[(0, (0, 0)), (1, (1, 0))], velocity=(1, 0)), "velocity: is given together with a path"),
    (ts.Box(**FLAT, path=[(0, (0, 0)), {"tim": 1}]), "colliders[0].path[1].tim: is not a known key"),
    (ts.Box(**FLAT, path=[(0, (0, 0)), 7]), "colliders[0].path[1]: 7 is not a keyframe"),
    (ts.Mesh(CUBE), "colliders[0]: a mesh needs a scene in 3D"),
    ("box", "colliders[0]: 'box' is not allowed; it must be one of ts.Sphere, ts.Box, ts.Capsule, ts.Mesh"),
]  # fmt: skip
BAD_3D = [
    (ts.Mesh((CUBE[0], CUBE[1][1:])), "colliders[0].mesh: the mesh is not closed: 3 edges"),
    (ts.Mesh((CUBE[0] * [1, 1, 0], CUBE[1])), "colliders[0].mesh: the mesh is flat: it encloses 0 m^3"),
    (ts.Mesh((CUBE[0], CUBE[1] + 1)), "colliders[0].mesh.triangles"),
    (ts.Mesh("none.obj"), "is not there"),
    (ts.Mesh(CUBE, scale=0.0), "colliders[0].scale: 0.0 is not allowed"),
    (ts.Mesh(CUBE, resolution=1), "colliders[0].resolution: 1 is not allowed; it must be a whole number from 4 to 512"),
    (ts.Box((0, 0, 0), (1, 1, 1), rotation=30), "colliders[0].rotation: shape () does not fit"),
]


@pytest.mark.parametrize(("dim", "shape", "message"), [(2, *b) for b in BAD] + [(3, *b) for b in BAD_3D])
def test_bad(dim, shape, message):
    scene = ts.Scene(dim=dim)
    with pytest.raises(ts.SceneError) as caught:
        scene.add_collider(shape)
    assert message in str(caught.value)
    assert not scene.colliders


def test_a_collider_around_balls_and_one_that_jumps_are_named():
    scene = ts.Scene(dim=2)
    scene.add_collider(ts.Box((5, 0), (1, 1)))
    scene.add_collider(ts.Sphere((0, 0), 1.0))
    scene.add_balls([[0.0, 0.0], [0.2, 0.0], [1.05, 0.0]], radius=0.1, pinned=[1])
    with pytest.raises(ts.SceneError, match=r"^colliders\[1\]: the sphere starts around ball 0, up to 1\.1 m deep"):
        ts.Simulation(scene, dt=1e-3)
    scene = ts.Scene(dim=2)
    scene.add_collider(ts.Box((0, 0), (1, 1), path=[(0, (0, 0)), (1, (1, 0)), (1.001, (2, 0))]))
    scene.add_balls([[5.0, 0.0]], radius=0.05)
    with pytest.warns(UserWarning, match=r"colliders\[0\] \(box\), path\[1\]: moves at up to 1000 m/s, 20 radii"):
        ts.Simulation(scene, dt=1e-3).close()


FILE = """format = 1
dim = 2
[[materials]]
name = "rubber"
[[balls]]
position = [[0.0, 3.0]]
radius = 0.1
[[colliders]]
shape = "sphere"
center = [0.0, 0.0]
radius = 1.0
hollow = 0.1
material = "rubber"
rotation_rate = 90.0
[[colliders]]
shape = "box"
center = [3.0, 0.0]
size = [1.0, 0.3]
rotation = 30.0
colour = [0.1, 0.2, 0.3]
path = [{time = 0.0, position = [0.0, 0.0], rotation = 0.0}, {time = 0.7, position = [0.1, 0.3], rotation = 400.0}]
"""


def test_scene_files_hold_colliders(tmp_path):
    (tmp_path / "a.toml").write_text(FILE)
    scene = ts.load_scene(tmp_path / "a.toml")
    assert [c.name for c in scene.colliders] == ["sphere", "box"]
    assert scene.colliders[0].material == 1


BAD_FILES = [
    ("radius = 1.0", "", 8, "colliders[0].radius: is missing; a sphere needs it"),
    ("radius = 1.0", "radius = 0.0", 11, "colliders[0].radius: 0.0 is not allowed; it must be greater than 0"),
    ("radius = 1.0", "radios = 1.0", 11, "colliders[0].radios: is not a known key; did you mean 'radius'?"),
    ("hollow = 0.1", "size = [1.0, 1.0]", 12, "colliders[0].size: is not a key of a sphere; "),
    ('"sphere"', '"ball"', 9, "colliders[0].shape: 'ball' is not allowed; it must be 'sphere', 'box', 'capsule' or 'mesh'"),
    ('material = "rubber"', 'material = "ice"', 13, "colliders[0].material: 'ice' is not a material"),
    ("time = 0.7", "time = 0.0", 21, "colliders[1].path[1].time: 0.0 is not allowed; it must be later than 0 s"),
    ("rotation = 30.0", "rotation = [30.0, 1.0]", 19, "colliders[1].rotation: "),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "line", "message"), BAD_FILES, ids=[b[1] or b[0] for b in BAD_FILES])
def test_bad_scene_files(tmp_path, old, new, line, message):
    assert old in FILE
    (tmp_path / "a.toml").write_text(FILE.replace(old, new, 1))
    with pytest.raises(ts.SceneError) as caught:
        ts.load_scene(tmp_path / "a.toml")
    assert str(caught.value).startswith(f"{tmp_path / 'a.toml'}, line {line}: {message}"), str(caught.value)


@pytest.mark.parametrize("shape", [ts.Box, ts.Sphere, ts.Capsule, ts.Mesh])
def test_help_of_a_shape_explains_all_arguments(shape):
    for name in inspect.signature(shape).parameters:
        assert re.search(rf"\b{name}\b[^:]*: ", shape.__doc__), name
