"""Laws that hold for every kind of element, on bodies of each side by side: forces, damping, momenta, tearing, implicit steps."""

import itertools

import numpy as np
import pytest
from element_blocks import add_block, block, blocks, downhill, kinds, lattice, mesh
from physics_support import EPS, F64, simulate
from scene_files import assert_unchanged

import taichi_sim as ts
from taichi_sim.analysis import diagnostics
from taichi_sim.analysis.element_rates import element_rates
from taichi_sim.analysis.methods import named
from taichi_sim.analysis.stability import stability
from taichi_sim.integrators import ImplicitEuler
from taichi_sim.scene.bricks import at_rest
from taichi_sim.scene.membranes import MEMBRANES
from taichi_sim.scene.membranes import shape_gradients as plane_gradients
from taichi_sim.scene.neo_hookean import lame
from taichi_sim.scene.solids import averages, operators, shape_gradients

SHORT = 1e-6 if F64 else 1e-3  # s, a step in which nothing moves
DAMPING = 0.4

each_dim = pytest.mark.parametrize("dim", [2, 3])


def forces(scene, x, v):
    """Forces (n, dim) [N], by the change of velocities in a short step from x and v (n, dim)."""
    with simulate(scene, integrator="symplectic_euler", dt=SHORT, substeps=1, contacts="off") as sim:
        sim.resume(ts.Snapshot(x, v))
        sim.step(1)
        return (sim.velocity - v) / SHORT * scene.mass[:, None]


def own(scene, kind, off=0.05, damping=DAMPING):
    """The scene of the body of this kind alone."""
    return block(kind, scene.dim, off, damping)


@each_dim
def test_forces_are_downhill_and_damping_does_not_resist_rotation(dim):
    scene, balls = blocks(dim, damping=DAMPING)
    spin = np.zeros((dim, dim))
    spin[0, 1], spin[1, 0] = -3.0, 3.0
    for v in (0.0 * scene.position, scene.position @ spin.T):
        found = forces(scene, scene.position, v)
        for kind, at in balls.items():
            expected = downhill(own(scene, kind))
            scale = np.abs(expected).max()
            assert np.abs(found[at] - expected).max() < (1e-5 if F64 else 3e-3) * scale, kind
            if F64:
                assert np.abs(found[at].sum(axis=0)).max() < 1e-7 * scale, kind


def lost(scene, kind, v):
    """Power [W] that the damping of a body of this kind, at rest in its shape, takes at velocities v (n, dim)."""
    x, dim = scene.position, scene.dim
    if kind == "springs":
        i, j = scene.pairs.T
        along = (x[j] - x[i]) / np.linalg.norm(x[j] - x[i], axis=1, keepdims=True)
        return scene.damping @ np.sum(along * (v[j] - v[i]), axis=1) ** 2
    if kind == "bends":
        bend, rate = (np.einsum("bk,bki->bi", scene.bend_weights, one[scene.bends]) for one in (x, v))
        return scene.bend_damping @ (np.sum(bend * rate, axis=1) / np.linalg.norm(bend, axis=1)) ** 2
    if "membranes" in kind:
        f, df = (MEMBRANES.gradients(scene, one) for one in (x, v))
        e = np.swapaxes(f, 1, 2) @ df
        a, b, ab = e[:, 0, 0], e[:, 1, 1], e[:, 0, 1] + e[:, 1, 0]
        law = scene.membrane_warp * a**2 + scene.membrane_weft * b**2 + 2 * scene.membrane_coupling * a * b
        area = plane_gradients(scene.membrane_rest)[1]
        return (area * scene.membrane_damping) @ (law + scene.membrane_shear * ab**2)
    if kind == "bricks":
        rows = zip(scene.bricks, scene.brick_size, scene.brick_modulus, scene.brick_ratio, scene.brick_viscosity)
        return sum(
            loss / lame(dim, modulus, ratio)[0] * v[own].ravel() @ at_rest(size, modulus, ratio)[1] @ v[own].ravel()
            for own, size, modulus, ratio, loss in rows
        )
    if kind == "solids":
        volume = shape_gradients(scene.solid_rest)[1]
        modulus, ratio, loss = scene.solid_modulus, scene.solid_ratio, scene.solid_viscosity
        at = averages(scene.solids, volume, modulus, ratio, loss)
        mean, _, here = operators(scene.solid_rest, at)
        rate = (mean @ v).reshape(len(x), dim, dim)
        return DAMPING * here @ np.sum(rate * (rate + np.swapaxes(rate, 1, 2)), axis=(1, 2))
    return 0.0


