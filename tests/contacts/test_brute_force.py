"""The listed pairs equal brute force, whatever the balls look like, after a jump and after steps, in both drivers."""

from itertools import product

import numpy as np
import pytest
from physics_support import F64, simulate

import taichi_sim as ts

pytestmark = pytest.mark.long_in("f32")

N, SCENES = 96, 250  # balls; scenes for each dimension and driver
LARGEST = 0.5  # m
H = 1e-3
CROWDS = ("box", "crowd", "apart", "far_apart", "coincident", "lattice")
SIZES = {
    "one_level": {"equal": 1.0, "1:4": 4.0, "1:30": 30.0},
    "levels": {"1:1000": 1000.0, "1:100": 100.0, "equal": 1.0},
}
SLOW = {(2, "fused", "one_level", "ordered"), (3, "parallel", "levels", "ordered")}
CASES = [
    pytest.param(*case, id="-".join(map(str, case)), marks=pytest.mark.slow if case in SLOW else pytest.mark.long)
    for case in product((2, 3), ("fused", "parallel"), SIZES, ("ordered", "gather"))
]


def listed(sim):
    """All touching pairs (i, j), i < j, as often as lists name them; where both balls do, as often as the first one does."""
    pairs, n = sim.parts.contacts.pairs, sim.scene.n_balls
    first, number, other = (f.to_numpy() for f in (pairs.first, pairs.touching, pairs.link.other))
    first, number = first[:n], number[:n]
    i = np.repeat(np.arange(n), number)
    e = np.concatenate([np.arange(a, a + k) for a, k in zip(first, number)]) if len(i) else i
    found = np.stack([i, other[e]], axis=1)
    if sim.parts.contacts.plan.gathers:
        assert set(map(tuple, found)) == set(map(tuple, found[:, ::-1]))
        found = found[found[:, 0] < found[:, 1]]
    return np.sort(found, axis=1)


def agrees(sim, radius) -> int:
    """Hold the lists against all pairs; those that rounding may decide either way are free. Returns how many there are."""
    x, n = sim.position, sim.scene.n_balls
    d = np.linalg.norm(x[:, None] - x[None], axis=2)
    reach, slack = radius[:, None] + radius[None], 1e-12 if F64 else 3e-6
    found = np.zeros((n, n), dtype=int)
    pairs = listed(sim)
    np.add.at(found, (pairs[:, 0], pairs[:, 1]), 1)
    upper = np.triu(np.ones((n, n), dtype=bool), 1)
    assert found.max(initial=0) <= 1, "a pair is listed twice"
    assert np.all(found[upper & (d < reach * (1.0 - slack))] == 1), "a pair is missing"
    assert np.all(found[d > reach * (1.0 + slack)] == 0), "a pair is listed that does not touch"
    return len(pairs)


