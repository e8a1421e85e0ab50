"""Closest points of points, triangles and edges (Ericson, Real-Time Collision Detection, 2005, section 5.1)."""

from taichi_sim.device.engine import ti

PARALLEL_EDGES = 1e-6  # square of the sine between two edges


@ti.func
def on_triangle(x, a, b, c):
    """Weights of the corners a, b, c at the point of the triangle closest to x; exactly 0 for those that do not count."""
    ab, ac, ax = b - a, c - a, x - a
    d1, d2 = ab.dot(ax), ac.dot(ax)
    bx, cx = x - b, x - c
    d3, d4 = ab.dot(bx), ac.dot(bx)
    d5, d6 = ab.dot(cx), ac.dot(cx)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    zero = 0.0 * d1
    w = ti.Vector([1.0 + zero, zero, zero])
    if d1 <= 0.0 and d2 <= 0.0:
        pass
    elif d3 >= 0.0 and d4 <= d3:
        w = ti.Vector([zero, 1.0 + zero, zero])
    elif d6 >= 0.0 and d5 <= d6:
        w = ti.Vector([zero, zero, 1.0 + zero])
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3)
        w = ti.Vector([1.0 - t, t, zero])
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6)
        w = ti.Vector([1.0 - t, zero, t])
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        t = (d4 - d3) / (d4 - d3 + d5 - d6)
        w = ti.Vector([zero, 1.0 - t, t])
    else:
        inverse = 1.0 / (va + vb + vc)
        w = ti.Vector([1.0 - (vb + vc) * inverse, vb * inverse, vc * inverse])
    return w


@ti.func
def between_edges(a, b, c, d):
    """Parts s of the way from a to b and t from c to d at which the two edges come closest."""
    one, two, r = b - a, d - c, a - c
    aa, ee, f = one.dot(one), two.dot(two), two.dot(r)
    c1, bb = one.dot(r), one.dot(two)
    square = aa * ee - bb * bb
    s, t = 0.0 * aa, 0.0 * aa
    if aa > 0.0 and ee > 0.0:
        if square > PARALLEL_EDGES * aa * ee:
            s = ti.max(0.0, ti.min(1.0, (bb * f - c1 * ee) / square))
        t = (bb * s + f) / ee
        if t < 0.0:
            t = 0.0
            s = ti.max(0.0, ti.min(1.0, -c1 / aa))
        elif t > 1.0:
            t = 1.0
            s = ti.max(0.0, ti.min(1.0, (bb - c1) / aa))
    return s, t
