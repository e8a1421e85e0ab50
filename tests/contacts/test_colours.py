"""Gauss-Seidel by colours, as on devices: each pair once, no two threads at one ball, and the motion of the CPU's order."""

import numpy as np
import pytest
from physics_support import EPS, exact, simulate
from taichi_sim.kernels.contacts.pair_colours import NO_LINK, SOLVED_BY_OTHER
from taichi_sim.kernels.contacts.spatial_hash import FINE_CELLS
from test_gathered import heap

import taichi_sim as ts

H = 1e-3
COLOURS = {"dt": H, "contacts": "gauss_seidel"}


def coloured(scene, driver="fused", **settings):
    return simulate(scene, ("gather", driver), **COLOURS, **settings)


def links(pairs):
    """(ball, other, colour, link, twin) of all that are listed."""
    first, number = pairs.first.to_numpy(), pairs.number.to_numpy()
    table = {name: column for name, column in pairs.link.to_numpy().items() if name in ("other", "colour", "twin")}
    entry = np.concatenate([f + np.arange(k) for f, k in zip(first, number)]).astype(int)
    return (
        np.repeat(np.arange(len(first)), number),
        *(table[k][entry] for k in ("other", "colour")),
        entry,
        table["twin"][entry],
    )


def blocks(grid, level, way, x):
    """The block (n, dim) of each position in one of the ways to cut the world, by the grid's own rounding of cells."""
    width = grid.inverse_width.to_numpy()[level]
    scale = np.full(x.shape[1], width, dtype=x.dtype)
    scale[0] *= FINE_CELLS
    cell = np.floor(x * scale).astype(int)
    cell[:, 0] //= FINE_CELLS
    return (cell + (way >> np.arange(x.shape[1]) & 1)) // 2


def of_sizes():
    """Two levels of the grid, and balls of the finer one in each other's and in the coarser one's cells."""
    rng = np.random.default_rng(5)
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_material("rubber", restitution=0.6, friction=0.4)
    radius = np.concatenate([np.full(12, 0.12), rng.choice([0.008, 0.011], 700)])
    scene.add_balls(rng.uniform(0, 1.2, (len(radius), 2)), radius=radius, mass=1e3 * radius**2, material="rubber")
    scene.add_wall((0, 1), 0.0, "rubber")
    return scene


@pytest.mark.long
@pytest.mark.parametrize(
    ("build", "side_by_side"),
    [(lambda: heap(2), 1), (lambda: heap(3), 0), (of_sizes, 1)],
    ids=["2d", "3d", "sizes"],
)
def test_each_pair_once_and_no_ball_twice(build, side_by_side):
    """One ball of each pair solves it, the other's link is its twin; both lie in one block of its colour, listed once."""
    scene = build()
    with coloured(scene, contact_iterations=1) as sim:
        sim.step(3)
        pairs = sim.parts.contacts.pairs
        grid, dim = pairs.grid, scene.dim
        i, j, colour, entry, twin = links(pairs)
        x, radius = grid.origin.to_numpy(), pairs.model.radius.to_numpy()
        assert grid.dense[0] == side_by_side  # else rows share the buckets of the table
        solved = colour != SOLVED_BY_OTHER
        assert solved.sum() * 2 == len(i) > 300
        assert (twin[solved] != NO_LINK).all()
        place = np.full(pairs.capacity, -1)
        place[entry] = np.arange(len(entry))
        other = place[twin[solved]]
        np.testing.assert_array_equal(i[other], j[solved])
        np.testing.assert_array_equal(j[other], i[solved])
        impulse = pairs.link.impulse.to_numpy()
        assert np.count_nonzero(impulse[entry]) > 40
        np.testing.assert_array_equal(impulse[entry[solved]], impulse[twin[solved]])
        assert len(set(colour[solved])) == 2**dim if grid.levels == 1 else grid.levels == 2
        level = np.searchsorted(grid.bound.to_numpy(), radius)
        for c in range(grid.colours):
            mine, way = solved & (colour == c), c % 2**dim
            one, two = (blocks(grid, c >> dim, way, x[ball[mine]]) for ball in (i, j))
            np.testing.assert_array_equal(one, two)
            assert (level[i[mine]] == c >> dim).all()
            count = grid.block_count.to_numpy()[c]
            leaders = grid.sorted.to_numpy()[grid.block.to_numpy()[c * len(x) : c * len(x) + count]]
            expected = np.unique(blocks(grid, c >> dim, way, x[level == c >> dim]), axis=0)
            np.testing.assert_array_equal(np.unique(blocks(grid, c >> dim, way, x[leaders]), axis=0), expected)
            assert len(expected) == count


