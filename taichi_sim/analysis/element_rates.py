"""How stiff cells, bending elements, gases and the wind are: lambda_max of M^-1 K and of M^-1 D, for the largest safe step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.scene.scene import Scene

__all__ = ["NO_RATES", "Rates", "declared_rates", "element_rates", "largest_rate", "pushing_gas", "undeclared"]

ROOM = 2.0  # times the stiffness at rest: cells that are stretched by a fifth in all directions
PUSH = 0.001  # of the shortest side at a ball: what a gas may move it by in a step of xpbd; a hung balloon is then right to 1 %
ROUNDS, MARGIN = 30, 1.1  # of power iteration, which after ten comes to nine tenths of what it seeks

Floats = NDArray[np.float64]


class Rates(NamedTuple):
    """`elastic` [1/s^2] and `damping` [1/s], of which `drag` is the wind's part; 0 without such elements."""

    elastic: float
    damping: float
    drag: float = 0.0

    def plus(self, other: Rates) -> Rates:
        """Of both together: lambda(A + B) <= lambda(A) + lambda(B)."""
        return Rates(*(a + b for a, b in zip(self, other)))


NO_RATES = Rates(0.0, 0.0)


class _Kind(NamedTuple):
    """Elements of one kind: balls (e, k) and the gradient (e, k, dim) of what each stores the square of, times its strength (e,).
    A gradient (e, k, 1) stands for the same in all directions."""

    corners: NDArray
    gradient: Floats
    strength: Floats


def element_rates(scene: Scene, with_gas: bool = True) -> Rates:
    """Rates of all elements together, or of all but gas.

    The energy of an element has the second derivative k g g^T. Its largest eigenvalue over all comes from power iteration, which
    errs below, with a margin, but is at most what Gershgorin's rows for M^-1/2 K M^-1/2 allow: max_i w_i^1/2 sum_e k |g_i| sum_j
    w_j^1/2 |g_j|. Bending is linear: exact. Cells have the gradients of their volume at rest, and room for stretching; a gas
    that of its volume now, and its pressure on top, which turns with the surface: p times the edges at a ball over six.
    """
    root = np.where(scene.pinned, 0.0, 1.0 / np.sqrt(scene.mass))
    kinds, press = [], 0.0
    if len(scene.cells):
        kinds.append(
            _Kind(scene.cells, _gradients(scene), (ROOM * scene.bulk_modulus + scene.crush_modulus) / scene.rest_volume)
        )
    bends = scene.bend_weights[:, :, None]
    stiffness, loss = scene.held_bending()
    if len(scene.bends):
        kinds.append(_Kind(scene.bends, bends, stiffness))
    for gas in scene.gases if with_gas else ():
        x, t = scene.position, gas.triangles
        area = np.cross(x[t[:, 1]] - x[t[:, 0]], x[t[:, 2]] - x[t[:, 0]]) / 6.0
        balls = np.unique(t)
        sums = [np.bincount(t.ravel(), np.repeat(area[:, a], 3), scene.n_balls) for a in range(3)]
        gradient = np.stack(sums, axis=1).astype(np.float64)
        strength = ROOM * (gas.pressure + gas.outside) / gas.volume
        kinds.append(_Kind(balls[None], gradient[balls][None], np.array([strength])))
        edge = np.linalg.norm(x[np.roll(t, -1, axis=1)] - x[t], axis=2)  # from corner k to the next
        length = np.bincount(t.ravel(), (edge + np.roll(edge, 1, axis=1)).ravel(), scene.n_balls)
        press += float((abs(gas.pressure) * length / 6.0 * root).max()) * float(root.max())
    elastic = _largest(kinds, root, scene.dim) + press
    damping = _largest([_Kind(scene.bends, bends, loss)], root, scene.dim) if len(scene.bends) else 0.0
    drag = _drag(scene)
    return Rates(elastic, damping + drag, drag)


def declared_rates(scene: Scene, forces: Sequence[Any]) -> Rates:
    """What user-defined forces declare: the sums of their `stiffness_rate(scene)` [1/s^2] and `damping_rate(scene)` [1/s], 0
    where a force has no such function. Raises ValueError for what is not a rate."""
    sums = []
    for name in ("stiffness_rate", "damping_rate"):
        sums.append(0.0)
        for force in forces:
            rate = getattr(force, name)(scene) if hasattr(force, name) else 0.0
            if np.ndim(rate) or not isinstance(rate, (int, float, np.number)) or not 0.0 <= rate < np.inf:
                raise ValueError(
                    f"forces: {type(force).__name__}.{name} gave {rate!r}; it must be one number, 0 or more, and finite"
                )
            sums[-1] += float(rate)
    return Rates(*sums)


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
    kind = _Kind(corners, g, strengths)
    return _largest([kind], np.where(scene.pinned, 0.0, 1.0 / np.sqrt(scene.mass)), scene.dim)


