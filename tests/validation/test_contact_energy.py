"""Kinetic energy over 1e4 random configurations: what one solve of the contacts does to it (physics notes, section 6)."""

import numpy as np
import pytest
from physics_clusters import PLACES, Clusters
from physics_support import F64, each_dim, simulate

import taichi_sim as ts

pytestmark = pytest.mark.long_in("f32")

BATCHES = 10_000 // PLACES
ROUNDING = 1e-13 if F64 else 1e-5
LONG = pytest.mark.long


def changes(clusters: Clusters, contacts: str, passes: int) -> np.ndarray:
    """Relative change of energy of each configuration in one step from rest impulses."""
    settings = {"contacts": contacts, "contact_iterations": passes, "integrator": "symplectic_euler", "dt": 1e-3}
    with simulate(clusters.scene, **settings) as sim:
        return clusters.gains(sim, BATCHES)


@pytest.mark.long
@pytest.mark.parametrize(
    ("dim", "friction", "passes"),
    [
        (2, True, 1),
        pytest.param(2, False, 1, marks=LONG),
        pytest.param(3, True, 1, marks=LONG),
        pytest.param(3, False, 1, marks=LONG),
        pytest.param(2, False, 2, marks=LONG),
        pytest.param(3, True, 3, marks=LONG),
    ],
)
def test_a_cold_pass_of_split_masses_never_adds_energy(dim, friction, passes):
    """Any masses, restitutions, frictions, spins, pinned balls, sticks, coplanar walls."""
    found = changes(Clusters(dim, friction=friction), "jacobi", passes)
    assert found.max() < ROUNDING, f"{found.max():.2e} in cluster {np.unravel_index(found.argmax(), found.shape)}"
    assert found.mean() < -0.1  # and contacts were met


@pytest.mark.long
@pytest.mark.parametrize("contacts", ["gauss_seidel", "jacobi"])
@pytest.mark.parametrize(("bounce", "passes"), [(0.0, 1), (0.0, 30), (0.5, 2), (0.5, 30)])
def test_without_friction_neither_solver_adds_energy_up_to_half_a_bounce(contacts, bounce, passes):
    """The restitutions for which "auto" takes gauss_seidel, with the 2 passes that it makes, or with many."""
    found = changes(Clusters(2, friction=False, bounce=bounce), contacts, passes)
    assert found.max() < ROUNDING, f"{found.max():.2e}"


@pytest.mark.long
@pytest.mark.parametrize("passes", [2, 30])
def test_without_a_bounce_gauss_seidel_adds_no_energy_with_friction_and_spin(passes):
    found = changes(Clusters(3, friction=True, bounce=0.0), "gauss_seidel", passes)
    assert found.max() < ROUNDING, f"{found.max():.2e}"


# Convergence ----------------------------------------------------------------------------------------------------------


def pack(dim: int) -> tuple[ts.Scene, np.ndarray]:
    """A hexagonal or face-centred cubic pack whose balls overlap by a thousandth, thrown together; and the contact pairs."""
    side = 8 if dim == 2 else 5
    cells = np.stack(np.unravel_index(np.arange(side**dim), (side,) * dim), axis=1)
    basis = np.array([[1.0, 0.0, 0.0], [0.5, np.sqrt(0.75), 0.0], [0.5, np.sqrt(1 / 12), np.sqrt(2 / 3)]])[:dim, :dim]
    x = 0.1 * 0.999 * (cells @ basis)
    scene = ts.Scene(dim=dim)
    v = -5.0 * (x - x.mean(axis=0)) + np.random.default_rng(2).normal(size=x.shape)
    scene.add_balls(x, radius=0.05, velocity=v)
    i, j = np.triu_indices(len(x), 1)
    near = np.linalg.norm(x[j] - x[i], axis=1) < 0.1
    return scene, np.stack([i[near], j[near]], axis=1)


def approach(scene: ts.Scene, pairs: np.ndarray, v: np.ndarray) -> float:
    """Largest speed [m/s] at which two balls in contact still approach."""
    r = scene.position[pairs[:, 1]] - scene.position[pairs[:, 0]]
    n = r / np.linalg.norm(r, axis=1)[:, None]
    return float(np.max(-np.sum(n * (v[pairs[:, 1]] - v[pairs[:, 0]]), axis=1)))


