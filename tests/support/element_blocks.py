"""Bodies of each kind of element, alone or side by side in one scene, and what their energy says of their forces."""

import itertools

import numpy as np

import taichi_sim as ts
from taichi_sim.analysis import diagnostics
from taichi_sim.scene.cells import cell_volumes

SIDES = np.array([0.3, 0.5, 0.7])  # m, of a cell of a lattice
APART = 2.0  # m, from body to body


def lattice(number) -> tuple[np.ndarray, np.ndarray]:
    """Whole-numbered points (n, dim) and corners (b, 2^dim) of so many boxes along each axis."""
    dim = len(number)
    points = np.array(list(itertools.product(*(range(n + 1) for n in number))), dtype=float)
    index = np.arange(len(points)).reshape([n + 1 for n in number])
    corners = [
        index[tuple(slice(o, o + n) for o, n in zip(offset, number))].ravel()
        for offset in itertools.product((0, 1), repeat=dim)
    ]
    return points, np.stack(corners, axis=1)


def mesh(number, off: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, dim) and elements (e, dim + 1) of so many boxes along each axis, each cut along a diagonal; off: how far points
    within may lie beside the lattice."""
    dim, rng = len(number), np.random.default_rng(4)
    points, boxes = lattice(number)
    places = []
    for axes in itertools.permutations(range(dim)):
        steps = 1 << (dim - 1 - np.array(axes))  # a corner of a box is numbered by its offsets, as binary digits
        places.append(boxes[:, np.cumsum([0, *steps])])
    corners = np.concatenate(places)
    turned = cell_volumes(points, corners) < 0
    corners[turned] = corners[turned][:, [1, 0, *range(2, dim + 1)]]
    within = (points > 0) & (points < np.array(number))
    return points + off * rng.uniform(-1, 1, points.shape) * within, corners


def _by_turns(corners, one, other):
    return np.where(np.arange(len(corners)) % 2, other, one)


def _springs(scene, at, corners, damping):
    pairs = np.unique(np.sort(corners[:, [0, 1]], axis=1), axis=0)
    scene.add_springs(at[pairs], stiffness=_by_turns(pairs, 30.0, 9.0), damping=damping)


def _bends(scene, at, corners, damping):
    rows, dim = at[corners], scene.dim
    weights = np.zeros((len(rows), 4))
    weights[:, :3] = 1.0, -2.5, 1.5
    four = np.stack([rows[:, 0], rows[:, 1], rows[:, 2], rows[:, dim] if dim > 2 else rows[:, 0]], axis=1)
    if dim == 2:  # the fourth ball has no weight
        four[:, 3] = [next(ball for ball in at if ball not in row) for row in rows]
    scene.add_bending(four, weights=weights, stiffness=_by_turns(rows, 3.0, 5.0), damping=damping)


def _cells(scene, at, corners, damping):
    scene.add_cells(at[corners], bulk_modulus=_by_turns(corners, 20.0, 30.0))


def _crushed_cells(scene, at, corners, damping):
    """Cells that resist more below half of their volume, where their stiffness leaps; in 2D the two of a box act together."""
    together = np.arange(len(corners)) % (len(corners) // 2) if scene.dim == 2 else None
    bulk = _by_turns(corners, 20.0, 30.0)
    scene.add_cells(at[corners], bulk_modulus=bulk, crush_modulus=2.0 * bulk, together=together)


def _membranes(scene, at, corners, damping, **more):
    law = {"warp": 30.0, "weft": 12.0, "shear": 4.0, "coupling": 7.0}
    scene.add_membranes(at[corners[:, :3]], damping=0.1 * damping, **law, **more)


def _folded_membranes(scene, at, corners, damping):
    _membranes(scene, at, corners, damping, compression_limit=_by_turns(corners, 0.0, 0.3))


def _solids(scene, at, corners, damping):
    ratio = _by_turns(corners, 0.2, 0.45)
    scene.add_solids(at[corners], young_modulus=30.0, poisson_ratio=ratio, viscosity=damping)


def _bricks(scene, at, corners, damping):
    ratio = _by_turns(corners, 0.2, 0.45)
    scene.add_bricks(at[corners], young_modulus=30.0, poisson_ratio=ratio, viscosity=damping)


ADD = {
    "springs": _springs,
    "bends": _bends,
    "cells": _cells,
    "crushed cells": _crushed_cells,
    "membranes": _membranes,
    "folded membranes": _folded_membranes,
    "bricks": _bricks,
    "solids": _solids,
}


def kinds(dim: int) -> list[str]:
    return [kind for kind in ADD if dim == 3 or "membranes" not in kind]


def add_block(scene: ts.Scene, kind: str, off: float, damping: float = 0.0, place: float = 0.0) -> np.ndarray:
    """Add a few elements of one kind and two materials, deformed by `off` [m] and in motion; returns its balls.

    damping: the viscosity of solids and bricks [Pa s] and the damping of springs and bending [N s/m]; a tenth of it is that of
    membranes [s].
    """
    dim = scene.dim
    rng = np.random.default_rng(3 + dim)
    points, corners = lattice((2, 1, 2)[:dim]) if kind == "bricks" else mesh((3, 2, 2)[:dim], 0.2)
    x = points * SIDES[:dim] + place * np.eye(dim)[0]
    balls = scene.add_balls(x, radius=0.01, mass=rng.uniform(0.5, 2.0, len(x)), velocity=rng.normal(size=x.shape))
    ADD[kind](scene, balls, corners, damping)
    scene.set_balls(balls, position=x + off * rng.normal(size=x.shape))
    return balls


def block(kind: str, dim: int, off: float = 0.05, damping: float = 0.0) -> ts.Scene:
    """One such body."""
    scene = ts.Scene(dim=dim, gravity=(0.0,) * dim)
    add_block(scene, kind, off, damping)
    return scene


def blocks(dim: int, off: float = 0.05, damping: float = 0.0, names=None) -> tuple[ts.Scene, dict[str, np.ndarray]]:
    """A scene with a body of each kind, and the balls of each."""
    scene = ts.Scene(dim=dim, gravity=(0.0,) * dim)
    names = kinds(dim) if names is None else names
    return scene, {kind: add_block(scene, kind, off, damping, APART * k) for k, kind in enumerate(names)}


def downhill(scene: ts.Scene, at: np.ndarray | None = None, torn: np.ndarray | None = None) -> np.ndarray:
    """Less the derivative (n, dim) of the energy by the places [N]."""
    at = scene.position if at is None else at
    gradient = np.zeros_like(at)
    for k in np.ndindex(*gradient.shape):
        there = at[None] + np.zeros((2, 1, 1))
        there[0][k] += 1e-6
        there[1][k] -= 1e-6
        stored = (diagnostics.energy(scene, x, scene.velocity, torn=torn).spring for x in there)
        gradient[k] = -np.diff(list(stored))[0] / 2e-6
    return -gradient
