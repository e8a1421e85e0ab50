"""Cloth of a material: the same at every resolution, against theory and a dense Newton solution; no Taichi."""

import numpy as np
import pytest
from statics import at_rest

from taichi_sim import Scene, SceneError, shapes
from taichi_sim.geometry.mesh import Surface
from taichi_sim.shapes.mesh_bending import _rows, mesh_bends

pytestmark = pytest.mark.once

STRETCH, SHEAR, RIGIDITY = 80.0, 20.0, 1e-3


def sheet(size=(1.0, 1.0), resolution=(9, 9), gravity=(0, -10, 0), **more):
    scene = Scene(dim=3, gravity=gravity)
    material = {
        "stretch_stiffness": STRETCH,
        "shear_stiffness": SHEAR,
        "bending_rigidity": RIGIDITY,
        "mass_per_area": 0.2,
    }
    return scene, shapes.cloth(scene, size, resolution, **(material | more))


def spring_energy(scene, x):
    length = np.linalg.norm(x[scene.pairs[:, 1]] - x[scene.pairs[:, 0]], axis=1)
    return 0.5 * float(scene.stiffness @ (length - scene.rest_length) ** 2)


def bending_energy(scene, x):
    return 0.5 * float(
        scene.bend_stiffness @ np.sum(np.einsum("bk,bki->bi", scene.bend_weights, x[scene.bends]) ** 2, axis=1)
    )


CUTS = {"alike": lambda i, j: True, "other": lambda i, j: False, "in turns": lambda i, j: (i + j) % 2 == 0}


def mesh_of(size, cells, cut="alike", moved=0.0):
    """A flat sheet in the x-z plane of squares (m, n), cut as is said, or of triangles of equal sides; inner vertices moved at
    random by that part of a square."""
    i, j = (k.ravel() for k in np.meshgrid(*(np.arange(n + 1) for n in cells), indexing="ij"))
    even = cut == "even"
    place = np.stack([(i + 0.5 * (j % 2) * even) / cells[0] * size[0], 0.0 * i, j / cells[1] * size[1]], axis=1)
    inner = (i > 2) & (i < cells[0]) & (j > 0) & (j < cells[1])
    step = np.array([size[0] / cells[0], 0.0, size[1] / cells[1]])
    place[inner] += moved * step * np.random.default_rng(8).uniform(-1, 1, (inner.sum(), 3))
    index = np.arange(len(i)).reshape(cells[0] + 1, -1)
    here, right, up, across = (one.ravel() for one in (index[:-1, :-1], index[1:, :-1], index[:-1, 1:], index[1:, 1:]))
    k, l = (one.ravel() for one in np.meshgrid(*(np.arange(n) for n in cells), indexing="ij"))
    turn = l % 2 == 1 if even else np.broadcast_to(CUTS[cut](k, l), k.shape)
    corners = [here, up, np.where(turn, across, right)], [right, np.where(turn, here, up), across]
    return Surface(place, np.concatenate([np.stack(three, axis=1) for three in corners]).astype(np.int32))


@pytest.mark.parametrize("resolution", [(3, 3), (5, 9), (13, 10)])
def test_moduli_and_mass_at_any_resolution(resolution):
    """Energy per area of a homogeneous strain e: (C11 (exx^2 + ezz^2) + 2 C12 exx ezz) / 2 + 2 C44 exz^2, C12 = C44."""
    size = (1.0, 1.2)
    scene, _ = sheet(size, resolution)
    if resolution == (5, 9):
        with pytest.raises(SceneError, match=r"cloth\.shear_stiffness: 79"):
            sheet(size, resolution, shear_stiffness=79.0)  # the sides of the grid are 0.25 and 0.15
    assert scene.mass.sum() == pytest.approx(0.2 * 1.2)
    assert scene.mass[0] == pytest.approx(0.25 * scene.mass.max() if min(resolution) > 2 else scene.mass.max())
    x, area, small = scene.position, 1.2, 1e-6
    for xx, zz, xz in ((1, 0, 0), (0, 1, 0), (1, 1, 0), (1, -0.5, 0.7)):
        strain = small * np.array([[xx, 0, xz], [0, 0, 0], [xz, 0, zz]])
        want = 0.5 * (STRETCH * (xx**2 + zz**2) + 2 * SHEAR * xx * zz) + 2 * SHEAR * xz**2
        assert spring_energy(scene, x + x @ strain) / area == pytest.approx(want * small**2, rel=1e-4)