def scatter(rng, crowd, dim, width):
    """Positions (N, dim) [m] of one kind of scene, of about this width."""
    x = rng.uniform(-1.0, 1.0, (N, dim)) * width
    if crowd == "crowd":
        x[: N // 2] *= 0.02
    elif crowd in ("apart", "far_apart"):
        far = 10.0 ** (rng.uniform(1.0, 3.0) if crowd == "apart" else rng.uniform(3.0, 6.0))
        x = 0.5 * x + rng.integers(-1, 2, (N, 1)) * far * width
    elif crowd == "coincident":
        x[N // 2 :] = x[rng.integers(0, N // 4, N - N // 2)]
    elif crowd == "lattice":
        side = int(np.ceil(N ** (1.0 / dim)))
        x = np.stack(np.unravel_index(rng.permutation(side**dim)[:N], (side,) * dim), axis=1) * (2.0 * width / side)
    return x + rng.uniform(-3.0, 1.0, dim) * width


def sizes(rng, ratio):
    """Radii (N,) [m]; a scene's largest may be smaller than the largest that its grid was made for."""
    largest = LARGEST * rng.choice([1.0, 0.6, 0.1])
    return largest * ratio ** -rng.uniform(0.0, 1.0, N) if ratio > 1.0 else np.full(N, largest)


@pytest.mark.parametrize(("dim", "driver", "kind", "accumulate"), CASES)
def test_a_thousand_scenes(dim, driver, kind, accumulate):
    """One compiled scene takes the positions and radii of all, is moved by set_position, by steps within the skin and beyond."""
    scene = ts.Scene(dim=dim)
    ratios = list(SIZES[kind].values())
    made_for = LARGEST * (1000.0 ** -np.linspace(0.0, 1.0, N) if kind == "levels" else np.ones(N))
    scene.add_balls(np.zeros((N, dim)) + np.arange(N)[:, None], radius=made_for)
    settings = {"dt": H, "integrator": "symplectic_euler", "contact_iterations": 1, "contacts": "jacobi"}
    met, hashed = np.zeros((len(CROWDS), len(ratios)), dtype=int), 0
    with simulate(scene, (accumulate, driver), **settings) as sim:
        assert sim.parts.contacts.plan.gathers == (accumulate == "gather")
        grid = sim.parts.contacts.pairs.grid
        assert grid.levels == (8 if kind == "levels" else 1)
        for seed in range(SCENES):
            rng = np.random.default_rng([seed, dim])
            crowd, size = seed % len(CROWDS), seed // len(CROWDS) % len(ratios)
            radius = sizes(rng, ratios[size]).astype(np.float64 if F64 else np.float32)
            width = float(np.mean(radius**dim) * N) ** (1.0 / dim) * 10.0 ** rng.uniform(-0.3, 0.3)
            sim.parts.model.radius.from_numpy(radius)
            sim.resume(ts.Snapshot(scatter(rng, CROWDS[crowd], dim, width), np.zeros((N, dim))))
            sim.step(0)
            met[crowd, size] += agrees(sim, radius)
            hashed += int(np.min(grid.dense.to_numpy()[: grid.levels]) == 0)
            typical = float(np.exp(np.mean(np.log(radius))))
            for step in 10.0 ** rng.uniform(-2.5, 0.5, 2):
                sim.set_velocity(rng.standard_normal((N, dim)) * step * typical / H)
                sim.step(2)
                agrees(sim, radius)
    assert met.min() > 5 * SCENES // met.size
    assert SCENES // 6 < hashed < SCENES


@pytest.mark.long
def test_sparse_worlds_are_swept_in_blocks():
    """Crowds far apart, their rows spread by a hash: still many blocks, and the same bits on one thread and several."""
    rng = np.random.default_rng(0)
    n = 6000
    x, v = (
        rng.uniform(-3.0, 3.0, (n, 2)) + np.outer(rng.integers(-1, 2, n) * 4e3, [1.0, 0.3]),
        rng.standard_normal((n, 2)),
    )
    seen = []
    for driver in ("fused", "parallel"):
        scene = ts.Scene(dim=2)
        scene.add_balls(x, radius=0.03, velocity=3.0 * v)
        with simulate(scene, ("ordered", driver), dt=H, contacts="gauss_seidel") as sim:
            sim.step(60)
            pairs = sim.parts.contacts.pairs
            assert int(pairs.grid.dense[0]) == 0
            assert int(pairs.blocks[0]) > 4
            seen.append(sim.position)
    assert np.array_equal(*seen)


@pytest.mark.slow
@pytest.mark.parametrize("dim", [2, 3])
def test_sticks_among_balls_of_all_sizes(dim):
    """Rows equal all balls against all sticks, where the grid has levels."""
    m = 24
    scene = ts.Scene(dim=dim)
    ends = scene.add_balls(np.arange(2 * m)[:, None] + np.zeros(dim), radius=1e-4)
    scene.add_balls(-5.0 - np.arange(N)[:, None] + np.zeros(dim), radius=0.3 * 1000.0 ** -np.linspace(0.0, 1.0, N))
    scene.add_springs(ends.reshape(-1, 2), stiffness=1.0, collides=True)
    n, met = scene.n_balls, 0
    with simulate(scene, dt=H) as sim:
        assert sim.parts.contacts.pairs.grid.levels > 4
        sticks = sim.parts.contacts.sticks
        for seed in range(40):
            rng = np.random.default_rng([seed, dim])
            x = rng.uniform(-1.0, 1.0, (n, dim)) * [1.0, 0.2, 0.05][:dim] + (seed % 4) * 30.0 * rng.integers(
                0, 2, (n, 1)
            )
            x[2 * m :: 2] = (
                x[rng.integers(0, 2 * m, N // 2)] + rng.standard_normal((N // 2, dim)) * scene.radius[2 * m :: 2, None]
            )
            sim.set_position(x)
            sim.penetration()
            used = int(sticks.used[0])
            touching = (column.to_numpy()[:used].tolist() for column in (sticks.contact.ball, sticks.contact.stick))
            found = set(zip(*touching))
            assert len(found) == used
            x = sim.position
            a, d = x[ends[0::2]], x[ends[1::2]] - x[ends[0::2]]
            t = np.einsum("ibk,bk->ib", x[:, None] - a[None], d) / np.sum(d * d, axis=1)
            gap = np.linalg.norm(x[:, None] - a[None] - t[..., None] * d[None], axis=2) / scene.radius[:, None]
            inside, slack = np.minimum(t, 1.0 - t) - 1e-5, 1e-9 if F64 else 1e-2
            near = (gap < 1.0 + slack) & (inside > -slack)
            sure = (gap < 1.0 - slack) & (inside > slack)
            for s in range(m):
                near[ends[2 * s : 2 * s + 2], s] = sure[ends[2 * s : 2 * s + 2], s] = False
            assert (
                set(zip(*(k.tolist() for k in np.nonzero(sure))))
                <= found
                <= set(zip(*(k.tolist() for k in np.nonzero(near))))
            )
            met += used
    assert met > 1000
