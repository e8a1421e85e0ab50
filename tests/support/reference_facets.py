"""Surfaces by brute force, in NumPy float64, sharing no code with the program: which pairs are near, and one pass over them."""

from itertools import combinations, product
from typing import NamedTuple

import numpy as np

LOOK, LISTED, SPACING, INSIDE = 1.5, 1.1, 0.5, 1e-4


class Pair(NamedTuple):
    """Whether of two edges; four balls, weights, normal, distance, distance at touch [m]; whether it is a contact, or only
    listed; how much [m] decided about either."""

    edge: bool
    balls: tuple[int, ...]
    g: np.ndarray
    normal: np.ndarray
    distance: float
    thickness: float
    contact: bool
    margin: float


def least_squares(one, other, r):
    """Parts s, t of two vectors that bring s one + t other closest to r."""
    a, b, c = one @ one, one @ other, other @ other
    return np.array([c * (one @ r) - b * (other @ r), a * (other @ r) - b * (one @ r)]) / (a * c - b * b)


def on_segment(x, a, b):
    """Part of the way from a to b that is closest to x."""
    d = b - a
    return float(np.clip((x - a) @ d / (d @ d), 0.0, 1.0))


def on_triangle(x, corners):
    """Weights of the corners at the closest point: the foot on the plane where it lies inside, else the best of the sides."""
    a, b, c = corners
    w = least_squares(b - a, c - a, x - a)
    inside = np.array([1.0 - w.sum(), *w])
    if inside.min() > 0.0:
        return inside
    options = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        t = on_segment(x, corners[i], corners[j])
        w = np.zeros(3)
        w[[i, j]] = 1.0 - t, t
        options.append(w)
    return min(options, key=lambda w: np.linalg.norm(x - w @ corners))


def between_edges(a, b, c, d):
    """Parts of the ways a b and c d at which they are closest: inside of both, or at one of the four ends."""
    options = [
        (0.0, on_segment(a, c, d)),
        (1.0, on_segment(b, c, d)),
        (on_segment(c, a, b), 0.0),
        (on_segment(d, a, b), 1.0),
    ]
    s, t = least_squares(b - a, c - d, c - a)
    if 0.0 < s < 1.0 and 0.0 < t < 1.0:
        options.append((s, t))
    return min(options, key=lambda p: np.linalg.norm(a + p[0] * (b - a) - c - p[1] * (d - c)))