@pytest.mark.parametrize("resolution", [(4, 4), (2, 4), (6, 4), (5, 4)])
@pytest.mark.parametrize("material", [{}, {"stiffness": 30.0}])
def test_a_sheet_of_an_odd_number_of_squares_does_not_shear_where_it_is_stretched(resolution, material):
    """Diagonals of one kind are one more than the others, and as stiff together."""
    scene = Scene(dim=3)
    shapes.cloth(scene, (1.1, 0.9), resolution, **(material or {"stretch_stiffness": STRETCH, "shear_stiffness": 5.0}))
    x, small = scene.position, 1e-4
    for xx, zz in ((1, 0), (0, 1), (0.6, -0.3)):
        strains = [small * np.array([[xx, 0, xz], [0, 0, 0], [xz, 0, zz]]) for xz in (0.5, -0.5)]
        one, other = (spring_energy(scene, x + x @ strain) for strain in strains)
        assert one == pytest.approx(other, rel=1e-3)


@pytest.mark.parametrize("resolution", [(9, 9), (33, 17)])
def test_bending_rigidity_of_a_sheet(resolution):
    """Curvatures wxx, wzz and twist wxz: B (wxx^2 + wzz^2 + 2 wxz^2) / 2 per area, but for the ends of its rows."""
    scene, _ = sheet((1.0, 1.0), resolution)
    x = scene.position
    (a, b), small = 1 / (np.array(resolution) - 1), 1e-4
    for xx, zz, xz in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 2, -0.5)):
        y = small * (0.5 * xx * x[:, 0] ** 2 + 0.5 * zz * x[:, 2] ** 2 + xz * x[:, 0] * x[:, 2])
        want = 0.5 * RIGIDITY * (xx**2 * (1 - a) + zz**2 * (1 - b) + 2 * xz**2)
        assert bending_energy(scene, x + np.outer(y, [0, 1, 0])) == pytest.approx(want * small**2, rel=1e-9)
    turned, _ = sheet((1.0, 1.0), resolution, rotation=(20, 30, 40))
    assert bending_energy(turned, turned.position) < 1e-20


def rolled(x, z, turn, radius):
    """Places (n, 3) of what lies flat at (x, z), rolled on a cylinder in the direction `turn` [rad]."""
    along, across = np.cos(turn) * x + np.sin(turn) * z, np.cos(turn) * z - np.sin(turn) * x
    return np.stack([radius * np.sin(along / radius), radius * (1 - np.cos(along / radius)), across], axis=1)


@pytest.mark.parametrize(
    ("cut", "moved"), [("alike", 0.0), ("in turns", 0.0), ("even", 0.0), ("in turns", 0.2), ("alike", 0.3)]
)
def test_bending_rigidity_of_a_flat_mesh(cut, moved):
    """Rolled on a cylinder it stores B / (2 r^2) per area, in whatever direction; half a row at its border does not bend."""
    cells = 25
    flat = mesh_of((1.0, np.sqrt(0.75) if cut == "even" else 1.0), (cells, cells), cut, moved)
    area = np.sqrt(0.75) if cut == "even" else 1.0
    scene = Scene(dim=3)
    shapes.cloth(scene, mesh=flat, stretch_stiffness=STRETCH, bending_rigidity=RIGIDITY)
    assert bending_energy(scene, scene.position) < 1e-20
    x, z = flat.vertices[:, 0], flat.vertices[:, 2]
    for radius in (0.7, 6.0):
        for turn in np.pi / 8 * np.arange(-3, 5):
            part = bending_energy(scene, rolled(x, z, turn, radius)) / (area * RIGIDITY / (2 * radius**2))
            assert 1.0 - (1.4 if moved < 0.3 else 2.5) / cells < part < 1.01


