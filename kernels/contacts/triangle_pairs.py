"""Pairs of a ball and a triangle, and of two edges: which of them are near, what they are listed with, and how far they may go.

A pair has four balls with weights (1, -u, -v, -w) or (1 - s, s, t - 1, -t); the first one, or two, are its upper side, and its
normal points there. Which pairs are looked at: triangle_bvh. What becomes of them: ccd_triangles.

What a tree finds are candidates, also those further apart than pairs are listed by less than `skin`, so that they hold for some
steps (ccd_triangles.begin); in each step those are listed that may meet then. Whether one is listed depends on where its balls
are and how they move alone, not on when it was found.
"""

from taichi_sim.kernels.contacts.closest_points import between_edges, on_triangle
from taichi_sim.kernels.contacts.collision_groups import balls_meet
from taichi_sim.kernels.contacts.contact_incidence import count_entries
from taichi_sim.kernels.contacts.kinds import BALL_TRIANGLE, EDGE_EDGE, STICK_FIRST, STICK_SECOND
from taichi_sim.kernels.contacts.pairs import COUNT_LIMIT, may_touch
from taichi_sim.kernels.contacts.touch_distance import distance_at_touch, is_upper
from taichi_sim.kernels.vectors import unit

from taichi_sim.device.engine import ti

FIND_CANDIDATES, LIST_PAIRS, LIMIT_WAYS = range(3)  # what is done with a pair
LOOK_AHEAD = 1.5  # of the way that the present velocity makes in a step: contacts are found before they touch
LISTED_DISTANCE = 1.1  # of the distance at touch: contacts that nearly touch count as those that do
# of a distance that is too short for the way of a step, and of the distance at touch where it is that short already
KEPT_DISTANCE = 0.1
BORDER, NOT_OWNED = -1, -2  # what lies beyond an edge: no other triangle, or hits on the edge belong to the other one
SHORTEST_LEVER = 0.1  # of a distance: what moves nearer to a pin than that part would be thrown as many times faster
# squared sine of an angle: directions more alike do not say what is at right angles to both
SMALLEST_ANGLE = 1e-6
BEYOND_ALL = 1e30  # m, beyond all that there is
LEAST_THICKNESS = 1e-30  # m, of a pair that does not push, so that its sign says so
EDGE_END = 1e-4  # of an edge: nearer to its end, the hit is one of the ball there


@ti.func
def ball_triangle(
    triangles: ti.template(), solver: ti.template(), ball: ti.template(), p, i, t, near, place, job: ti.template()
):
    """1 where ball i and triangle t become a candidate, else 0; or let them limit their ways."""
    found = 0
    triangle = triangles.triangle[t]
    a, b, c = triangle.a, triangle.b, triangle.c
    if i != a and i != b and i != c and is_whole(triangles, t):
        low, high = stretch(triangles, ball, i, job)
        low_a, high_a = stretch(triangles, ball, a, job)
        low_b, high_b = stretch(triangles, ball, b, job)
        low_c, high_c = stretch(triangles, ball, c, job)
        if near_boxes(low, high, ti.min(low_a, low_b, low_c), ti.max(high_a, high_b, high_c), near):
            found = ball_near_triangle(triangles, solver, ball, p, i, t, near, place, job)
    return found


@ti.func
def ball_near_triangle(
    triangles: ti.template(), solver: ti.template(), ball: ti.template(), p, i, t, near, place, job: ti.template()
):
    """1 where ball i and triangle t, whose boxes are near, become a candidate, else 0; or list them as a pair, or let them
    limit their ways."""
    found = 0
    triangle = triangles.triangle[t]
    a, b, c = triangle.a, triangle.b, triangle.c
    x, xa, xb, xc = origins(triangles, i, a, b, c)
    w = on_triangle(x, xa, xb, xc)
    at_triangle = w[0] * xa + w[1] * xb + w[2] * xc
    r = x - at_triangle
    balls = ti.Vector([i, a, b, c])
    if ti.static(job == FIND_CANDIDATES):
        if r.dot(r) < near * near and may_meet(triangles, balls, BALL_TRIANGLE):
            found = note_candidate(triangles, p, place, i, t)
    else:
        g = ti.Vector([1.0 + 0.0 * w[0], -w[0], -w[1], -w[2]])
        whole = True
        if ti.static(job == LIST_PAIRS):
            whole = (w[0] > 0.0 and w[1] > 0.0 and w[2] > 0.0) or is_hit_at_corner(triangles, i, t, balls, w)
            beyond = ti.Vector([triangle.beyond_a, triangle.beyond_b, triangle.beyond_c])
            if ti.static(triangles.tears):
                across_from = ti.Vector([triangle.across_a, triangle.across_b, triangle.across_c])
                for k in ti.static(range(3)):
                    if beyond[k] != BORDER and not is_whole(triangles, across_from[k]):
                        beyond[k] = BORDER
            for k in ti.static(range(3)):  # on the edge across from corner k
                if w[k] == 0.0 and w[(k + 1) % 3] > 0.0 and w[(k + 2) % 3] > 0.0 and beyond[k] > NOT_OWNED:
                    whole = True
                    if beyond[k] >= 0:  # nearer to the inside of the triangle on the other side: that one's
                        along = (
                            triangles.grid.origin[balls[1 + (k + 2) % 3]]
                            - triangles.grid.origin[balls[1 + (k + 1) % 3]]
                        )
                        m = triangles.grid.origin[beyond[k]] - at_triangle
                        m -= m.dot(along) / along.dot(along) * along
                        whole = r.dot(m) <= 0.0
        if w[0] > 0.0 and w[1] > 0.0 and w[2] > 0.0:
            r = across(r, xb - xa, xc - xa, x - xa)
        take_pair(triangles, solver, ball, p, balls, g, r, BALL_TRIANGLE, whole, place, False, job)
    return found


