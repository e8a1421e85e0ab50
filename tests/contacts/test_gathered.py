"""accumulate = "gather": both balls of a pair list it and each sums what it gets, as on devices: the motion is that of blocks."""

import numpy as np
import pytest
from physics_support import F64, simulate

import taichi_sim as ts
from taichi_sim.contacts import pairs
from taichi_sim.contacts.jacobi import Jacobi

pytestmark = pytest.mark.long_in("f64")

H = 1e-3


def heap(dim, n=120):
    """Balls of two sizes that start in each other, above a floor and a sphere; they rub, bounce and turn."""
    rng = np.random.default_rng(dim)
    scene = ts.Scene(dim=dim, gravity=(0, -10, 0)[:dim])
    scene.add_material("rubber", restitution=0.6, friction=0.4)
    radius = rng.choice([0.05, 0.03], n)
    scene.add_balls(
        rng.uniform(0, 0.9 if dim == 2 else 0.4, (n, dim)), radius=radius, mass=radius**dim, material="rubber"
    )
    scene.add_wall((0, 1, 0)[:dim], 0.0, "rubber")
    scene.add_collider(ts.Sphere((0.2, -0.14, 0.2)[:dim], 0.1, material="rubber"))
    return scene


def ended(scene, accumulate, steps=30, driver="parallel", **settings):
    """(position, velocity, spin), contacts and the plan after some steps."""
    given = {"dt": H, "contacts": "jacobi", **settings}
    with simulate(scene, (accumulate, driver), **given) as sim:
        sim.step(steps)
        return (
            np.hstack([sim.position, sim.velocity, sim.angular_velocity.reshape(scene.n_balls, -1)]),
            sim.contacts(),
            sim.parts.contacts.plan,
        )


@pytest.fixture
def lay_side_by_side(monkeypatch):
    """Call it with whether lists made from now on lie side by side, as on a device."""
    return lambda side_by_side: monkeypatch.setattr(pairs, "on_device", lambda: side_by_side)


@pytest.mark.slow
@pytest.mark.parametrize("saved", [False, True], ids=["in_pieces", "side_by_side"])
def test_a_saved_pile_goes_on_with_lists_in_another_layout(lay_side_by_side, tmp_path, saved):
    """Saved where a chunk of substeps ends, so that what contacts hold is read and not found again."""
    lay_side_by_side(saved)
    with simulate(heap(2), ("gather", "fused"), dt=H, contacts="jacobi") as sim:
        sim.step(4096)
        sim.save(tmp_path / "pile.npz")
        sim.step(5)
        here = np.hstack([sim.position, sim.velocity])
    for side_by_side in (saved, not saved):
        lay_side_by_side(side_by_side)
        with ts.Simulation.restore(tmp_path / "pile.npz") as sim:
            assert sim.parts.contacts.pairs.interleaved is side_by_side
            sim.step(5)
            np.testing.assert_array_equal(np.hstack([sim.position, sim.velocity]), here)


@pytest.mark.slow
def test_both_balls_get_the_same_impulse():
    """Momentum is kept to rounding, though each ball works out its own impulse."""
    scene = heap(2)
    scene.walls.clear()
    scene.colliders.clear()
    mass = scene.mass[:, None]
    before = np.sum(mass * scene.velocity, axis=0) + np.array([0.0, -10.0]) * 30 * H * mass.sum()
    after, contacts, _ = ended(scene, "gather")
    assert contacts.number > 100
    assert np.sum(mass * after[:, 2:4], axis=0) == pytest.approx(before, abs=(1e-12 if F64 else 1e-5) * mass.sum())