@pytest.mark.parametrize("kind", ["grid", "in turns", "even", "moved"])
@pytest.mark.parametrize("angle", [0.0, 90.0, 25.0])
def test_a_fabric_bends_along_warp_and_weft(kind, angle):
    """Rolled at an angle to the warp it stores B cos^2 + C sin^2, of rigidities B and C along warp and weft; half a row at its
    border does not bend."""
    n, size, rigid, soft = 25, (1.0, 0.8 if kind != "even" else np.sqrt(0.75)), 3.0 * RIGIDITY, RIGIDITY
    cut, moved = ("in turns", 0.2) if kind == "moved" else (kind, 0.0)
    place = (
        {"resolution": (n + 1, n + 1), "size": size} if kind == "grid" else {"mesh": mesh_of(size, (n, n), cut, moved)}
    )
    scene = Scene(dim=3)
    shapes.cloth(scene, **place, warp=STRETCH, warp_angle=angle, bending_rigidity=rigid, bending_weft=soft)
    x, z, radius = scene.position[:, 0], scene.position[:, 2], 3.0
    for turn in np.pi / 8 * np.arange(-3, 5):
        share = np.cos(turn - np.radians(angle)) ** 2
        part = bending_energy(scene, rolled(x, z, turn, radius)) / (
            size[0] * size[1] * (rigid * share + soft * (1 - share)) / (2 * radius**2)
        )
        assert 1.0 - 2.0 / n < part < 1.02, (turn, part)


@pytest.mark.parametrize(
    ("cut", "moved", "allowed"),
    [("alike", 0.0, 0.01), ("other", 0.0, 0.01), ("in turns", 0.0, 0.03), ("in turns", 0.2, 0.1)],
)
@pytest.mark.parametrize("wide", [2, 5])
def test_a_strip_of_mesh_sags_as_a_beam(cut, moved, allowed, wide):
    """By q L^4 / (8 B), L from the last held vertices: also what bends between hinges, which no cylinder shows, counts."""
    n, mass = 17, 3e-5
    flat = mesh_of((1.0, wide / n), (n, wide), cut, moved)
    scene = Scene(dim=3, gravity=(0, -10, 0))
    held = {"shape": "box", "center": (0, 0, 0), "size": (2.2 / n, 1, 3)}
    shapes.cloth(
        scene, mesh=flat, pinned=held, stretch_stiffness=STRETCH, bending_rigidity=RIGIDITY, mass_per_area=mass
    )
    x, _ = at_rest(scene, most=1e-7)
    sag = -x[np.isclose(scene.position[:, 0], 1.0), 1].mean()
    assert sag == pytest.approx(mass * 10 * (1 - 1 / n) ** 4 / (8 * RIGIDITY), rel=allowed)


def hinge(fold):
    """Two triangles at an edge along z, about which one of them is turned by `fold` [rad]."""
    corners = [[0.0, 0, -0.2], [0, 0, 0.3], [-0.3, 0, 0.1], [0.4 * np.cos(fold), 0.4 * np.sin(fold), 0]]
    return Surface(np.array(corners), np.array([[0, 1, 3], [1, 0, 2]], dtype=np.int32))


def test_a_fold_is_as_stiff_as_a_flat_hinge():
    """B e^2 / (A0 + A1) times half the square of the change of the angle: by an element, or by a spring across the edge."""
    small = 1e-4
    want = RIGIDITY * 0.5**2 / (0.5 * 0.5 * 0.7) * small**2 / 2
    for angle in (0.0, 0.5, -1.5):
        scene = Scene(dim=3)
        shapes.cloth(scene, mesh=hinge(angle), stretch_stiffness=1e6, bending_rigidity=RIGIDITY)
        assert (len(scene.bends), scene.n_springs) == ((1, 5) if angle == 0 else (0, 6))
        bent = hinge(angle + small).vertices
        assert bending_energy(scene, bent) + spring_energy(scene, bent) == pytest.approx(want, rel=1e-3)


