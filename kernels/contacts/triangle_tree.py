"""The distance from a closed mesh, by a tree of boxes around its triangles.

box, link, triangle: the tables of contacts.triangle_tree one row behind the other, as fields or as arrays.
"""

from taichi_sim.kernels.contacts.closest_points import on_triangle

from taichi_sim.device.engine import ti

# numbers of a triangle: its corners, the directions in its plane away from it at the sides across from them, and from NORMALS on
# the normals of its inside, its corners and its sides
WIDTH, OUTWARD, NORMALS = 39, 9, 18
INSIDE, CORNERS, SIDES = 0, 1, 4  # features that have normals, or the first of them


@ti.func
def entry(table: ti.template(), at):
    """Three numbers as a vector."""
    return ti.Vector([table[at], table[at + 1], table[at + 2]])


@ti.func
def feature_of(weight):
    """Feature of a triangle, its inside, a corner or a side, on which the point with these weights lies."""
    feature, zeros = INSIDE, 0
    for k in ti.static(range(3)):
        if weight[k] == 0.0:
            feature = SIDES + k
            zeros += 1
    for k in ti.static(range(3)):
        if zeros == 2 and weight[k] != 0.0:
            feature = CORNERS + k
    return feature


@ti.func
def from_triangle(triangle: ti.template(), t, p):
    """The way from the closest point of triangle t to p, and the feature on which that lies."""
    a, b, c = entry(triangle, WIDTH * t), entry(triangle, WIDTH * t + 3), entry(triangle, WIDTH * t + 6)
    w = on_triangle(p, a, b, c)
    return (p - a) - (w[1] * (b - a) + w[2] * (c - a)), feature_of(w)


@ti.func
def is_within(box: ti.template(), k, p, square):
    """True if node k comes nearer to p than the root of `square` [m^2]."""
    gap = ti.max(entry(box, 6 * k) - p, p - entry(box, 6 * k + 3), 0.0)
    return gap.dot(gap) < square


@ti.func
def least_square(triangle: ti.template(), t, p):
    """Square of a distance [m] from p than which triangle t is no nearer: by its plane and the side that p is farthest beyond."""
    above = entry(triangle, WIDTH * t + NORMALS).dot(p - entry(triangle, WIDTH * t))
    beyond = 0.0 * above
    for k in ti.static(range(3)):
        end = entry(triangle, WIDTH * t + 3 * ((k + 1) % 3))
        beyond = ti.max(beyond, entry(triangle, WIDTH * t + OUTWARD + 3 * k).dot(p - end))
    return above * above + beyond * beyond


@ti.func
def nearer(triangle: ti.template(), t, p, r, feature, closest):
    """The way to p from the closer one of triangle t and of the one known so far; its feature, and its number."""
    if least_square(triangle, t, p) < r.dot(r):
        q, on = from_triangle(triangle, t, p)
        if q.dot(q) < r.dot(r):
            r, feature, closest = q, on, t
    return r, feature, closest


@ti.func
def signed_distance(box: ti.template(), link: ti.template(), triangle: ti.template(), first, last, near, p):
    """Signed distance [m] of p from the mesh whose nodes are `first` to before `last`, the direction out of it, and the closest
    triangle. near: a triangle that is not far."""
    r, feature = from_triangle(triangle, near, p)
    closest = near
    k = first
    while k < last:
        if is_within(box, k, p, r.dot(r)):
            for t in range(link[3 * k + 1], link[3 * k + 2]):
                r, feature, closest = nearer(triangle, t, p, r, feature, closest)
            k += 1
        else:
            k = link[3 * k]
    d, n = signed(triangle, closest, feature, r)
    return d, n, closest


@ti.func
def distance_by_list(triangle: ti.template(), listed: ti.template(), away: ti.template(), first, last, p, out):
    """Signed distance [m] of p from the mesh, and the direction out of it, where only the triangles listed from `first` to before
    `last` can be closest, in the order of their distances `away` [m] from a place that is `out` [m] from p."""
    closest = listed[first]
    r, feature = from_triangle(triangle, closest, p)
    e = first + 1
    while e < last and away[e] < r.norm() + out:  # no triangle is nearer to p than that
        r, feature, closest = nearer(triangle, listed[e], p, r, feature, closest)
        e += 1
    d, n = signed(triangle, closest, feature, r)
    return d, n


@ti.func
def signed(triangle: ti.template(), closest, feature, r):
    """The length of the way r from a feature of the closest triangle, negative inside, and the direction out of the mesh."""
    n = entry(triangle, WIDTH * closest + NORMALS + 3 * feature)
    d = r.dot(n)
    # inside r is along n, but for rounding, which tilts what is close to a large triangle; one without an area has no n
    if feature != INSIDE or n.dot(n) == 0.0:
        best = r.dot(r)
        d = ti.select(d < 0.0, -ti.sqrt(best), ti.sqrt(best))
        if best > 0.0:
            n = r / d
    return d, n
