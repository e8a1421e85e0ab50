"""Distances from a closed triangle mesh on a regular grid: exact near the triangles, then handed on from corner to corner.

Real numbers are of the type of the arrays handed in, best in double precision, whatever that of the run is. frame (5,): the
lowest corner of the grid [m], the width of a cell [m], and by which part of it `winding` shifts its lines.
"""

from taichi_sim.device.engine import ti

LEAST = 1e-37  # in place of a division by 0; also a number in single precision


@ti.func
def point(table: ti.template(), k):
    return ti.Vector([table[k, 0], table[k, 1], table[k, 2]])


@ti.func
def lowest(frame: ti.template()):
    return ti.Vector([frame[0], frame[1], frame[2]])


@ti.func
def squared(p, a, b, c):
    """Squared distance of p from the triangle a b c (Ericson, Real-Time Collision Detection, 5.1.5)."""
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = ab.dot(ap), ac.dot(ap)
    bp = p - b
    d3, d4 = ab.dot(bp), ac.dot(bp)
    cp = p - c
    d5, d6 = ab.dot(cp), ac.dot(cp)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    q = a
    if d1 <= 0.0 and d2 <= 0.0:
        q = a
    elif d3 >= 0.0 and d4 <= d3:
        q = b
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        q = a + ab * (d1 / ti.max(d1 - d3, LEAST))
    elif d6 >= 0.0 and d5 <= d6:
        q = c
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        q = a + ac * (d2 / ti.max(d2 - d6, LEAST))
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        q = b + (c - b) * ((d4 - d3) / ti.max((d4 - d3) + (d5 - d6), LEAST))
    else:
        q = a + (ab * vb + ac * vc) / ti.max(va + vb + vc, LEAST)
    return (p - q).dot(p - q)


@ti.func
def to_triangle(corner: ti.template(), p, t):
    return squared(p, point(corner, 3 * t), point(corner, 3 * t + 1), point(corner, 3 * t + 2))


@ti.kernel
def seed(
    corner: ti.types.ndarray(ndim=2),
    closest: ti.types.ndarray(ti.i32, 3),
    best: ti.types.ndarray(ndim=3),
    frame: ti.types.ndarray(ndim=1),
):
    """The nearest triangle of every grid corner (closest, best: squared distance) within a cell of a triangle's box."""
    low, cell = lowest(frame), frame[3]
    ti.loop_config(serialize=True)  # the first of equals wins, whatever the threads
    for t in range(corner.shape[0] // 3):
        a, b, c = point(corner, 3 * t), point(corner, 3 * t + 1), point(corner, 3 * t + 2)
        first = ti.cast(ti.floor((ti.min(a, b, c) - low) / cell), ti.i32) - 1
        last = ti.cast(ti.floor((ti.max(a, b, c) - low) / cell), ti.i32) + 2
        for k in range(ti.max(first[2], 0), ti.min(last[2] + 1, closest.shape[0])):
            for j in range(ti.max(first[1], 0), ti.min(last[1] + 1, closest.shape[1])):
                for i in range(ti.max(first[0], 0), ti.min(last[0] + 1, closest.shape[2])):
                    d = squared(low + cell * ti.Vector([i, j, k]), a, b, c)
                    if d < best[k, j, i]:
                        best[k, j, i] = d
                        closest[k, j, i] = t


@ti.kernel
def spread(
    corner: ti.types.ndarray(ndim=2),
    source: ti.types.ndarray(ti.i32, 3),
    closest: ti.types.ndarray(ti.i32, 3),
    best: ti.types.ndarray(ndim=3),
    frame: ti.types.ndarray(ndim=1),
    reach: int,
):
    """Take over a nearer triangle from the corners `reach` cells away (Rong and Tan, Jump flooding, 2006)."""
    low, cell = lowest(frame), frame[3]
    for k, j, i in ti.ndrange(source.shape[0], source.shape[1], source.shape[2]):
        p = low + cell * ti.Vector([i, j, k])
        nearest, d = source[k, j, i], best[k, j, i]
        for n in range(27):
            x, y, z = i + (n % 3 - 1) * reach, j + (n // 3 % 3 - 1) * reach, k + (n // 9 - 1) * reach
            if 0 <= x < source.shape[2] and 0 <= y < source.shape[1] and 0 <= z < source.shape[0]:
                t = source[z, y, x]
                if t >= 0 and t != nearest:
                    e = to_triangle(corner, p, t)
                    if e < d:
                        nearest, d = t, e
        closest[k, j, i] = nearest
        best[k, j, i] = d


@ti.kernel
def winding(corner: ti.types.ndarray(ndim=2), windings: ti.types.ndarray(ti.i32, 3), frame: ti.types.ndarray(ndim=1)):
    """How often the surface winds around each grid corner: crossings of the line along x, counted with their sign.

    Lines are shifted by frame[4] of a cell, so that none runs along an edge of a mesh with round coordinates.
    """
    low, cell = lowest(frame), frame[3]
    ti.loop_config(serialize=True)
    for t in range(corner.shape[0] // 3):
        a = (point(corner, 3 * t) - low) / cell
        b = (point(corner, 3 * t + 1) - low) / cell
        c = (point(corner, 3 * t + 2) - low) / cell
        area = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
        first = ti.cast(ti.floor(ti.min(a, b, c)), ti.i32) - 1
        last = ti.cast(ti.floor(ti.max(a, b, c)), ti.i32) + 1
        for k in range(ti.max(first[2], 0), ti.min(last[2] + 1, windings.shape[0])):
            for j in range(ti.max(first[1], 0), ti.min(last[1] + 1, windings.shape[1])):
                y, z = j + frame[4], k + 0.7 * frame[4]
                wa = (c[1] - b[1]) * (z - b[2]) - (c[2] - b[2]) * (y - b[1])
                wb = (a[1] - c[1]) * (z - c[2]) - (a[2] - c[2]) * (y - c[1])
                wc = (b[1] - a[1]) * (z - a[2]) - (b[2] - a[2]) * (y - a[1])
                inside = (wa > 0.0 and wb > 0.0 and wc > 0.0) or (wa < 0.0 and wb < 0.0 and wc < 0.0)
                if inside and area != 0.0:
                    x = (wa * a[0] + wb * b[0] + wc * c[0]) / (wa + wb + wc)
                    i = ti.max(ti.cast(ti.ceil(x), ti.i32), 0)
                    if i < windings.shape[2]:
                        windings[k, j, i] += ti.select(area > 0.0, 1, -1)
    for k, j in ti.ndrange(windings.shape[0], windings.shape[1]):
        total = 0
        for i in range(windings.shape[2]):
            total += windings[k, j, i]
            windings[k, j, i] = total
