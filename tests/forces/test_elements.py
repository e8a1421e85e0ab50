"""Cells, bending, gas and wind against plain NumPy in float64; what they conserve; how stiff they may be."""

from dataclasses import replace

import numpy as np
import pytest
from physics_support import EPS, F64, box_mesh, simulate
from scene_files import assert_unchanged

import taichi_sim as ts
from taichi_sim.analysis import diagnostics
from taichi_sim.analysis import element_rates as rates_of
from taichi_sim.analysis.element_rates import element_rates
from taichi_sim.forces.corners import Corners
from taichi_sim.forces.sum import _kernels
from taichi_sim.forces.wind import GUST_WAVES, SIDEWAYS_GUSTS, axes
from taichi_sim.scene.cells import cell_volumes
from taichi_sim.scene.elements import ELEMENTS

pytestmark = pytest.mark.long_in("f32")

H = 1e-3  # s


def box(seed: int = 1) -> ts.Scene:
    """A deformed, moving box of 8 balls in 3D with six cells, bending elements, gas and a gusty wind; one ball pinned."""
    rng = np.random.default_rng(seed)
    scene = ts.Scene(dim=3)
    corner, faces = box_mesh(1.0, 0.5)
    balls = scene.add_balls(
        corner, radius=0.1, mass=rng.uniform(0.5, 2.0, 8), velocity=rng.normal(size=(8, 3)), pinned=[7]
    )
    paths = [(0, 4, 6, 7), (0, 6, 2, 7), (0, 2, 3, 7), (0, 3, 1, 7), (0, 1, 5, 7), (0, 5, 4, 7)]
    scene.add_cells(paths, bulk_modulus=rng.uniform(10.0, 30.0, 6))
    weights = rng.normal(size=(3, 4))
    weights[:, 3] = -weights[:, :3].sum(axis=1)
    scene.add_bending(
        [[0, 1, 2, 3], [4, 5, 6, 7], [0, 2, 5, 7]], weights=weights, stiffness=[3.0, 5.0, 1.0], damping=[0.0, 0.2, 0.1]
    )
    scene.add_triangles(balls[faces])
    scene.add_gas(faces, pressure=40.0, outside=5.0)
    scene.add_wind((3.0, 1.0, -2.0), gust=0.5, gust_length=0.7)
    scene.set_balls(position=scene.position + rng.normal(size=(8, 3)) * 0.15)
    return scene


def test_every_element_has_kernels_of_its_name_that_are_implicit_as_it_says():
    for one in ELEMENTS:
        kernels = _kernels(one.name)
        given = [getattr(kernels, name) is not getattr(Corners, name) for name in ("corner_product", "corner_block")]
        assert given == [one.is_implicit] * 2, one.name
        assert hasattr(ts.Scene, one.method)


def square() -> ts.Scene:
    """Two triangular cells in 2D, deformed."""
    rng = np.random.default_rng(2)
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 0], [1, 0], [1, 1], [0, 1]], radius=0.1, mass=[1.0, 2.0, 1.5, 0.5])
    scene.add_cells([[0, 1, 2], [0, 3, 2]], bulk_modulus=[20.0, 30.0])
    scene.set_balls(position=scene.position + rng.normal(size=(4, 2)) * 0.2)
    return scene


def joined() -> ts.Scene:
    """The same, and two more cells, of the other diagonal; three of the four act together. All have less than half of their rest
    volumes, and resist being crushed."""
    scene = square()
    scene.add_cells([[0, 1, 3], [1, 2, 3]], bulk_modulus=[25.0, 15.0], rest_volume=[0.4, 0.6])
    crushed = {"rest_volume": 2.5 * scene.rest_volume, "crush_modulus": np.array([40.0, 30.0, 10.0, 60.0])}
    scene.tables["cells"].replace(slice(None), together=[0, -1, 0, 0], **crushed)
    return scene


def elastic_forces(scene: ts.Scene, x: np.ndarray) -> np.ndarray:
    """-dE/dx (n, dim) by central differences of the energy that diagnostics gives."""
    force, step = np.zeros_like(x), 1e-5
    for i in range(x.shape[0]):
        for a in range(x.shape[1]):
            e = []
            for side in (1, -1):
                moved = x.copy()
                moved[i, a] += side * step
                e.append(diagnostics.energy(scene, moved, np.zeros_like(x)).spring)
            force[i, a] = (e[1] - e[0]) / (2 * step)
    return force