@pytest.mark.long
@each_dim
def test_packs_thrown_together(dim):
    """Passes of split masses converge, to the velocities that gauss_seidel finds; those of the plain sum diverge."""
    scene, pairs = pack(dim)
    touching = np.bincount(pairs.ravel())
    assert touching.max() == (6 if dim == 2 else 12)
    left, ends = {}, {}
    for contacts, passes in (("jacobi", 30), ("jacobi", 1500), ("gauss_seidel", 1500), ("sum", 1), ("sum", 30)):
        settings = {"dt": 1e-6, "integrator": "symplectic_euler", "contacts": contacts, "contact_iterations": passes}
        with simulate(scene, **settings) as sim:
            start = sim.energy().kinetic
            sim.step()
            left[contacts, passes] = approach(scene, pairs, sim.velocity)
            ends[contacts, passes] = sim.velocity
            if contacts != "sum":
                assert sim.energy().kinetic < start
    before = approach(scene, pairs, scene.velocity)
    assert left["jacobi", 1500] < 1e-2 * left["jacobi", 30]
    assert left["jacobi", 1500] < 1e-3 * before, f"{left}, before {before:.3g} m/s"
    assert np.max(np.abs(ends["jacobi", 1500] - ends["gauss_seidel", 1500])) < 1e-2 * before
    assert left["sum", 30] > 10 * left["sum", 1] > 10 * before * 0.5


# Bounces of several that touch each other ------------------------------------------------------------------------------


@pytest.mark.parametrize("contacts", ["gauss_seidel", "jacobi"])
@pytest.mark.slow
@pytest.mark.long_where(contacts="jacobi")
def test_two_elastic_balls_on_each_other_bounce_and_keep_most_of_their_energy(contacts):
    """At forty speeds: wherever in a step they meet the floor, it pushes once only, and what the passes leave is a loss."""
    scene = ts.Scene(dim=2, gravity=(0.0, -10.0))
    scene.add_material("default", restitution=1.0)
    x = np.array([[0.0, 0.2], [0.0, 0.4002]])
    scene.add_balls(x, radius=0.1)
    scene.add_wall((0, 1))
    rng = np.random.default_rng(1)
    changes = []  # of the energy that is not left when both lie on the floor
    with simulate(scene, dt=1e-3, contacts=contacts) as sim:
        for _ in range(40):
            sim.set_position(x)
            sim.set_velocity([[0.0, -rng.uniform(1.0, 4.0)]] * 2)
            before = sim.energy()
            sim.step(90)
            changes.append((sim.energy().total - before.total) / (before.total - 4.0))
    assert max(changes) < (1e-6 if F64 else 1e-3)
    assert np.median(changes) > -0.1
    assert min(changes) > -0.2


@pytest.mark.long
@pytest.mark.parametrize("restitution", [0.3, 0.6, 0.8, 1.0])
@pytest.mark.parametrize("contacts", ["gauss_seidel", "jacobi"])
def test_stacks_thrown_on_a_floor_never_gain_energy(contacts, restitution):
    scene = ts.Scene(dim=3, gravity=(0.0, -10.0, 0.0))
    scene.add_material("default", restitution=restitution)
    x = np.stack([[0.0, 0.2 + 0.2001 * k, 0.0] for k in range(5)])
    scene.add_balls(x, radius=0.1)
    scene.add_wall((0, 1, 0))
    rng = np.random.default_rng(2)
    with simulate(scene, dt=1e-3, contacts=contacts) as sim:
        for _ in range(60):
            sim.set_position(x)
            sim.set_velocity([[0.0, -rng.uniform(0.5, 5.0), 0.0]] * 5)
            before = sim.energy()
            most = before.total
            for _ in range(15):
                sim.step(10)
                most = max(most, sim.energy().total)
            # a push-out lifts what overlaps, by less than a hundredth of a radius each
            assert most < before.total + 0.01 * before.kinetic
