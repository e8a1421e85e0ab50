"""Polygons of mesh files, and the triangles that fill them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["FormatError", "Polygons", "real", "shown", "triangulated", "without_repeats"]

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]
LEAST = 1e-9  # of a polygon's area: a triangle of less has none
MOST_CUT = 3e8  # corners squared of polygons that are cut ear by ear, which takes a minute


class FormatError(ValueError):
    """A file that breaks the rules of its format; the message is for its user."""


class Polygons(NamedTuple):
    """A mesh as a file holds it: `counts[k]` corners for polygon k, one polygon behind the other."""

    vertices: Floats  # (n, 3) m
    corners: Whole  # (c,) vertices
    counts: Whole  # (p,)
    uv: Floats | None = None  # (c, 2) place of each corner on a texture, v upward; nan where it has none


def real(word: bytes) -> float:
    """Return the number that a word of a text is. Raises FormatError."""
    try:
        if b"_" not in word:  # which Python passes over
            return float(word)
    except ValueError:
        pass
    raise FormatError(f"{shown(word)} is not a number")


def shown(word: bytes) -> str:
    """Return a word of a file as messages show it."""
    return repr(word.decode("utf-8", "replace")[:40])


def triangulated(vertices: Floats, corners: Whole, counts: Whole) -> tuple[Whole, Whole]:
    """Return positions (t, 3) in `corners` of the triangles that fill the polygons, and the polygons (k,) that cross themselves.

    A polygon of n corners gives n - 2 triangles that face as it does; one of less than three corners gives none. Triangles from
    its first corner are taken where none of them turns over: only then do they fill a polygon that is not convex. The others are
    cut off ear by ear; FormatError is raised where that would take minutes. A polygon that crosses itself is cut from its first
    corner.
    """
    starts = np.cumsum(counts) - counts
    found, crossing, left = [np.zeros((0, 3), dtype=np.int64)], [], MOST_CUT
    for n in np.unique(counts[counts >= 3]).tolist():
        first = starts[counts == n]
        fan = first[:, None, None] + np.stack([np.zeros(n - 2), np.arange(1, n - 1), np.arange(2, n)], axis=1)
        fan = fan.astype(np.int64)
        if n > 3:
            x = vertices[corners[first[:, None] + np.arange(n)]]
            x = x - x[:, :1]
            normal = np.cross(x, np.roll(x, -1, axis=1)).sum(axis=1)
            area = np.einsum("pki,pi->pk", np.cross(x[:, 1:-1], x[:, 2:]), normal)
            square = np.einsum("pi,pi->p", normal, normal)
            for k in np.flatnonzero((area <= LEAST * square[:, None]).any(axis=1) & (square > 0.0)).tolist():
                left -= n * n
                if left < 0:
                    raise FormatError(
                        f"a face of {n} corners is not convex, or too many are; divide them into triangles"
                    )
                ears = _ears(_flat(x[k], normal[k] / np.sqrt(square[k])))
                if ears is None:
                    crossing.append(np.flatnonzero(counts == n)[k])
                else:
                    fan[k] = first[k] + ears
        found.append(fan.reshape(-1, 3))
    triangles = np.concatenate(found)
    return triangles[np.argsort(triangles[:, 0], kind="stable")], np.array(crossing, dtype=np.int64)


def without_repeats(corners: Whole, counts: Whole) -> tuple[NDArray[np.bool_], Whole]:
    """Return which corners (c,) of polygons are another vertex than the one before, and how many (p,) that leaves to each."""
    starts = np.cumsum(counts) - counts
    before = np.roll(corners, 1)
    before[starts[counts > 0]] = corners[(starts + counts - 1)[counts > 0]]
    kept = corners != before
    return kept, np.bincount(np.repeat(np.arange(len(counts)), counts)[kept], minlength=len(counts))


def _flat(x: Floats, normal: Floats) -> Floats:
    """Places (n, 2) in the plane across a unit normal."""
    along = np.eye(3)[np.argmin(np.abs(normal))]
    along = along - (along @ normal) * normal
    along /= np.linalg.norm(along)
    return np.stack([x @ along, x @ np.cross(normal, along)], axis=1)


def _ears(p: Floats) -> Whole | None:
    """Corners (n - 2, 3) of the triangles that fill a polygon (n, 2), counter-clockwise; None where it crosses itself.

    An ear is a corner whose triangle faces upward and holds no other corner; the one nearest to an equilateral triangle is cut
    off first. Since triangles that all face upward cover each point as often as the polygon winds around it, they fill any
    polygon that does not cross itself, exactly once.
    """
    p = p / np.max(np.abs(p))
    left = list(range(len(p)))
    worth = [_worth(p, left, k) for k in range(len(left))]
    triangles = []
    while len(left) > 3:
        k = int(np.argmax(worth))
        if worth[k] < 0.0:
            worth = [_worth(p, left, j) for j in range(len(left))]  # what was within an ear may be gone
            k = int(np.argmax(worth))
            if worth[k] < 0.0:
                return None
        triangles.append((left[k - 1], left[k], left[(k + 1) % len(left)]))
        del left[k], worth[k]
        for j in (k - 1, k % len(left)):
            worth[j] = _worth(p, left, j)
    a, b, c = p[left]
    return np.array([*triangles, tuple(left)]) if _cross(b - a, c - a) > 0.0 else None


def _worth(p: Floats, left: list[int], k: int) -> float:
    """Twice the area of the triangle of a corner over its longest side squared; -1 where it is no ear."""
    a, b, c = p[left[k - 1]], p[left[k]], p[left[(k + 1) % len(left)]]
    area = float(_cross(b - a, c - b))
    if area <= LEAST:
        return -1.0
    q = p[left]
    near = -LEAST
    inside = (_cross(b - a, q - a) >= near) & (_cross(c - b, q - b) >= near) & (_cross(a - c, q - c) >= near)
    for corner in (a, b, c):
        inside &= (q != corner).any(axis=1)
    return -1.0 if inside.any() else area / max(float(np.sum(side**2)) for side in (b - a, c - b, a - c))


def _cross(a: Floats, b: Floats) -> Floats:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