@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_a_hinge_of_a_fabric_is_as_stiff_as_the_fabric_across_it(angle):
    """Flat or folded, of two triangles: its edge lies along z, so that it bends along x."""
    small, found = 1e-4, []
    for fold in (0.0, 1e-3):
        for weft in (RIGIDITY, 0.25 * RIGIDITY):
            scene = Scene(dim=3)
            threads = {"warp": 1e6, "warp_angle": np.degrees(angle), "bending_rigidity": RIGIDITY, "bending_weft": weft}
            shapes.cloth(scene, mesh=hinge(fold), **threads)
            bent = hinge(fold + small).vertices
            found.append(bending_energy(scene, bent) + spring_energy(scene, bent))
    want = np.cos(angle) ** 2 + 0.25 * np.sin(angle) ** 2
    assert found[1] / found[0] == pytest.approx(want, rel=1e-6)
    assert found[3] / found[2] == pytest.approx(want, rel=1e-3)


@pytest.mark.parametrize("fold", [np.pi, np.pi - 2e-5, -np.pi])
def test_nothing_crosses_an_edge_folded_onto_itself(fold):
    bends, pairs, strength = mesh_bends(hinge(fold), RIGIDITY)
    assert (len(bends.corners), len(pairs), len(strength)) == (0, 0, 0)


@pytest.mark.parametrize("rigidity", [None, RIGIDITY])
@pytest.mark.parametrize("height", [0.0, 1e-7])
def test_nothing_bends_beside_a_triangle_without_area(rigidity, height):
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [2, height, 0], [0, 0.3, 1]])
    bends, pairs, _ = mesh_bends(Surface(corners, np.array([[0, 3, 1], [0, 1, 2]], dtype=np.int32)), rigidity)
    assert (len(bends.corners), len(pairs)) == (0, 0)


@pytest.mark.parametrize("fold", [3e-5, 9e-5])
def test_a_fold_that_counts_as_flat_bends_as_a_flat_one_beside_a_large_triangle(fold):
    """A slight fold lifts distant vertices far off the plane of a small triangle, whose edges bend all the same."""
    x = np.array([[0, 0, 0], [0.3, 0, 0], [0.1, 0, -0.1], [0.2, 0, 3.0], [3.5, 0, 3.0]])
    triangles = np.array([[0, 1, 2], [1, 0, 3], [1, 3, 4]], dtype=np.int32)
    flat = mesh_bends(Surface(x, triangles), RIGIDITY)[0]
    x[3:, 1] = fold * x[3:, 2]
    folded, pairs, _ = mesh_bends(Surface(x, triangles), RIGIDITY)
    assert len(pairs) == 0
    assert {0, 1, 2, 3} in [set(four) for four in folded.corners.tolist()]
    np.testing.assert_array_equal(folded.corners, flat.corners)
    np.testing.assert_allclose(folded.weights, flat.weights, rtol=1e-3)
    np.testing.assert_allclose(folded.stiffness, flat.stiffness, rtol=1e-3)


@pytest.mark.parametrize("spokes", [48, 300])
def test_the_elements_of_a_hub_grow_as_its_neighbours_do(spokes):
    """A fan of any number of triangles stores |kappa|^2 less the square of what it has across its border."""
    angle = 2 * np.pi * np.arange(spokes) / spokes
    x = np.vstack([np.zeros(3), np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)])
    k = np.arange(spokes)
    surface = Surface(x, np.stack([0 * k, 1 + k, 1 + (k + 1) % spokes], axis=1).astype(np.int32))
    bends = mesh_bends(surface, RIGIDITY)[0]
    assert len(bends.corners) < 3 * spokes
    assert len(_rows(surface.vertices, surface.triangles)) < 17 * spokes
    area = 0.5 * spokes * np.sin(2 * np.pi / spokes)
    for height, want in ((x[:, 0] ** 2 / 2, 0.625), (x[:, 0] * x[:, 2], 1.5)):
        bent = (bends.weights * height[bends.corners]).sum(axis=1)
        assert 0.5 * bends.stiffness @ bent**2 == pytest.approx(RIGIDITY * area * want / 2, rel=0.06)


