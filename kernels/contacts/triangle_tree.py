"""The distance from a closed mesh, by a tree of boxes around its triangles.

box, link, triangle: the tables of contacts.triangle_tree one row behind the other, as fields or as arrays.
"""

from taichi_sim.kernels.contacts.closest_points import on_triangle

from taichi_sim.device.engine import ti

WIDTH = 30  # numbers of a triangle: three corners, then the normals of its inside, its corners and its sides
CORNERS, SIDES = 1, 4  # the first of these features


@ti.func
def entry(table: ti.template(), at):
    """Three numbers as a vector."""
    return ti.Vector([table[at], table[at + 1], table[at + 2]])


@ti.func
def feature_of(weight):
    """Feature of a triangle, its inside, a corner or a side, on which the point with these weights lies."""
    feature, zeros = 0, 0
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
def signed_distance(box: ti.template(), link: ti.template(), triangle: ti.template(), first, last, near, p):
    """Signed distance [m] of p from the mesh whose nodes are `first` to before `last`, the direction out of it, and the closest
    triangle. near: a triangle that is not far."""
    r, feature = from_triangle(triangle, near, p)
    best, closest = r.dot(r), near
    k = first
    while k < last:
        gap = ti.max(entry(box, 6 * k) - p, p - entry(box, 6 * k + 3), 0.0)
        if gap.dot(gap) < best:
            for t in range(link[3 * k + 1], link[3 * k + 2]):
                above = entry(triangle, WIDTH * t + 9).dot(p - entry(triangle, WIDTH * t))
                if above * above < best:
                    q, on = from_triangle(triangle, t, p)
                    if q.dot(q) < best:
                        r, feature, best, closest = q, on, q.dot(q), t
            k += 1
        else:
            k = link[3 * k]
    n = entry(triangle, WIDTH * closest + 9 + 3 * feature)
    d = ti.sqrt(best)
    if r.dot(n) < 0.0:
        d = -d
    if best > 0.0:
        n = r / d
    return d, n, closest