def _drag(scene: Scene) -> float:
    """Of the wind [1/s]: the drag of a triangle changes with the speed u past it by density drag A u, and lambda is at most the
    largest of that times D = sum over its corners w_j t_j / 9, t_j the triangles at ball j. u: of the strongest gust, and of the
    fastest ball at the start."""
    if scene.wind is None or not len(scene.triangles):
        return 0.0
    wind, t, x = scene.wind, scene.triangles, scene.position
    w = np.where(scene.pinned, 0.0, 1.0 / scene.mass)
    give = (w * np.bincount(t.ravel(), minlength=scene.n_balls))[t].sum(axis=1) / 9.0
    area = 0.5 * np.linalg.norm(np.cross(x[t[:, 1]] - x[t[:, 0]], x[t[:, 2]] - x[t[:, 0]]), axis=1)
    speed = float(np.linalg.norm(wind.velocity)) * (1.0 + wind.gust)
    speed += float(np.linalg.norm(scene.velocity, axis=1).max(initial=0.0))
    return wind.density * max(wind.drag, wind.skin_friction) * speed * float((give * area).max())


def pushing_gas(scene: Scene) -> float:
    """The longest step [s] in which no gas, if nothing held it, would move a ball by more than PUSH of the shortest side there.

    xpbd lets springs answer a gas once in a step: what they hold against it, h^2 p |dV/dx| / m, is an error of their lengths.
    """
    least = np.inf
    for gas in scene.gases:
        x, t = scene.position, gas.triangles
        area = np.cross(x[t[:, 1]] - x[t[:, 0]], x[t[:, 2]] - x[t[:, 0]]) / 6.0
        push = np.stack([np.bincount(t.ravel(), np.repeat(area[:, a], 3), scene.n_balls) for a in range(3)], axis=1)
        edge = np.full(scene.n_balls, np.inf)
        side = np.linalg.norm(x[np.roll(t, -1, axis=1)] - x[t], axis=2)
        for one in (t, np.roll(t, -1, axis=1)):
            np.minimum.at(edge, one.ravel(), side.ravel())
        rate = np.where(scene.pinned, 0.0, abs(gas.pressure) * np.linalg.norm(push, axis=1) / (scene.mass * edge))
        if rate.max() > 0.0:
            least = min(least, float(np.sqrt(PUSH / rate.max())))
    return least


def _largest(kinds: list[_Kind], root: Floats, dim: int) -> float:
    """The largest eigenvalue of sum k g g^T, both sides times `root` (n,)."""
    kinds = [kind for kind in kinds if np.any(kind.strength > 0)]
    if not kinds:
        return 0.0
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


def _product(kind: _Kind, p: Floats) -> Floats:
    """sum k g g^T p, (n, dim)."""
    whole = kind.gradient.shape[2] == 1
    terms = kind.gradient * p[kind.corners]
    inner = terms.sum(axis=1, keepdims=True) if whole else terms.sum(axis=(1, 2), keepdims=True)
    force = kind.strength[:, None, None] * inner * kind.gradient
    flat = kind.corners.ravel()
    return np.stack([np.bincount(flat, force[..., a].ravel(), len(p)) for a in range(p.shape[1])], axis=1)


def _gradients(scene: Scene) -> Floats:
    """Gradients (c, dim + 1, dim) of each cell's volume, scaled to its volume at rest."""
    x = scene.position[scene.cells]
    if scene.dim == 2:
        sides = [x[:, (k + 2) % 3] - x[:, (k + 1) % 3] for k in range(3)]
        gradient = 0.5 * np.stack([np.stack([-s[:, 1], s[:, 0]], axis=1) for s in sides], axis=1)
        now = 0.5 * np.abs(np.linalg.det(x[:, 1:] - x[:, :1]))
    else:
        faces = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))
        normals = [np.cross(x[:, b] - x[:, a], x[:, c] - x[:, a]) for a, b, c in faces]
        gradient = np.stack(normals, axis=1) / -6.0
        now = np.abs(np.linalg.det(x[:, 1:] - x[:, :1])) / 6.0
    # the rest shape is not known, only its volume: the present one, as much larger or smaller
    ratio = np.divide(scene.rest_volume, now, out=np.ones_like(now), where=now > 0)
    return gradient * ratio[:, None, None] ** ((scene.dim - 1) / scene.dim)