def pairs(x, v, radius, triangles, joined, h, start):
    """All pairs of a ball and a triangle, and of two edges, that share no ball and are listed. joined: pairs (i, j) of balls that
    a spring joins. start: positions (n, 3) [m] from which the distances of what is held together are taken."""
    edges = sorted({tuple(sorted((int(t[i]), int(t[j])))) for t in triangles for i, j in ((0, 1), (1, 2), (2, 0))})
    joined = {tuple(sorted(map(int, p))) for p in joined}
    spacing = np.full(len(x), np.inf)
    for t in triangles:
        a, b, c = start[t]
        longest = max(np.linalg.norm(p - q) for p, q in ((a, b), (b, c), (c, a)))
        height = np.linalg.norm(np.cross(b - a, c - a)) / longest
        spacing[t] = np.minimum(spacing[t], SPACING * height)
    body = np.arange(len(x))  # the lowest ball that springs and triangles hold each one to
    for _ in range(len(x)):
        for one in (*joined, *map(list, triangles)):
            body[list(one)] = body[list(one)].min()
    found = []

    def note(edge, upper, lower, g, whole):
        balls = (*upper, *lower)
        r = g @ x[list(balls)]
        d = float(np.linalg.norm(r))
        u = float(r / d @ (g @ v[list(balls)]))
        thickness = float(np.abs(g) @ radius[list(balls)])
        way = LOOK * h * max(0.0, -u)
        closing = float((v[list(lower)] @ r).max() - (v[list(upper)] @ r).min()) / d
        reach = radius[list(upper)].max() + radius[list(lower)].max() + LOOK * h * max(0.0, closing)
        if d < reach:
            if body[upper[0]] == body[lower[0]]:
                corners = start[list(balls)]
                s = between_edges(*corners) if edge else on_triangle(corners[0], corners[1:])
                rest = np.array([1 - s[0], s[0], s[1] - 1, -s[1]]) if edge else np.array([1.0, *-s])
                apart = float(np.linalg.norm(rest @ corners))
                part = 0.0
                for (i, a), (j, b) in product(zip(upper, np.abs(g)), zip(lower, np.abs(g)[len(upper) :])):
                    if tuple(sorted((i, j))) in joined:
                        part += a * b
                        thickness -= a * b * max(0.0, radius[i] + radius[j] - min(spacing[i], spacing[j]))
                thickness = min(thickness, (1.0 - (1.0 - SPACING) * part) * apart)
            touch = max(LISTED * thickness, thickness + way)
            margin = min(reach - d, abs(d - touch), 1e-3 * np.abs(np.abs(g[g != 0]) - (INSIDE if edge else 0)).min())
            found.append(Pair(edge, tuple(map(int, balls)), g, r / d, d, thickness, bool(whole and d < touch), margin))

    for t in map(tuple, triangles):
        for i in range(len(x)):
            if i not in t:
                w = on_triangle(x[i], x[list(t)])
                note(False, (i,), t, np.array([1.0, *-w]), _is_own(i, t, w, x, triangles))
    for (a, b), (c, d) in combinations(edges, 2):
        if len({a, b, c, d}) == 4:
            s, t = between_edges(*x[[a, b, c, d]])
            note(True, (a, b), (c, d), np.array([1 - s, s, t - 1, -t]), all(INSIDE < p < 1 - INSIDE for p in (s, t)))
    return found


def _is_own(i, t, w, x, triangles):
    """True if ball i hits triangle t inside; or a side of it and nothing nearer of the triangle beyond, which counts once; or a
    corner, which counts once of all triangles there and, of two corners, for the lower ball."""
    if np.all(w > 0):
        return True
    if np.count_nonzero(w) < 2:
        corner = t[int(np.argmax(w))]
        first = min((tuple(other) for other in triangles if corner in other), key=lambda other: (min(other),))
        return t == first and (i < corner or i not in np.asarray(triangles))
    side = {t[k] for k in range(3) if w[k] > 0}
    sharing = [tuple(other) for other in triangles if side <= set(map(int, other))]
    at = w @ x[list(t)]
    d = np.linalg.norm(x[i] - at)
    lowest = min(
        sharing, key=lambda other: (min(other),)
    )  # of a side that two triangles share, the first in the program's order
    return t == lowest and all(
        np.linalg.norm(x[i] - on_triangle(x[i], x[list(o)]) @ x[list(o)]) > d * (1 - 1e-12) for o in sharing
    )


def one_pass(contacts, v, w, e, h, threshold):
    """One cold pass without friction: velocities after it. s of a ball: largest eigenvalue of sum g^2 n n^T."""
    tensor = np.zeros((len(v), 3, 3))
    for c in contacts:
        for i, g in zip(c.balls, c.g):
            tensor[i] += g * g * np.outer(c.normal, c.normal)
    s = np.linalg.eigvalsh(tensor)[:, -1]
    after = v.copy()
    for c in contacts:
        at = list(c.balls)
        u = float(c.normal @ (c.g @ v[at]))
        target = -e * u if u < -threshold or u > 0 else 0.0
        gap = c.distance - c.thickness
        if gap > 0:
            target = min(target, u if e > 0 and u < -threshold else -gap / h)
        mass = 1.0 / float(np.sum((w * s)[at] * (c.g != 0)))
        impulse = max(0.0, (target - u) * mass)
        after[at] += (w[at] * c.g * impulse)[:, None] * c.normal
    return after