@pytest.mark.slow
def test_more_neighbours_than_a_ball_has_room_for(monkeypatch):
    """One ball among hundreds that touch it: its list lies in the pool, which has to grow."""
    monkeypatch.setattr("taichi_sim.contacts.pairs.POOL_LINKS", 8)
    rng = np.random.default_rng(1)
    scene = ts.Scene(dim=3)
    around = rng.standard_normal((400, 3))
    scene.add_balls([[0, 0, 0]], radius=1.0)
    scene.add_balls(1.015 * around / np.linalg.norm(around, axis=1)[:, None], radius=0.02)
    d = np.linalg.norm(scene.position[:, None] - scene.position[None], axis=2)
    expected = int(np.sum(np.triu(d < scene.radius[:, None] + scene.radius[None], 1)))
    with simulate(scene, ("gather", "parallel"), dt=H, contacts="jacobi", contact_iterations=1) as sim:
        room = sim.parts.contacts.pairs.capacity
        sim.step(0)
        assert sim.contacts().number == expected > 400
        assert sim.parts.contacts.pairs.capacity > room
        assert sim.parts.contacts.pairs.touching[0] == 400


@pytest.mark.slow
def test_what_is_fast_stops_where_it_meets():
    """Continuous collision detection: balls that move five radii a step do not pass through a row."""
    scene = ts.Scene(dim=2)
    scene.add_balls(np.stack([np.zeros(40), 0.1 * np.arange(40)], axis=1), radius=0.06, mass=1e3)
    scene.add_balls(
        np.stack([np.full(10, -1.0), 0.4 * np.arange(10) + 0.1], axis=1), radius=0.04, velocity=(200.0, 3.0)
    )
    here, _, _ = ended(scene, "gather", steps=12)
    there, _, _ = ended(scene, "ordered", steps=12)
    assert here[40:, 0].max() < 0.0
    assert here == pytest.approx(there, rel=1e-9 if F64 else 1e-4, abs=1e-9 if F64 else 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("accumulate", ["ordered", "gather"])
def test_triangles_look_for_nothing_where_the_grid_gives_up(accumulate):
    """120 balls at one place, and memory for 100 of their pairs: looking on would take as long as they are many, squared."""
    scene = ts.Scene(dim=3)
    ts.shapes.cloth(scene, size=(0.5, 0.5), resolution=(4, 4), stiffness=100.0, surface_collision=True, radius=0.02)
    scene.add_balls(np.zeros((120, 3)), radius=0.02)
    with simulate(scene, (accumulate, "fused"), contacts="sum", contact_iterations=1, dt=1e-3) as sim:
        contacts = sim.parts.contacts
        contacts.pairs.grid.pair_limit[0] = 1e9
        sim.parts.prime(1e-3, 0.0)
        assert contacts.triangles.used[0] > 0
        contacts.pairs.grid.pair_limit[0] = 100.0
        sim.parts.prime(1e-3, 0.0)
        assert contacts.pairs.overflow[0] > contacts.pairs.capacity
        assert contacts.triangles.used[0] == 0


@pytest.mark.slow_where(accumulate="ordered")
@pytest.mark.parametrize("accumulate", ["ordered", "gather"])
def test_what_arrives_together_without_restitution_stays_together(accumulate):
    """Three discs at once on a fourth: by split masses each contact stops, to what iterations leave; none bounces. The solution:
    V = sum of impulses / M, each contact's normal speed 0."""
    angle = np.radians([35.0, 100.0, 165.0])
    d = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    scene = ts.Scene(dim=2, gravity=(0, 0))
    scene.add_material("clay", restitution=0.0)
    scene.add_balls([[0, 0]], radius=0.1, mass=2.0, material="clay")
    scene.add_balls(d * 0.204, radius=0.1, mass=1.0, velocity=-1.3 * d, material="clay")
    # M V = sum p_k n_k, p_k = m (v_k - n_k . V): (M + m N N^T) V = m sum v_k n_k
    exact = np.linalg.solve(2.0 * np.eye(2) + d.T @ d, -1.3 * d.sum(axis=0))
    end, contacts, _ = ended(scene, accumulate, steps=8)
    assert contacts.number == 3
    assert end[0, 2:4] == pytest.approx(exact, rel=1e-2)


def test_a_rule_of_a_users_takes_each_pair_once():
    """It may change both balls of a pair, so its pairs are listed by one of them."""

    class Own(Jacobi):
        name = "own"

    with simulate(heap(2), ("gather", "fused"), dt=H, contacts=Own()) as sim:
        assert not sim.parts.contacts.plan.gathers
