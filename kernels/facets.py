"""Contacts of surfaces: balls against triangles, edges against edges, and how far balls may move before any of them meet.

The patch of a ball is what it owns: the triangles whose first ball it is, and the edges. Patches are looked up in the grid of the
balls. A pair has four balls with weights (1, -u, -v, -w) or (1 - s, s, t - 1, -t); the first one, or two, are its upper side, and
its normal points there. Each ball has a sorted list of the places that it takes in pairs, so that sums come out the same
whatever the threads did.
"""

import taichi as ti

from .direction import unit
from .grid import bucket_of, cell_of, clip, run, same_row, table
from .groups import balls_meet
from .pairs import FULL
from .triangle import between_edges, on_triangle

DETECT, LIMIT = range(2)  # what a walk does with the pairs it finds
LOOK = 1.5  # of the way that the present velocity makes in a step: contacts are found before they touch
LISTED = 1.1  # of the distance at touch: contacts that nearly touch count as those that do
KEEP = 0.1  # of a distance that is too short for the way of a step, and of the distance at touch where it is that short already
CLEAR, SWEEPS = (
    0.02,
    2,
)  # of what is kept: how far past its plane a ball is led; times that all its planes are gone through
SAFE = 0.99  # of a radius: what moves no further cannot meet what was not listed
BORDER, NOT_OWNED = -1, -2  # what lies beyond an edge: no other triangle, or hits on the edge belong to the other one
LEVER = 0.1  # of a distance: what moves nearer to a pin than that part would be thrown as many times faster
INSIDE = 1e-4  # of an edge: nearer to its end, the hit is one of the ball there


@ti.func
def patch_boxes(facets: ti.template()):
    """Boxes around each ball with its patch, each ball with its reach, and `extent`: how far any of them goes from its ball."""
    for i in range(facets.work[1]):
        x = facets.grid.origin[i]
        low, high = x - facets.reach[i], x + facets.reach[i]
        for e in range(facets.edge_start[i], facets.edge_start[i + 1]):
            k = facets.edge[e].two
            low = ti.min(low, facets.grid.origin[k] - facets.reach[k])
            high = ti.max(high, facets.grid.origin[k] + facets.reach[k])
        facets.box[i].low = low
        facets.box[i].high = high
        ti.atomic_max(facets.extent[0], ti.max((high - x).max(), (x - low).max()))


@ti.func
def overlap(facets: ti.template(), p, j):
    """Whether the boxes of two patches overlap."""
    yes = True
    for a in ti.static(range(3)):
        yes = yes and facets.box[p].low[a] <= facets.box[j].high[a] and facets.box[j].low[a] <= facets.box[p].high[a]
    return yes


@ti.func
def walk(facets: ti.template(), grid: ti.template(), solver: ti.template(), ball: ti.template(), p, job: ti.template()):
    """Go through the balls whose patches may come near that of ball p."""
    found = 0
    for level in range(grid.levels):
        low = cell_of(facets.box[p].low - facets.extent[0], grid, level)
        high = cell_of(facets.box[p].high + facets.extent[0], grid, level)
        if ti.static(grid.levels > 1):
            low, high = clip(grid, level, low, high)
        first_bucket, size = table(grid, level)
        all_from, all_to = grid.start[first_bucket], grid.start[first_bucket + size]
        cells = (1.0 + high[1] - low[1]) * (1.0 + high[2] - low[2])
        everywhere = not cells < 1.0 * (all_to - all_from)  # then looking at all balls is less work
        height = high[1] - low[1] + 1
        for row in range(ti.select(everywhere, 1, height * (high[2] - low[2] + 1))):
            cell = low
            begin, end, first, last = all_from, all_to, 0, 0
            if not everywhere:
                cell[1] += row % height
                cell[2] += row // height
                bucket = bucket_of(cell, grid, level)
                begin, end = run(grid, level, bucket, high[0] - low[0] + 1, 0)
                first, last = run(grid, level, bucket, high[0] - low[0] + 1, 1)
            for k in range(end - begin + last - first):
                own = ti.select(k < end - begin, begin + k, first + k - (end - begin))
                j = grid.sorted[own]
                if overlap(facets, p, j):
                    here = everywhere
                    if not here:
                        c = cell_of(grid.copy[own].x, grid, level)
                        here = same_row(cell, c) and c[0] >= low[0] and c[0] <= high[0]
                    if here:
                        found = meet(facets, solver, ball, p, j, found, job)


