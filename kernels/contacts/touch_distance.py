"""The distance at which the two sides of a pair of surfaces touch; for the weights of a pair see triangle_pairs."""

from taichi_sim.kernels.contacts.closest_points import between_edges, on_triangle
from taichi_sim.kernels.contacts.kinds import BALL_TRIANGLE, EDGE_EDGE, STICK_FIRST, STICK_SECOND
from taichi_sim.kernels.contacts.pairs import are_joined

from taichi_sim.device.engine import ti


@ti.func
def is_upper(k, kind):
    """True if ball k of a pair is on its upper side."""
    return k == 0 or (k == 1 and kind != BALL_TRIANGLE)


@ti.func
def half_thickness(triangles: ti.template(), b, k, kind):
    """Radius [m] of ball k of a pair; sticks have no thickness of their own."""
    stick = ti.select(is_upper(k, kind), kind == EDGE_EDGE + STICK_FIRST, kind == EDGE_EDGE + STICK_SECOND)
    return ti.select(stick, 0.0, triangles.model.radius[b[k]])


@ti.func
def distance_at_touch(triangles: ti.template(), b, g, kind, of_edges: ti.template()):
    """Distance [m] at which the two sides of a pair touch: as thick as its balls are at most, by their weights g. What
    is held together by springs or elements may be as near as in its first shape, lest a body pushes itself open, and nearer where
    one of them joins two balls. These count by their weights as well, so that the distance does not jump where what is nearest
    changes from a triangle with a joined ball to one without."""
    touch = 0.0 * g[0]
    for k in ti.static(range(4)):
        touch += ti.abs(g[k]) * half_thickness(triangles, b, k, kind)
    if triangles.held_together[b[0]] == triangles.held_together[b[3]]:
        part = 0.0 * touch  # that is joined
        for k in ti.static(range(2)):
            for m in ti.static(range(1, 4)):
                if is_upper(k, kind) and not is_upper(m, kind):
                    share = ti.abs(g[k] * g[m])
                    if share > 0.0 and are_joined(triangles.pairs, b[k], b[m]):
                        part += share
                        apart = half_thickness(triangles, b, k, kind) + half_thickness(triangles, b, m, kind)
                        most = ti.min(triangles.spacing[b[k]], triangles.spacing[b[m]])
                        touch -= share * ti.max(0.0, apart - most)
        rest = distance_at_rest(triangles, b, of_edges)
        touch = ti.min(touch, (1.0 - (1.0 - triangles.joined_part) * part) * rest)
    return touch


@ti.func
def distance_at_rest(triangles: ti.template(), b, of_edges: ti.template()):
    """Distance [m] of the two sides of a pair in the first shape."""
    x = ti.static(triangles.rest_position)
    xa, xb, xc, xd = x[b[0]], x[b[1]], x[b[2]], x[b[3]]
    r = xa
    if ti.static(of_edges):
        s, t = between_edges(xa, xb, xc, xd)
        r += s * (xb - xa) - xc - t * (xd - xc)
    else:
        w = on_triangle(xa, xb, xc, xd)
        r -= w[0] * xb + w[1] * xc + w[2] * xd
    return r.norm()
