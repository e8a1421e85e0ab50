"""Membranes: their law, forces and damping, what implicit methods make of them, and sheets and meshes of them."""

import numpy as np
import pytest
from physics_support import F64, simulate
from scene_files import assert_unchanged

import taichi_sim as ts
from taichi_sim.forces.membranes import Membranes
from taichi_sim.integrators import ImplicitEuler
from taichi_sim.scene.membranes import MEMBRANES
from taichi_sim.scene.presets import PRESETS
from tests.shapes.test_cloth_material import mesh_of
from tests.support.drag import Drag

LAW = {"warp": 300.0, "weft": 120.0, "shear": 40.0, "coupling": 70.0}  # N/m
MATRIX = np.array([[300.0, 70.0, 0.0], [70.0, 120.0, 0.0], [0.0, 0.0, 40.0]])  # of E_uu, E_vv, 2 E_uv


def strain(slope):
    """(E_uu, E_vv, 2 E_uv) of the derivative (..., 3, 2) of places."""
    e = 0.5 * (np.swapaxes(slope, -1, -2) @ slope - np.eye(2))
    return np.stack([e[..., 0, 0], e[..., 1, 1], 2.0 * e[..., 0, 1]], axis=-1)


def energy(scene, x):
    return MEMBRANES.energies(scene, x, np.ones(len(scene.membranes), dtype=bool))[0]


def irregular(n=4, disturbed=0.0, **more):
    """A scene with a square of 1 m, cut irregularly, at rest where `flat` (n^2, 2) says, and its balls at its border."""
    rng = np.random.default_rng(5)
    i, j = (axis.ravel() for axis in np.meshgrid(*2 * [np.arange(n)], indexing="ij"))
    border = (i == 0) | (j == 0) | (i == n - 1) | (j == n - 1)
    flat = np.stack([i, j], axis=1) / (n - 1) + ~border[:, None] * rng.uniform(-0.2, 0.2, (n * n, 2)) / (n - 1)
    index = np.arange(n * n).reshape(n, n)
    here, right, up, across = index[:-1, :-1], index[1:, :-1], index[:-1, 1:], index[1:, 1:]
    triangles = np.concatenate(
        [np.stack([c.ravel() for c in t], axis=1) for t in ([here, right, across], [here, across, up])]
    )
    scene = ts.Scene(dim=3, gravity=(0.0, 0.0, 0.0))
    slope = np.array([[1.1, 0.2], [-0.1, 0.9], [0.3, -0.2]])
    x = flat @ slope.T + disturbed * ~border[:, None] * rng.normal(size=(n * n, 3))
    pinned = border if more.pop("held", False) else False
    scene.add_balls(
        x, radius=0.01, mass=rng.uniform(0.01, 0.03, n * n), velocity=rng.normal(size=(n * n, 3)), pinned=pinned
    )
    scene.add_membranes(triangles, rest=flat[triangles], **(LAW | more))
    return scene, flat @ slope.T


@pytest.mark.once
@pytest.mark.parametrize("resolution", [(2, 2), (6, 4)])
@pytest.mark.parametrize("fabric", [None, *(name for name, known in PRESETS.items() if known.warp is not None)])
def test_a_sheet_stores_what_its_law_says_at_any_strain_and_angle(fabric, resolution):
    """Uniaxial along and across the threads, shear, biaxial, compressed; turned as a whole: nothing."""
    known = None if fabric is None else PRESETS[fabric]
    matrix, given = MATRIX, LAW
    if known is not None:
        both = known.coupling or 0.0
        matrix = np.array([[known.warp, both, 0.0], [both, known.weft, 0.0], [0.0, 0.0, known.shear]])
        given = {"material": fabric}
    for angle in (0.0, 35.0):
        scene = ts.Scene(dim=3)
        ts.shapes.cloth(scene, (0.8, 0.5), resolution, warp_angle=angle, **given)
        x, axes = scene.position, np.radians(angle)
        u, v = np.array([np.cos(axes), 0.0, np.sin(axes)]), np.array([np.sin(axes), 0.0, -np.cos(axes)])
        turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
        for slope in (
            [[1.3, 0], [0, 1]],
            [[1, 0], [0, 1.2]],
            [[1, 0.4], [0, 1]],
            [[0.7, 0.1], [0, 1.1]],
            [[1, 0], [0, 1]],
        ):
            f = np.array(slope, dtype=float)
            moved = (np.outer(x @ u, u * f[0, 0] + v * f[1, 0]) + np.outer(x @ v, u * f[0, 1] + v * f[1, 1])) @ turn.T
            e = strain(f)
            assert energy(scene, moved) == pytest.approx(0.8 * 0.5 * 0.5 * e @ matrix @ e, rel=1e-12, abs=1e-24)