@ti.func
def is_hit_at_corner(triangles: ti.template(), i, t, balls, w):
    """True if ball i is nearest to a corner of triangle t, weights w, and their hit is none that pairs of balls have; once, in
    the triangle that stands for the ball there, and of two balls of surfaces for the first one."""
    yes = False
    for k in ti.static(range(3)):
        if w[k] > 0.0 and w[(k + 1) % 3] == 0.0 and w[(k + 2) % 3] == 0.0:
            j = balls[1 + k]
            if (i < j or not has_triangle(triangles, i)) and (
                triangles.own_triangle[j] == t or not has_triangle(triangles, j)
            ):
                yes = True
                if ti.static(triangles.pairs.plan.neighbours):
                    yes = not may_touch(triangles.pairs, i, j)
    return yes


@ti.func
def has_triangle(triangles: ti.template(), i):
    """True if the triangle that stands for ball i is there, and has not torn."""
    yes = triangles.own_triangle[i] >= 0
    if ti.static(triangles.tears):
        yes = yes and is_whole(triangles, ti.max(0, triangles.own_triangle[i]))
    return yes


@ti.func
def edge_edge(triangles: ti.template(), solver: ti.template(), ball: ti.template(), p, e, f, low, high, near, place,
              job: ti.template()):  # fmt: skip
    """1 where edges e and f become a candidate, else 0; or let them limit their ways. low, high: the box of edge f."""
    found = 0
    a, b, c, d = triangles.edge[e].one, triangles.edge[e].two, triangles.edge[f].one, triangles.edge[f].two
    apart = a != c and a != d and b != c and b != d and triangles.edge[e].bare + triangles.edge[f].bare < 2
    if apart and holds(triangles, e) and holds(triangles, f):
        low_a, high_a = stretch(triangles, ball, a, job)
        low_b, high_b = stretch(triangles, ball, b, job)
        if near_boxes(ti.min(low_a, low_b), ti.max(high_a, high_b), low, high, near):
            found = near_edges(triangles, solver, ball, p, e, f, near, place, job)
    return found


@ti.func
def near_edges(
    triangles: ti.template(), solver: ti.template(), ball: ti.template(), p, e, f, near, place, job: ti.template()
):
    """1 where edges e and f, whose boxes are near, become a candidate, else 0; or list them as a pair, or let them limit their
    ways."""
    found = 0
    a, b, c, d = triangles.edge[e].one, triangles.edge[e].two, triangles.edge[f].one, triangles.edge[f].two
    xa, xb, xc, xd = origins(triangles, a, b, c, d)
    s, t = between_edges(xa, xb, xc, xd)
    r = xa + s * (xb - xa) - xc - t * (xd - xc)
    balls = ti.Vector([a, b, c, d])
    if ti.static(job == FIND_CANDIDATES):
        if r.dot(r) < near * near and may_meet(triangles, balls, EDGE_EDGE):
            found = note_candidate(triangles, p, place, e, -1 - f)
    else:
        g = ti.Vector([1.0 - s, s, t - 1.0, -t])
        inside = s > EDGE_END and s < 1.0 - EDGE_END and t > EDGE_END and t < 1.0 - EDGE_END
        if inside:
            r = across(r, xb - xa, xd - xc, xa - xc)
        kind = EDGE_EDGE + STICK_FIRST * triangles.edge[e].bare + STICK_SECOND * triangles.edge[f].bare
        take_pair(triangles, solver, ball, p, balls, g, r, kind, inside, place, True, job)
    return found


