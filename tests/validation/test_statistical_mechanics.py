"""Contacts against statistical mechanics and statics (physics notes, section 7): stack, elastic gas, granular cooling."""

import functools
from types import SimpleNamespace

import numpy as np
import pytest
from physics_support import F64, each_dim, simulate

import taichi_sim as ts

pytestmark = pytest.mark.long_in("f32")

G, R, H = 10.0, 0.05, 1e-3


# Statics --------------------------------------------------------------------------------------------------------------


def contact_forces(sim: ts.Simulation) -> dict[tuple[int, int], float]:
    """Normal force [N] by pair of balls, and by (-1, ball) on the floor: the impulses held, one solve for each half step."""
    contacts, n = sim.parts.contacts, sim.scene.n_balls
    pairs, h = contacts.pairs, 0.5 * sim.dt / sim.substeps
    first, touching, other, impulse = (
        f.to_numpy() for f in (pairs.first, pairs.touching, pairs.link.other, pairs.link.impulse)
    )
    floor = contacts.walls.contact.impulse.to_numpy()
    forces = {(-1, i): float(floor[i]) / h for i in range(n)}
    for i in range(n):
        for e in range(first[i], first[i] + touching[i]):
            forces[min(i, int(other[e])), max(i, int(other[e]))] = float(impulse[e]) / h
    return forces


@pytest.mark.slow_where(contacts="jacobi")
@pytest.mark.parametrize("contacts", ["gauss_seidel", "jacobi"])
@pytest.mark.slow
@pytest.mark.long_where(contacts="jacobi")
def test_forces_in_a_stack_of_10(contacts):
    """Contact s from the floor carries (N - s + 1) m g; overlap below the slop and 1 % r; no drift."""
    mass, n = 3.0, 10
    scene = ts.Scene(dim=2, gravity=(0.0, -G))
    scene.add_wall((0.0, 1.0))
    scene.add_balls([[0.0, (2 * k + 1) * R] for k in range(n)], radius=R, mass=mass)
    with simulate(scene, dt=H, contacts=contacts) as sim:
        sim.step(3000)
        forces, x = contact_forces(sim), sim.position
        for s in range(n):
            got, want = forces[s - 1, s], (n - s) * mass * G
            assert abs(got / want - 1.0) < (1e-6 if F64 else 1e-3), f"contact {s + 1}: {got:.6f} N, not {want:.6f} N"
        assert sim.penetration() < 0.02 * R
        sim.step(1000)
        assert np.max(np.abs(sim.position - x)) < (1e-6 if F64 else 1e-4) * R


# Elastic gas ----------------------------------------------------------------------------------------------------------

SPEED = 10.0  # m/s, of each component
MIDDLE = 0.35  # m: what lies further from the centre is near a wall

# (dim, balls, filled share, parts of a radius that a ball at SPEED moves in a step, steps, largest error of the pressure).
# Balls are found to overlap when they do, half a step too late on average: that makes them a little smaller.
GASES = [
    pytest.param(2, 100, 0.2, 1 / 50, 2500, None, id="2d-short"),
    pytest.param(2, 900, 0.3, 1 / 100, 90_000, 0.02, id="2d", marks=pytest.mark.long),
    pytest.param(3, 729, 0.2, 1 / 150, 50_000, 0.02, id="3d", marks=pytest.mark.long),
]


def box_of_gas(dim, n, filled, share, restitution=1.0, seed=1):
    """n balls of 1 kg on a lattice in the unit box with Maxwellian velocities, their radius and step."""
    rng, side = np.random.default_rng(seed), round(n ** (1 / dim))
    r = (filled / (n * (np.pi if dim == 2 else 4 / 3 * np.pi))) ** (1 / dim)
    gap = 1 / side - 2 * r
    x = (np.stack(np.unravel_index(np.arange(n), (side,) * dim), axis=1) + 0.5) / side
    scene = ts.Scene(dim=dim)
    ideal, ball = scene.add_material("ideal", restitution=1.0), scene.add_material("ball", restitution=restitution)
    v = rng.normal(size=(n, dim))
    v *= SPEED * np.sqrt(dim * n / np.sum(v**2))
    scene.add_balls(x + rng.uniform(-0.4 * gap, 0.4 * gap, (n, dim)), radius=r, velocity=v, material=ball)
    for normal in np.eye(dim):
        scene.add_wall(normal, 0.0, ideal)
        scene.add_wall(-normal, -1.0, ideal)
    return scene, r, share * r / SPEED


def walls_given(sim):
    """Impulse that all walls have received [N s]."""
    return sum(value for name, value in sim.probes().items() if name.endswith("magnitude"))