@pytest.mark.once
def test_the_energy_of_a_smooth_shape_converges_with_order_2():
    found = []
    for n in (5, 9, 17, 33):
        scene = ts.Scene(dim=3)
        ts.shapes.cloth(scene, (1.0, 1.0), (n, n), **LAW)
        x, z = scene.position[:, 0], scene.position[:, 2]
        found.append(energy(scene, np.stack([x + 0.1 * np.sin(2 * z), 0.2 * x * z + 0.1 * x**2, 1.1 * z], axis=1)))
    error = np.abs(np.diff(found))
    assert np.log2(error[:-1] / error[1:]) == pytest.approx(2.0, abs=0.05)


@pytest.mark.once
def test_a_modulus_and_a_thickness_make_an_isotropic_sheet_and_a_mesh_of_any_directions():
    young, ratio, thick = 2e6, 0.4, 1e-3
    scene = ts.Scene(dim=3)
    sheet = ts.shapes.cloth(scene, (1.0, 0.5), (5, 4), young_modulus=young, thickness=thick, poisson_ratio=ratio)
    x, small = scene.position, 1e-6
    pulled = x @ np.diag([1.0 + small, 1.0, 1.0 - ratio * small])  # free across
    assert energy(scene, pulled) == pytest.approx(0.5 * young * thick * 0.5 * small**2, rel=1e-4)
    assert scene.bend_stiffness.max() > 0.0
    assert scene.n_springs == 0
    other = ts.Scene(dim=3)
    turned = x @ np.array([[0, 0, 1], [0.6, 0.8, 0], [-0.8, 0.6, 0]])
    ts.shapes.cloth(other, mesh=(turned, sheet.triangles), young_modulus=young, thickness=thick, poisson_ratio=ratio)
    more = np.random.default_rng(0).normal(size=x.shape) * 0.05
    assert energy(other, turned + more) == pytest.approx(energy(scene, (turned + more)), rel=1e-9)


def test_patch_test():
    """An irregular sheet whose border is held where a homogeneous strain has it comes to that strain inside, exactly."""
    scene, exact = irregular(disturbed=0.05, held=True, damping=0.01)
    with simulate(scene, integrator=ImplicitEuler(tolerance=1e-10 if F64 else 1e-5), dt=1.0, contacts="off") as sim:
        assert sim.stability().dt_any_shape == np.inf
        sim.step(40)
        assert np.abs(sim.position - exact).max() < (1e-12 if F64 else 1e-5)
        assert sim.energy().spring == pytest.approx(energy(scene, exact), rel=1e-12 if F64 else 1e-5)


