"""Distances from a closed triangle mesh on a regular grid: exact near the triangles, then handed on from corner to corner.

Real numbers are of the type of the arrays handed in, best in double precision, whatever that of the run is. frame (8,): the
lowest corner of the grid [m], the width of a cell [m], by which part of it `winding` shifts its lines, and three lengths, see
`find_inexact`.
"""

from taichi_sim.kernels.contacts.closest_points import on_triangle
from taichi_sim.kernels.contacts.triangle_tree import (
    AT_CORNER,
    CORNERS,
    FAR,
    INSIDE,
    WIDTH,
    above_and_beyond,
    entry,
    from_triangle,
    is_within,
    least_square,
    nearer,
    signed_distance,
)

from taichi_sim.device.engine import ti

HALF_DIAGONAL, SLACK = 0.8660255, 1e-3  # of a cell, and for rounding
PARTS = 3  # along each axis of a cell: in each of them a triangle of its list may be closest
DOUBTFUL = 0.1  # of the error that is allowed: in the middle of a cell, where it may be larger elsewhere
UNSAFE = 0.2  # of a distance: an error that those who march along it, see ccd_colliders.MARCH_SAFETY, bear


@ti.func
def point(table: ti.template(), k):
    return ti.Vector([table[k, 0], table[k, 1], table[k, 2]])


@ti.func
def lowest(frame: ti.template()):
    return ti.Vector([frame[0], frame[1], frame[2]])


@ti.func
def to_triangle(corner: ti.template(), p, t):
    """Squared distance of p from triangle t."""
    return squared(p, point(corner, 3 * t), point(corner, 3 * t + 1), point(corner, 3 * t + 2))