def gusts(wind, x: np.ndarray, time: float) -> np.ndarray:
    """Velocity of the air (3,) [m/s] at x (3,): waves of three lengths that go with the wind."""
    velocity = np.array(wind.velocity)
    along, one, two = axes(velocity)
    speed = float(np.linalg.norm(velocity))
    s, p, q = x @ along - speed * time, x @ one, x @ two
    angles = np.array(
        [2.0 * np.pi / wind.gust_length * (a * s + b * p + c * q) + phase for a, b, c, phase in GUST_WAVES]
    )
    waves = np.sin(angles).mean() * along + SIDEWAYS_GUSTS * np.cos(1.3 * angles).mean() * one
    return velocity + wind.gust * speed * waves


def wind_forces(scene: ts.Scene, x: np.ndarray, v: np.ndarray, h: float) -> np.ndarray:
    """Air on triangles (n, 3), one after another."""
    force, wind = np.zeros_like(x), scene.wind
    w = np.where(scene.pinned, 0.0, 1.0 / scene.mass)
    count = np.bincount(scene.triangles.ravel(), minlength=len(x))
    for t in scene.triangles:
        area = 0.5 * np.cross(x[t[1]] - x[t[0]], x[t[2]] - x[t[0]])
        size = np.linalg.norm(area)
        n = area / size
        u = gusts(wind, x[t].mean(axis=0), 0.0) - v[t].mean(axis=0)
        most = 0.5 / (h * (w[t] * count[t]).sum() / 9.0)
        across, slip = u @ n, u - (u @ n) * n
        f = min(0.5 * wind.density * wind.drag * size * abs(across), most) * across * n
        f += min(0.5 * wind.density * wind.skin_friction * size * np.linalg.norm(slip), most) * slip
        force[t] += f / 3.0
    return force


