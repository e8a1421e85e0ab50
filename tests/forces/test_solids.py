"""Solids: their forces against their energy, what they conserve, bars and patches against theory, and how stiff they may be."""

import itertools

import numpy as np
import pytest
from physics_support import EPS, F64, simulate
from scipy import sparse
from scipy.sparse.linalg import spsolve

import taichi_sim as ts
from taichi_sim.analysis import diagnostics
from taichi_sim.analysis.element_rates import element_rates
from taichi_sim.forces.solids import Pairs
from taichi_sim.scene.cells import cell_volumes
from taichi_sim.scene.neo_hookean import STRETCHED, lame
from taichi_sim.scene.solids import averages, operators, shape_gradients
from tests.forces.test_bricks import downhill, forces


def mesh(number, off: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, dim) and elements (e, dim + 1) of so many boxes along each axis, each cut along a diagonal; off: how far points
    within may lie beside the lattice."""
    dim, rng = len(number), np.random.default_rng(4)
    points = np.array(list(itertools.product(*(range(n + 1) for n in number))))
    boxes = np.array(list(itertools.product(*map(range, number))))
    places = []
    for axes in itertools.permutations(range(dim)):
        way = np.cumsum([np.zeros(dim, dtype=int), *np.eye(dim, dtype=int)[list(axes)]], axis=0)
        places.append([np.ravel_multi_index(tuple((boxes + one).T), [n + 1 for n in number]) for one in way])
    corners = np.concatenate([np.stack(one, axis=1) for one in places])
    turned = cell_volumes(points, corners) < 0
    corners[turned] = corners[turned][:, [1, 0, *range(2, dim + 1)]]
    within = (points > 0) & (points < np.array(number))
    return points + off * rng.uniform(-1, 1, points.shape) * within, corners


def block(dim: int, off: float = 0.05, viscosity: float = 0.0) -> ts.Scene:
    """A few solids of two materials, deformed and in motion."""
    rng = np.random.default_rng(3 + dim)
    points, corners = mesh((3, 2, 2)[:dim], 0.2)
    scene = ts.Scene(dim=dim, gravity=(0.0,) * dim)
    x = points * np.array([0.3, 0.5, 0.7])[:dim]
    scene.add_balls(x, radius=0.01, mass=rng.uniform(0.5, 2.0, len(x)), velocity=rng.normal(size=x.shape))
    ratio = np.where(np.arange(len(corners)) % 2, 0.45, 0.2)
    scene.add_solids(corners, young_modulus=30.0, poisson_ratio=ratio, viscosity=viscosity)
    scene.set_balls(position=x + off * rng.normal(size=x.shape))
    return scene


@pytest.mark.parametrize("dim", [2, 3])
def test_forces_are_downhill(dim) -> None:
    scene = block(dim)
    found, expected = forces(scene), downhill(scene)
    scale = np.abs(expected).max()
    assert np.abs(found - expected).max() < (1e-6 if F64 else 1e-3) * scale
    if F64:
        assert np.abs(found.sum(axis=0)).max() < 1e-8 * scale


@pytest.mark.parametrize("dim", [2, 3])
def test_viscosity_takes_energy_and_keeps_momenta(dim) -> None:
    scene = block(dim, viscosity=0.4)
    scene.tables["solids"].replace(slice(1), viscosity=0.0)
    with simulate(scene, integrator="symplectic_euler", dt=1e-4, contacts="off") as sim:
        energies, momenta = [], []
        for _ in range(5):
            energies.append(sim.energy().total)
            momenta.append(np.append(sim.momentum(), sim.angular_momentum()))
            sim.step(60)
    assert (np.diff(energies) < -1e-3 * energies[0]).all()
    assert np.ptp(momenta, axis=0).max() < 300 * EPS * np.abs(momenta).max()


@pytest.mark.parametrize("dim", [2, 3])
def test_viscosity_does_not_resist_rotation(dim) -> None:
    scene = block(dim, viscosity=20.0)
    spin = np.zeros((dim, dim))
    spin[0, 1], spin[1, 0] = -1.0, 1.0
    scene.set_balls(velocity=scene.position @ spin.T)
    expected = downhill(scene)
    assert np.abs(forces(scene) - expected).max() < (1e-5 if F64 else 3e-3) * np.abs(expected).max()


@pytest.mark.parametrize("dim", [2, 3])
def test_elements_with_a_torn_side_act_no_more(dim) -> None:
    """The others go on; a ball that has lost all of its elements is free."""
    scene = block(dim)
    sides = np.unique(np.sort(scene.solids[[0, 1, 9], :2], axis=1), axis=0)
    lonely = np.flatnonzero(np.bincount(scene.solids.ravel()) == 1)
    if len(lonely):
        of = scene.solids[(scene.solids == lonely[0]).any(axis=1)][0]
        sides = np.concatenate([sides, [[lonely[0], next(k for k in of if k != lonely[0])]]])
    scene.add_springs(sides, stiffness=0.0, rest_length=1e-3, break_strain=1.0)
    torn = np.ones(len(sides), dtype=bool)
    h = 1e-6 if F64 else 1e-3
    with simulate(scene, integrator="symplectic_euler", dt=h, substeps=1, contacts="off") as sim:
        sim.step(1)
        assert sim.torn.all()
        before, at = sim.velocity, sim.position
        assert sim.energy().spring == pytest.approx(diagnostics.energy(scene, at, before, torn=torn).spring, rel=1e-5)
        sim.step(1)
        found = (sim.velocity - before) / h * scene.mass[:, None]
    expected = downhill(scene, at, torn)
    assert np.abs(found - expected).max() < (1e-5 if F64 else 2e-3) * np.abs(expected).max()


def test_both_drivers_give_the_same_bits() -> None:
    found = []
    for driver in ("fused", "parallel"):
        with simulate(block(3, viscosity=0.02), ("ordered", driver), dt=1e-3, contacts="off") as sim:
            sim.step(100)
            found.append(sim.position)
    np.testing.assert_array_equal(*found)


@pytest.mark.skipif(not F64, reason="rounding hides the small steps")
def test_verlet_has_order_2() -> None:
    places = []
    for halving in range(4):
        h = 4e-3 / 2**halving
        with simulate(block(3, viscosity=0.02), integrator="verlet", dt=h, substeps=1, contacts="off") as sim:
            sim.step(80 * 2**halving)
            places.append(sim.position)
    errors = [np.linalg.norm(one - other) for one, other in itertools.pairwise(places)]
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx([2.0, 2.0], abs=0.02)


@pytest.mark.once
@pytest.mark.parametrize("dim", [2, 3])
def test_small_strains_have_the_given_moduli(dim) -> None:
    """Any uniform strain, in any orientation, stores what Hooke's law says."""
    rng = np.random.default_rng(5)
    turn = np.linalg.qr(rng.normal(size=(dim, dim)))[0]
    turn[:, 0] *= np.linalg.det(turn)
    scene = block(dim, off=0.0)
    x, e = scene.position, rng.normal(size=(dim, dim))
    e = 1e-5 * (e + e.T)
    stored = diagnostics.energy(scene, (x + x @ e) @ turn.T, 0.0 * x).spring
    mu, lam = lame(dim, scene.solid_modulus, scene.solid_ratio)
    volume = shape_gradients(scene.solid_rest)[1]
    assert stored == pytest.approx((mu * np.sum(e * e) + 0.5 * lam * np.trace(e) ** 2) @ volume, rel=1e-3)


