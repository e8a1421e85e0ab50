"""The listed pairs equal brute force, whatever the balls look like, after a jump and after steps, in both drivers."""

import numpy as np
import pytest
from physics_support import F64, each_dim, simulate

import taichi_sim as ts

N, SCENES = 96, 250  # balls; scenes for each dimension and driver
LARGEST = 0.5  # m
H = 1e-3
CROWDS = ("box", "crowd", "apart", "far_apart", "coincident", "lattice")
SIZES = ("equal", "1:4", "1:1000")


def listed(sim):
    """All touching pairs (i, j), i < j, as often as lists name them."""
    pairs, n = sim._parts.contacts.pairs, sim.scene.n_balls
    first, number, other = (f.to_numpy() for f in (pairs.first, pairs.touching, pairs.link.other))
    first, number = first[:n], number[:n]
    i = np.repeat(np.arange(n), number)
    e = np.concatenate([np.arange(a, a + k) for a, k in zip(first, number)]) if len(i) else i
    return np.sort(np.stack([i, other[e]], axis=1), axis=1)


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


def sizes(rng, size):
    """Radii (N,) [m]; a scene's largest may be smaller than the largest that its grid was made for."""
    largest = LARGEST * rng.choice([1.0, 0.6, 0.1])
    ratio = {"equal": 1.0, "1:4": 4.0, "1:1000": 1000.0}[size]
    return largest * ratio ** -rng.uniform(0.0, 1.0, N) if ratio > 1.0 else np.full(N, largest)


@pytest.fixture(scope="module", params=["fused", "parallel"])
def driver(request):
    return request.param


@each_dim
def test_a_thousand_scenes(dim, driver):
    """One compiled scene takes the positions and radii of all, is moved by set_position, by steps within the skin and beyond."""
    scene = ts.Scene(dim=dim)
    reach = LARGEST * 1000.0 ** -np.linspace(0.0, 1.0, N)  # all sizes that any of them has
    scene.add_balls(np.zeros((N, dim)) + np.arange(N)[:, None], radius=reach)
    settings = {"dt": H, "integrator": "symplectic_euler", "contact_passes": 1, "contacts": "jacobi"}
    met, hashed = np.zeros((len(CROWDS), len(SIZES)), dtype=int), 0
    with simulate(scene, ("ordered", driver), **settings) as sim:
        grid = sim._parts.contacts.pairs.grid
        for seed in range(SCENES):
            rng = np.random.default_rng([seed, dim])
            kind, size = seed % len(CROWDS), seed // len(CROWDS) % len(SIZES)
            radius = sizes(rng, SIZES[size]).astype(np.float64 if F64 else np.float32)
            width = float(np.mean(radius**dim) * N) ** (1.0 / dim) * 10.0 ** rng.uniform(-0.3, 0.3)
            sim._parts.model.radius.from_numpy(radius)
            sim.resume(scatter(rng, CROWDS[kind], dim, width), np.zeros((N, dim)), 0.0)
            sim.step(0)
            met[kind, size] += agrees(sim, radius)
            hashed += 1 - int(np.min(grid.dense.to_numpy()))
            typical = float(np.exp(np.mean(np.log(radius))))
            for step in 10.0 ** rng.uniform(-2.5, 0.5, 2):
                sim.set_velocity(rng.standard_normal((N, dim)) * step * typical / H)
                sim.step(2)
                agrees(sim, radius)
    assert met.min() > 5 * SCENES // met.size
    assert SCENES // 6 < hashed < SCENES