def test_stretch_of_a_mesh():
    """Van Gelder's springs on triangles of equal sides: C11 is the stretch stiffness, C12 = C44 a third of it."""
    rows, side = 20, 1 / 20
    i, j = (k.ravel() for k in np.meshgrid(np.arange(rows + 1), np.arange(rows + 1), indexing="ij"))
    place = np.stack([side * (i + 0.5 * j), 0 * i, side * np.sqrt(0.75) * j], axis=1)
    k = np.arange(len(i)).reshape(rows + 1, rows + 1)
    faces = np.concatenate(
        [
            np.stack([a.ravel() for a in three], 1)
            for three in ((k[:-1, :-1], k[:-1, 1:], k[1:, :-1]), (k[1:, :-1], k[:-1, 1:], k[1:, 1:]))
        ]
    )
    scene = Scene(dim=3)
    shapes.cloth(scene, mesh=Surface(place, faces.astype(np.int32)), stretch_stiffness=STRETCH, mass_per_area=0.3)
    area, small = np.sqrt(0.75), 1e-6
    assert scene.mass.sum() == pytest.approx(0.3 * area)
    for xx, zz, xz in ((1, 0, 0), (0, 1, 0), (1, 1, 0), (0, 0, 1)):
        strain = small * np.array([[xx, 0, xz], [0, 0, 0], [xz, 0, zz]])
        want = 0.5 * STRETCH * (xx**2 + zz**2 + 2 / 3 * xx * zz) + 2 / 3 * STRETCH * xz**2
        assert spring_energy(scene, scene.position @ (np.eye(3) + strain)) / area == pytest.approx(
            want * small**2, rel=1e-4
        )


@pytest.mark.parametrize("kind", ["grid", "rope", "rope of springs"])
def test_a_clamp_is_at_the_last_held_balls(kind):
    """What is clamped at one end by two rows sags by q L^4 / (8 B), L from the second row: 19 meshes."""
    n, rigidity, mass = 20, 1e-3, 2e-5
    a = 1 / n
    held = {"shape": "box", "center": (0, 0, 0), "size": (2.1 * a, 1, 1)}
    scene = Scene(dim=3, gravity=(0, -10, 0))
    if kind == "grid":
        scene, _ = sheet((1.0, 2 * a), (n + 1, 3), bending_rigidity=rigidity, mass_per_area=mass, pinned=held)
    elif kind == "rope":
        shapes.rope(scene, (0, 0, 0), (1, 0, 0), n + 1, mass_per_length=mass, EI=rigidity, EA=STRETCH, pinned=held)
    else:
        made = {"stiffness": STRETCH / a, "bending_stiffness": rigidity / a**3}
        shapes.rope(scene, (0, 0, 0), (1, 0, 0), n + 1, mass=mass * (n + 1) / n, pinned=held, **made)
    x, _ = at_rest(scene, most=1e-7)
    tip = np.isclose(scene.position[:, 0], 1.0)
    # equal balls: the last one weighs twice its share, a / 2 too much at the end
    more = 4 * a / (3 * (1 - a)) if kind == "rope of springs" else 0.0
    assert -x[tip, 1].mean() == pytest.approx(mass * 10 * (1 - a) ** 4 / (8 * rigidity) * (1 + more), rel=0.01)


@pytest.mark.once
def test_rows_that_are_not_quite_straight_are_clamped_as_straight_ones():
    """A strip of triangles of equal sides, held by two rows. Moved by 1e-4 of a side its rows have a fourth ball beside them,
    held or free, which bears next to nothing; it sags as it did."""
    wide, rows, mass = 18, 9, 3e-5
    flat = mesh_of((1.0, rows / wide * np.sqrt(0.75)), (wide, rows), "even")
    away = 1e-4 / wide * np.random.default_rng(5).uniform(-1, 1, flat.vertices.shape) * [1, 0, 1]
    pinned, sags = np.flatnonzero(flat.vertices[:, 2] < 1.1 / wide), []
    for place in (flat.vertices, flat.vertices + away):
        scene = Scene(dim=3, gravity=(0, -10, 0))
        made = {"stretch_stiffness": STRETCH, "bending_rigidity": RIGIDITY, "mass_per_area": mass}
        shapes.cloth(scene, mesh=Surface(place, flat.triangles), pinned=pinned, **made)
        sags.append(at_rest(scene, most=1e-7)[0][flat.vertices[:, 2] > (rows - 0.5) / wide * np.sqrt(0.75), 1].mean())
    assert sags[1] == pytest.approx(sags[0], rel=6e-3)


