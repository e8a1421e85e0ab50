"""Contacts between balls and sticks: found by traversing the grid along each stick. Those of a stick lie together."""

from taichi_sim.kernels.contacts import warm_start
from taichi_sim.kernels.contacts.contact_incidence import begin_entries, count_entries, list_entries
from taichi_sim.kernels.contacts.pairs import COUNT_LIMIT, may_meet
from taichi_sim.kernels.contacts.spatial_hash import (
    FINE_CELLS,
    bucket_of,
    cell_of,
    clip,
    run,
    same_row,
    table,
)
from taichi_sim.kernels.loops import each
from taichi_sim.kernels.vectors import unit

from taichi_sim.device.engine import ti

STICK_END = 1e-5  # of the length: nearer to an end, rounding must not make a second contact of a hit on the ball there


@ti.func
def closest(x, a, b):
    """Parameter t of the point of the line a + t (b - a) closest to x, and the vector from that point to x."""
    d = b - a
    square = d.dot(d)
    t = 0.0 * square
    if square > 0.0:
        t = d.dot(x - a) / square
    return t, x - a - t * d


@ti.func
def may_touch(sticks: ti.template(), i, one, two):
    """True if ball i and the stick from `one` to `two` collide at all."""
    w = sticks.model.inverse_mass[i] + sticks.model.inverse_mass[one] + sticks.model.inverse_mass[two]
    return i != one and i != two and w > 0.0 and may_meet(sticks.pairs, i, one)


@ti.func
def touches(sticks: ti.template(), ball: ti.template(), i, x, radius, one, two):
    """True if ball i touches the inside of a stick. A hit at an end is the ball-ball contact with the ball there."""
    hit = False
    if i != one and i != two:
        t, r = closest(x, ball[one].x, ball[two].x)
        hit = t > STICK_END and t < 1.0 - STICK_END and r.dot(r) < radius * radius
        hit = hit and may_touch(sticks, i, one, two)
    return hit


@ti.func
def slab(grid: ti.template(), level, a, d, axis, k):
    """Lowest and highest cell around the piece of a stick a .. a + d that lies in slab k of its longest axis.

    A slab is as thick as a cell across x; along x it holds FINE_CELLS cells.
    """
    reach = grid.largest[level]
    width = 1.0 / grid.inverse_width[level]
    t0 = 0.0 * a[0]
    t1 = t0 + 1.0
    for c in ti.static(range(a.n)):
        if c == axis and d[c] != 0.0:
            u = (k * width - reach - a[c]) / d[c]
            v = ((k + 1) * width + reach - a[c]) / d[c]
            t0 = ti.max(0.0, ti.min(u, v))
            t1 = ti.min(1.0, ti.max(u, v))
    low = cell_of(ti.min(a + t0 * d, a + t1 * d) - reach, grid, level)
    high = cell_of(ti.max(a + t0 * d, a + t1 * d) + reach, grid, level)
    for c in ti.static(range(a.n)):
        if c == axis:
            low[c] = k * ti.static(FINE_CELLS if c == 0 else 1)
            high[c] = low[c] + ti.static(FINE_CELLS - 1 if c == 0 else 0)
    return low, high


@ti.func
def visit(sticks: ti.template(), ball: ti.template(), level, s, low, high, at, fill: ti.template()):
    """Count, or write as contacts from `at` on, the balls in the cells low..high of a level that touch stick s."""
    one, two = sticks.one[s], sticks.two[s]
    found = 0
    depth = 1
    if ti.static(low.n == 3):
        depth = high[2] - low[2] + 1
    for row in range((high[1] - low[1] + 1) * depth):
        left = low
        left[1] = low[1] + row // depth
        if ti.static(low.n == 3):
            left[2] = low[2] + row % depth
        length = high[0] - low[0] + 1
        bucket = bucket_of(left, sticks.grid, level)
        for piece in ti.static(range(2)):
            first, last = run(sticks.grid, level, bucket, length, piece)
            for k in range(first, last):
                b = sticks.grid.copy[k]
                i = sticks.grid.sorted[k]
                if touches(sticks, ball, i, b.x, b.radius, one, two):
                    cell = cell_of(b.x, sticks.grid, level)
                    if same_row(left, cell) and cell[0] >= low[0] and cell[0] <= high[0]:
                        if ti.static(fill):
                            sticks.contact[at + found].ball = i
                            sticks.contact[at + found].stick = s
                        found += 1
    return found


