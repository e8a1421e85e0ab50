"""Shapes: what they add, that their defaults are stable at 1 ms, and what they refuse."""

import numpy as np
import pytest
from scene_files import assert_unchanged

import taichi_sim as ts
from taichi_sim import Scene, SceneError, shapes
from taichi_sim.analysis.diagnostics import energy
from taichi_sim.geometry.mesh import Surface

pytestmark = pytest.mark.once

TETRAHEDRON = Surface(
    np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], dtype=np.int32),
)

MADE = {
    "cloth": (3, lambda s: shapes.cloth(s)),
    "coarse cloth": (3, lambda s: shapes.cloth(s, (2, 1), (2, 2))),
    "long cloth": (3, lambda s: shapes.cloth(s, (2, 1), (8, 200))),
    "heavy cloth": (3, lambda s: shapes.cloth(s, mass=50.0)),
    "shell": (3, lambda s: shapes.cloth(s, mesh=TETRAHEDRON)),
    "jelly 3D": (3, lambda s: shapes.jelly(s)),
    "fine jelly 3D": (3, lambda s: shapes.jelly(s, (0.2, 1, 0.4), (20, 40, 30))),
    "jelly 2D": (2, lambda s: shapes.jelly(s)),
    "fine jelly 2D": (2, lambda s: shapes.jelly(s, resolution=(100, 90))),
    "rope 2D": (2, lambda s: shapes.rope(s, (0, 0), (1, 1))),
    "rope 3D": (3, lambda s: shapes.rope(s, (0, 0, 0), (1, 1, 0), 2)),
    "wheel 2D": (2, lambda s: shapes.wheel(s, (0, 0), 0.5)),
    "wheel 3D": (3, lambda s: shapes.wheel(s, (0, 0, 1), 0.5, 40)),
    "truss 2D": (2, lambda s: shapes.truss(s, (4, 1))),
    "truss 3D": (3, lambda s: shapes.truss(s, (4, 1, 0.5), 5)),
    "net": (3, lambda s: shapes.net(s)),
}


def stiffness_bound(scene: Scene, h: float) -> float:
    """h^2 max (S_i / m_i + S_j / m_j) over the springs; velocity Verlet is stable below 4."""
    rate = np.bincount(scene.pairs.ravel(), np.repeat(scene.stiffness, 2), minlength=scene.n_balls) / scene.mass
    return float(h**2 * rate[scene.pairs].sum(axis=1).max())


