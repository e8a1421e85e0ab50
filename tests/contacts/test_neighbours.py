"""The spatial hash from inside: rows side by side or spread by a hash, cells crowded by several threads, overlaps reported."""

import resource

import numpy as np
import pytest
import taichi as ti
from physics_support import F64, VARIANTS, each_dim, simulate

import taichi_sim as ts
from taichi_sim.common import memory
from taichi_sim.contacts import sticks

pytestmark = pytest.mark.long_in("f32")

H = 1e-3


def test_a_crowded_cell_is_sorted_whatever_the_threads_did(monkeypatch):
    """One large ball makes the cells so wide that hundreds of small ones share one; enough of them to keep two threads busy."""
    monkeypatch.setattr("taichi_sim.contacts.grid.FEWER_CANDIDATES", np.inf)  # all in one level
    n = 200_000
    scene = ts.Scene(dim=2)
    i, j = np.divmod(np.random.default_rng(5).permutation(n), 500)
    scene.add_balls(np.stack([i, j], axis=1) * 0.02 - 1.3, radius=0.009)
    scene.add_balls([[100.0, 0.0]], radius=0.2, pinned=True)
    with simulate(scene, VARIANTS[1], dt=H) as sim:
        sim.step(0)
        grid = sim.parts.contacts.pairs.grid
        start, order = grid.start.to_numpy()[: grid.size + 1], grid.sorted.to_numpy()[: n + 1]
    assert np.array_equal(np.sort(order), np.arange(n + 1))
    falls = np.flatnonzero(np.diff(order) < 0) + 1  # only where a new bucket begins
    assert np.max(np.diff(start)) > 100
    assert np.all(np.isin(falls, start))


@pytest.mark.slow_where(dim=2)
@each_dim
@pytest.mark.slow
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
@pytest.mark.long
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


@pytest.mark.slow
def test_few_large_balls_do_not_fill_the_lists_of_small_ones():
    """Half of the balls a thousand times larger than the others, and far away: nothing is within reach of anything."""
    scene = ts.Scene(dim=2)
    i, j = np.divmod(np.arange(2500), 50)
    scene.add_balls(np.stack([i, j], axis=1) * 0.004, radius=0.001)
    scene.add_balls(np.stack([i, j], axis=1) * 3.0 + 100.0, radius=1.0)
    with simulate(scene, dt=H) as sim:
        sim.step(2)
        assert sim.parts.contacts.pairs.number.to_numpy()[:5000].max() == 0


@pytest.mark.slow
def test_more_than_memory_holds_leaves_the_last_good_state(monkeypatch):
    """2000 balls within reach of each other are refused where memory is short, before or after their pairs are counted."""
    scene = ts.Scene(dim=2)
    scene.add_balls(np.arange(2000)[:, None] * [1.0, 0.0], radius=0.1)
    crowd = 1e-5 * scene.position
    with simulate(scene, dt=H) as sim:
        grid = sim.parts.contacts.pairs.grid
        enough = grid.pair_limit[0]
        with monkeypatch.context() as patch:
            patch.setattr(memory, "available", lambda: 1 << 20)
            for most, words in (
                (enough, r"pairs .* need 200\d{4} entries, .* memory for \d{6,7} "),
                (1e5, "2e.06 pairs .* same cells"),
            ):
                grid.pair_limit[0] = most
                sim.set_position(crowd)
                for _ in range(2):
                    with pytest.raises(ts.SceneError, match=r"contacts: .*" + words):
                        sim.step(5)
                assert sim.time == 0.0
                assert np.allclose(sim.position, crowd)
        grid.pair_limit[0] = enough
        assert sim.penetration() == pytest.approx(0.2 - 1e-5, rel=1e-5)
        found = sim.parts.contacts.pairs
        assert int(np.sum(found.number.to_numpy()[:2000])) == 1999 * 1000
        assert found.grid is not grid


@pytest.mark.long
def test_rows_of_sticks_grow(monkeypatch):
    """Twenty sticks through a hundred balls that touch each of them."""
    monkeypatch.setattr(sticks, "MINIMUM_CAPACITY", 1)
    scene = ts.Scene(dim=2)
    ends = scene.add_balls(np.array([[-5.0, 0.0], [5.0, 0.0]] * 20), radius=0.001, pinned=True)
    scene.add_balls(np.linspace(-4.0, 4.0, 100)[:, None] * [1.0, 0.0], radius=0.03)
    scene.add_springs(ends.reshape(-1, 2), stiffness=1.0, collides=True)
    with simulate(scene, dt=H) as sim:
        assert sim.penetration() == pytest.approx(0.03, rel=1e-6)
        part = sim.parts.contacts.sticks
        assert int(part.used[0]) == 2000
        assert 2000 <= part.capacity < 4000


@pytest.mark.slow
def test_a_million_balls_in_a_cell_are_refused():
    """Their pairs would fill terabytes: that is said before any is stored, and before time goes into sorting them."""
    scene = ts.Scene(dim=2)
    scene.add_balls(np.random.default_rng(0).uniform(0.1, 0.2, (1_000_000, 2)), radius=1.0)
    with simulate(scene, VARIANTS[1], dt=H) as sim:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        with pytest.raises(ts.SceneError, match=r"5e\+11 pairs of balls lie in the same cells"):
            sim.step(1)
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000  # kB


@pytest.mark.slow
def test_own_integrator_that_moves_balls_itself_still_meets_contacts():
    """It never says how far balls have moved, so contacts are looked for anew in every step."""

    @ti.data_oriented
    class Plain(ts.Integrator):
        method = ts.Method("plain", order=1)

        @ti.func
        def substep(self, h, time):
            for i in range(self.model.n):
                self.ball[i].x += h * self.ball[i].v
            self.contacts.refresh(self.ball)
            self.contacts.solve(self.ball, h, self.contacts.iterations, True)

    scene = ts.Scene(dim=2)
    scene.add_balls([[-1.0, 0.0], [1.0, 0.0]], radius=0.1, velocity=[[1.0, 0.0], [-1.0, 0.0]])
    with simulate(scene, integrator=Plain(), dt=H) as sim:
        sim.step(2000)
        assert np.max(np.abs(sim.velocity)) < 1e-6