def state(sim):
    return np.hstack([sim.position, sim.velocity, sim.angular_velocity.reshape(sim.scene.n_balls, -1)])


def crowds(e=1.0, n=120):
    """Balls thrown at each other, without gravity; far away two that meet head on, and one that is met by two at once."""
    rng = np.random.default_rng(3)
    scene = ts.Scene(dim=2, gravity=(0, 0))
    scene.add_material("elastic", restitution=e)
    k = np.arange(n)
    x = 0.12 * np.stack([k % 12, k // 12], axis=1) + rng.uniform(-0.01, 0.01, (n, 2))
    scene.add_balls(x, velocity=-3.0 * (x - x.mean(axis=0)), mass=rng.uniform(1, 5, n), radius=0.05, material="elastic")
    scene.add_balls([[9.0, 0.0], [9.11, 0.0]], velocity=[[1.0, 0.5], [-2.0, 0.5]], mass=[1.0, 3.0], radius=0.05,
                    material="elastic")  # fmt: skip
    return scene


@pytest.mark.slow
@pytest.mark.long_in("f64")
def test_impacts_keep_momentum_and_gain_no_energy():
    """Two balls exchange what the closed formula says; a crowd keeps its momentum and gains no energy in any step."""
    scene = crowds()
    m = scene.mass[:, None]
    before = np.sum(m * scene.velocity, axis=0)
    with coloured(scene, contact_iterations=4) as sim:
        assert sim.parts.contacts.plan.limits_energy
        last, hits = sim.energy().kinetic, 0
        for _ in range(60):
            sim.step(5)
            now = sim.energy().kinetic
            assert now <= last * (1.0 + 100 * EPS)
            last = now
            hits += sim.contacts().number
        v = sim.velocity
    assert hits > 200
    assert np.sum(m * v, axis=0) == pytest.approx(before, abs=200 * EPS * float(np.sum(m * np.abs(scene.velocity))))
    common = (1.0 - 6.0) / 4.0  # m/s, along x; relative to it both turn round
    assert v[-2:, 0] == pytest.approx([2 * common - 1.0, 2 * common + 2.0], rel=exact(300))
    assert v[-2:, 1] == pytest.approx([0.5, 0.5], rel=exact(300))


def caught():
    """A sheet in free space, and balls thrown at it that meet it and each other."""
    rng = np.random.default_rng(7)
    scene = ts.Scene(dim=3, gravity=(0, 0, 0))
    scene.add_material("cotton", friction=0.3)
    ts.shapes.cloth(
        scene, size=(0.6, 0.6), resolution=(8, 8), mass=0.2, stiffness=100.0, damping=0.05, position=(-0.3, 0.0, -0.3),
        surface_collision=True, material="cotton",
    )  # fmt: skip
    x = rng.uniform([-0.15, 0.06, -0.15], [0.15, 0.3, 0.15], (60, 3))
    scene.add_balls(x, velocity=(0.0, -2.0, 0.0), radius=0.03, mass=2e-3, material="cotton")
    return scene


@pytest.mark.long
def test_triangles_beside_colours():
    """Balls are caught by a sheet and lie on each other: the momentum is kept, nothing goes through, and every driver agrees."""
    scene = caught()
    m = scene.mass[:, None]
    before = np.sum(m * scene.velocity, axis=0)
    bits = []
    for driver in ("fused", "parallel"):
        with coloured(scene, driver, contact_iterations=4) as sim:
            start, most = sim.energy().total, 0
            for _ in range(8):
                sim.step(25)
                assert sim.crossings() == 0
                most = max(most, sim.contacts().number)
            assert most > 30
            assert sim.energy().total < start * (1.0 + 100 * EPS)
            v = sim.velocity
            bits.append(state(sim))
            assert np.sum(m * v, axis=0) == pytest.approx(before, abs=1000 * EPS * float(np.abs(before).sum()))
            sheet, balls = np.arange(64), np.arange(64, 124)
            middle = sim.position[sheet, 1].min()
            near = np.abs(sim.position[balls][:, [0, 2]]).max(axis=1) < 0.2
            assert (sim.position[balls, 1][near] > middle - 0.01).all()
    np.testing.assert_array_equal(*bits)


def resting(dim):
    """Balls piled up in a box: side by side, a row or layer on the other."""
    rng = np.random.default_rng(1)
    scene = ts.Scene(dim=dim, gravity=(0, -10, 0)[:dim])
    scene.add_material("stone", friction=0.3)
    side, n = (8, 96) if dim == 2 else (4, 160)
    k = np.arange(n)
    place = [k % side, k // side ** (dim - 1), k // side % side][:dim]
    x = 0.101 * np.stack(place, axis=1) + 0.05 + rng.uniform(-0.003, 0.003, (n, dim))
    scene.add_balls(x, radius=0.05, material="stone")
    scene.add_wall((0, 1, 0)[:dim], 0.0, "stone")
    for axis in np.eye(dim)[[0, 2][: dim - 1]]:
        scene.add_wall(axis, 0.0, "stone")
        scene.add_wall(-axis, -0.103 * side, "stone")
    return scene


@pytest.mark.parametrize("dim", [2, pytest.param(3, marks=pytest.mark.long)])
@pytest.mark.long
def test_a_pile_rests_as_by_the_order_of_the_cpu(dim):
    """One iteration by colours bears the pile as one in the CPU's order does, and better than four from split masses."""
    found = {}
    for rule, accumulate, many in (
        ("gauss_seidel", "gather", 1),
        ("gauss_seidel", "ordered", 1),
        ("jacobi", "gather", 4),
    ):
        given = {"contacts": rule, "contact_iterations": many, "dt": H}
        with simulate(resting(dim), (accumulate, "fused"), **given) as sim:
            sim.step(2000)  # the last ball rolls for more than a second
            contacts = sim.contacts()
            found[rule, accumulate] = contacts.mean_relative_penetration
            assert contacts.relative_penetration < 0.02
            assert np.abs(sim.velocity).max() < 0.05
    by_colours, ordered, split = found.values()
    assert by_colours < 1.2 * ordered
    assert by_colours < 0.8 * split


def test_what_has_too_many_colours_is_refused():
    scene = ts.Scene(dim=3)
    rng = np.random.default_rng(0)
    for radius, n in ((1.0, 1), (0.1, 30), (0.01, 3000)):
        scene.add_balls(rng.uniform(-5, 5, (n, 3)), radius=radius)
    says = "contacts: 'gauss_seidel' takes pairs by 8 colours for each level of sizes, 16 at most, and these radii have 3 levels"
    with pytest.raises(ts.SceneError, match=says):
        coloured(scene)


def test_atomics_have_no_colours():
    says = "contacts: 'gauss_seidel' changes velocities in a fixed order, which accumulate: 'atomic' does not have; use 'jacobi'"
    with pytest.raises(ts.SceneError, match=says):
        simulate(heap(2), ("atomic", "fused"), **COLOURS)
