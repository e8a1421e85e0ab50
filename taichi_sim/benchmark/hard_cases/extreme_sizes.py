"""Hard cases of sizes and places: far away, tiny, of very different radii, crowded."""

import time
import warnings

import numpy as np

from taichi_sim.benchmark.hard_cases.verdicts import H, Verdict, double, on_floor, simulation
from taichi_sim.scene.scene import Scene
from taichi_sim.simulation.simulation import Simulation


def _offset_scene(shift: float) -> Scene:
    scene = on_floor(offset=shift, restitution=0.5, friction=0.2)
    x = np.array([[0.0, 1.25], [3.0, 1.0], [3.0, 3.0], [6.0, 4.0], [8.5, 4.0]])  # falls; one on another; two meet
    v = [[1.0, 0.0], [0.0, 0.0], [0.0, 0.0], [0.97, 0.0], [-0.91, 0.0]]
    scene.add_balls(shift + x, radius=1.0, velocity=v, material="it")
    return scene


def world_offset(contacts: str, short: bool) -> Verdict:
    """Balls of 1 m fall, slide, meet and rest on each other for 0.5 s, at the origin and 1e6 m away."""
    ends, shift = [], 1e6
    for at in (0.0, shift):
        with simulation(_offset_scene(at), contacts) as sim:
            sim.run(0.5)
            ends.append(sim.position - at)
            in_double = double(sim)
    if in_double:
        far = float(np.max(np.abs(ends[1] - ends[0])))
        return Verdict(far < 1e-9 * 10.0, far / 10.0, "of the scene's 10 m")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        Simulation(_offset_scene(shift), arch="cpu", dt=H, contacts=contacts).close()
    return Verdict(
        any("precision" in str(w.message) for w in caught), float(len(caught)), "warnings in single precision"
    )


def _right_pairs(scene: Scene, contacts: str) -> Verdict:
    """Check of what one iteration changed, against pairs found by brute force.

    Of two balls that touch and approach at least one must change. No ball may that touches no other: balls that overlap and part
    turn more slowly about each other as they are pushed apart.
    """
    with simulation(scene, contacts, integrator="symplectic_euler", contact_iterations=1) as sim:
        x, v = sim.position, sim.velocity
        sim.step()
        changed = np.any(sim.velocity != v, axis=1)
    i, j = np.triu_indices(len(x), 1)
    r = x[j] - x[i]
    near = np.sum(r * r, axis=1) < (scene.radius[i] + scene.radius[j]) ** 2
    i, j, r = i[near], j[near], r[near]
    approach = np.sum((v[j] - v[i]) * r, axis=1) < 0.0
    missed = int(np.sum(approach & ~(changed[i] | changed[j])))
    changed[np.concatenate([i, j])] = False
    false = int(changed.sum())
    return Verdict(missed + false == 0 and approach.any(), missed + false, f"wrong; {len(i)} pairs touch")


def tiny_in_a_large_world(contacts: str, short: bool) -> Verdict:
    """Radius 1e-4 m, groups of three scattered over 1e4 m."""
    rng, n = np.random.default_rng(4), 500
    x = np.repeat(rng.uniform(-5e3, 5e3, (n, 3)), 3, axis=0) + rng.uniform(-1.2e-4, 1.2e-4, (3 * n, 3))
    scene = Scene(dim=3)
    scene.add_balls(x, radius=1e-4, velocity=rng.normal(size=x.shape) * 1e-3)
    return _right_pairs(scene, contacts)


def radii_from_1_to_1000(contacts: str, short: bool) -> Verdict:
    """Large balls among a thousand small ones."""
    rng, n = np.random.default_rng(5), 1500
    radius = np.where(np.arange(n) < 5, 1.0, 10 ** rng.uniform(-3, -1.5, n))
    scene = Scene(dim=2)
    scene.add_balls(rng.uniform(-1.5, 1.5, (n, 2)), radius=radius, velocity=rng.normal(size=(n, 2)))
    return _right_pairs(scene, contacts)


def negative_coordinates(contacts: str, short: bool) -> Verdict:
    """Balls on all sides of the origin and far on the negative side."""
    rng, n = np.random.default_rng(6), 1000
    x = rng.uniform(-1.0, 1.0, (n, 2)) - np.where(np.arange(n) % 2, 0.0, 100.0)[:, None]
    scene = Scene(dim=2)
    scene.add_balls(x, radius=0.03, velocity=rng.normal(size=x.shape))
    return _right_pairs(scene, contacts)


def crowded_cell(contacts: str, short: bool) -> Verdict:
    """A million (short: 1e4) small balls, none touching another, in the cell of one large ball."""
    n = 10_000 if short else 1_000_000
    side = round(n ** (1 / 2))
    scene = Scene(dim=2)
    i, j = np.divmod(np.arange(n), side)
    scene.add_balls(np.stack([i, j], axis=1) / side, radius=0.4 / side, velocity=(0.0, 1e-3))
    scene.add_balls([[10.0, 0.0]], radius=1.0, pinned=True)
    start = time.perf_counter()
    with simulation(scene, contacts, contact_iterations=1) as sim:
        sim.step()
        still = np.array_equal(sim.velocity, scene.velocity.astype(np.float64 if double(sim) else np.float32))
    took = time.perf_counter() - start
    return Verdict(still and took < 600.0, took, "s, compiling included")