@ti.func
def meet(facets: ti.template(), solver: ti.template(), ball: ti.template(), p, j, found, job: ti.template()):
    """Ball j against the triangles of patch p, the edges of patch j against those of patch p, each pair of edges once. found: how
    many pairs patch p has listed; returned with these."""
    number = found
    for t in range(facets.triangle_start[p], facets.triangle_start[p + 1]):
        number += ball_triangle(facets, solver, ball, p, j, t, number, job)
    if j >= p:
        for f in range(facets.edge_start[j], facets.edge_start[j + 1]):
            for e in range(facets.edge_start[p], ti.min(facets.edge_start[p + 1], f)):
                number += edge_edge(facets, solver, ball, p, e, f, number, job)
    return number


@ti.func
def ball_triangle(
    facets: ti.template(), solver: ti.template(), ball: ti.template(), p, i, t, place, job: ti.template()
):
    """1 where ball i and triangle t are listed as a pair, else 0."""
    found = 0
    triangle = facets.triangle[t]
    a, b, c = triangle.a, triangle.b, triangle.c
    if i != a and i != b and i != c:
        x, xa, xb, xc = facets.grid.origin[i], facets.grid.origin[a], facets.grid.origin[b], facets.grid.origin[c]
        reach = facets.reach[i] + ti.max(facets.reach[a], facets.reach[b], facets.reach[c])
        if near_boxes(x, x, ti.min(xa, xb, xc), ti.max(xa, xb, xc), reach):
            w = on_triangle(x, xa, xb, xc)
            at_triangle = w[0] * xa + w[1] * xb + w[2] * xc
            r = x - at_triangle
            if r.dot(r) < reach * reach:
                balls = ti.Vector([i, a, b, c])
                g = ti.Vector([1.0 + 0.0 * w[0], -w[0], -w[1], -w[2]])
                whole = True
                if ti.static(job == DETECT):
                    whole = w[0] > 0.0 and w[1] > 0.0 and w[2] > 0.0
                    beyond = ti.Vector([triangle.beyond_a, triangle.beyond_b, triangle.beyond_c])
                    for k in ti.static(
                        range(3)
                    ):  # on the edge across from corner k; a hit at a corner is one of two balls
                        if w[k] == 0.0 and w[(k + 1) % 3] > 0.0 and w[(k + 2) % 3] > 0.0 and beyond[k] > NOT_OWNED:
                            whole = True
                            if beyond[k] >= 0:  # nearer to the inside of the triangle on the other side: that one's
                                along = (
                                    facets.grid.origin[balls[1 + (k + 2) % 3]]
                                    - facets.grid.origin[balls[1 + (k + 1) % 3]]
                                )
                                m = facets.grid.origin[beyond[k]] - at_triangle
                                m -= m.dot(along) / along.dot(along) * along
                                whole = r.dot(m) <= 0.0
                found = settle(facets, solver, ball, p, balls, g, r, 0, whole, place, job)
    return found