@each_dim
def test_damping_is_the_derivative_of_the_power_that_it_takes(dim):
    """At rest in their shapes; bricks and solids take twice their viscosity times the square of a uniform rate of strain."""
    scene, balls = blocks(dim, off=0.0, damping=DAMPING)
    v = scene.velocity
    found = forces(scene, scene.position, v) - forces(scene, scene.position, 0.0 * v)
    rate = np.random.default_rng(dim).normal(size=(dim, dim))
    strain = 0.5 * (rate + rate.T)
    for kind, at in balls.items():
        alone = own(scene, kind, 0.0)
        expected = np.zeros_like(v[at])
        for k in np.ndindex(*expected.shape):
            ahead = v[at].copy()
            ahead[k] += 0.5
            behind = v[at].copy()
            behind[k] -= 0.5
            expected[k] = 0.5 * (lost(alone, kind, behind) - lost(alone, kind, ahead))
        scale = np.abs(expected).max() + 0.1
        assert np.abs(found[at] - expected).max() < (1e-5 if F64 else 5e-3) * scale, kind
        if kind in ("bricks", "solids"):
            volume = alone.brick_size.prod(axis=1) if kind == "bricks" else shape_gradients(alone.solid_rest)[1]
            uniform = 2 * DAMPING * np.sum(strain**2) * volume.sum()
            assert lost(alone, kind, alone.position @ rate.T) == pytest.approx(uniform, rel=1e-9), kind


def quantities(scene, kind, x, v):
    """Energy, and linear and angular momentum, of the body of a kind alone at x and v (k, dim)."""
    alone = own(scene, kind)
    momenta = diagnostics.momentum(alone, v), diagnostics.angular_momentum(alone, x, v)
    return diagnostics.energy(alone, x, v).total, np.concatenate([np.atleast_1d(one) for one in momenta])


def watched(sim, scene, balls, steps):
    """Energies (6,) and momenta (6, ...) of each kind at the start and after five times so many steps."""
    found = {kind: [] for kind in balls}
    for k in range(6):
        if k:
            sim.step(steps)
        x, v = sim.position, sim.velocity
        for kind, at in balls.items():
            found[kind].append(quantities(scene, kind, x[at], v[at]))
    return {kind: [np.array(one) for one in zip(*rows)] for kind, rows in found.items()}


@each_dim
def test_damping_takes_energy_and_keeps_momenta(dim):
    scene, balls = blocks(dim, damping=DAMPING)
    with simulate(scene, integrator="symplectic_euler", dt=1e-4, substeps=1, contacts="off") as sim:
        for kind, (energies, momenta) in watched(sim, scene, balls, 60).items():
            most = 1e-5 if "cells" in kind else -1e-3  # cells have no damping
            assert (np.diff(energies) < most * energies[0]).all(), kind
            assert np.ptp(momenta, axis=0).max() < 1000 * EPS * np.abs(momenta).max(), kind


@pytest.mark.long_in("f32")
@each_dim
def test_energy_and_momenta_are_kept_without_damping(dim):
    scene, balls = blocks(dim)
    with simulate(scene, dt=5e-4, substeps=1, contacts="off") as sim:
        for kind, (energies, momenta) in watched(sim, scene, balls, 80).items():
            assert np.ptp(energies) < 2e-3 * energies[0], kind
            assert np.ptp(momenta, axis=0).max() < 1000 * EPS * np.abs(momenta).max(), kind
        assert np.abs(sim.position - scene.position).max() > 0.05


@pytest.mark.skipif(not F64, reason="rounding hides the small steps")
def test_verlet_has_order_2():
    places, smooth = [], [kind for kind in kinds(3) if kind != "crushed cells"]
    for halving in range(4):
        scene, balls = blocks(3, damping=0.02, names=smooth)
        with simulate(scene, integrator="verlet", dt=4e-3 / 2**halving, substeps=1, contacts="off") as sim:
            sim.step(80 * 2**halving)
            places.append(sim.position)
    for kind, at in balls.items():
        errors = [np.linalg.norm(one[at] - other[at]) for one, other in itertools.pairwise(places)]
        assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx([2.0, 2.0], abs=0.05), kind


@pytest.mark.once
def test_both_drivers_give_the_same_bits():
    found = []
    for driver in ("fused", "parallel"):
        with simulate(blocks(3, damping=0.02)[0], ("ordered", driver), dt=1e-3, substeps=1, contacts="off") as sim:
            sim.step(100)
            found.append(sim.position)
    np.testing.assert_array_equal(*found)