@pytest.mark.slow
def test_a_sheet_hangs_alike_however_it_is_cut():
    """A grid, and meshes cut along either diagonal and in turns, of a fabric with a warp, held by two patches."""
    scene, sheets, n = ts.Scene(dim=3, gravity=(0.0, -9.81, 0.0)), [], 14
    held = [i * (n + 1) + j for i in (0, 1, n - 1, n) for j in (0, 1)]
    for k, cut in enumerate((None, "alike", "other", "in turns")):
        if cut is None:
            form = {"size": (1.1, 0.9), "resolution": (n + 1, n + 1)}
        else:
            flat = mesh_of((1.1, 0.9), (n, n), cut)
            form = {"mesh": (flat.vertices, flat.triangles)}
        made = {"material": "denim", "warp_angle": 20.0, "pinned": held, "radius": 0.01}
        sheets.append(ts.shapes.cloth(scene, position=(2.0 * k, 0.0, 0.0), **form, **made).balls)
    with simulate(scene, integrator="implicit_euler", dt=0.02, contacts="off", forces=[Drag(4.0)]) as sim:
        sim.run(2.0)
        x = sim.position
    grid = x[sheets[0]]
    assert grid[:, 1].min() < -0.8
    for k, balls in enumerate(sheets):
        assert np.linalg.norm(x[balls] - grid - [2.0 * k, 0.0, 0.0], axis=1).mean() < 3e-3


@pytest.mark.slow
def test_verlet_keeps_the_energy_of_a_sheet_at_the_step_it_finds():
    scene = ts.Scene(dim=3, gravity=(0.0, -10.0, 0.0))
    ts.shapes.cloth(scene, (0.6, 0.4), (7, 5), pinned=[0, 30], damping=0.0, mass_per_area=0.2, **LAW)
    with simulate(scene, contacts="off", dt="auto") as sim:
        start = sim.energy().total
        sim.run(1.0)
        assert sim.energy().kinetic > 0.01
        assert abs(sim.energy().total - start) < 0.01 * sim.energy().kinetic


@pytest.mark.once
def test_a_sheet_that_tears_has_springs_without_stiffness():
    scene = ts.Scene(dim=3)
    ts.shapes.cloth(scene, (1.0, 1.0), (4, 5), break_strain=0.2, **LAW)
    assert scene.n_springs == len(np.unique(np.sort(scene.pairs, axis=1), axis=0)) > 0
    assert not scene.stiffness.any()


@pytest.mark.once
@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"weft": 1.0}, r"cloth\.warp: is missing"),
        ({"warp": 1.0, "stretch_stiffness": 1.0}, r"cloth\.warp: does not go with stretch_stiffness"),
        ({"young_modulus": 1e6}, r"cloth\.thickness: is missing"),
        ({"young_modulus": 1e6, "warp": 1.0}, r"cloth\.warp: does not go with young_modulus"),
        ({"warp": 4.0, "weft": 1.0, "coupling": 2.1}, r"cloth\.coupling: 2\.1"),
    ],
)
def test_refusals(given, message):
    assert_unchanged(ts.Scene(dim=3), lambda scene: ts.shapes.cloth(scene, (1.0, 1.0), (3, 3), **given), message)


@pytest.mark.once
def test_too_much_coupling_names_its_triangle():
    scene = ts.Scene(dim=3)
    scene.add_balls([[0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 1]], radius=0.1)
    with pytest.raises(ts.SceneError, match=r"^membranes\.coupling\[1\]: -3\.5 .* at most 3,"):
        scene.add_membranes([[0, 2, 1], [1, 2, 3]], warp=9.0, weft=1.0, shear=1.0, coupling=[2.9, -3.5])


@pytest.mark.once
def test_what_corners_gather_is_kept_where_they_gather():
    """On one thread explicit methods add forces to the balls at once."""
    scene = ts.Scene(dim=3)
    ts.shapes.cloth(scene, (0.7, 0.4), (4, 3), **LAW)
    for method, gathers in (("verlet", False), ("implicit_euler", True)):
        with ts.Simulation(scene, integrator=method, dt=1e-4, driver="fused") as sim:
            assert sim.parts.model.serial
            (membranes,) = (one for one in sim.parts.forces.elements if isinstance(one, Membranes))
            assert hasattr(membranes, "given") == gathers