@functools.cache
def gas_run(dim, n, filled, share, steps):
    """Energy, moments of the speed, density in the middle, and what the middles of the walls were given, after a metre's way.

    Near edges walls are hit less often, and near walls the gas is denser: both are left out.
    """
    scene, r, dt = box_of_gas(dim, n, filled, share)
    for k in range(len(scene.walls)):
        scene.add_probe(f"wall_{k}", "impulse", wall=k)
    got = SimpleNamespace(impulse=0.0, squares=0.0, hits=0, inside=[], second=[], fourth=[], energy=[])
    with simulate(scene, dt=dt) as sim:
        got.energy.append(sim.energy().total)
        sim.step(round(1.0 / (SPEED * dt)))
        counted, given = 0.0, walls_given(sim)
        for k in range(steps):
            sim.step()
            x, v = sim.position, sim.velocity
            # behind a wall: the ball was reflected in this step, and had the opposite velocity before
            back = x - dt * v
            hit = ((v > 0) & (back < r)) | ((v < 0) & (back > 1 - r))
            counted += 2.0 * np.sum(np.abs(v[hit]))
            for ball, axis in np.argwhere(hit):
                if np.all(np.abs(np.delete(x[ball], axis) - 0.5) < MIDDLE):
                    p = 2.0 * abs(v[ball, axis])
                    got.impulse, got.squares, got.hits = got.impulse + p, got.squares + p * p, got.hits + 1
            if k % 10 == 0:
                square = np.sum(v**2, axis=1)
                got.inside.append(np.sum(np.all(np.abs(x - 0.5) < MIDDLE, axis=1)))
                got.second.append(np.mean(square))
                got.fourth.append(np.mean(square**2))
        got.energy.append(sim.energy().total)
        # some met a ball and a wall in one step, which their paths do not tell
        unseen = (walls_given(sim) - given) / counted
    area, volume = 2 * dim * (2 * MIDDLE) ** (dim - 1), (2 * MIDDLE) ** dim
    got.n, got.dim, got.samples = n, dim, len(got.inside)
    got.density = np.mean(got.inside) / volume
    got.temperature = 2 * got.energy[-1] / (dim * n)
    got.pressure = unseen * got.impulse / (steps * dt * area)
    got.error = np.sqrt(got.squares) / got.impulse  # relative, one standard deviation of a sum of random hits
    got.filled = got.density * (np.pi * r**2 if dim == 2 else 4 / 3 * np.pi * r**3)
    got.ways = steps * dt * SPEED / (2 * r)  # diameters travelled
    return got


def compressibility(dim, y):
    """p / (n k T) of hard discs (Henderson 1975) or spheres (Carnahan and Starling 1969) that fill a share y."""
    return (1 + y**2 / 8) / (1 - y) ** 2 if dim == 2 else (1 + y + y**2 - y**3) / (1 - y) ** 3


@pytest.mark.slow
@pytest.mark.parametrize(("dim", "n", "filled", "share", "steps", "bound"), GASES)
def test_elastic_gas(dim, n, filled, share, steps, bound):
    """Energy kept, speeds Maxwellian, pressure by the equation of state."""
    gas = gas_run(dim, n, filled, share, steps)
    assert abs(gas.energy[1] / gas.energy[0] - 1.0) < 1e-3
    D = dim * n  # of a given total energy: velocities are spread evenly over a sphere of D dimensions
    maxwell, found = (dim + 2) / dim * D / (D + 2), np.mean(gas.fourth) / np.mean(gas.second) ** 2
    # the fourth moment of n speeds has the variance 20 (2D) or 8.9 (3D) of <v^2>^4 / n; half a dozen ways make a new sample
    spread = np.sqrt((20.0 if dim == 2 else 8.9) / (n * max(1.0, gas.ways / 6)))
    ratio = gas.pressure / (gas.density * gas.temperature) / compressibility(dim, gas.filled)
    print(
        f"{dim}d: energy {gas.energy[1] / gas.energy[0] - 1:.1e}, <v^4>/<v^2>^2 {found:.4f} of {maxwell:.4f} +- {spread:.4f}"
    )
    print(f"pressure {ratio:.4f} +- {gas.error:.4f} of the equation of state, filled {gas.filled:.4f}, {gas.hits} hits")
    assert abs(found - maxwell) < 4 * spread
    assert abs(ratio - 1.0) < (4 * gas.error if bound is None else bound), f"{ratio:.4f} +- {gas.error:.4f}"


# Granular cooling -----------------------------------------------------------------------------------------------------


def collision_rate(sim, steps):
    """Collisions with other balls, per ball and second: velocities that changed by more than the signs of their components."""
    v, met = sim.velocity, 0
    for _ in range(steps):
        sim.step()
        now = sim.velocity
        met += np.count_nonzero(np.any(np.abs(np.abs(now) - np.abs(v)) > 1e-4 * SPEED, axis=1))
        v = now
    return -np.log1p(-met / (steps * len(v))) / sim.dt  # some met more than once in a step


@pytest.mark.long
@each_dim
def test_granular_cooling(dim):
    """Haff's law T0 (1 + t/tau)^-2 with tau = 2d / ((1 - e^2) nu), nu counted before: within 5 % until a twelfth is left.

    The box is smaller than the least one in which such a gas gathers in whirls and clusters, which cool more slowly.
    """
    e, n, filled = 0.98, 400 if dim == 2 else 729, 0.1
    runs = []
    for seed in range(4):  # one alone is off by 2.6 % (a standard deviation)
        gas, _, dt = box_of_gas(dim, n, filled, 1 / 50, seed=seed)
        with simulate(gas, dt=dt) as sim:  # from the lattice to a gas
            sim.step(round(1.0 / (SPEED * dt)))
            nu = collision_rate(sim, 4000 if dim == 2 else 800)
            x, v = sim.position, sim.velocity
        scene, _, _ = box_of_gas(dim, n, filled, 1 / 50, e)
        start, tau = float(np.mean(v**2)), 2 * dim / ((1 - e**2) * nu)
        with simulate(scene, dt=dt) as sim:
            sim.set_position(x)
            sim.set_velocity(v)
            run, t = [], 0.0
            for _ in range(25):
                sim.run(0.1 * tau)
                t += round(0.1 * tau / dt) * dt
                run.append(float(np.mean(sim.velocity**2)) / start * (1 + t / tau) ** 2 - 1.0)
        runs.append(run)
    worst = max(np.mean(runs, axis=0), key=abs)
    print(
        f"{dim}d: {nu:.0f} collisions per second, after {t / tau:.2f} tau {run[-1]:+.4f}, at worst on average {worst:+.3f}"
    )
    assert (1 + t / tau) ** -2 < 1 / 12
    assert abs(worst) < 0.05