@each_dim
def test_elements_with_a_torn_side_act_no_more(dim):
    """The others go on; a ball that has lost all of its elements is free."""
    names = [kind for kind in kinds(dim) if kind not in ("springs", "bends")]
    scene, torn = ts.Scene(dim=dim, gravity=(0.0,) * dim), {}
    for k, kind in enumerate(names):
        alone = ts.Scene(dim=dim, gravity=(0.0,) * dim)
        for one, place in ((scene, 2.0 * k), (alone, 0.0)):
            balls = add_block(one, kind, 0.05, place=place)
            corners = (
                balls[0] + lattice((2, 1, 2)[:dim])[1] if kind == "bricks" else balls[0] + mesh((3, 2, 2)[:dim])[1]
            )
            sides = np.unique(np.sort(corners[[0, 1, -1], :2], axis=1), axis=0)
            one.add_springs(sides, stiffness=0.0, rest_length=1e-3, break_strain=1.0)
        torn[kind] = alone, balls
    with simulate(scene, integrator="symplectic_euler", dt=SHORT, substeps=1, contacts="off") as sim:
        sim.step(1)
        assert sim.torn.all()
        before, at = sim.velocity, sim.position
        expected = diagnostics.energy(scene, at, before, torn=np.ones(scene.n_springs, dtype=bool)).spring
        assert sim.energy().spring == pytest.approx(expected, rel=1e-5)
        sim.step(1)
        found = (sim.velocity - before) / SHORT * scene.mass[:, None]
    first = 0
    for k, kind in enumerate(names):
        alone = torn[kind][0]
        own_balls = slice(first, first := first + alone.n_balls)
        place = at[own_balls] - 2.0 * k * np.eye(dim)[0]
        expected = downhill(alone, place, np.ones(alone.n_springs, dtype=bool))
        whole = downhill(alone, place, np.zeros(alone.n_springs, dtype=bool))
        scale = np.abs(whole).max()
        assert np.abs(expected - whole).max() > 0.05 * scale, kind
        assert np.abs(found[own_balls] - expected).max() < (1e-5 if F64 else 3e-3) * scale, kind


@pytest.mark.long_in("f32")
@pytest.mark.slow_where(dim=3)
@each_dim
def test_a_step_of_implicit_euler_solves_its_equation(dim):
    """Of elements so deformed that some resist with a negative stiffness: m (v - v0) = h F(x + h v)."""
    h = 0.5
    scene, balls = blocks(dim, off=0.15)
    method = ImplicitEuler(tolerance=1e-11 if F64 else 1e-5)
    with simulate(scene, integrator=method, dt=h, substeps=1, contacts="off") as sim:
        assert sim.stability().dt_any_shape == np.inf
        sim.step(1)
        found = sim.velocity
    for kind, at in balls.items():
        alone = block(kind, dim, 0.15)
        left = [
            alone.mass[:, None] * (v - alone.velocity) - h * downhill(alone, alone.position + h * v)
            for v in (found[at], alone.velocity)
        ]
        assert np.abs(left[0]).max() < (1e-7 if F64 else 1e-3) * np.abs(left[1]).max(), kind


@pytest.mark.once
@each_dim
def test_only_methods_that_solve_for_elements_have_no_longest_step(dim):
    for kind in kinds(dim):
        scene = block(kind, dim)
        longest = {name: stability(scene, named(name)).dt_any_shape for name in ("implicit_euler", "tr_bdf2", "xpbd")}
        assert set(longest.values()) == {np.inf}, kind
        assert stability(scene, named("verlet")).dt_any_shape < 1.0, kind


@pytest.mark.once
def test_a_body_that_is_turned_inside_out_comes_back():
    """Bodies of bricks and of solids, flat, inside out and scrambled at the start; none of them at rest."""
    rng = np.random.default_rng(8)
    scene = ts.Scene(dim=3, gravity=(0.0, 0.0, 0.0))
    for kind, (points, corners) in (("bricks", lattice((3, 3, 3))), ("solids", mesh((3, 3, 3), 0.1))):
        starts = [points * (1, 0, 1), points * (1, -0.5, 1), points + rng.uniform(-1, 1, points.shape)]
        for k, start in enumerate(starts):
            aside = np.array([10.0 * k, 0.0, 10.0 * (kind == "solids")])
            balls = scene.add_balls(points + aside, radius=0.1, body=scene.new_body())
            law = {"young_modulus": 50.0, "poisson_ratio": 0.4, "viscosity": 10.0}
            getattr(scene, f"add_{kind}")(balls[corners], **law)
            scene.set_balls(balls, position=start + 1e-3 * rng.normal(size=points.shape) + aside)
    with simulate(scene, dt="auto", contacts="off") as sim:
        assert sim.inverted() > 310
        sim.run(20.0)
        assert sim.inverted() == 0
        assert sim.energy().total < 1e-4 * 50 * 81