@ti.func
def edge_edge(facets: ti.template(), solver: ti.template(), ball: ti.template(), p, e, f, place, job: ti.template()):
    """1 where edges e and f are listed as a pair, else 0."""
    found = 0
    a, b, c, d = facets.edge[e].one, facets.edge[e].two, facets.edge[f].one, facets.edge[f].two
    if a != c and a != d and b != c and b != d and facets.edge[e].bare + facets.edge[f].bare < 2:
        xa, xb, xc, xd = facets.grid.origin[a], facets.grid.origin[b], facets.grid.origin[c], facets.grid.origin[d]
        reach = ti.max(facets.reach[a], facets.reach[b]) + ti.max(facets.reach[c], facets.reach[d])
        if near_boxes(ti.min(xa, xb), ti.max(xa, xb), ti.min(xc, xd), ti.max(xc, xd), reach):
            s, t = between_edges(xa, xb, xc, xd)
            r = xa + s * (xb - xa) - xc - t * (xd - xc)
            if r.dot(r) < reach * reach:
                g = ti.Vector([1.0 - s, s, t - 1.0, -t])
                inside = s > INSIDE and s < 1.0 - INSIDE and t > INSIDE and t < 1.0 - INSIDE
                bare = facets.edge[e].bare + 2 * facets.edge[f].bare
                found = settle(facets, solver, ball, p, ti.Vector([a, b, c, d]), g, r, 4 + bare, inside, place, job)
    return found


@ti.func
def near_boxes(low, high, other_low, other_high, reach):
    """Whether two boxes come nearer than `reach` along every axis."""
    near = True
    for a in ti.static(range(3)):
        near = near and low[a] - other_high[a] < reach and other_low[a] - high[a] < reach
    return near


@ti.func
def settle(facets: ti.template(), solver: ti.template(), ball: ti.template(), p, b, g, r, kind, whole, place,
           job: ti.template()):  # fmt: skip
    """List the pair of balls b with weights g at distance r, or let it limit their way. whole: no other pair has this hit.
    kind: 0 for a ball and a triangle, 4 for two edges, 5 and 6 where the first or the second is a stick."""
    found = 0
    allowed = False
    for k in ti.static(range(4)):
        allowed = allowed or facets.model.inverse_mass[b[k]] > 0.0
    other = ti.select(kind == 0, b[1], b[2])
    if ti.static(facets.model.has_groups):
        allowed = allowed and balls_meet(facets.model, b[0], other)
    if allowed:
        n, d = unit(r, b[0], other)
        if ti.static(job == LIMIT):
            hold_apart(facets, ball, b, n, kind)
        else:
            u, give = 0.0 * d, 0.0 * d
            thick, upper, lower, nearest = 0.0 * d, 0.0 * d, 0.0 * d, facets.spacing[b[0]]
            for k in ti.static(range(4)):
                radius = facets.model.radius[b[k]]
                u += g[k] * n.dot(ball[b[k]].v)
                give += ti.select(ti.abs(g[k]) > LEVER, facets.model.inverse_mass[b[k]], 0.0 * d)
                on_top = k == 0 or (k == 1 and kind > 0)
                upper = ti.max(upper, ti.select(on_top, radius, 0.0))
                lower = ti.max(lower, ti.select(on_top, 0.0, radius))
                if not ((kind == 5 and on_top) or (kind == 6 and not on_top)):  # sticks have no thickness of their own
                    thick += ti.abs(g[k]) * radius
                nearest = ti.min(nearest, facets.spacing[b[k]])
            way = LOOK * ti.max(0.0, -u) / solver.rate[0]
            if d < upper + lower or d < thick + way:
                found = 1
                at = FULL
                if facets.used[0] < FULL:
                    at = ti.atomic_add(facets.used[0], 1)
                if at >= facets.capacity:
                    ti.atomic_max(facets.overflow[0], at + 1)
                else:
                    if joined(facets, b, kind):
                        thick = ti.min(thick, nearest)
                    # between points that pins hold nothing can be pushed, or only by a long lever
                    contact = whole and give > 0.0 and d < ti.max(LISTED * thick, thick + way)
                    facets.row[at].owner = p
                    facets.row[at].place = place
                    facets.row[at].kind = kind
                    facets.row[at].normal = n
                    facets.row[at].distance = d
                    facets.row[at].thickness = ti.select(contact, thick, -1.0)
                    for k in ti.static(range(4)):
                        facets.member[4 * at + k] = b[k]
                        facets.weight[4 * at + k] = g[k]
    return found


