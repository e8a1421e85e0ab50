"""Every order of sums comes to one result; and one pass of contacts against brute force."""

import numpy as np
import physics_bits
import pytest
import reference as ref
from physics_support import EPS, F64, VARIANTS, each_dim, error, exact, relaxed_pass, simulate
from trajectories import muscle

import taichi_sim as ts
from taichi_sim.contacts.jacobi import RELAXATION
from taichi_sim.device import spatial_sort
from taichi_sim.simulation import assembly

pytestmark = pytest.mark.long_in("f32")

H = 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("build", "method", "steps", "most"),
    [
        pytest.param(lambda: physics_bits.cloth(2), "verlet", 100, exact(100), marks=pytest.mark.long, id="2d"),
        pytest.param(lambda: physics_bits.cloth(3), "verlet", 100, exact(100), id="3d"),
        pytest.param(lambda: physics_bits.cloth(3), "symplectic_euler", 100, exact(100), id="symplectic_euler"),
        pytest.param(muscle, "verlet", 300, 1e5 * EPS, marks=pytest.mark.long, id="motors"),
        pytest.param(muscle, "implicit_euler", 300, 2e-3, marks=pytest.mark.long, id="implicit_euler"),
    ],
)
def test_every_order_of_springs_comes_to_the_same(build, method, steps, most, monkeypatch):
    """Four orders of one sum, of springs with motors too; positions, and velocities in units of omega^2 = k / m = 2000 / s^2."""
    scene, ends = build(), {}
    for order in ("blocks", "gather", "padded", "atomic"):
        monkeypatch.setattr(assembly, "fixed_order", lambda *_, order=order: order)
        accumulate = order if order in ("gather", "atomic") else "ordered"
        with simulate(scene, (accumulate, "parallel"), integrator=method, dt=H, contacts="off") as sim:
            taken = "ends" if order == "gather" and method == "implicit_euler" else order  # it takes each spring once
            assert f"springs.{taken}" in sim.kernels()
            sim.step(steps)
            ends[order] = sim.position, sim.velocity / np.sqrt(2000.0)
    size = float(np.max(np.abs(ends["blocks"][0])))
    for order in ("gather", "padded", "atomic"):
        found = max(error(*both, size) for both in zip(ends[order], ends["blocks"]))
        assert found < most, f"{order}: {found:.2e}"


@pytest.mark.long
@each_dim
def test_every_order_of_contacts_comes_to_the_same(dim, monkeypatch):
    """Before collisions multiply the rounding, 20 steps: by blocks, by both balls of a pair, by atomics, and by blocks of balls
    that are stored as they lie in space."""
    scene, ends = physics_bits.pile(dim), []
    scene.set_balls(7, pinned=True)
    for accumulate, first in (("ordered", 1000), ("gather", 1000), ("atomic", 1000), ("ordered", 1)):
        monkeypatch.setattr(spatial_sort, "FEWEST_SORTED", first)
        with simulate(scene, (accumulate, "parallel"), dt=H, contacts="jacobi", contact_iterations=2) as sim:
            assert (sim.parts.state.order is None) == (first > 1)
            assert sim.parts.contacts.plan.gathers == (accumulate == "gather")
            assert np.array_equal(sim.position, scene.position if F64 else scene.position.astype(np.float32))
            sim.step(20)
            ends.append((sim.position, sim.velocity))
    for x, v in ends[1:]:
        assert error(x, ends[0][0]) < (1e-10 if F64 else 2e-6)
        assert error(v, ends[0][1]) < (1e-9 if F64 else 1e-4)
        assert np.array_equal(x[7], ends[0][0][7])


# One pass of contacts -------------------------------------------------------------------------------------------------

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