@ti.func
def traverse(sticks: ti.template(), ball: ti.template(), s, at, fill: ti.template()):
    """All balls that touch stick s, slab by slab along its longest axis."""
    a = ball[sticks.one[s]].x
    d = ball[sticks.two[s]].x - a
    axis = 0
    for c in ti.static(range(1, d.n)):
        if ti.abs(d[c]) > ti.abs(d[axis]):
            axis = c
    cells = ti.select(axis == 0, FINE_CELLS, 1)  # of a slab
    found = 0
    for level in range(sticks.grid.levels):
        reach = sticks.grid.largest[level]
        from_cell = cell_of(ti.min(a, a + d) - reach, sticks.grid, level)
        to_cell = cell_of(ti.max(a, a + d) + reach, sticks.grid, level)
        if ti.static(sticks.grid.levels > 1):
            from_cell, to_cell = clip(sticks.grid, level, from_cell, to_cell)
        low, high = (from_cell // cells)[axis], (to_cell // cells)[axis]
        begin, size = table(sticks.grid, level)
        first_ball, last_ball = sticks.grid.start[begin], sticks.grid.start[begin + size]
        if high - low > last_ball - first_ball:  # more slabs than balls: quicker one by one
            for k in range(first_ball, last_ball):
                b = sticks.grid.copy[k]
                if touches(sticks, ball, sticks.grid.sorted[k], b.x, b.radius, sticks.one[s], sticks.two[s]):
                    if ti.static(fill):
                        sticks.contact[at + found].ball = sticks.grid.sorted[k]
                        sticks.contact[at + found].stick = s
                    found += 1
        else:
            for k in range(low, high + 1):
                first, last = slab(sticks.grid, level, a, d, axis, k)
                found += visit(sticks, ball, level, s, first, last, at + found, fill)
    return found


@ti.func
def detect(sticks: ti.template(), ball: ti.template()):
    """Contacts of all sticks, with what they accumulated under the last list, then for each ball the list of its entries."""
    if ti.static(sticks.plan.warm_starts):
        warm_start.store(sticks)
    for i in range(sticks.model.n):
        begin_entries(sticks, i)
    fixed = ti.static(sticks.plan.gathers)
    # none where the grid gave up
    each(ti.select(sticks.grid.work[0].balls > 0, sticks.m, 0), sticks.m, fixed, list_contacts, (sticks, ball))
    list_entries(sticks)


@ti.func
def list_contacts(s, sticks: ti.template(), ball: ti.template()):
    """The contacts of stick s, one behind the other."""
    found = traverse(sticks, ball, s, 0, False)
    first = COUNT_LIMIT
    if found > 0:
        if sticks.used[0] < COUNT_LIMIT:
            first = ti.atomic_add(sticks.used[0], found)
        if first + found <= sticks.capacity:
            traverse(sticks, ball, s, first, True)
        else:
            ti.atomic_max(sticks.overflow[0], first + found)
            for c in range(first, ti.min(first + found, sticks.capacity)):  # of old, but listed all the same
                count_entries(c, sticks)
            found = 0
    for c in range(first, first + found):
        measure(sticks, ball, c)
        count_entries(c, sticks)
        if ti.static(sticks.plan.warm_starts):
            sticks.contact[c].last_speed = sticks.relative_velocity(ball, c).dot(sticks.contact[c].normal)
            warm_start.recall(sticks, s, c)
    sticks.begin[s], sticks.length[s] = first, found


@ti.func
def measure(sticks: ti.template(), ball: ti.template(), c):
    """Measure contact c: its place on the stick (0 to 1), the normal from stick to ball, and the distance [m]."""
    contact = sticks.contact[c]
    one, two = sticks.one[contact.stick], sticks.two[contact.stick]
    t, r = closest(ball[contact.ball].x, ball[one].x, ball[two].x)
    n, d = unit(r, contact.stick, contact.ball)
    if d == 0.0:  # the centre lies on the stick: any direction across it
        n = across(ball[two].x - ball[one].x)
    sticks.contact[c].at = ti.max(0.0, ti.min(1.0, t))
    sticks.contact[c].normal = n
    sticks.contact[c].distance = d


@ti.func
def across(d):
    """A unit vector at right angles to d."""
    n = d * 0.0
    if ti.static(d.n == 2):
        n = ti.Vector([d[1], -d[0]])
    else:
        n = ti.Vector([d[1], -d[0], 0.0 * d[0]])
        if ti.abs(d[2]) > ti.max(ti.abs(d[0]), ti.abs(d[1])):
            n = ti.Vector([0.0 * d[0], d[2], -d[1]])
    return n / n.norm()