def test_a_hinge_counts_by_the_part_that_is_free():
    """Sides of 1 and 3 m: with the first held the element is 3 of 4 m long, with the second 1, with none or both all of it."""
    scene = Scene(dim=2)
    scene.add_balls([[0.0, 0.0], [1.0, 0.0], [4.0, 0.0]], radius=0.1)
    hinge = {"weights": [-2 / 3, -2 / 3, 1.0, 1 / 3], "stiffness": 6.0, "damping": 3.0}
    scene.add_bending([[1, 1, 0, 2]], hinge=True, **hinge)
    scene.add_bending([[1, 1, 0, 2]], **hinge)
    for pinned, rise in (([], 1), ([0], 1), ([0, 1], 4 / 3), ([1, 2], 4), ([0, 2], 1), ([0, 1, 2], 1)):
        scene.set_balls(pinned=np.isin(np.arange(3), pinned))
        stiffness, damping = scene.held_bending()
        assert stiffness == pytest.approx([6.0 * rise, 6.0])
        assert damping == pytest.approx([3.0 * rise, 3.0])
    scene = Scene(dim=2)
    scene.add_balls([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [1.0, 1.0]], radius=0.1)
    for part in (0.1, 0.4, 0.7, -0.05):  # of the hinge's weight on its other end, which is free
        scene.add_bending([[1, 3, 0, 2]], weights=[2 * part - 2, -2 * part, 1.0, 1.0], stiffness=1.0, hinge=True)
    scene.set_balls(pinned=[True, True, False, False])
    assert scene.held_bending()[0] == pytest.approx([1 / (1 - 0.4), 1 / (1 - 0.1), 1.0, 2.0])
    scene.set_balls(pinned=[True, True, True, False])  # the other does not feel how those that are held are folded
    assert scene.held_bending()[0] == pytest.approx(1.0)
    with pytest.raises(SceneError, match=r"bending\.weights\[0\]: .* of one sign"):
        scene.add_bending([[0, 1, 1, 2]], weights=[1.0, -1.0, -1.0, 1.0], stiffness=1.0, hinge=True)


def hanging(n):
    """A cloth that hangs flat from its edge: how far it reaches, and the period of its slowest bounce."""
    scene, _ = sheet((1.0, 1.0), (n, n), pinned=list(range(n)), bending_rigidity=1e-5)
    x = scene.position
    scene.set_balls(position=np.stack([0 * x[:, 0], -x[:, 0], x[:, 2]], axis=1))
    x, matrix = at_rest(scene)
    free = np.repeat(scene.mass[~scene.pinned], 3)
    rate, mode = np.linalg.eigh(matrix / np.sqrt(np.outer(free, free)))
    part = np.abs(np.sqrt(free[1::3]) @ mode[1::3])  # how much of the mass a mode moves up and down
    return -x[:, 1].min(), 2 * np.pi / np.sqrt(rate[np.argmax(part)])


def test_it_hangs_alike_at_every_resolution():
    coarse, fine = hanging(6), hanging(13)
    young = STRETCH - SHEAR**2 / STRETCH  # its width is free
    assert fine[0] - 1 == pytest.approx(0.5 * 0.2 * 10 / young, rel=0.02)
    assert coarse[0] - 1 == pytest.approx(fine[0] - 1, rel=0.03)
    assert coarse[1] == pytest.approx(fine[1], rel=0.03)
    assert fine[1] == pytest.approx(4 / np.sqrt(young / 0.2), rel=0.02)  # a rod held at one end


def test_damping_is_shared_out_as_the_stiffness_is():
    for n in (5, 9):
        scene, _ = sheet((1.0, 1.0), (n, n), damping=0.4)
        assert scene.damping == pytest.approx(0.4 / STRETCH * scene.stiffness)