def area_vectors(x: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = (x[triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a) / 2


@pytest.mark.parametrize("name", MADE)
def test_defaults_are_stable_at_1_ms_with_a_factor_2(name):
    dim, make = MADE[name]
    scene = Scene(dim=dim)
    shape = make(scene)
    of_material = name.startswith("rope")
    assert of_material or stiffness_bound(scene, 1e-3) <= 2.0 * (1 + 1e-12)
    assert shape.balls.tolist() == list(range(scene.n_balls))
    assert shape.springs.tolist() == list(range(scene.n_springs))
    assert np.array_equal(shape.triangles, scene.triangles)
    assert not scene.pinned.any()
    assert len(np.unique(scene.body)) == 1
    assert scene.body[0] > 0
    assert len(np.unique(np.sort(scene.pairs, axis=1), axis=0)) == scene.n_springs
    if not of_material:
        damping_ratio = scene.damping / (2 * np.sqrt(scene.stiffness * scene.mass[0] / 2))
        assert damping_ratio == pytest.approx(0.1)


def test_grid_cloth():
    scene = Scene(dim=3)
    sheet = shapes.cloth(scene, (2, 1), (5, 3), mass=3.0, pinned=[0, 12], radius=0.01)
    assert scene.position[1 * 3 + 2].tolist() == [0.5, 0.0, 1.0]  # ball (1, 2)
    assert scene.mass.sum() == pytest.approx(3.0)
    assert np.flatnonzero(scene.pinned).tolist() == [0, 12]
    assert len(sheet.springs) == (4 * 3 + 5 * 2) + 4 * 2
    assert len(scene.bends) == 3 * 3 + 5 * 1
    vectors = area_vectors(scene.position, sheet.triangles)
    assert (vectors[:, 1] > 0).all()
    assert vectors.sum(axis=0) == pytest.approx([0, 2, 0])


def test_default_mass_follows_the_area():
    scene = Scene(dim=3)
    shapes.cloth(scene, (2, 3), (4, 4), scale=2.0)
    assert scene.mass.sum() == pytest.approx(0.2 * 24)


def test_mesh_cloth_keeps_coordinates_and_moves():
    scene = Scene(dim=3)
    shapes.cloth(scene, mesh=TETRAHEDRON)
    assert np.array_equal(scene.position, TETRAHEDRON.vertices)
    assert scene.n_springs == 6  # the edges; each pair that faces across one is an edge itself
    shapes.cloth(scene, mesh=TETRAHEDRON, position=(0, 0, 5), rotation=(0, 0, 90), scale=2)
    assert scene.position[5] == pytest.approx([0, 2, 5])  # (1, 0, 0)
    assert scene.position[6] == pytest.approx([-2, 0, 5])  # (0, 1, 0)


def test_a_mesh_of_springs_bends_across_its_edges():
    """By an element where it is flat, and by a spring that resists a change of the angle as much where it is folded."""
    faces, k, small = np.array([[0, 1, 2], [0, 2, 3]]), 3.0, 1e-3

    def hinge(angle):
        up, out = 0.5 * np.sin(angle), 0.5 * np.cos(angle)
        return np.array([[0.5, 0, 0.5], [0, 0, 0.5], [0.5, 0, 0], [0.5 + out, up, 0.2]])

    stored = []
    for angle, bends in ((0.0, 1), (0.9, 0)):
        scene = Scene(dim=3)
        shapes.cloth(scene, mesh=Surface(hinge(angle), faces), stiffness=1e6, bending_stiffness=k)
        assert (len(scene.bends), scene.n_springs) == (bends, 6 - bends)
        stored.append(energy(scene, hinge(angle + small), np.zeros((4, 3))).spring / small**2)
        apart = np.linalg.norm(hinge(angle)[3] - hinge(angle)[1])
        assert stored[-1] == pytest.approx(k * (apart / 2) ** 2 / 2, rel=1e-2)


@pytest.mark.parametrize("dim", [2, 3])
def test_what_is_made_of_springs_resists_the_smallest_bend(dim):
    """Three balls in a row, 0.2 m apart, turned by phi: k (0.2 phi)^2 / 2, which is not 0 to the second order."""
    for small in (1e-3, 2e-3):
        scene = Scene(dim=dim)
        shapes.rope(scene, [0.0] * dim, [0.6, *[0.0] * (dim - 1)], 4, bending_stiffness=7.0)
        if dim == 3:
            shapes.cloth(scene, (0.6, 0.2), (4, 2), bending_stiffness=7.0)
        x = scene.position.copy()
        beyond = np.maximum(x[:, 0] - 0.4, 0.0)
        x[:, 0] -= beyond * (1 - np.cos(small))
        x[:, 1] += beyond * np.sin(small)
        want = (1 if dim == 2 else 3) * 7.0 * (0.2 * small) ** 2 / 2
        assert energy(scene, x, 0 * x).spring == pytest.approx(want, rel=1e-3)


def test_rotation_is_about_x_then_y_then_z():
    scene = Scene(dim=3)
    shapes.cloth(scene, mesh=TETRAHEDRON, rotation=(90, 90, 0))
    assert scene.position[2] == pytest.approx([1, 0, 0])  # y -> z by x, z -> x by y
    flat = Scene(dim=2)
    shapes.jelly(flat, (1, 1), (2, 2), rotation=90, position=(1, 0))
    assert flat.position[2] == pytest.approx([1, 1])  # ball (1, 0) at (1, 0), turned to (0, 1)


def test_jelly_surface_is_closed_and_outward():
    scene = Scene(dim=3)
    cube = shapes.jelly(scene, (1, 2, 3), (3, 4, 5))
    vectors = area_vectors(scene.position, cube.triangles)
    centres = scene.position[cube.triangles].mean(axis=1)
    assert vectors.sum(axis=0) == pytest.approx([0, 0, 0], abs=1e-12)
    assert (vectors * centres).sum() / 3 == pytest.approx(6.0)  # the volume, by Gauss
    assert scene.mass.sum() == pytest.approx(6000.0)


@pytest.mark.parametrize("dim", [2, 3])
def test_jelly_is_elastic_alike_in_all_directions(dim):
    """Small stretches of a large lattice along an axis and along the diagonal store the same energy."""
    scene = Scene(dim=dim)
    shapes.jelly(scene, (1.0,) * dim, (9,) * dim, stiffness=1.0)
    x = scene.position
    inner = (np.abs(x[scene.pairs].mean(axis=1) - 0.5) < 0.126).all(axis=1)  # one period, its border counted below
    on_border = np.isclose(np.abs(x[scene.pairs].mean(axis=1) - 0.5), 0.125)
    weight = np.where(inner, 0.5 ** on_border.sum(axis=1), 0.0)
    axis, diagonal = np.eye(dim)[0], np.array([1.0, 1.0, 0.0])[:dim] / np.sqrt(2)
    stored = []
    for direction in (axis, diagonal):
        edge = x[scene.pairs[:, 1]] - x[scene.pairs[:, 0]]
        change = (edge @ direction) ** 2 / np.linalg.norm(edge, axis=1)  # per unit strain
        stored.append((weight * scene.stiffness * change**2).sum())
    assert stored[0] == pytest.approx(stored[1], rel=1e-9)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_pile_of_different_balls_has_one_density(dim):
    scene = Scene(dim=dim)
    kind = {"resolution": (20,) * 2 + (3,) * (dim - 2), "radius": 0.05, "mass": 0.2, "jitter": 0.1, "seed": 4}
    heap = shapes.pile(scene, smallest_radius=0.02, **kind)
    same = shapes.pile(scene, **kind)
    r, n = scene.radius[heap.balls], len(heap.balls)
    assert 0.02 <= r.min() < 0.0205 < 0.0495 < r.max() <= 0.05
    assert abs(r.mean() - 0.035) < 4 * 0.03 / np.sqrt(12 * n)
    assert scene.mass[heap.balls] == pytest.approx(0.2 * (r / 0.05) ** dim)
    assert np.array_equal(scene.position[heap.balls], scene.position[same.balls])
    assert np.all(scene.radius[same.balls] == 0.05)
    for wrong in (0.0, 0.06):
        with pytest.raises(SceneError, match=r"pile\.smallest_radius"):
            shapes.pile(scene, smallest_radius=wrong, **kind)


def test_rope_wheel_pile():
    scene = Scene(dim=2)
    rope = shapes.rope(scene, (0, 0), (4, 0), 5, bending_stiffness=7.0, pinned=[0])
    assert scene.position[rope.balls, 0].tolist() == [0, 1, 2, 3, 4]
    assert (scene.bend_stiffness == 7.0).sum() == 3
    assert scene.mass == pytest.approx(0.08)
    wheel = shapes.wheel(scene, (2, 3), 0.5, 6, pinned=[0])
    assert scene.position[wheel.balls[0]].tolist() == [2, 3]
    assert np.linalg.norm(scene.position[wheel.balls[1:]] - [2, 3], axis=1) == pytest.approx(0.5)
    assert len(wheel.springs) == 12
    pile = shapes.pile(scene, (3, 4), 0.1, mass=2.0)
    assert len(pile.balls) == 12
    assert not len(pile.springs)
    assert (scene.body[pile.balls] == 0).all()
    assert (scene.mass[pile.balls] == 2.0).all()
    x = scene.position[pile.balls]
    distance = np.linalg.norm(x[:, None] - x, axis=2) + np.eye(12)
    assert distance.min() > 0.2  # they do not touch at the start


def test_a_rope_of_a_material_is_the_same_at_every_resolution():
    """Stretched by a strain e it stores EA e^2 L / 2, bent to a radius r EI / (2 r^2) per length, and weighs the same."""
    length, radius, strain = 1.5, 40.0, 1e-4
    for n in (9, 40):
        scene = Scene(dim=2)
        made = {"mass_per_length": 0.2, "EA": 300.0, "EI": 0.7, "damping": 5.0}
        rope = shapes.rope(scene, (0, 0), (length, 0), n + 1, **made)
        x, still = scene.position, np.zeros((n + 1, 2))
        assert scene.mass.sum() == pytest.approx(0.2 * length)
        assert scene.mass[[0, 1]] == pytest.approx([0.1 * length / n, 0.2 * length / n])
        assert energy(scene, x * (1 + strain), still).spring == pytest.approx(150.0 * strain**2 * length, rel=1e-4)
        rolled = np.stack([radius * np.sin(x[:, 0] / radius), radius * (1 - np.cos(x[:, 0] / radius))], axis=1)
        bent = energy(scene, rolled, still).spring
        assert bent == pytest.approx(0.35 / radius**2 * length * (1 - 1 / n), rel=1e-3)  # its ends have no hinge
        assert scene.damping[rope.springs] * length / n == pytest.approx(5.0)


def test_a_rope_of_a_modulus_and_the_default_one():
    scene = Scene(dim=3)
    shapes.rope(scene, (0, 0, 0), (2, 0, 0), 5, young_modulus=1e6, radius=0.01)
    assert scene.stiffness * 0.5 == pytest.approx(1e6 * np.pi * 1e-4)
    assert scene.bend_stiffness * 0.5**3 == pytest.approx(1e6 * np.pi * 1e-8 / 4)
    for n in (5, 50):
        usual = Scene(dim=2)
        shapes.rope(usual, (0, 0), (2, 0), n, mass=0.3)
        assert usual.stiffness * 2 / (n - 1) == pytest.approx(1000 * 0.3 * 10)
        slowest = np.pi / 2 * np.sqrt(3000.0 / 0.15) / 2  # 1/s, of a rod held at one end
        assert usual.damping * 2 / (n - 1) * slowest / (2 * 3000.0) == pytest.approx(0.01)
        assert not len(usual.bends)


HANGING = {
    "level": ((0, 0), (1, 0), 1.3, 33, (0, -9.81)),
    "to a lower end": ((-1, 2), (0.5, 0.2), 2.9, 20, (0, -1.62)),
    "along x": ((0.3, 0), (0.1, 1.4), 2.0, 41, (3.0, 0)),
    "nearly taut": ((0, 0), (2, 1), np.hypot(2, 1) * (1 + 1e-6), 50, (0, -9.81)),
    "two pieces": ((0, 0), (1, 0.2), 1.5, 3, (0, -9.81)),
    "in space": ((1, 2, 3), (2, 2.5, 2), 3.0, 64, (0.1, -9.0, 2.0)),
    "without gravity": ((0, 0, 0), (0, 0, 1), 1.2, 30, (0, 0, 0)),
}


@pytest.mark.parametrize("name", HANGING)
def test_a_rope_longer_than_the_distance_hangs_at_rest(name):
    """The forces along its pieces that carry the weight of its balls: those at each ball add up to its weight."""
    start, end, length, n, gravity = HANGING[name]
    scene = Scene(dim=len(start), gravity=gravity)
    shapes.rope(scene, start, end, n, length=length, mass=2.0)
    x, down = scene.position, np.array(gravity) if any(gravity) else np.array([0.0, -1.0, 0.0])
    assert np.allclose(x[[0, -1]], [start, end], rtol=0, atol=1e-15)
    assert scene.rest_length == pytest.approx(length / (n - 1), rel=1e-12)
    assert scene.mass.sum() == pytest.approx(2.0)
    piece = np.diff(x, axis=0) / scene.rest_length[:, None]
    down = down / np.linalg.norm(down)
    sideways = piece - np.outer(piece @ down, down)
    slope = piece @ down / np.linalg.norm(sideways, axis=1)  # of the pull, whose part sideways is the same throughout
    assert np.ptp(np.diff(slope)) < 1e-9 * np.abs(np.diff(slope)).max() + 1e-11
    assert np.diff(slope).max() < 0
    assert np.abs(sideways @ sideways[0] / np.linalg.norm(sideways, axis=1) - np.linalg.norm(sideways[0])).max() < 1e-9


def test_a_hanging_rope_is_the_catenary_of_its_length():
    """y = c cosh(x / c) with 2 c sinh(D / 2 c) = L: c = 0.8, D = 1.2; the difference falls as the square of the spacing."""
    c, apart = 0.8, 1.2
    length, sag = 2 * c * np.sinh(apart / 2 / c), c * (np.cosh(apart / 2 / c) - 1)
    off = []
    for n in (17, 33, 65):
        scene = Scene(dim=2, gravity=(0, -9.81))
        shapes.rope(scene, (0, 0), (apart, 0), n, length=length)
        x, y = (scene.position - [apart / 2, 0]).T
        off.append(np.abs(y + sag + c - c * np.cosh(x / c)).max())
    assert off[2] < 2e-4 * sag
    assert off[0] / off[1] == pytest.approx(4, rel=0.05)
    assert off[1] / off[2] == pytest.approx(4, rel=0.05)


def test_a_rope_shorter_than_the_distance_is_tight():
    scene = Scene(dim=2, gravity=(0, -9.81))
    rope = shapes.rope(scene, (0, 0), (3, 4), 11, length=4.0, EA=200.0, mass_per_length=0.3)
    assert scene.position[rope.balls] == pytest.approx(np.linspace(0, 1, 11)[:, None] * [3, 4])
    assert scene.rest_length == pytest.approx(0.4)
    assert scene.stiffness * (0.5 - 0.4) == pytest.approx(200.0 * 0.25)
    assert scene.mass.sum() == pytest.approx(1.2)


def test_truss():
    for dim, bars in ((2, 4 * 2 + 5 + 4 * 2), (3, 16 + 20 + 4 * 8 + 5 * 2)):
        scene = Scene(dim=dim)
        beam = shapes.truss(scene, (4, 1, 2)[:dim], 4, mass=3.0, pinned=range(2 ** (dim - 1)))
        assert len(beam.springs) == bars
        assert (scene.position[scene.pinned, 0] == 0).all()
        assert scene.position.max(axis=0).tolist() == [4, 1, 2][:dim]
        assert scene.mass.sum() == pytest.approx(3.0)
        assert set(np.round(scene.rest_length**2, 9)) == (
            {1, 2} if dim == 2 else {1, 2, 4, 5}
        )  # no diagonal through a cell


def test_net():
    scene = Scene(dim=3)
    made = shapes.net(scene, (2, 1), (4, 2), 3, mass=2.0, pinned=[0, 14])
    knots, between = 5 * 3, 2 * (4 * 3 + 5 * 2)
    assert len(made.balls) == knots + between
    assert len(made.springs) == 3 * (4 * 3 + 5 * 2)
    assert scene.position[[0, 1, 3, 14]].tolist() == [[0, 0, 0], [0, 0, 0.5], [0.5, 0, 0], [2, 0, 1]]
    ends = np.bincount(scene.pairs.ravel())
    assert (ends[knots:] == 2).all()
    assert sorted(set(ends[:knots])) == [2, 3, 4]
    assert scene.rest_length == pytest.approx(1 / 6)


def test_balloon_is_in_balance():
    """The skin's pull on each ball is what the gas pushes, p times its share of the area."""
    scene = Scene(dim=3)
    made = shapes.balloon(scene, (1, 2, 3), 0.5, 3, pressure=30.0, stretch_stiffness=60.0, mass=0.1)
    assert len(made.balls) == 642
    x = scene.position
    assert np.linalg.norm(x - [1, 2, 3], axis=1) == pytest.approx(0.5)
    assert scene.mass.sum() == pytest.approx(0.1)
    assert scene.gases[0].volume == pytest.approx(np.pi / 6, rel=0.02)
    apart = x[scene.pairs[:, 1]] - x[scene.pairs[:, 0]]
    length = np.linalg.norm(apart, axis=1)
    pull = (scene.stiffness * (length - scene.rest_length) / length)[:, None] * apart
    force, push = np.zeros_like(x), np.zeros_like(x)
    np.add.at(force, scene.pairs[:, 0], pull)
    np.add.at(force, scene.pairs[:, 1], -pull)
    for k in range(3):
        np.add.at(push, made.triangles[:, k], 30.0 * area_vectors(x, made.triangles) / 3)
    outward = x - [1, 2, 3]
    assert (force * outward).sum() == pytest.approx(-(push * outward).sum(), rel=0.005)
    assert np.linalg.norm(force + push, axis=1).max() < 0.1 * np.linalg.norm(push, axis=1).max()
    shapes.balloon(scene, (0, 0, 0), 0.2, 1)
    assert scene.gases[1].pressure > 0


def test_tower():
    for dim in (2, 3):
        scene = Scene(dim=dim)
        made = shapes.tower(scene, 3, (0.3,) * dim, (4,) * dim, gap=0.01, mass=2.0, radius=0.04)
        assert scene.mass.sum() == pytest.approx(6.0)
        assert len(np.unique(scene.body)) == 3
        low = [scene.position[scene.body == body, 1].min() for body in np.unique(scene.body)]
        assert np.diff(low) == pytest.approx(0.3 + 0.08 + 0.01)
        assert made.balls.tolist() == list(range(scene.n_balls))
        assert len(made.springs) == scene.n_springs


def test_self_collision():
    scene = Scene(dim=3)
    shapes.cloth(scene, resolution=(4, 4), self_collision=True)
    assert (scene.body == 0).all()


def test_surface_collision():
    scene = Scene(dim=3)
    sheet = shapes.cloth(scene, resolution=(5, 5))
    solid = shapes.cloth(scene, resolution=(5, 5), surface_collision=True)
    block = shapes.jelly(scene, size=(0.4, 0.4, 0.4), resolution=(5, 5, 5), surface_collision=True)
    thick = shapes.cloth(scene, resolution=(5, 5), surface_collision=True, radius=0.1)
    assert not scene.solid[: len(sheet.triangles)].any()
    assert scene.solid[len(sheet.triangles) :].all()
    radius = [float(scene.radius[part.balls[0]]) for part in (sheet, solid, block, thick)]
    np.testing.assert_allclose(radius, [0.45 * 0.25, 0.25 * 0.25, 0.25 * 0.1, 0.1])


@pytest.mark.parametrize("make", [shapes.cloth, shapes.jelly], ids=["cloth", "jelly"])
@pytest.mark.parametrize(
    ("x", "t", "message"),
    [
        (TETRAHEDRON.vertices, [[0, 1, 4]], r"mesh\.triangles\[0\]: \[0, 1, 4\] .* a vertex, from 0 to 3"),
        (TETRAHEDRON.vertices, [[0, 1, -1]], r"mesh\.triangles\[0\]: .* a vertex"),
        (TETRAHEDRON.vertices, [[0.0, 1.0, 2.0]], r"mesh\.triangles: .* is not a list of integers"),
        (TETRAHEDRON.vertices, [], r"mesh: has no triangle"),
        (TETRAHEDRON.vertices * np.nan, TETRAHEDRON.triangles, r"mesh\.vertices\[0\].*finite"),
        (TETRAHEDRON.vertices[:, :2], TETRAHEDRON.triangles, r"mesh\.vertices: "),
    ],
)
def test_a_mesh_by_hand_is_checked(make, x, t, message):
    for mesh in (Surface(np.asarray(x), np.asarray(t)), (x, t)):
        scene = Scene(dim=3)
        with pytest.raises(SceneError, match=f"{make.__name__}.{message}"):
            make(scene, mesh=mesh)
        assert scene.n_balls == 0


def test_a_mesh_may_be_two_lists():
    one, two = Scene(dim=3), Scene(dim=3)
    shapes.cloth(one, mesh=TETRAHEDRON)
    shapes.cloth(two, mesh=(TETRAHEDRON.vertices.tolist(), TETRAHEDRON.triangles.tolist()))
    assert np.array_equal(one.position, two.position)
    assert np.array_equal(one.pairs, two.pairs)
    assert np.array_equal(one.triangles, two.triangles)
    with pytest.raises(SceneError, match=r"cloth\.mesh: \(1, 2, 3\) .* a file .obj .* or \(vertices, triangles\)$"):
        shapes.cloth(one, mesh=(1, 2, 3))
    with pytest.raises(SceneError, match=r"^cloth\.mesh: \(\[\[\d.*\.\.\. is not .* or \(vertices, triangles\)$"):
        shapes.cloth(one, mesh=(two.position, two.triangles, two.pairs))


def scaled(factor):
    return TETRAHEDRON.vertices * factor, TETRAHEDRON.triangles


REFUSED = [
    (2, lambda s: shapes.cloth(s), "dim = 3"),
    (3, lambda s: shapes.cloth(s, surface_collision=1), r"cloth\.surface_collision: 1"),
    (2, lambda s: shapes.jelly(s, surface_collision=True), r"jelly\.surface_collision: .*dim = 3"),
    (3, lambda s: shapes.cloth(s, (1, 1, 1)), r"cloth\.size: .* 2 lengths"),
    (3, lambda s: shapes.cloth(s, (1, -1)), r"cloth\.size\[1\]: -1.0"),
    (3, lambda s: shapes.cloth(s, resolution=(1, 4)), r"cloth\.resolution: .*at least 2"),
    (3, lambda s: shapes.cloth(s, resolution=(4, 4.5)), r"cloth\.resolution"),
    (3, lambda s: shapes.cloth(s, (1, 1), mesh=TETRAHEDRON), r"cloth\.mesh: takes the place"),
    (3, lambda s: shapes.cloth(s, mesh="no.obj"), r"cloth\.mesh: 'no.obj' is not there"),
    (3, lambda s: shapes.cloth(s, mesh=3), r"cloth\.mesh: 3"),
    (3, lambda s: shapes.cloth(s, mass=0), r"cloth\.mass: 0"),
    (3, lambda s: shapes.cloth(s, mass=float("nan")), r"cloth\.mass: nan"),
    (3, lambda s: shapes.cloth(s, radius=-1), r"cloth\.radius: -1"),
    (3, lambda s: shapes.cloth(s, stiffness=-1), r"cloth\.stiffness: -1"),
    (3, lambda s: shapes.cloth(s, damping=-1), r"cloth\.damping: -1"),
    (3, lambda s: shapes.cloth(s, bending_stiffness=-1), r"cloth\.bending_stiffness: -1"),
    (3, lambda s: shapes.cloth(s, resolution=(4, 4), pinned=[16]), r"cloth\.pinned\[0\]: 16"),
    (3, lambda s: shapes.cloth(s, material="jam"), r"cloth\.material: 'jam'"),
    (3, lambda s: shapes.cloth(s, scale=0), r"cloth\.scale: 0"),
    (3, lambda s: shapes.cloth(s, position=(0, 1)), r"cloth\.position"),
    (3, lambda s: shapes.cloth(s, rotation=(0, float("inf"), 1)), r"cloth\.rotation\[1\]: inf"),
    (3, lambda s: shapes.cloth(s, colour=(2, 0, 0)), r"cloth\.colour\[0\]: 2"),
    (
        3,
        lambda s: shapes.cloth(s, warp=9.0, bending_rigidity=8e49),
        r"^cloth\.bending_rigidity: makes a stiffness of \d",
    ),
    (3, lambda s: shapes.cloth(s, bending_weft=9e49), r"^cloth\.bending_weft: makes a stiffness of \d"),
    (3, lambda s: shapes.cloth(s, warp=9.0, mass_per_area=1e-49), r"^cloth\.mass_per_area: makes a mass of \d"),
    (3, lambda s: shapes.cloth(s, mass=1e-49), r"^cloth\.mass: makes a mass of .*at least 1e-50"),
    (3, lambda s: shapes.cloth(s, mesh=scaled(1e-26)), r"^cloth\.mesh: makes a mass of .*at least 1e-50"),
    (3, lambda s: shapes.cloth(s, (1e27, 1e27), warp=9.0), r"^cloth\.size: makes a mass of .*at most 1e\+50"),
    (3, lambda s: shapes.cloth(s, scale=1e27), r"^cloth\.scale: makes a mass of .*at most 1e\+50"),
    (
        3,
        lambda s: shapes.cloth(s, young_modulus=1e40, thickness=1e11),
        r"^cloth\.young_modulus: makes, with thickness, a warp of 1\.\d+e\+51, which is not allowed",
    ),
    (3, lambda s: shapes.jelly(s, young_modulus=1e4, damping=9e49), r"^jelly\.damping: makes a viscosity of \d"),
    (3, lambda s: shapes.jelly(s, young_modulus=1e4, density=1e-50), r"^jelly\.density: makes a mass of .*least 1e-50"),
    (3, lambda s: shapes.jelly(s, scale=1e20), r"^jelly\.scale: makes a mass of .*at most 1e\+50"),
    (3, lambda s: shapes.jelly(s, (1e-20,) * 3), r"^jelly\.size: makes a mass of .*at least 1e-50"),
    (3, lambda s: shapes.jelly(s, mesh=scaled(1e20)), r"^jelly\.mesh: makes a mass of .*at most 1e\+50"),
    (2, lambda s: shapes.jelly(s, (1, 1, 1)), r"jelly\.size: .* 2 lengths"),
    (2, lambda s: shapes.rope(s, (0, 0), (0, 0)), r"rope\.end: .*another point"),
    (2, lambda s: shapes.rope(s, (0, 0), (1, 0), 1), r"rope\.n: 1 .*at least 2"),
    (2, lambda s: shapes.rope(s, (0, 0), (1, 0), EA=1.0, stiffness=1.0), r"rope\.EA: does not go with stiffness"),
    (2, lambda s: shapes.rope(s, (0, 0), (1, 0), EI=1.0, young_modulus=1.0), r"rope\.young_modulus: .* with EI"),
    (2, lambda s: shapes.rope(s, (0, 0), (1, 0), young_modulus=1.0), r"rope\.young_modulus: needs the radius"),
    (
        2,
        lambda s: shapes.rope(s, (0, 0), (1, 0), mass=1.0, mass_per_length=1.0),
        r"rope\.mass_per_length: .* with mass",
    ),
    (2, lambda s: shapes.rope(s, (0, 0), (1, 0), EA=0.0), r"rope\.EA: 0"),
    (2, lambda s: shapes.rope(s, (0, 0), (1, 0), length=0.0), r"rope\.length: 0"),
    (2, lambda s: shapes.rope(s, (0, 0), (3, 4), length=1e-30), r"rope\.length: 1e-30 .*at least 0\.005, 0\.001 of"),
    (2, lambda s: shapes.rope(s, (0, 0), (1, 0), 2, length=1.5), r"rope\.length: 1\.5 .*more balls"),
    (2, lambda s: shapes.rope(s, (0, 0), (0, -1), 9, length=4.0), r"rope\.length: 4\.0 .*0 m apart sideways"),
    (2, lambda s: shapes.rope(s, (0, 0), (1, 0), EI=1e47), r"^rope\.EI: makes a stiffness of .*at most 1e\+50"),
    (2, lambda s: shapes.rope(s, (0, 0), (1, 0), mass_per_length=2e-50), r"^rope\.mass_per_length: makes a mass of"),
    (2, lambda s: shapes.wheel(s, (0, 0), 0.0), r"wheel\.radius: 0"),
    (2, lambda s: shapes.wheel(s, (0, 0), 1.0, 2), r"wheel\.spokes: 2 .*at least 3"),
    (2, lambda s: shapes.pile(s, (3, 0), 1.0), r"pile\.resolution"),
    (2, lambda s: shapes.pile(s, (3, 3), 1.0, jitter=2), r"pile\.jitter: 2"),
    (3, lambda s: shapes.cloth(s, resolution=(200000, 200000)), r"cloth\.resolution: .*4e\+10 balls .*GB of memory"),
    (2, lambda s: shapes.truss(s, (1, 2, 3)), r"truss\.size: .* 2 lengths"),
    (2, lambda s: shapes.truss(s, (1, 2), 0), r"truss\.cells: 0 .*at least 1"),
    (3, lambda s: shapes.net(s, meshes=(0, 2)), r"net\.meshes: .*at least 1"),
    (2, lambda s: shapes.net(s), "net: needs a scene with dim = 3"),
    (3, lambda s: shapes.balloon(s, (0, 0, 0), -1), r"balloon\.radius: -1"),
    (3, lambda s: shapes.balloon(s, (0, 0, 0), 1, 20), r"balloon\.subdivisions: 20 .*GB of memory"),
    (3, lambda s: shapes.balloon(s, (0, 0, 0), 1, pressure=1e6), r"balloon\.pressure: 1000000\.0 .*at most 133\.3 Pa"),
    (3, lambda s: shapes.tower(s, 0), r"tower\.levels: 0 .*at least 1"),
    (3, lambda s: shapes.tower(s, young_modulus=-1), r"tower\.young_modulus: -1"),
]


@pytest.mark.parametrize(("dim", "make", "message"), REFUSED, ids=[message for _, _, message in REFUSED])
def test_refused_and_the_scene_unchanged(dim, make, message):
    assert_unchanged(Scene(dim=dim), make, message)


def test_color_is_colour():
    scene = Scene(dim=3)
    balls = shapes.rope(scene, (0, 0, 0), (1, 0, 0), n=3, color=(1, 0, 0)).balls
    scene.add_balls([[0, 2, 0]], radius=0.1, color=(0, 1, 0))
    assert scene.colour[[balls[0], 3]].tolist() == [[1, 0, 0], [0, 1, 0]]
    with pytest.raises(TypeError, match="got colour and color"):
        shapes.cloth(scene, colour=(1, 0, 0), color=(1, 0, 0))


def test_center_is_centre():
    hub = [0.5, 2.0, 0.25]
    wheels = [shapes.wheel(Scene(dim=3), radius=1.0, **{word: hub}) for word in ("centre", "center")]
    assert wheels[0].balls.tolist() == wheels[1].balls.tolist()
    scene = Scene(dim=3)
    wheel = shapes.wheel(scene, center=hub, radius=1.0)
    assert scene.position[wheel.balls[0]].tolist() == hub
    scene.add_collider(ts.Sphere(centre=hub, radius=0.25, color=(1, 0, 0)))
    scene.add_collider(ts.Box(hub, size=(1, 1, 1), colour=(1, 0, 0)))
    for one in scene.colliders:
        assert one.motion.at(0.0)[0][0].tolist() == hub
        assert one.colour == (1, 0, 0)
    with pytest.raises(TypeError, match="got center and centre"):
        ts.Box(centre=hub, center=hub, size=(1, 1, 1))


def test_a_narrow_fold_of_rope_says_how_many_balls_help():
    scene = Scene(dim=2, gravity=(0, -9.81))
    with pytest.raises(SceneError, match=r"0 m apart sideways; give ends that are further apart sideways$"):
        shapes.rope(scene, (1, 3), (1, 2), 12, length=2.5)
    with pytest.raises(SceneError, match=r"give more balls \(n = 51\), or ends"):
        shapes.rope(scene, (1, 3), (1.05, 2), 12, length=2.5)
    shapes.rope(scene, (1, 3), (1.05, 2), 52, length=2.5)
