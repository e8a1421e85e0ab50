"""Two drivers, two ways to accumulate, any number of threads, one result; and the neighbour search against brute force."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import physics_bits
import pytest
import reference as ref
from physics_support import F64, PRECISION, VARIANTS, each_dim, error, exact, relaxed_pass, simulate

import taichi_sim as ts
from taichi_sim.contacts.jacobi import RELAXATION
from taichi_sim.simulation import assembly

pytestmark = pytest.mark.long_in("f32")

H = 1e-3


@pytest.mark.long
def test_one_and_two_threads_have_the_same_bits():
    def run(threads):
        command = [sys.executable, str(Path(physics_bits.__file__)), PRECISION, str(threads)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout.split()

    one = run(1)
    assert len({one[0], *one[2:]}) == 4  # in double precision rows and blocks agree to the last bit
    assert run(2) == one


@pytest.mark.slow
@pytest.mark.parametrize("method", ["verlet", "symplectic_euler"])
@each_dim
@pytest.mark.long_where(dim=2)
def test_all_orders_of_springs_agree(dim, method, monkeypatch):
    """Four orders of one sum, after 100 steps of a cloth."""
    scene, steps = physics_bits.cloth(dim), 100
    ends = {}
    for order in ("blocks", "gather", "padded", "atomic"):
        monkeypatch.setattr(assembly, "fixed_order", lambda *_, order=order: order)
        with simulate(
            scene, ("atomic" if order == "atomic" else "ordered", "parallel"), integrator=method, dt=H, contacts="off"
        ) as sim:
            assert f"springs.{order}" in sim.kernels()
            sim.step(steps)
            ends[order] = sim.position, sim.velocity
    for order in ("gather", "padded", "atomic"):
        # in phase space: velocities in units of omega times the size, where omega^2 = k / m
        size = float(np.max(np.abs(ends["blocks"][0])))
        found = max(error(ends[order][k], ends["blocks"][k], size * (1.0, np.sqrt(2000.0))[k]) for k in (0, 1))
        assert found < exact(steps), f"{order}: {found:.2e}"


@pytest.mark.parametrize("dim", [pytest.param(2, marks=pytest.mark.long), 3], ids=["2d", "3d"])
@pytest.mark.long
def test_atomic_agrees_with_ordered_in_a_pile(dim):
    """Before collisions multiply the rounding: 20 steps."""
    scene = physics_bits.pile(dim)
    ends = []
    for accumulate in ("ordered", "atomic"):
        with simulate(scene, (accumulate, "parallel"), dt=H, contacts="jacobi", contact_iterations=2) as sim:
            sim.step(20)
            ends.append((sim.position, sim.velocity))
    assert error(ends[1][0], ends[0][0]) < (1e-10 if F64 else 2e-6)
    assert error(ends[1][1], ends[0][1]) < (1e-9 if F64 else 1e-4)


# Neighbour search -----------------------------------------------------------------------------------------------------

N, TRIALS = 60, 25


@pytest.fixture(
    scope="module",
    params=[
        pytest.param((2, VARIANTS[0]), id="2d-ordered"),
        pytest.param((2, VARIANTS[3]), id="2d-atomic", marks=pytest.mark.slow),
        pytest.param((3, VARIANTS[0]), id="3d-ordered", marks=pytest.mark.slow),
        pytest.param((3, VARIANTS[3]), id="3d-atomic"),
    ],
)
def searching(request):
    """One simulation, moved to a new random scene for each trial: radii 1 : 20, some balls joined, of one body, pinned."""
    dim, variant = request.param
    rng = np.random.default_rng(8)
    scene = ts.Scene(dim=dim)
    radius = 0.3 * 20.0 ** -rng.uniform(0, 1, N)
    scene.add_balls(np.zeros((N - 10, dim)), radius=radius[:-10], mass=10 ** rng.uniform(-1, 1, N - 10))
    scene.add_balls(np.zeros((10, dim)), radius=radius[-10:], body=scene.new_body())
    scene.set_balls([3, 4, 5], pinned=True)
    joined = [(0, 1), (2, 7), (8, 30), (30, 31)]
    scene.add_springs(joined, stiffness=0.0)
    with simulate(scene, variant, integrator="symplectic_euler", dt=H, contacts="jacobi", contact_iterations=1) as sim:
        yield dim, scene, sim, rng


def _expected(scene, x, v):
    joined = [tuple(p) for p in scene.pairs]
    held, body = scene.pinned, scene.body
    contacts = [
        c
        for c in ref.ball_contacts(x, scene.radius, joined)
        if not (held[c.balls[0]] and held[c.balls[1]])
        and not (body[c.balls[0]] > 0 and body[c.balls[0]] == body[c.balls[1]])
    ]
    w = np.where(held, 0.0, 1.0 / scene.mass)
    return contacts, relaxed_pass(contacts, v, w, RELAXATION)


def _whole_velocity(sim):
    """With what single precision rounds off: the split between the two parts may change where their sum does not."""
    now = sim.snapshot()
    return now.velocity if now.low_velocity is None else now.velocity + now.low_velocity


@pytest.mark.long
def test_random_scenes_against_brute_force(searching):
    """One pass from rest impulses is the reference's; a pair missed, or found twice, would show at once.

    The scene lies around the origin, far in the negative, or far out; it is moved there by set_position.
    """
    dim, scene, sim, rng = searching
    apart = np.outer(np.arange(N) * 10.0 + 1000.0, np.ones(dim))
    total = 0
    for trial in range(TRIALS):
        sim.set_position(apart)  # lets go of the impulses that contacts hold
        sim.set_velocity(np.zeros((N, dim)))
        sim.step()
        size = (2.0, 3.0, 1.2)[trial % 3] * (1.0 if dim == 2 else 0.4)
        x = rng.uniform(-size, size, (N, dim)) + (
            (0.0, -123.4, 517.0)[trial % 3] if F64 else (0.0, -3.4, 5.1)[trial % 3]
        )
        v = rng.normal(size=(N, dim))
        v[scene.pinned] = 0.0
        sim.set_position(x)
        sim.set_velocity(v)
        x, v = sim.position, sim.velocity
        contacts, want = _expected(scene, x, v)
        total += len(contacts)
        sim.step()
        found = np.max(np.abs(sim.velocity - want))
        assert found < (1e-5 if F64 else 5e-4), f"trial {trial}, {len(contacts)} contacts: {found:.2e} m/s"
        free = [i for i in range(N) if all(i not in c.balls for c in contacts)]
        assert np.array_equal(sim.velocity[free], v[free])
    assert total > 10 * TRIALS


@pytest.mark.slow
def test_pairs_are_found_again_as_balls_move(searching):
    """Lists are kept while balls move little: steps of a fast gas, each against brute force."""
    dim, scene, sim, rng = searching
    sim.set_position(np.outer(np.arange(N) * 10.0 + 1000.0, np.ones(dim)))
    sim.set_velocity(np.zeros((N, dim)))
    sim.step()
    v = rng.normal(size=(N, dim)) * 20.0
    v[scene.pinned] = 0.0
    side = 2.0 if dim == 2 else 0.8
    sim.set_position(rng.uniform(-side, side, (N, dim)))
    sim.set_velocity(v)
    met = 0
    for _ in range(60):
        x, v, whole = sim.position, sim.velocity, _whole_velocity(sim)
        contacts, _ = _expected(scene, x, v)
        approaching = [c for c in contacts if c.normal @ (v[c.balls[1]] - v[c.balls[0]]) < -0.5]
        sim.step()
        after = sim.velocity
        touched = np.unique([i for c in contacts for i in c.balls]).astype(int)
        others = np.setdiff1d(np.arange(N), touched)
        assert np.array_equal(_whole_velocity(sim)[others], whole[others])
        for c in approaching:
            i, j = c.balls
            assert not np.array_equal(after[[i, j]], v[[i, j]])
        met += len(approaching)
    assert met > 20