def test_a_folded_triangle_without_area():
    x = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 0, 1]])
    bad = Surface(x, np.array([[0, 3, 1], [0, 1, 2]], dtype=np.int32))
    scene = Scene(dim=3)
    with pytest.raises(SceneError, match=r"cloth\.mesh: triangles 1 \(from 0\) have no area"):
        shapes.cloth(scene, mesh=bad, mass_per_area=0.1)
    assert scene.n_balls == 0


ROW = np.array([[0.0, 0, 0], [0.5, 0, 0], [2, 0, 0], [3, 0, 0]])
SHEETS = [{"mesh": (ROW, [[0, 1, 2], [1, 2, 3]])}, {"mesh": (np.insert(ROW, 2, [0, 0, 1], axis=0), [[0, 2, 1]])}]


@pytest.mark.parametrize("material", [{}, {"stretch_stiffness": 50.0}, {"warp": 50.0}])
def test_a_mesh_without_area(material):
    with pytest.raises(SceneError, match=r"cloth\.mesh: triangles 0, 1 .* no area"):
        shapes.cloth(Scene(dim=3), **SHEETS[0], **material)


@pytest.mark.parametrize("material", [{}, {"stiffness": 40.0}, {"mass_per_area": 0.3}, {"warp": 50.0}])
def test_a_mesh_with_a_slip(material):
    """A vertex without a triangle, and a triangle with a corner twice, are mistakes of any mesh."""
    with pytest.raises(SceneError, match=r"cloth\.mesh: vertex 3 \(from 0\) belongs to no triangle"):
        shapes.cloth(Scene(dim=3), **SHEETS[1], **material)
    twice = np.delete(SHEETS[1]["mesh"][0], 3, axis=0), [[0, 2, 1], [2, 2, 1], [1, 2, 3]]
    with pytest.raises(SceneError, match=r"cloth\.mesh: triangles 1 \(from 0\) have no area"):
        shapes.cloth(Scene(dim=3), mesh=twice, **material)


@pytest.mark.parametrize(
    ("threads", "says"),
    [
        ({"warp": 0.0, "weft": 20.0, "damping": 0.5}, r"^cloth\.damping: acts along the warp"),
        ({"warp": 0.0}, r"^cloth\.warp: 0\.0 is not allowed; it must be greater than 0"),
        ({"warp": 50.0, "coupling": -60.0}, r"^cloth\.coupling: -60\.0 is not allowed; it must be at most 50"),
        (
            {"warp": 50.0, "weft": 8.0, "coupling": 21.0},
            r"^cloth\.coupling: 21\.0 is not allowed; it must be at most 20",
        ),
    ],
)
def test_threads_that_make_no_sheet(threads, says):
    with pytest.raises(SceneError, match=says):
        shapes.cloth(Scene(dim=3), (1.0, 1.0), (3, 3), **threads)


def test_a_sheet_may_have_threads_in_one_direction_only():
    scene = Scene(dim=3)
    shapes.cloth(scene, (1.0, 1.0), (3, 3), warp=0.0, weft=20.0, damping=0.0)
    assert not scene.membrane_damping.any()
    assert not scene.membrane_warp.any()


MATERIAL = ("mass_per_area", "stretch_stiffness", "shear_stiffness", "bending_rigidity")


@pytest.mark.parametrize("new", MATERIAL)
@pytest.mark.parametrize("old", ["stiffness", "bending_stiffness"])
def test_a_material_and_springs_exclude_each_other(new, old):
    with pytest.raises(SceneError, match=rf"cloth\.{new}: does not go with {old}"):
        shapes.cloth(Scene(dim=3), **{new: 1.0, old: 1.0})


def test_other_conflicts():
    with pytest.raises(SceneError, match=r"cloth\.mass_per_area: does not go with mass"):
        shapes.cloth(Scene(dim=3), mass=1.0, mass_per_area=1.0)
    with pytest.raises(SceneError, match=r"cloth\.shear_stiffness: a mesh has none"):
        shapes.cloth(Scene(dim=3), mesh=mesh_of((1, 1), (2, 2)), shear_stiffness=1.0)
    scene = Scene(dim=3)
    shapes.cloth(scene, mass=3.0, stretch_stiffness=10.0, resolution=(4, 4))
    assert scene.mass.sum() == pytest.approx(3.0)
