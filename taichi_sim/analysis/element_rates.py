"""Stiffness of cells, bending elements, gases and the wind: lambda_max of M^-1 K and of M^-1 D, for the largest safe step."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.gases import volume_gradient
from taichi_sim.scene.part import Element, Quadratic
from taichi_sim.scene.scene import Scene
from taichi_sim.scene.wind import WIND

__all__ = [
    "NO_RATES",
    "Declared",
    "Rates",
    "declared_rates",
    "element_rates",
    "largest_rate",
    "pushing_gas",
    "undeclared",
]

PUSH = 0.001  # of the shortest side at a ball: what a gas may move it by in a step of xpbd; a hung balloon is then right to 1 %
ROUNDS, MARGIN = 30, 1.1  # of power iteration, which after ten comes to nine tenths of what it seeks

MOST_KNOWN = 16  # eigenvalues that are kept: a report asks for the same ones for each method

Floats = NDArray[np.float64]
_known: dict[bytes, float] = {}


class Rates(NamedTuple):
    """`elastic` [1/s^2] and `damping` [1/s], of which `drag` is the wind's part; 0 without such elements."""

    elastic: float
    damping: float
    drag: float = 0.0

    def plus(self, other: Rates) -> Rates:
        """Rates of both together, by the bound lambda(A + B) <= lambda(A) + lambda(B)."""
        return Rates(*(a + b for a, b in zip(self, other)))


NO_RATES = Rates(0.0, 0.0)


class Declared(NamedTuple):
    """Rates that user-defined forces declare: of `elements` that implicit methods solve for, and of all `others`."""

    others: Rates = NO_RATES
    elements: Rates = NO_RATES

    def left(self, solved: bool) -> Rates:
        """Rates of what is explicit in a method that solves for elements, or does not."""
        return self.others if solved else self.others.plus(self.elements)


def element_rates(scene: Scene, solved: Collection[Element] = ()) -> Rates:
    """Rates of all elements together, or of all but those that a method has `solved`.

    The energy of an element has the second derivative k g g^T. Its largest eigenvalue over all comes from power iteration, which
    errs below, with a margin, but is at most what Gershgorin's rows for M^-1/2 K M^-1/2 allow: max_i w_i^1/2 sum_e k |g_i| sum_j
    w_j^1/2 |g_j|. Bending is linear: exact. Cells have the gradients of their volume at rest, and room for stretching; a gas
    that of its volume now, and its pressure on top, which turns with the surface: p times the edges at a ball over six.
    """
    root = np.where(scene.pinned, 0.0, 1.0 / np.sqrt(scene.mass))
    there = [one for one in ELEMENTS if one.count(scene) and one not in solved]
    further = [one.further_rates(scene) for one in there]
    elastic = _largest([kind for one in there for kind in one.stiffness(scene)], root, scene.dim)
    damping = _largest([kind for one in there for kind in one.damping(scene)], root, scene.dim)
    drag = WIND.further_rates(scene)[1] if WIND.count(scene) else 0.0
    return Rates(elastic + sum(rate for rate, _ in further), damping + sum(rate for _, rate in further), drag)


def declared_rates(scene: Scene, forces: Sequence[Any]) -> Declared:
    """Rates that user-defined forces declare: the sums of their `stiffness_rate(scene)` [1/s^2] and `damping_rate(scene)`
    [1/s], 0 where a force has no such function. Raises ValueError for what is not a rate."""
    sums = {False: [0.0, 0.0], True: [0.0, 0.0]}
    for k, name in enumerate(("stiffness_rate", "damping_rate")):
        for force in forces:
            rate = getattr(force, name)(scene) if hasattr(force, name) else 0.0
            if np.ndim(rate) or not isinstance(rate, (int, float, np.number)) or not 0.0 <= rate < np.inf:
                raise ValueError(
                    f"forces: {type(force).__name__}.{name} gave {rate!r}; it must be one number, 0 or more, and finite"
                )
            sums[bool(getattr(force, "implicit", False))][k] += float(rate)
    return Declared(Rates(*sums[False]), Rates(*sums[True]))


def undeclared(forces: Sequence[Any]) -> list[str]:
    """Names of the user-defined forces that say nothing of how stiff they are, and so are not in any safe step."""
    silent = [one for one in forces if not (hasattr(one, "stiffness_rate") or hasattr(one, "damping_rate"))]
    return list(dict.fromkeys(type(force).__name__ for force in silent))