@pytest.mark.once
@pytest.mark.parametrize("dim", [2, 3])
def test_a_patch_is_exact(dim) -> None:
    """Averages of a uniform gradient are that gradient, and its forces balance at the balls within, to rounding."""
    points, corners = mesh((3, 4, 3)[:dim], 0.2)
    gradient, volume = shape_gradients(points[corners])
    pairs = Pairs(corners, gradient, volume, np.full(len(points), 3.0))
    given = np.random.default_rng(6).normal(size=(dim, dim))
    apart = (points[pairs.other] - points[pairs.own]) @ given.T
    mean = np.zeros((len(points), dim, dim))
    np.add.at(mean, pairs.own, apart[:, :, None] * pairs.slope[:, None])
    assert mean / pairs.volume[:, None, None] == pytest.approx(np.broadcast_to(given, mean.shape), abs=1e-12)
    force = np.zeros_like(points)
    np.add.at(force, pairs.own, pairs.back @ given.T + pairs.link[:, None] * apart)
    within = ((points > 0) & (points < points.max(axis=0))).all(axis=1)
    assert within.any()
    assert np.abs(force[within]).max() < 1e-12 * np.abs(force).max()


def stiffness(points, corners, modulus, ratio, viscosity=0.0):
    """Stiffness and damping at rest, (n dim, n dim) sparse, of solids of one material."""
    each = np.ones(len(corners))
    at = averages(corners, shape_gradients(points[corners])[1], modulus * each, ratio * each, viscosity * each)
    averaged, link, here = operators(points[corners], at)
    dim, mu, lam = points.shape[1], at.mu[0], at.lam[0]
    one = np.eye(dim)
    swap = np.einsum("aj,ib->aibj", one, one).reshape(dim * dim, -1)
    trace = np.outer(one.ravel(), one.ravel())
    averaged, link, here = sparse.kron(averaged, one), sparse.kron(link, one), sparse.diags(here)
    law = mu * (np.eye(dim * dim) + swap) + lam * trace - at.own[0] * np.eye(dim * dim)
    loss = averaged.T @ sparse.kron(here, viscosity * (np.eye(dim * dim) + swap)) @ averaged
    return averaged.T @ sparse.kron(here, law) @ averaged + link, loss