@pytest.mark.once
@each_dim
@pytest.mark.parametrize("kind", ["bricks", "solids"])
def test_small_strains_have_the_given_moduli(kind, dim):
    """Any uniform strain, in any orientation, stores what Hooke's law says."""
    rng = np.random.default_rng(5)
    turn = np.linalg.qr(rng.normal(size=(dim, dim)))[0]
    turn[:, 0] *= np.linalg.det(turn)
    scene = block(kind, dim, off=0.0)
    x, e = scene.position, rng.normal(size=(dim, dim))
    e = 1e-5 * (e + e.T)
    stored = diagnostics.energy(scene, (x + x @ e) @ turn.T, 0.0 * x).spring
    if kind == "bricks":
        modulus, ratio, volume = scene.brick_modulus, scene.brick_ratio, scene.brick_size.prod(axis=1)
    else:
        modulus, ratio, volume = scene.solid_modulus, scene.solid_ratio, shape_gradients(scene.solid_rest)[1]
    mu, lam = lame(dim, modulus, ratio)
    assert stored == pytest.approx((mu * np.sum(e * e) + 0.5 * lam * np.trace(e) ** 2) @ volume, rel=1e-3)


@pytest.mark.once
@each_dim
def test_solids_that_cannot_move_have_no_rate(dim):
    scene = block("solids", dim, 0.0, damping=3.0)
    scene.set_balls(pinned=np.ones(scene.n_balls, dtype=bool))
    assert element_rates(scene)[:2] == (0.0, 0.0)


SOLID = {"corners": [[0, 1, 2]], "young_modulus": 1.0, "poisson_ratio": 0.3}
BRICK = SOLID | {"corners": [[0, 2, 1, 4]]}


@pytest.mark.once
@pytest.mark.parametrize(
    ("kind", "given", "message"),
    [
        ("solids", {"corners": [[0, 1, 1]]}, r"solids.corners\[0\].*twice"),
        ("solids", {"corners": [[0, 1, 3]]}, r"solids.corners\[0\].*is flat now; give its rest"),
        ("solids", {"poisson_ratio": 0.9999}, r"solids.poisson_ratio.*0.9996"),
        ("solids", {"young_modulus": 0.0}, r"solids.young_modulus.*greater than 0"),
        ("solids", {"rest": [[0, 0], [0, 1], [1, 0]]}, r"solids.corners\[0\].*no volume at rest"),
        ("solids", {"rest": [1.0, 2.0]}, r"solids.rest: shape \(2,\) does not fit; it must be \(1, 3, 2\)"),
        ("solids", {"viscosity": -1.0}, r"solids.viscosity"),
        ("solids", {"rest": [[[0, 0], [1, 0], [0, np.nan]]]}, r"solids.rest\[0\]\[2\]\[1\]: nan is not allowed"),
        ("solids", {"rest": "flat"}, r"solids.rest: 'flat' is not a list of 3 2-vectors for each of 1"),
        ("solids", {"rest": [[[0, 0], [1, 0], [0]]]}, r"solids.rest: .* is not a list of 3 2-vectors"),
        ("bricks", {"corners": [[0, 1, 2, 2]]}, r"bricks.corners\[0\].*twice"),
        ("bricks", {"corners": [[0, 2, 4, 1]]}, r"bricks.corners\[0\].*no box.*order"),
        ("bricks", {"poisson_ratio": 0.9999}, r"bricks.poisson_ratio.*0.9996"),
        ("bricks", {"young_modulus": 0.0}, r"bricks.young_modulus.*greater than 0"),
        ("bricks", {"rest_size": [1.0, -1.0]}, r"bricks.rest_size"),
        ("bricks", {"rest_size": 2.0}, r"bricks.rest_size: shape \(\) does not fit; it must be \(2,\) or \(1, 2\)"),
        ("bricks", {"rest_size": [1.0, 2.0, 3.0]}, r"bricks.rest_size: shape \(3,\) does not fit; it must be"),
        ("bricks", {"rest_size": [True, 1.0]}, r"bricks.rest_size: .* is not a list of 2-vectors"),
        ("bricks", {"viscosity": -1.0}, r"bricks.viscosity"),
    ],
)
def test_refusals(kind, given, message):
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 0], [1, 0], [0, 1], [2, 0], [1, 1]], radius=0.1)
    arguments = (BRICK if kind == "bricks" else SOLID) | given
    assert_unchanged(scene, lambda scene: getattr(scene, f"add_{kind}")(**arguments), message)