def largest_rate(scene: Scene, balls: ArrayLike, gradient: Floats, strength: Floats) -> float:
    """lambda_max of M^-1 K [1/s^2] of elements that store strength |sum_k g_k x_k|^2 / 2, or strength (sum_k g_k . x_k)^2 / 2:
    balls (e, k), the corners; gradient (e, k) or (k,), or (e, k, dim) where it has a direction; strength one or (e,)."""
    corners = np.asarray(balls)
    corners = validation.indices("balls", corners, scene.n_balls, corners.shape[1] if corners.ndim == 2 else 1)
    strengths = validation.per_item("strength", strength, len(corners), low=0)
    g = np.asarray(gradient, dtype=np.float64)
    g = g if g.ndim == 3 else np.broadcast_to(g, corners.shape)[:, :, None]
    kind = Quadratic(corners, g, strengths)
    return _largest([kind], np.where(scene.pinned, 0.0, 1.0 / np.sqrt(scene.mass)), scene.dim)


def pushing_gas(scene: Scene) -> float:
    """The longest step [s] in which no gas, if nothing held it, would move a ball by more than PUSH of the shortest side there.

    xpbd lets springs answer a gas once in a step: what they hold against it, h^2 p |dV/dx| / m, is an error of their lengths.
    """
    least = np.inf
    for gas in scene.gases:
        x, t = scene.position, gas.triangles
        push = volume_gradient(x, t)
        edge = np.full(scene.n_balls, np.inf)
        side = np.linalg.norm(x[np.roll(t, -1, axis=1)] - x[t], axis=2)
        for one in (t, np.roll(t, -1, axis=1)):
            np.minimum.at(edge, one.ravel(), side.ravel())
        rate = np.where(scene.pinned, 0.0, abs(gas.pressure) * np.linalg.norm(push, axis=1) / (scene.mass * edge))
        if rate.max() > 0.0:
            least = min(least, float(np.sqrt(PUSH / rate.max())))
    return least


def _largest(kinds: list[Quadratic], root: Floats, dim: int) -> float:
    """The largest eigenvalue of sum k g g^T, both sides times `root` (n,); that of the same arrays is worked out once."""
    kinds = [kind for kind in kinds if np.any(kind.strength > 0)]
    if not kinds:
        return 0.0
    content = hashlib.blake2b(f"{dim} {[kind.gradient.shape for kind in kinds]}".encode())
    for array in (root, *(array for kind in kinds for array in kind)):
        content.update(np.ascontiguousarray(array).data)
    key = content.digest()
    if key not in _known:
        if len(_known) >= MOST_KNOWN:
            del _known[next(iter(_known))]
        _known[key] = _iterated(kinds, root, dim)
    return _known[key]


def _iterated(kinds: list[Quadratic], root: Floats, dim: int) -> float:
    """The largest eigenvalue by power iteration, see `element_rates`."""
    rows = np.zeros(len(root))
    for kind in kinds:
        scaled = np.linalg.norm(kind.gradient, axis=2) * root[kind.corners]
        each = kind.strength[:, None] * scaled * scaled.sum(axis=1, keepdims=True)
        rows += np.bincount(kind.corners.ravel(), each.ravel(), len(root))
    alike = all(kind.gradient.shape[2] == 1 for kind in kinds)  # in all directions: one of them tells
    p = np.random.default_rng(0).normal(size=(len(root), 1 if alike else dim))
    value, bound = 0.0, float(rows.max())
    for _ in range(ROUNDS):
        p /= np.linalg.norm(p)
        p = sum(_product(kind, p * root[:, None]) for kind in kinds) * root[:, None]
        value = float(np.linalg.norm(p))
        if value == 0.0 or MARGIN * value >= bound:  # it only grows
            break
    return min(MARGIN * value, bound)


def _product(kind: Quadratic, p: Floats) -> Floats:
    """sum k g g^T p, (n, dim)."""
    whole = kind.gradient.shape[2] == 1
    terms = kind.gradient * p[kind.corners]
    inner = terms.sum(axis=1, keepdims=True) if whole else terms.sum(axis=(1, 2), keepdims=True)
    force = kind.strength[:, None, None] * inner * kind.gradient
    flat = kind.corners.ravel()
    return np.stack([np.bincount(flat, force[..., a].ravel(), len(p)) for a in range(p.shape[1])], axis=1)