def bar(across: int, ratio: float, length: float = 10.0) -> float:
    """Deflection of a bar with one end held and a force across at the other, in parts of Timoshenko's."""
    points, corners = mesh((int(length * across), across, across), 0.1)
    points = points / across
    matrix = stiffness(points, corners, 1.0, ratio)[0].tocsc()
    load = np.zeros_like(points)
    ends = points[:, 0] == length
    faces = np.prod(np.where(points[:, 1:] % 1 == 0, 0.5, 1.0), axis=1)
    load[ends, 1] = faces[ends] / faces[ends].sum()
    free = np.flatnonzero(np.repeat(points[:, 0] > 0, 3))
    u = np.zeros(points.size)
    u[free] = spsolve(matrix[free][:, free], load.ravel()[free])
    shear = 10 * (1 + ratio) / (12 + 11 * ratio) / (2 * (1 + ratio))
    return float(load.ravel() @ u / (4 * length**3 + length / shear))


@pytest.mark.once
@pytest.mark.parametrize(
    ("across", "within", "ratios"), [(2, 0.12, (0.25, 0.45, 0.49)), (4, 0.05, (0.25, 0.45, 0.49, 0.4999))]
)
def test_bars_bend_as_theory_says(across, within, ratios) -> None:
    """Two across are too few for a bar that cannot change its volume: 0.69 at a ratio of 0.4999."""
    for ratio in ratios:
        assert bar(across, ratio) == pytest.approx(1.0, abs=within), ratio


@pytest.mark.once
@pytest.mark.parametrize("dim", [2, 3])
def test_largest_rate_is_that_of_the_whole(dim) -> None:
    points, corners = mesh((4, 3, 3)[:dim], 0.2)
    scene = ts.Scene(dim=dim)
    mass = np.random.default_rng(2).uniform(1.0, 2.0, len(points))
    scene.add_balls(points, radius=0.1, mass=mass)
    scene.add_solids(corners, young_modulus=7.0, poisson_ratio=0.45, viscosity=0.3)
    root = sparse.diags(np.repeat(mass, dim) ** -0.5)
    parts = stiffness(points, corners, 7.0, 0.45, 0.3)
    exact = [np.linalg.eigvalsh((root @ part @ root).toarray())[-1] for part in parts]
    rates = element_rates(scene)
    for found, rate in zip((rates.elastic, rates.damping), exact):
        assert rate * (1 - 1e-9) < found / STRETCHED < 1.05 * rate