@ti.func
def squared(p, a, b, c):
    """Squared distance of p from the triangle a b c."""
    w = on_triangle(p, a, b, c)
    r = (p - a) - (w[1] * (b - a) + w[2] * (c - a))
    return r.dot(r)


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
    """Count how often the surface winds around each grid corner: crossings of the line along x, counted with their sign.

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


@ti.func
def corner_value(value: ti.template(), k, j, i, c: ti.template()):
    """Value at corner c, 0 to 7, of the cell whose lowest one is i, j, k."""
    return value[k + ti.static(c >> 2 & 1), j + ti.static(c >> 1 & 1), i + ti.static(c & 1)]


@ti.func
def interpolated(value: ti.template(), k, j, i, part):
    """Between the corners of a cell, at the parts (3) of it along the axes."""
    total = 0.0 * part[0]
    for c in ti.static(range(8)):
        weight = 1.0 + total * 0.0
        for a in ti.static(range(3)):
            weight *= part[a] if ti.static(c >> a & 1) else 1.0 - part[a]
        total += weight * corner_value(value, k, j, i, c)
    return total


@ti.kernel
def find_inexact(
    value: ti.types.ndarray(ndim=3),
    closest: ti.types.ndarray(ti.i32, 3),
    box: ti.types.ndarray(ndim=1),
    link: ti.types.ndarray(ti.i32, 1),
    triangle: ti.types.ndarray(ndim=1),
    near: ti.types.ndarray(ti.i32, 3),
    frame: ti.types.ndarray(ndim=1),
):
    """A triangle near each cell (near, at its lowest corner) where the values at its corners would be wrong somewhere between,
    looked at halfway; else -1. Wrong is more than frame[6] m at places within frame[7] m, where balls touch, and farther away,
    where they only approach, more than a share of the distance. Beyond frame[5] m of the mesh values are wrong only where two
    places of it are as near, as between the sides of a corner: there they are too small, and so in the middle of the cell."""
    low, cell = lowest(frame), frame[3]
    for k, j, i in ti.ndrange(value.shape[0] - 1, value.shape[1] - 1, value.shape[2] - 1):
        least = frame[7] + cell
        for c in ti.static(range(8)):
            least = ti.min(least, ti.abs(corner_value(value, k, j, i, c)))
        triangle_near, wrong = closest[k, j, i], False
        place, places = 0, ti.select(least < ti.max(frame[5], frame[7]), 27, 0)
        while place < places and not wrong:
            number = (place + 13) % 27  # from the middle on
            part = 0.5 * ti.Vector([number % 3, number // 3 % 3, number // 9])
            p = low + cell * (part + ti.Vector([i, j, k]))
            d, _, t = signed_distance(box, link, triangle, 0, link[0], triangle_near, p)
            error = interpolated(value, k, j, i, part) - d
            if place == 0:
                triangle_near = t
                if least > frame[5] and error > -DOUBTFUL * frame[6]:
                    places = 0
            error = ti.abs(error)
            wrong = error > frame[6] and (ti.abs(d) < frame[7] or error > UNSAFE * ti.abs(d))
            place += 1
        if wrong:
            near[k, j, i] = triangle_near


@ti.func
def insert(listed: ti.template(), away: ti.template(), c, number, t, d):
    """Put triangle t at the distance d [m] into row c of so many, which are in the order of theirs."""
    s = number
    while s > 0 and away[c, ti.max(s - 1, 0)] > d:
        listed[c, s], away[c, s] = listed[c, s - 1], away[c, s - 1]
        s -= 1
    listed[c, s], away[c, s] = t, d


@ti.func
def thin_out(triangle: ti.template(), listed: ti.template(), away: ti.template(), c, number, p, width):
    """Keep of the triangles in row c, so many, those that may be closest to some point of one of the parts of a cell, this wide
    [m] around p, and of those that are at the same distance one. Returns how many."""
    part = width / PARTS
    for e in range(PARTS * PARTS * PARTS):
        step = ti.Vector([e % PARTS, e // PARTS % PARTS, e // (PARTS * PARTS)])
        q = p + part * (ti.cast(step, float) - 0.5 * (PARTS - 1))
        square, r, feature, closest = FAR + 0.0 * q[0], 0.0 * q, INSIDE, 0
        for s in range(number):
            square, r, feature, closest = nearer(triangle, unmarked(listed[c, s]), q, square, r, feature, closest)
        reach = (ti.sqrt(square) + 2.0 * HALF_DIAGONAL * part) * (1.0 + SLACK)
        for s in range(number):
            t = listed[c, s]
            if t >= 0:
                above, beyond = above_and_beyond(triangle, t, q)
                if least_square(above, beyond) < reach * reach:
                    listed[c, s] = -1 - t
    for s in range(number):
        if listed[c, s] < 0 and is_double(triangle, listed, c, s, number, p, width):
            listed[c, s] = unmarked(listed[c, s])
    kept = 0
    for s in range(number):
        if listed[c, s] < 0:
            listed[c, kept], away[c, kept] = unmarked(listed[c, s]), away[c, s]
            kept += 1
    return kept


@ti.func
def is_double(triangle: ti.template(), listed: ti.template(), c, s, number, p, width):
    """True if entry s of list c, which has `number` entries, can be left out of a cell: nowhere in the cell, `width` [m] wide
    around p, is its triangle nearer than another one that is kept. That is so where all of the cell is closest to one side or
    corner of the triangle, which the other one shares."""
    at, feature = WIDTH * unmarked(listed[c, s]) + CORNERS, only_feature(triangle, unmarked(listed[c, s]), p, width)
    one, two = feature - AT_CORNER, feature - AT_CORNER
    if feature < AT_CORNER:
        one, two = (feature + 1) % 3, (feature + 2) % 3
    double = False
    if feature != INSIDE:
        for o in range(number):
            if o != s and listed[c, o] < 0 and not double:
                other = unmarked(listed[c, o])
                double = has_corner(triangle, other, entry(triangle, at + 3 * one))
                double = double and has_corner(triangle, other, entry(triangle, at + 3 * two))
    return double


@ti.func
def only_feature(triangle: ti.template(), t, p, width):
    """The feature of triangle t that is closest to all of a cell, this wide [m] around p, if that is a side or a corner; else
    INSIDE. What is closest to one of these is convex: it holds the cell if it holds its corners."""
    only = INSIDE
    for e in range(8):
        step = ti.Vector([e & 1, e >> 1 & 1, e >> 2 & 1])
        _, feature = from_triangle(triangle, t, p + width * (ti.cast(step, float) - 0.5))
        only = ti.select(e == 0 or feature == only, feature, INSIDE)
    return only


@ti.func
def has_corner(triangle: ti.template(), t, place):
    """True if a corner of triangle t is this place."""
    yes = False
    for k in ti.static(range(3)):
        r = entry(triangle, WIDTH * t + CORNERS + 3 * k) - place
        yes = yes or r.dot(r) == 0.0
    return yes


@ti.func
def unmarked(t):
    """Number of a triangle in a list, where those to keep are marked as negative."""
    return ti.select(t < 0, -1 - t, t)


@ti.kernel
def list_triangles(
    centre: ti.types.ndarray(ndim=2),
    box: ti.types.ndarray(ndim=1),
    link: ti.types.ndarray(ti.i32, 1),
    triangle: ti.types.ndarray(ndim=1),
    near: ti.types.ndarray(ti.i32, 1),
    number: ti.types.ndarray(ti.i32, 1),
    listed: ti.types.ndarray(ti.i32, 2),
    away: ti.types.ndarray(ndim=2),
    frame: ti.types.ndarray(ndim=1),
    part: float,
):
    """List the triangles (listed, one row a cell) that may be closest to some point of each cell, `part` of a cell of the grid
    wide, around the places `centre` (c, 3) [m], in the order of their distances from these (away [m]), and count them (number);
    where there is no room for all the row has a part of them. near: a triangle not far from each place; becomes the closest.
    Cells that lie inside the mesh, where balls hardly come, list none."""
    width = part * frame[3]
    for c in range(centre.shape[0]):
        p = point(centre, c)
        d, _, closest = signed_distance(box, link, triangle, 0, link[0], near[c], p)
        # from the place the closest triangle of a point at most half a diagonal away is at most two halves farther than d
        reach = (ti.abs(d) + 2.0 * HALF_DIAGONAL * width) * (1.0 + SLACK)
        near[c] = closest
        found, k = 0, 0
        if d < -HALF_DIAGONAL * (1.0 + SLACK) * width:
            k = link[0]
        while k < link[0] and found <= listed.shape[1]:
            if is_within(box, k, p, reach * reach):
                for t in range(link[3 * k + 1], link[3 * k + 2]):
                    r, _ = from_triangle(triangle, t, p)
                    if r.dot(r) < reach * reach:
                        if found < listed.shape[1]:
                            insert(listed, away, c, found, t, r.norm())
                        found += 1
                k += 1
            else:
                k = link[3 * k]
        if 0 < found <= listed.shape[1]:
            found = thin_out(triangle, listed, away, c, found, p, width)
        number[c] = found
