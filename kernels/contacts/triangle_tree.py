"""The distance from a closed mesh, by a tree of boxes around its triangles.

box, link, triangle: the tables of contacts.triangle_tree one row behind the other, as fields or as arrays.
"""

from taichi_sim.kernels.contacts.closest_points import on_triangle

from taichi_sim.device.engine import ti

# numbers of a triangle: the normals of its features, the directions in its plane away from it at its sides, its height over the
# first one, and its corners. What rules it out lies together, from the normal of its inside to its first corner
WIDTH, OUTWARD, HEIGHT, CORNERS = 40, 21, 30, 31
# features: the sides, from that across from the first corner on, the corners, the inside
AT_SIDE, AT_CORNER, INSIDE = 0, 3, 6
FAR = 1e38  # m^2, the square of the distance of a triangle that is not yet known


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
            feature = AT_SIDE + k
            zeros += 1
    for k in ti.static(range(3)):
        if zeros == 2 and weight[k] != 0.0:
            feature = AT_CORNER + k
    return feature


@ti.func
def from_triangle(triangle: ti.template(), t, p):
    """The way from the closest point of triangle t to p, and the feature on which that lies."""
    at = WIDTH * t + CORNERS
    a, b, c = entry(triangle, at), entry(triangle, at + 3), entry(triangle, at + 6)
    w = on_triangle(p, a, b, c)
    return (p - a) - (w[1] * (b - a) + w[2] * (c - a)), feature_of(w)


@ti.func
def is_within(box: ti.template(), k, p, square):
    """True if node k comes nearer to p than the root of `square` [m^2]."""
    gap = ti.max(entry(box, 6 * k) - p, p - entry(box, 6 * k + 3), 0.0)
    return gap.dot(gap) < square


@ti.func
def above_and_beyond(triangle: ti.template(), t, p):
    """Height [m] of p over the plane of triangle t, and how far [m] p is beyond the side that it is farthest beyond: negative if
    what is closest to it lies inside the triangle, 0 if that has no area."""
    q, at = p - entry(triangle, WIDTH * t + CORNERS), WIDTH * t + OUTWARD
    above = entry(triangle, WIDTH * t + 3 * INSIDE).dot(q)
    first = entry(triangle, at).dot(q) - triangle[WIDTH * t + HEIGHT]
    return above, ti.max(first, entry(triangle, at + 3).dot(q), entry(triangle, at + 6).dot(q))


@ti.func
def least_square(above, beyond):
    """Square of a distance [m] than which a triangle is no nearer, see `above_and_beyond`."""
    return above * above + ti.max(beyond, 0.0) ** 2


@ti.func
def nearer(triangle: ti.template(), t, p, square, r, feature, closest):
    """The closer one to p of triangle t and of the one known so far: the square of its distance [m^2], the way from it to p, its
    feature, and its number."""
    above, beyond = above_and_beyond(triangle, t, p)
    least = least_square(above, beyond)
    if least < square:
        q, on = above * entry(triangle, WIDTH * t + 3 * INSIDE), INSIDE
        if beyond >= 0.0:
            q, on = from_triangle(triangle, t, p)
            least = q.dot(q)
        if least < square:
            square, r, feature, closest = least, q, on, t
    return square, r, feature, closest


@ti.func
def signed_distance(box: ti.template(), link: ti.template(), triangle: ti.template(), first, last, near, p):
    """Signed distance [m] of p from the mesh whose nodes are `first` to before `last`, the direction out of it, and the closest
    triangle. near: a triangle that is not far."""
    square, r, feature, closest = FAR + 0.0 * p[0], 0.0 * p, INSIDE, near
    k, begin, end = first, near, near + 1
    while begin < end:
        for t in range(begin, end):
            square, r, feature, closest = nearer(triangle, t, p, square, r, feature, closest)
        begin = end
        while begin >= end and k < last:  # the next leaf that comes nearer
            if is_within(box, k, p, square):
                begin, end = link[3 * k + 1], link[3 * k + 2]
                k += 1
            else:
                k = link[3 * k]
    d, n = signed(triangle, closest, feature, r)
    return d, n, closest


@ti.func
def distance_by_list(triangle: ti.template(), listed: ti.template(), first, last, p, out):
    """Signed distance [m] of p from the mesh, and the direction out of it, where only the triangles listed from `first` to before
    `last` can be closest, in the order of their distances `away` [m] from a place that is `out` [m] from p."""
    square, r, feature, closest = FAR + 0.0 * p[0], 0.0 * p, INSIDE, 0
    e = first
    while e < last and ti.max(listed[e].away - out, 0.0) ** 2 < square:  # no triangle is nearer to p than that
        square, r, feature, closest = nearer(triangle, listed[e].triangle, p, square, r, feature, closest)
        e += 1
    return signed(triangle, closest, feature, r)


@ti.func
def signed(triangle: ti.template(), closest, feature, r):
    """The length of the way r from a feature of the closest triangle, negative inside, and the direction out of the mesh."""
    n = entry(triangle, WIDTH * closest + 3 * feature)
    d = r.dot(n)
    # inside r is along n, but for rounding, which tilts what is close to a large triangle; one without an area has no n
    if feature != INSIDE or n.dot(n) == 0.0:
        best = r.dot(r)
        d = ti.select(d < 0.0, -ti.sqrt(best), ti.sqrt(best))
        if best > 0.0:
            n = r / d
    return d, n