@pytest.mark.once
@pytest.mark.parametrize("dim", [2, 3])
def test_solids_that_cannot_move_have_no_rate(dim) -> None:
    scene = block(dim, 0.0, viscosity=3.0)
    scene.set_balls(pinned=np.ones(scene.n_balls, dtype=bool))
    assert element_rates(scene)[:2] == (0.0, 0.0)


@pytest.mark.once
def test_viscous_solids_that_cannot_move_have_no_loss() -> None:
    points, corners = mesh((1, 1))
    scene = ts.Scene(dim=2)
    for viscosity in (2.0, 0.0):
        first = scene.n_balls
        scene.add_balls(points + np.array([first, 0.0]), radius=0.01, pinned=viscosity > 0.0)
        scene.add_solids(corners + first, young_modulus=50.0, poisson_ratio=0.1, viscosity=viscosity)
    rates = element_rates(scene)
    assert rates.damping == 0.0 < rates.elastic


@pytest.mark.once
def test_solids_come_back_from_a_file(tmp_path) -> None:
    scene = block(3, viscosity=0.4)
    scene.save(tmp_path / "solids.toml")
    again = ts.load_scene(tmp_path / "solids.toml")
    for name in ("solids", "solid_modulus", "solid_ratio", "solid_viscosity", "solid_rest"):
        np.testing.assert_array_equal(getattr(again, name), getattr(scene, name))


def test_a_body_that_is_turned_inside_out_comes_back() -> None:
    """Flat, inside out and scrambled at the start; none of it at rest."""
    points, corners = mesh((3, 3, 3), 0.1)
    rng = np.random.default_rng(8)
    starts = [points * (1, 0, 1), points * (1, -0.5, 1), points + rng.uniform(-1, 1, points.shape)]
    scene = ts.Scene(dim=3, gravity=(0.0, 0.0, 0.0))
    for k, start in enumerate(starts):
        aside = np.array([10.0 * k, 0.0, 0.0])
        balls = scene.add_balls(points + aside, radius=0.1, body=scene.new_body())
        scene.add_solids(balls[corners], young_modulus=50.0, poisson_ratio=0.4, viscosity=10.0)
        scene.set_balls(balls, position=start + 1e-3 * rng.normal(size=points.shape) + aside)
    with simulate(scene, dt="auto", contacts="off") as sim:
        assert sim.inverted() > 250
        sim.run(20.0)
        assert sim.inverted() == 0
        assert sim.energy().total < 1e-4 * 50 * 81


@pytest.mark.once
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"corners": [[0, 1, 1]]}, r"solids.corners\[0\].*twice"),
        ({"corners": [[0, 1, 3]]}, r"solids.corners\[0\].*is flat now; give its rest"),
        ({"poisson_ratio": 0.9999}, r"solids.poisson_ratio.*0.9996"),
        ({"young_modulus": 0.0}, r"solids.young_modulus.*greater than 0"),
        ({"rest": [[0, 0], [0, 1], [1, 0]]}, r"solids.corners\[0\].*no volume at rest"),
        ({"rest": [1.0, 2.0]}, r"solids.rest: shape \(2,\) does not fit; it must be \(1, 3, 2\)"),
        ({"viscosity": -1.0}, r"solids.viscosity"),
        ({"rest": [[[0, 0], [1, 0], [0, np.nan]]]}, r"solids.rest\[0\]\[2\]\[1\]: nan is not allowed"),
        ({"rest": "flat"}, r"solids.rest: 'flat' is not a list of 3 2-vectors for each of 1"),
        ({"rest": [[[0, 0], [1, 0], [0]]]}, r"solids.rest: .* is not a list of 3 2-vectors"),
    ],
)
def test_refusals(arguments, message) -> None:
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 0], [1, 0], [0, 1], [2, 0]], radius=0.1)
    with pytest.raises(ts.SceneError, match=message):
        scene.add_solids(**{"corners": [[0, 1, 2]], "young_modulus": 1.0, "poisson_ratio": 0.3} | arguments)
    assert len(scene.solids) == 0
