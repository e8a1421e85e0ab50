"""Finding and solving contacts between balls, from the sorted copies of a grid."""

import taichi as ti

from . import contact_law
from .direction import unit
from .grid import bucket_of, cell_of, run, same_row


@ti.func
def may_touch(pairs: ti.template(), i, j):
    """Whether two balls collide at all: not both pinned, not of one body, not joined by a spring."""
    allowed = pairs.model.inverse_mass[i] + pairs.model.inverse_mass[j] > 0.0
    if ti.static(pairs.has_bodies):
        allowed = allowed and (pairs.body[i] == 0 or pairs.body[i] != pairs.body[j])
    if ti.static(pairs.has_joints):
        for e in range(pairs.joint_start[i], pairs.joint_start[i + 1]):
            allowed = allowed and pairs.joint_other[e] != j
    return allowed


@ti.func
def nearby(pairs: ti.template(), own, at, room):
    """Write the sorted copies within reach of copy `own`, itself among them, as links from `at` on; returns how many.

    Links beyond `room` are counted; the last place holds any one of them.
    """
    found = 0
    if pairs.grid.dense[0] == 0:
        found = scan(pairs, own, at, room, False)
    if pairs.grid.dense[0] == 1:
        found = scan(pairs, own, at, room, True)
    return found


@ti.func
def scan(pairs: ti.template(), own, at, room, dense: ti.template()):
    """`nearby` for one of the two ways to place rows in the table."""
    a = pairs.grid.copy[own]
    span = (a.radius + pairs.grid.largest) * pairs.grid.enlarged * pairs.grid.margin
    low = cell_of(a.x - span, pairs.grid)
    high = cell_of(a.x + span, pairs.grid)
    length = high[0] - low[0] + 1
    corner = bucket_of(low, pairs.grid)
    found = 0
    for dz in range(1 if ti.static(pairs.model.dim == 2) else high[2] - low[2] + 1):
        for dy in range(high[1] - low[1] + 1):
            row = low
            row[1] += dy
            bucket = corner + dy * pairs.grid.pitch[1]
            if ti.static(pairs.model.dim == 3):
                row[2] += dz
                bucket += dz * pairs.grid.pitch[2]
            if ti.static(not dense):
                bucket = bucket_of(row, pairs.grid)
            for piece in ti.static(range(1 if dense else 2)):
                first, last = run(pairs.grid, bucket, length, piece)
                for k in range(first, last):
                    b = pairs.grid.copy[k]
                    r = b.x - a.x
                    reach = (a.radius + b.radius) * pairs.grid.enlarged
                    if r.dot(r) < reach * reach:
                        if ti.static(dense) or same_row(row, cell_of(b.x, pairs.grid)):
                            pairs.link[at + ti.min(found, room)].other = k
                            found += 1
    return found


@ti.func
def settle(pairs: ti.template(), own, at, found):
    """Turn `found` links to sorted copies into links to the balls that may touch; returns how many those are."""
    i = pairs.grid.order[own]
    kept = 0
    guess = pairs.first[i]
    for e in range(at, at + found):
        k = pairs.link[e].other
        j = pairs.grid.order[k]
        if k != own and may_touch(pairs, i, j):
            if ti.static(pairs.warm):
                old = recall(pairs, i, j, guess)
                held = ti.cast(0.0, float)
                if old >= 0:
                    held = pairs.link[old].impulse
                    guess = old + 1
                pairs.link[at + kept].impulse = held
            pairs.link[at + kept].other = j
            kept += 1
    return kept


@ti.func
def recall(pairs: ti.template(), i, j, guess):
    """The link of i to j when the lists were last made, or -1 where there was none.

    Starting from the impulse it holds, passes need not build up the load of a pile from nothing in every step. Most lists
    change little: the place after the last one found is tried first.
    """
    end = pairs.first[i] + pairs.number[i]
    old = -1
    if guess < end and pairs.link[guess].other == j:
        old = guess
    else:
        for e in range(pairs.first[i], end):
            if pairs.link[e].other == j:
                old = e
    return old