@ti.func
def joined(facets: ti.template(), b, kind):
    """Whether a spring joins the two sides of a pair: at rest they may be nearer to each other than they are thick."""
    yes = False
    if ti.static(facets.pairs.has_joints):
        for k in range(ti.select(kind == 0, 1, 2)):
            i = ti.select(k == 0, b[0], b[1])
            for e in range(facets.pairs.joint_start[i], facets.pairs.joint_start[i + 1]):
                j = facets.pairs.joint_other[e]
                yes = yes or j == b[2] or j == b[3] or (kind == 0 and j == b[1])
    return yes


@ti.func
def planes(facets: ti.template(), ball: ti.template(), b, n, kind):
    """Two heights along n, from where the first of the balls b began: the upper side may not go below the first, nor the lower
    one above the second; and the distance kept between. Where no side would, they are out of reach.

    The closest points of two convex things lie on two planes at right angles to their distance, with nothing in between. Planes
    in between stand still for a step: so whatever the others do, neither side gets to the other.
    """
    base = facets.grid.origin[b[0]]
    far = 1e30 + 0.0 * base[0]
    low, top, high, bottom = far, far, -far, -far
    for k in ti.static(range(4)):
        here = n.dot(facets.grid.origin[b[k]] - base)
        there = n.dot(ball[b[k]].x - base)
        if k == 0 or (k == 1 and kind > 0):
            low, top = ti.min(low, here), ti.min(top, here, there)
        else:
            high, bottom = ti.max(high, here), ti.max(bottom, here, there)
    width = ti.max(0.0, low - high)
    floor = KEEP * (facets.model.radius[b[0]] + facets.model.radius[b[3]])
    keep = ti.max(KEEP * width, ti.min(width, floor))
    up, down = -far, far
    if top - bottom < keep and (low > top or bottom > high):
        part = (bottom - high) / (low - top + bottom - high)  # the way of the lower side, of both
        middle = high + ti.max(0.5 * keep, ti.min(width - 0.5 * keep, part * width))
        up, down = middle + 0.5 * keep, middle - 0.5 * keep
    return up, down, keep


@ti.func
def hold_apart(facets: ti.template(), ball: ti.template(), b, n, kind):
    """Cut short the way of each of the balls b that crosses its plane."""
    base = facets.grid.origin[b[0]]
    up, down, _ = planes(facets, ball, b, n, kind)
    if up > down:
        for k in ti.static(range(4)):
            here = n.dot(facets.grid.origin[b[k]] - base)
            there = n.dot(ball[b[k]].x - base)
            if k == 0 or (k == 1 and kind > 0):
                if there < ti.min(here, up):
                    ti.atomic_min(facets.part[b[k]], ti.max(0.0, (here - up) / (here - there)))
            elif there > ti.max(here, down):
                ti.atomic_min(facets.part[b[k]], ti.max(0.0, (down - here) / (there - here)))


@ti.func
def balls_of(facets: ti.template(), c):
    """The four balls of a row."""
    return ti.Vector([facets.member[4 * c + k] for k in ti.static(range(4))])


@ti.func
def lead_past(facets: ti.template(), solver: ti.template(), ball: ti.template()):
    """Take from the ways of balls what leads across the planes of listed pairs, so that they may slide along: a way that is cut
    short as a whole lets a ball stick. This need not settle all."""
    for c in range(facets.work[0]):
        up, down, keep = planes(facets, ball, balls_of(facets, c), facets.row[c].normal, facets.row[c].kind)
        facets.row[c].up = up + CLEAR * keep
        facets.row[c].down = down - CLEAR * keep
    for i in range(facets.model.n):
        x = ball[i].x
        change = 0.0 * x
        for _ in range(SWEEPS):
            for e in range(facets.first[i], facets.first[i] + facets.number[i]):
                c, k = facets.entry[e] // 4, facets.entry[e] % 4
                n = facets.row[c].normal
                height = n.dot(x + change - facets.grid.origin[facets.member[4 * c]])
                if k == 0 or (k == 1 and facets.row[c].kind > 0):
                    change += ti.max(0.0, facets.row[c].up - height) * n
                else:
                    change -= ti.max(0.0, height - facets.row[c].down) * n
        if change.dot(change) > 0.0 and facets.model.inverse_mass[i] > 0.0:  # a pin stays where it is
            solver.state.shift(i, change)