def bend_damping(scene: ts.Scene, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Against the rate of |sum w x|, whose gradient at ball i is w_i n."""
    force = np.zeros_like(v)
    for balls, w, c in zip(scene.bends, scene.bend_weights, scene.bend_damping):
        n = w @ x[balls] / np.linalg.norm(w @ x[balls])
        force[balls] -= c * (n @ (w @ v[balls])) * np.outer(w, n)
    return force


def bent() -> ts.Scene:
    """Balls with undamped bending elements that share pairs of balls, two of them rods, one ball pinned; no wind."""
    rng = np.random.default_rng(5)
    scene = ts.Scene(dim=3)
    scene.add_balls(rng.normal(size=(7, 3)), radius=0.01, mass=rng.uniform(0.5, 2.0, 7), pinned=[2])
    weights = rng.normal(size=(5, 4))
    weights[:, 3] = -weights[:, :3].sum(axis=1)
    corners = [[0, 1, 2, 3], [3, 2, 1, 4], [1, 5, 6, 0], [2, 2, 3, 5], [4, 4, 6, 1]]
    scene.add_bending(corners, weights=weights, stiffness=rng.uniform(1.0, 5.0, 5))
    return scene


@pytest.mark.parametrize("make", [box, joined, bent])
def test_forces_agree_with_numpy(make):
    scene = make()
    x, v = scene.position.copy(), scene.velocity.copy()
    force = elastic_forces(scene, x)
    if scene.wind is not None:
        force += wind_forces(scene, x, v, H) + bend_damping(scene, x, v)
    w = np.where(scene.pinned, 0.0, 1.0 / scene.mass)[:, None]
    with simulate(scene, ("ordered", "parallel"), integrator="symplectic_euler", dt=H, contacts="off") as sim:
        sim.step()
        change = (sim.velocity - v) / H
    scale = np.abs(w * force).max()
    assert scale > 1.0
    np.testing.assert_allclose(change, w * force, atol=scale * (1e-8 if F64 else 3e-3))


def test_a_strong_wind_takes_at_most_half_of_what_it_slows_in_a_step():
    """Light triangles, a gale and a long step: uncapped they would fly off faster than the wind."""
    scene = ts.Scene(dim=3)
    scene.add_balls([[0, 0, 0], [1, 0, 0], [0, 1, 0]], radius=0.01, mass=1e-4)
    scene.add_triangles([[0, 1, 2]])
    scene.add_wind((0.0, 0.0, 50.0))
    with simulate(scene, integrator="symplectic_euler", dt=0.1, contacts="off") as sim:
        sim.step()
        np.testing.assert_allclose(sim.velocity[:, 2], 25.0, rtol=1e-5)
        sim.step(60)
        assert np.all(sim.velocity[:, 2] <= 50.0 * (1 + 1e-6))
        assert np.all(sim.velocity[:, 2] > 49.0)


@pytest.mark.slow
def test_the_wind_on_light_cloth_does_not_depend_on_the_step():
    """A sail of 0.2 g/m^2, held at its border: it carries density / 2 drag A u^2, whatever it weighs."""
    scene, n = ts.Scene(dim=3), 4
    border = [i for i in range(n * n) if i % n in (0, n - 1) or i // n in (0, n - 1)]
    ts.shapes.cloth(
        scene,
        size=(0.3, 0.3),
        resolution=(n, n),
        mass_per_area=2e-4,
        stretch_stiffness=40.0,
        damping=0.02,
        pinned=border,
    )
    scene.add_wind((0.0, 4.0, 0.0), skin_friction=0.0)
    sag = []
    for part in (1, 4):
        with simulate(scene, dt="auto" if part == 1 else sag[0][0] / part, substeps=1, contacts="off") as sim:
            sim.run(0.1)
            sag.append((sim.dt, sim.position[:, 1].max()))
    assert sag[0][1] > 0.01
    assert sag[0][1] == pytest.approx(sag[1][1], rel=1e-3)


def closed(dim: int) -> ts.Scene:
    """Cells, in 3D bending and gas too, without wind, damping or pins."""
    scene = square() if dim == 2 else box()
    scene.wind = None
    scene.set_balls(pinned=False)
    if dim == 3:
        scene.set_bending(damping=0.0)
    return scene


def test_momentum_and_energy_are_kept_with_gas():
    scene = closed(3)
    with simulate(scene, dt=5e-4, contacts="off") as sim:
        start, momentum, angular = sim.energy(), sim.momentum(), np.atleast_1d(sim.angular_momentum())
        largest = start.spring + start.kinetic + 1.0
        sim.step(400)
        size = float(np.sum(scene.mass[:, None] * np.abs(sim.velocity))) + 1.0
        assert np.abs(sim.momentum() - momentum).max() < 40 * EPS * size * 20
        assert np.abs(np.atleast_1d(sim.angular_momentum()) - angular).max() < 40 * EPS * size * 40
        assert abs(sim.energy().total - start.total) < 2e-3 * largest
        assert sim.energy().kinetic > 0.05  # it moved


@pytest.mark.slow_where(dim=2)
@pytest.mark.parametrize("dim", [2, 3])
def test_a_cell_turned_inside_out_comes_back(dim):
    scene = ts.Scene(dim=dim)
    corners = np.concatenate([np.zeros((1, dim)), np.eye(dim)])
    scene.add_balls(corners, radius=0.01)
    scene.add_cells([list(range(dim + 1))], bulk_modulus=50.0)
    scene.add_springs([[i, j] for i in range(dim + 1) for j in range(i)], stiffness=1.0, damping=2.0)
    scene.set_balls(0, position=[0.8] * dim)  # through the opposite side
    assert diagnostics.inverted(scene, scene.position) == 1
    with simulate(scene, contacts="off") as sim:
        sim.run(6.0)
        assert diagnostics.inverted(scene, sim.position) == 0
        volume = cell_volumes(sim.position, scene.cells)
        np.testing.assert_allclose(volume, scene.rest_volume, rtol=0.03)


def hessian(scene: ts.Scene, x: np.ndarray) -> np.ndarray:
    n, step = x.size, 1e-5
    rows = []
    for k in range(n):
        sides = []
        for side in (1, -1):
            moved = x.copy().ravel()
            moved[k] += side * step
            sides.append(-elastic_forces(scene, moved.reshape(x.shape)).ravel())
        rows.append((sides[0] - sides[1]) / (2 * step))
    return np.array(rows)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_bound_is_above_the_exact_eigenvalue_at_rest(dim):
    scene = closed(dim)
    if dim == 3:  # at rest but for the gas, whose pressure is bounded coarsely
        scene.gases[0] = replace(scene.gases[0], pressure=1.0, outside=40.0)
        scene.set_balls(position=[[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    else:
        scene.set_balls(position=[[0, 0], [1, 0], [1, 1], [0, 1]])
    root = np.repeat(1.0 / np.sqrt(scene.mass), dim)
    exact = np.linalg.eigvalsh(root[:, None] * hessian(scene, scene.position) * root)[-1]
    bound = element_rates(scene).elastic
    assert exact * 1.0 < bound < 3.0 * exact, (exact, bound)


@pytest.mark.once
def test_rates_of_the_same_arrays_are_worked_out_once(monkeypatch):
    """A report asks for them for each method; any change is noticed."""
    products = []
    product = rates_of._product
    monkeypatch.setattr(rates_of, "_known", {})
    monkeypatch.setattr(rates_of, "_product", lambda *given: products.append(1) or product(*given))
    scene = box()
    first, many = element_rates(scene), len(products)
    assert element_rates(box()) == first
    assert len(products) == many > 0
    scene.set_balls(mass=2.0 * scene.mass)
    assert element_rates(scene).elastic == pytest.approx(first.elastic / 2.0)


def test_the_advised_step_counts_elements():
    scene = square()
    scene.add_springs([[0, 1], [1, 2]], stiffness=5.0)
    alone = ts.Scene(dim=2)
    alone.add_balls(scene.position, radius=0.1, mass=scene.mass)
    alone.add_springs([[0, 1], [1, 2]], stiffness=5.0)
    from taichi_sim.analysis.methods import named
    from taichi_sim.analysis.stability import stability

    for method in ("symplectic_euler", "verlet", "rk4"):
        assert stability(scene, named(method)).dt_any_shape < 0.7 * stability(alone, named(method)).dt_any_shape
    assert "cells" in stability(scene, named("verlet")).reason
    assert np.isinf(stability(scene, named("xpbd")).dt_any_shape)
    assert stability(scene, named("explicit_euler")).dt_any_shape == 0.0


@pytest.mark.parametrize("pressure", [40.0, -3.0, pytest.param(-5.0, marks=pytest.mark.slow)])
def test_a_gas_keeps_pressure_times_volume(pressure):
    """A cube of gas by itself: what pushes one side out, or in, is the pressure on its area, at any size; -5 is a vacuum."""
    scene, cube = ts.Scene(dim=3), np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], dtype=float)
    scene.add_balls(cube, radius=0.1, mass=2.0)
    scene.add_gas(box().gases[0].triangles, pressure=pressure, outside=5.0)
    assert scene.gases[0].volume == pytest.approx(1.0)
    with simulate(scene, integrator="symplectic_euler", dt=H, contacts="off") as sim:
        for factor in (0.9, 1.0, 1.2):
            sim.resume(ts.Snapshot(cube * factor, np.zeros_like(cube)))
            sim.step()
            for axis in range(3):
                side = cube[:, axis] == 1.0
                force = 2.0 * sim.velocity[side, axis].sum() / H
                assert force == pytest.approx(
                    ((pressure + 5.0) / factor**3 - 5.0) * factor**2, rel=1e-10 if F64 else 1e-5
                )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s.add_cells([[0, 1, 2, 2]], bulk_modulus=1.0), r"cells.corners\[0\].*twice"),
        (lambda s: s.add_cells([[0, 1, 2, 9]], bulk_modulus=1.0), r"cells.corners\[0\].*from 0 to 7"),
        (lambda s: s.add_cells([[0, 1, 2, 3]], bulk_modulus=1.0), r"cells.corners\[0\].*flat"),
        (lambda s: s.add_cells([[0, 1, 2, 4]], bulk_modulus=-1.0), r"cells.bulk_modulus: -1.0"),
        (lambda s: s.add_bending([[0, 1, 2, 3]], weights=[1, 1, 1, 1], stiffness=1.0), r"bending.weights\[0\].*sum"),
        (lambda s: s.add_wind((0, 0)), r"wind.velocity"),
        (lambda s: s.add_wind((0, 0, 1), gust=2.0), r"wind.gust: 2.0.*from 0 to 1"),
        (
            lambda s: s.add_gas(box().gases[0].triangles, pressure=-5.1, outside=5.0),
            r"gases.pressure: -5.1 is not allowed; it must be at least -5",
        ),
        (lambda s: s.add_gas([[0, 1, 2]], pressure=1.0), r"gases.triangles.*edge from ball 0 to 1"),
        (  # a triangle given twice counted twice in the volume, which then depended on where the origin is
            lambda s: s.add_gas(box().gases[0].triangles[[*range(12), 4]], pressure=1.0),
            r"gases.triangles.*edge from ball \d to \d has 3$",
        ),
        (
            lambda s: s.add_gas(np.tile(box().gases[0].triangles, (2, 1)), pressure=1.0),
            r"gases.triangles.*edge from ball \d to \d has 4$",
        ),
        (lambda s: s.attach([0, 1], [2], stiffness=1.0), r"attachments.other: names 1 balls and attachments.one 2"),
        (lambda s: s.add_springs([[0, 1]], stiffness=1.0, break_strain=0.0), r"springs.break_strain: 0.0"),
        (
            lambda s: s.add_springs([[0, 1]], stiffness=1.0, rest_length=0.0, break_strain=1.0),
            r"springs.break_strain\[0\].*rest length 0",
        ),
        (
            lambda s: s.add_springs([[0, 1]], stiffness=1.0, break_strain=1.0, collides=True),
            r"springs.break_strain\[0\].*stick",
        ),
    ],
)
def test_wrong_arguments_are_named(change, words):
    scene = ts.Scene(dim=3)
    scene.add_balls([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], radius=0.1)
    assert_unchanged(scene, change, words)


def test_two_dimensions_have_no_wind_and_no_gas():
    scene = square()
    with pytest.raises(ts.SceneError, match="dim = 3"):
        scene.add_wind((1.0, 0.0))
    with pytest.raises(ts.SceneError, match="dim = 3"):
        scene.add_gas([[0, 1, 2]], pressure=1.0)