@ti.func
def search(pairs: ti.template()):
    """For each ball the list of balls within reach, in an order that the grid fixes; nothing where the last one holds.

    The lists of a block of balls lie one behind the other in the room of that block; what it cannot hold goes to a pool at
    the end, where its place depends on the threads, but not what it holds. What does not fit there is counted and not kept;
    the host then stops with an error. New and old lists take turns in the two halves of the memory where impulses are kept.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        if pairs.grid.work[0] > 0:
            if ti.static(pairs.warm):
                pairs.half[0] = pairs.capacity - pairs.half[0]
            pairs.used[0] = 0
    for block in range((pairs.grid.work[0] + pairs.block - 1) // pairs.block):
        at = pairs.half[0] + block * pairs.room
        end = at + pairs.room
        for k in range(block * pairs.block, ti.min((block + 1) * pairs.block, pairs.grid.n)):
            first = at
            found = nearby(pairs, k, at, end - 1 - at)
            if at + found < end:
                found = settle(pairs, k, at, found)
                at += found
            else:
                used = pairs.pool + ti.atomic_add(pairs.used[0], found + 1)
                if used + found < pairs.capacity:
                    first = pairs.half[0] + used
                    nearby(pairs, k, first, found)
                    found = settle(pairs, k, first, found)
                else:
                    ti.atomic_max(pairs.overflow[0], used + found + 1)
                    found = 0
            i = pairs.grid.order[k]
            pairs.first[i] = first
            pairs.number[i] = found


@ti.func
def measure(pairs: ti.template(), ball: ti.template(), i):
    """T = sum n n^T over the listed balls that touch ball i, and their number; moves these to the front of the list.

    So the passes need not ask which touch: what touches changes little from step to step, but not from entry to entry.
    """
    T = ti.Matrix.zero(float, pairs.model.dim, pairs.model.dim)
    a = ball[i].x
    radius = pairs.model.radius[i]
    begin = pairs.first[i]
    end = begin
    for e in range(begin, begin + pairs.number[i]):
        link = pairs.link[e]
        r = ball[link.other].x - a
        reach = radius + pairs.model.radius[link.other]
        if r.dot(r) < reach * reach:
            n, _ = unit(r, i, link.other)
            T += n.outer_product(n)
            if ti.static(pairs.keeps_normals):
                pairs.row[end - pairs.half[0]].normal = n
            if e > end:
                pairs.link[e] = pairs.link[end]
                pairs.link[end] = link
            end += 1
        elif ti.static(pairs.warm):
            pairs.link[e].impulse = 0.0
    pairs.touching[i] = end - begin
    return T, end - begin


@ti.func
def law_of(pairs: ti.template(), i, j):
    """Pair law of two balls."""
    which = 0
    if ti.static(pairs.model.surfaces > 1):
        which = pairs.model.surface[i] * pairs.model.surfaces + pairs.model.surface[j]
    return pairs.model.laws[which]


@ti.func
def normal_of(pairs: ti.template(), ball: ti.template(), i, e):
    """Normal of the contact in link e of ball i; positions are still those that `measure` saw."""
    n = ti.Vector.zero(float, pairs.model.dim)
    if ti.static(pairs.keeps_normals):
        n = pairs.row[e - pairs.half[0]].normal
    else:
        j = pairs.link[e].other
        n, _ = unit(ball[j].x - ball[i].x, i, j)
    return n


@ti.func
def begin(pairs: ti.template(), ball: ti.template(), solver: ti.template(), i, e, impacts: ti.template()):
    """Fix the target speed and the mass of the contact in link e for the passes; returns normal and relative velocity."""
    j = pairs.link[e].other
    c = e - pairs.half[0]
    n = normal_of(pairs, ball, i, e)
    u = ball[j].v - ball[i].v
    speed = u.dot(n)
    restitution = 0.0 * speed
    if ti.static(pairs.model.has_restitution):
        restitution = law_of(pairs, i, j).restitution
    alone = pairs.model.inverse_mass[i] + pairs.model.inverse_mass[j]
    shared = solver.lightness[i] + solver.lightness[j]
    pairs.row[c].mass = ti.min(solver.relaxation / shared, 1.0 / alone)
    pairs.row[c].target = contact_law.target_speed(speed, restitution, solver.threshold, impacts)
    if ti.static(pairs.model.has_friction):
        pairs.row[c].slide = 0.0 * n
    if ti.static(not pairs.warm):
        pairs.link[e].impulse = 0.0 * speed
    return n, u


@ti.func
def hold(pairs: ti.template(), ball: ti.template(), solver: ti.template(), i, e, impacts: ti.template()):
    """`begin`, and the impulse on ball i that the contact holds from before."""
    n, _ = begin(pairs, ball, solver, i, e, impacts)
    return -pairs.link[e].impulse * n


@ti.func
def first_contact(pairs: ti.template(), ball: ti.template(), solver: ti.template(), i, e, time, impacts: ti.template()):
    """`begin` and `contact` in one, where nothing is held from before."""
    n, u = begin(pairs, ball, solver, i, e, impacts)
    return push(pairs, solver, i, e, n, u, time)


@ti.func
def contact(pairs: ti.template(), ball: ti.template(), solver: ti.template(), i, e, time):
    """Further impulse on ball i from the contact in link e; viscous friction acts for `time` seconds."""
    u = ball[pairs.link[e].other].v - ball[i].v
    return push(pairs, solver, i, e, normal_of(pairs, ball, i, e), u, time)


@ti.func
def push(pairs: ti.template(), solver: ti.template(), i, e, n, u, time):
    """Further impulse on ball i from the contact in link e with normal n, for the relative velocity u."""
    c = e - pairs.half[0]
    row = pairs.row[c]
    held = pairs.link[e].impulse
    total = contact_law.normal_impulse(u, n, row.target, row.mass, held)
    p = (held - total) * n
    pairs.link[e].impulse = total
    if ti.static(pairs.model.has_friction):
        if contact_law.presses(total, row.mass, solver.threshold):
            law = law_of(pairs, i, pairs.link[e].other)
            slip = contact_law.decayed(law.viscous_friction * time)
            change, slide = contact_law.sliding_impulse(u, n, row.mass, row.slide, law.friction * total, slip)
            pairs.row[c].slide = slide
            p -= change
    return p


@ti.func
def push_out(pairs: ti.template(), ball: ti.template(), solver: ti.template(), i, e, h):
    """Pseudo-impulse [kg m] that separates the pair in link e where its own motion does not: -q on i, +q on the other."""
    j = pairs.link[e].other
    n = normal_of(pairs, ball, i, e)
    smaller = ti.min(pairs.model.radius[i], pairs.model.radius[j])
    depth = pairs.model.radius[i] + pairs.model.radius[j] - n.dot(ball[j].x - ball[i].x) - pairs.slop * smaller
    depth -= h * ti.max(0.0, n.dot(ball[j].v - ball[i].v))
    return solver.push_out * ti.max(0.0, depth) / (solver.lightness[i] + solver.lightness[j]) * n