@ti.func
def limit(facets: ti.template(), solver: ti.template(), ball: ti.template()):
    """Shorten the ways of the step just made so that no two surfaces, and no surface and ball, have gone through each other.

    What was not listed was further away than its balls are thick: where nothing moved that far, the listed pairs are all that
    could meet. Else all patches are looked at once more, where they were, with the ways that balls made.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        facets.work[0] = ti.min(facets.used[0], facets.capacity)
        facets.fast[0] = 0
        facets.extent[0] = 0.0
    lead_past(facets, solver, ball)
    for i in range(facets.model.n):
        way = (ball[i].x - facets.grid.origin[i]).norm()
        facets.part[i] = 1.0
        facets.reach[i] = 1.01 * way
        if not way <= SAFE * facets.model.radius[i]:
            facets.fast[0] = 1
    ti.loop_config(serialize=True)
    for _ in range(1):
        facets.work[0] = (1 - facets.fast[0]) * facets.work[0]
        facets.work[1] = facets.fast[0] * facets.model.n
    for c in range(facets.work[0]):
        hold_apart(facets, ball, balls_of(facets, c), facets.row[c].normal, facets.row[c].kind)
    patch_boxes(facets)
    for p in range(facets.work[1]):
        if facets.edge_start[p + 1] > facets.edge_start[p]:
            walk(facets, facets.grid, solver, ball, p, LIMIT)
    for i in range(facets.model.n):
        if facets.part[i] < 1.0:
            solver.state.shift(i, (1.0 - facets.part[i]) * (facets.grid.origin[i] - ball[i].x))


@ti.func
def detect(facets: ti.template(), solver: ti.template(), ball: ti.template()):
    """Rows of all patches, then for each ball the sorted list of its entries 4 row + place."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        facets.work[1] = ti.select(facets.grid.work[0] > 0, facets.model.n, 0)  # none where the grid gave up
        facets.used[0], facets.entries[0] = 0, 0
        facets.extent[0] = 0.0
    for i in range(facets.work[1]):
        facets.reach[i] = facets.model.radius[i] + LOOK * ball[i].v.norm() / solver.rate[0]
    patch_boxes(facets)
    for p in range(facets.work[1]):
        if facets.edge_start[p + 1] > facets.edge_start[p]:
            walk(facets, facets.grid, solver, ball, p, DETECT)
    for i in range(facets.model.n):
        facets.number[i] = 0
    for c in range(ti.min(facets.used[0], facets.capacity)):
        for k in range(4):
            facets.number[facets.member[4 * c + k]] += 1
    for i in range(facets.model.n):
        facets.first[i] = ti.atomic_add(facets.entries[0], facets.number[i])
        facets.number[i] = 0
    for c in range(ti.min(facets.used[0], facets.capacity)):
        for k in range(4):
            i = facets.member[4 * c + k]
            facets.entry[facets.first[i] + ti.atomic_add(facets.number[i], 1)] = 4 * c + k
    for i in range(facets.model.n):
        sort_entries(facets, facets.first[i], facets.first[i] + facets.number[i])


@ti.func
def sort_entries(facets: ti.template(), first, last):
    """Insertion sort by owner, then by place among what the owner listed: rows lie wherever threads put them."""
    for a in range(first + 1, last):
        value = facets.entry[a]
        owner, place = facets.row[value // 4].owner, facets.row[value // 4].place
        b = a - 1
        while b >= first and after(facets, facets.entry[b], owner, place):
            facets.entry[b + 1] = facets.entry[b]
            b -= 1
        facets.entry[b + 1] = value


@ti.func
def after(facets: ti.template(), entry, owner, place):
    """Whether the row of `entry` comes after the one at that place of that owner."""
    row = facets.row[entry // 4]
    return row.owner > owner or (row.owner == owner and row.place > place)
