"""The spatial hash from inside: rows side by side or spread by a hash, cells crowded by several threads, overlaps reported."""

import numpy as np
import pytest
import taichi as ti
from physics_support import F64, VARIANTS, each_dim, simulate

import taichi_sim as ts

H = 1e-3


def touching(sim):
    """All pairs (i, j), i < j, that the lists name as touching."""
    pairs, n = sim._parts.contacts.pairs, sim.scene.n_balls
    first, number, other = (f.to_numpy() for f in (pairs.first, pairs.touching, pairs.link.other))
    own = int(pairs.turn[0]) * n
    listed = [(i, int(j)) for i in range(n) for j in other[first[own + i] : first[own + i] + number[own + i]]]
    return [(min(pair), max(pair)) for pair in listed]


def brute_force(x, radius):
    d = np.linalg.norm(x[:, None] - x[None], axis=2)
    return {(i, j) for i, j in zip(*np.nonzero(d < radius[:, None] + radius[None])) if i < j}


@pytest.mark.parametrize("far", [0.0, 1e3, 1e5], ids=["together", "apart", "far_apart"])
@each_dim
def test_rows_side_by_side_or_spread(dim, far):
    """Crowds that lie so far apart that their box has more cells than the table: the same pairs, each once."""
    rng = np.random.default_rng(3)
    n = 240
    x = rng.uniform(-1.0, 1.0, (n, dim)) * (1.0 if dim == 2 else 0.7) + np.outer(
        rng.integers(-2, 3, n) * far, np.ones(dim)
    )
    scene = ts.Scene(dim=dim)
    scene.add_balls(x, radius=rng.uniform(0.02, 0.2, n))
    with simulate(scene, VARIANTS[1], dt=H) as sim:
        sim.step(0)
        found, dense = touching(sim), int(sim._parts.contacts.pairs.grid.dense[0])
        x = sim.position
    assert dense == (1 if far == 0.0 and dim == 2 else 0)
    assert len(found) == len(set(found))
    assert set(found) == brute_force(x, scene.radius)
    assert len(found) > n // 2


def test_a_crowded_cell_is_sorted_whatever_the_threads_did():
    """One large ball makes the cells so wide that hundreds of small ones share one; enough of them to keep two threads busy."""
    n = 200_000
    scene = ts.Scene(dim=2)
    i, j = np.divmod(np.random.default_rng(5).permutation(n), 500)
    scene.add_balls(np.stack([i, j], axis=1) * 0.02 - 1.3, radius=0.009)
    scene.add_balls([[100.0, 0.0]], radius=0.2, pinned=True)
    with simulate(scene, VARIANTS[1], dt=H) as sim:
        sim.step(0)
        grid = sim._parts.contacts.pairs.grid
        start, order = grid.start.to_numpy()[: grid.size + 1], grid.order.to_numpy()[: n + 1]
    assert np.array_equal(np.sort(order), np.arange(n + 1))
    falls = np.flatnonzero(np.diff(order) < 0) + 1  # only where a new bucket begins
    assert np.max(np.diff(start)) > 100
    assert np.all(np.isin(falls, start))


@each_dim
def test_penetration_is_that_of_the_deepest_contact(dim):
    scene = ts.Scene(dim=dim)
    x = np.zeros((5, dim))
    x[:, 0] = 0.0, 1.9, 5.0, 6.7, 20.0
    scene.add_balls(x, radius=[1.0, 1.0, 1.0, 1.0, 0.3])
    scene.add_wall(np.eye(dim)[0], 19.8)
    with simulate(scene, dt=H, contacts="off") as sim:
        assert sim.penetration() == 0.0
    with simulate(scene, dt=H) as sim:
        assert sim.penetration() == pytest.approx(20.8 - 0.0, rel=1e-6)  # the first ball lies far behind the wall
    scene.walls.clear()
    with simulate(scene, dt=H) as sim:
        assert sim.penetration() == pytest.approx(0.3, rel=1e-12 if F64 else 1e-6)


@each_dim
def test_a_short_lever_does_not_throw_a_stick(dim):
    """A stick hinged inside a pinned ball overlaps it however it turns: it must not be flung about."""
    scene = ts.Scene(dim=dim)
    across, along = 0.05 * np.eye(dim)[1], np.eye(dim)[0]
    scene.add_balls([0.0 * along], radius=0.5, pinned=True)
    hinge = scene.add_balls([across - 0.02 * along], radius=0.01, pinned=True)
    end = scene.add_balls([across + 0.98 * along], radius=0.01)
    scene.add_springs([[hinge[0], end[0]]], stiffness=1e4, damping=1.0, collides=True)
    with simulate(scene, dt=H) as sim:
        for _ in range(30):
            sim.step(10)
            assert np.max(np.abs(sim.velocity)) < 20.0
            assert np.max(np.abs(sim.position)) < 1.5


def test_few_large_balls_do_not_fill_the_lists_of_small_ones():
    """Half of the balls a thousand times larger than the others, and far away: nothing is within reach of anything."""
    scene = ts.Scene(dim=2)
    i, j = np.divmod(np.arange(2500), 50)
    scene.add_balls(np.stack([i, j], axis=1) * 0.004, radius=0.001)
    scene.add_balls(np.stack([i, j], axis=1) * 3.0 + 100.0, radius=1.0)
    with simulate(scene, dt=H) as sim:
        sim.step(2)
        assert sim._parts.contacts.pairs.number.to_numpy()[:5000].max() == 0


def test_too_many_neighbours_leave_the_last_good_state():
    scene = ts.Scene(dim=2)
    scene.add_balls(np.zeros((2000, 2)), radius=0.1)
    with simulate(scene, dt=H) as sim:
        for _ in range(2):
            with pytest.raises(ts.SceneError, match=r"contacts: .* room for"):
                sim.step(5)
        assert sim.time == 0.0
        assert np.array_equal(sim.position, scene.position)


def test_own_integrator_that_moves_balls_itself_still_meets_contacts():
    """It never says how far balls have moved, so contacts are looked for anew in every step."""

    @ti.data_oriented
    class Plain(ts.Integrator):
        name, order = "plain", 1

        @ti.func
        def substep(self, h, time):
            for i in range(self.model.n):
                self.ball[i].x += h * self.ball[i].v
            self.contacts.refresh(self.ball)
            self.contacts.solve(self.ball, h, self.contacts.passes, True)

    scene = ts.Scene(dim=2)
    scene.add_balls([[-1.0, 0.0], [1.0, 0.0]], radius=0.1, velocity=[[1.0, 0.0], [-1.0, 0.0]])
    with simulate(scene, integrator=Plain(), dt=H) as sim:
        sim.step(2000)
        assert np.max(np.abs(sim.velocity)) < 1e-6