@ti.func
def is_whole(triangles: ti.template(), t):
    """True if no side of triangle t has torn. A triangle with a torn side no longer exists."""
    whole = True
    if ti.static(triangles.tears):
        whole = triangles.severed_triangles.gone[t] == 0
    return whole


@ti.func
def holds(triangles: ti.template(), e):
    """True if edge e has not torn."""
    yes = True
    if ti.static(triangles.tears):
        yes = triangles.severed_edges.gone[e] == 0
    return yes


@ti.func
def origins(triangles: ti.template(), one, two, three, four):
    """Positions of four balls [m], now or at the start of the step."""
    origin = ti.static(triangles.grid.origin)
    return origin[one], origin[two], origin[three], origin[four]


@ti.func
def may_meet(triangles: ti.template(), b, kind):
    """True if the pair of balls b can move at all, and its groups collide."""
    may = False
    for k in ti.static(range(4)):
        may = may or triangles.model.inverse_mass[b[k]] > 0.0
    if ti.static(triangles.model.has_groups):
        may = may and balls_meet(triangles.model, b[0], ti.select(kind == BALL_TRIANGLE, b[1], b[2]))
    return may


@ti.func
def note_candidate(triangles: ti.template(), p, place, first, second):
    """Note a candidate of ball and triangle, or of edges e and -1 - f; 1, how many that is."""
    at = COUNT_LIMIT
    if triangles.candidates[0] < COUNT_LIMIT:
        at = ti.atomic_add(triangles.candidates[0], 1)
    if at < triangles.candidate_capacity:
        triangles.candidate[at].owner = p
        triangles.candidate[at].place = place
        triangles.candidate[at].first = first
        triangles.candidate[at].second = second
    else:
        ti.atomic_max(triangles.overflow[0], at // triangles.candidates_per_contact + 1)
    return 1


@ti.func
def list_candidate(c, triangles: ti.template(), solver: ti.template(), ball: ti.template()):
    """List candidate c as a pair if it may meet in this step."""
    candidate = triangles.candidate[c]
    p, place = candidate.owner, candidate.place
    if candidate.second >= 0:
        if is_whole(triangles, candidate.second):
            ball_near_triangle(triangles, solver, ball, p, candidate.first, candidate.second, 0.0, place, LIST_PAIRS)
    else:
        if holds(triangles, candidate.first) and holds(triangles, -1 - candidate.second):
            near_edges(triangles, solver, ball, p, candidate.first, -1 - candidate.second, 0.0, place, LIST_PAIRS)


@ti.func
def across(r, one, other, way):
    """The distance r between two things, at right angles to two directions in them; `way` leads from one thing to the other. The
    difference of two points that nearly coincide has lost its direction, and planes at right angles to that would cut large
    triangles."""
    out = r
    m = one.cross(other)
    if m.dot(m) > SMALLEST_ANGLE * one.dot(one) * other.dot(other) and m.dot(way) != 0.0:
        out = m.dot(way) / m.dot(m) * m
    return out


@ti.func
def stretch(triangles: ti.template(), ball: ti.template(), i, job: ti.template()):
    """Box around ball i: where it is, or all its way in this step."""
    low = triangles.grid.origin[i]
    high = low
    if ti.static(job == LIMIT_WAYS):
        low, high = ti.min(low, ball[i].x), ti.max(high, ball[i].x)
    return low, high


@ti.func
def near_boxes(low, high, other_low, other_high, reach):
    """True if two boxes come nearer than `reach` [m] along every axis. One comparison: three would often be guessed wrong."""
    return ti.max(low - other_high, other_low - high).max() < reach


@ti.func
def take_pair(triangles: ti.template(), solver: ti.template(), ball: ti.template(), p, b, g, r, kind, whole, place,
           of_edges: ti.template(), job: ti.template()):  # fmt: skip
    """List the pair of balls b with weights g at distance r, or let it limit their way. whole: no other pair has this hit.
    kind: see kinds."""
    n, d = unit(r, b[0], ti.select(kind == BALL_TRIANGLE, b[1], b[2]))
    if ti.static(job == LIST_PAIRS):
        list_pair(triangles, solver, ball, p, b, g, n, d, kind, whole, place, of_edges)
    elif may_meet(triangles, b, kind):
        # a pair that is not listed began further apart than its balls are thick: a part of that is enough
        hold_apart(triangles, ball, b, n, kind, 0.0)


@ti.func
def list_pair(triangles: ti.template(), solver: ti.template(), ball: ti.template(), p, b, g, n, d, kind, whole, place,
              of_edges: ti.template()):  # fmt: skip
    """List the pair, with the normal n and distance d, where it may meet within the step."""
    u, give, above, below = 0.0 * d, 0.0 * d, BEYOND_ALL + 0.0 * d, -BEYOND_ALL + 0.0 * d
    upper, lower = 0.0 * d, 0.0 * d
    for k in ti.static(range(4)):
        radius = triangles.model.radius[b[k]]
        speed = n.dot(ball[b[k]].v)
        u += g[k] * speed
        give += ti.select(ti.abs(g[k]) > SHORTEST_LEVER, triangles.model.inverse_mass[b[k]], 0.0 * d)
        on_top = is_upper(k, kind)
        upper = ti.max(upper, ti.select(on_top, radius, 0.0))
        lower = ti.max(lower, ti.select(on_top, 0.0, radius))
        above = ti.min(above, ti.select(on_top, speed, above))
        below = ti.max(below, ti.select(on_top, below, speed))
    way = LOOK_AHEAD * ti.max(0.0, -u) / solver.rate[0]
    if d < upper + lower + LOOK_AHEAD * ti.max(0.0, below - above) / solver.rate[0]:
        at = COUNT_LIMIT
        if triangles.used[0] < COUNT_LIMIT:
            at = ti.atomic_add(triangles.used[0], 1)
        if at >= triangles.capacity:
            ti.atomic_max(triangles.overflow[0], at + 1)
        else:
            thick = distance_at_touch(triangles, b, g, kind, of_edges)
            # between pinned points nothing can be pushed, or only by a long lever
            contact = whole and give > 0.0 and d < ti.max(LISTED_DISTANCE * thick, thick + way)
            triangles.contact[at].owner = p
            triangles.contact[at].place = place
            triangles.contact[at].kind = kind
            triangles.contact[at].normal = n
            triangles.contact[at].distance = d
            triangles.contact[at].thickness = ti.select(contact, thick, -ti.max(thick, LEAST_THICKNESS))
            for k in ti.static(range(4)):
                triangles.member[4 * at + k] = b[k]
                triangles.weight[4 * at + k] = g[k]
            count_entries(at, triangles)


@ti.func
def planes(triangles: ti.template(), ball: ti.template(), b, n, kind, thickness):
    """Two heights along n, from where the first of the balls b began: the upper side may not go below the first, nor the lower
    one above the second; and the distance kept between. Where no side would, they are out of reach. thickness: of the pair [m].

    The closest points of two convex things lie on two planes at right angles to their distance, with nothing in between. Planes
    in between stand still for a step: so whatever the others do, neither side gets to the other.
    """
    base = triangles.grid.origin[b[0]]
    far = BEYOND_ALL + 0.0 * base[0]
    low, top, high, bottom = far, far, -far, -far
    for k in ti.static(range(4)):
        here = n.dot(triangles.grid.origin[b[k]] - base)
        there = n.dot(ball[b[k]].x - base)
        if is_upper(k, kind):
            low, top = ti.min(low, here), ti.min(top, here, there)
        else:
            high, bottom = ti.max(high, here), ti.max(bottom, here, there)
    width = ti.max(0.0, low - high)
    keep = ti.max(KEPT_DISTANCE * width, ti.min(width, KEPT_DISTANCE * thickness))
    up, down = -far, far
    if top - bottom < keep and (low > top or bottom > high):
        part = (bottom - high) / (low - top + bottom - high)  # the way of the lower side, of both
        middle = high + ti.max(0.5 * keep, ti.min(width - 0.5 * keep, part * width))
        up, down = middle + 0.5 * keep, middle - 0.5 * keep
    return up, down, keep


@ti.func
def hold_apart(triangles: ti.template(), ball: ti.template(), b, n, kind, thickness):
    """Cut short the way of each of the balls b that crosses its plane. thickness: of the pair [m]."""
    base = triangles.grid.origin[b[0]]
    up, down, _ = planes(triangles, ball, b, n, kind, thickness)
    if up > down:
        for k in ti.static(range(4)):
            here = n.dot(triangles.grid.origin[b[k]] - base)
            there = n.dot(ball[b[k]].x - base)
            if is_upper(k, kind):
                if there < ti.min(here, up):
                    ti.atomic_min(triangles.allowed_part[b[k]], ti.max(0.0, (here - up) / (here - there)))
            elif there > ti.max(here, down):
                ti.atomic_min(triangles.allowed_part[b[k]], ti.max(0.0, (down - here) / (there - here)))
