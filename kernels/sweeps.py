"""Sweeps over all pairs, each once, in a fixed order.

The balls, in the order of the sorted grid, are cut into blocks longer than any pair reaches. A block writes to itself and the
next one only, so even blocks can run at the same time, then odd ones: the bits are the same for any number of threads, and for
one that does all in turn, also where each pair changes velocities at once (Gauss-Seidel).
"""

import taichi as ti

from . import contact_law
from .direction import cross, lever
from .pairs import law_of

GRAIN = 32  # Taichi hands loop indices to CPU threads in runs of at least this many: one run holds one block

# What a sweep does. HOLD applies the impulses held from before; FIRST is the first pass of a solve, NEXT a later one; LAST
# belongs to the short solve at the end of a step, RELAX follows a move without one; SHARE counts contacts; OFFSET undoes overlap.
HOLD, FIRST, NEXT, LAST, RELAX, SHARE, OFFSET = range(7)


@ti.func
def sweep(solver: ti.template(), ball: ti.template(), time, stage: ti.template()):
    """All pairs; in fixed order, or with atomic adds in any."""
    if ti.static(solver.atomic):
        for k in range(solver.n):
            row_of(solver, ball, solver.pairs.grid.order[k], time, stage)
    elif ti.static(solver.serial):
        for parity in range(2):
            for g in range((solver.pairs.blocks[0] + 1 - parity) // 2):
                block(solver, ball, 2 * g + parity, time, stage)
    else:  # at the top level of a kernel only an unrolled loop leaves the inner ones parallel
        for parity in ti.static(range(2)):
            for g in range((solver.pairs.blocks[0] + 1 - parity) // 2 * GRAIN):
                if g % GRAIN == 0:
                    block(solver, ball, g // GRAIN * 2 + parity, time, stage)


@ti.func
def block(solver: ti.template(), ball: ti.template(), b, time, stage: ti.template()):
    """The balls of block b, in the order of the grid."""
    begin = b * solver.pairs.length[0]
    for k in range(begin, ti.min(begin + solver.pairs.length[0], solver.n)):
        row_of(solver, ball, solver.pairs.grid.order[k], time, stage)


@ti.func
def row_of(solver: ti.template(), ball: ti.template(), i, time, stage: ti.template()):
    """The pairs that ball i lists."""
    own = solver.pairs.turn[0] * solver.n + i
    begin = solver.pairs.first[own]
    end = begin + solver.pairs.touching[own]
    if ti.static(stage == SHARE):
        share(solver, i, begin, end)
    elif ti.static(stage == OFFSET):
        offset(solver, ball, i, begin, end, time)
    elif ti.static(solver.in_turn):
        solve_in_turn(solver, ball, i, begin, end, time, stage)
    else:
        solve_at_once(solver, ball, i, begin, end, time, stage)


@ti.func
def solve_in_turn(solver: ti.template(), ball: ti.template(), i, begin, end, time, stage: ti.template()):
    """Each pair changes the velocities that the next one sees."""
    v = ball[i].v
    w = solver.model.inverse_mass[i]
    turn = zero_turn(solver)
    if ti.static(solver.spins):
        turn = solver.state.turn[i]
    for e in range(begin, end):
        j = solver.pairs.link[e].other
        p = pair(solver, ball, i, j, e, v, turn, time, stage)
        v += w * p
        ball[j].v = ball[j].v - solver.model.inverse_mass[j] * p
        if ti.static(solver.spins):
            t = solver.turning * torque(solver, e, p)
            turn += w * t
            solver.state.turn[j] = solver.state.turn[j] + solver.model.inverse_mass[j] * t
    ball[i].v = v
    if ti.static(solver.spins):
        solver.state.turn[i] = turn


@ti.func
def solve_at_once(solver: ti.template(), ball: ti.template(), i, begin, end, time, stage: ti.template()):
    """All pairs see the old velocities; impulses are summed in `push` and `twist`, to be applied at the end."""
    v = ball[i].v
    total = ti.Vector.zero(float, solver.model.dim)
    turn, twist = zero_turn(solver), zero_turn(solver)
    if ti.static(solver.spins):
        turn = solver.state.turn[i]
    for e in range(begin, end):
        j = solver.pairs.link[e].other
        p = pair(solver, ball, i, j, e, v, turn, time, stage)
        total += p
        add(solver, solver.push, j, -p)
        if ti.static(solver.spins):
            t = torque(solver, e, p)
            twist += t
            add(solver, solver.twist, j, t)
    add(solver, solver.push, i, total)
    if ti.static(solver.spins):
        add(solver, solver.twist, i, twist)


@ti.func
def zero_turn(solver: ti.template()):
    """A turn of nothing: a scalar in 2D."""
    if ti.static(solver.model.dim == 2):
        return ti.cast(0.0, float)
    else:
        return ti.Vector.zero(float, 3)


@ti.func
def torque(solver: ti.template(), e, p):
    """What impulse p on the lister of link e does to the turn of either ball, in units of its radius."""
    c = e - solver.pairs.turn[0] * solver.pairs.capacity
    return solver.pairs.row[c].arm * cross(solver.pairs.row[c].normal, p)


@ti.func
def add(solver: ti.template(), table: ti.template(), i, change):
    """table[i] += change; atomic only where balls are not taken in a fixed order."""
    if ti.static(solver.atomic):
        table[i] += change
    else:
        table[i] = table[i] + change


@ti.func
def pair(solver: ti.template(), ball: ti.template(), i, j, e, v, turn, time, stage: ti.template()):
    """Further impulse [N s] on ball i (at velocity v, turn) from its pair with j in link e; -impulse acts on j."""
    c = e - solver.pairs.turn[0] * solver.pairs.capacity
    n = solver.pairs.row[c].normal
    held = solver.pairs.link[e].impulse
    p = ti.Vector.zero(float, solver.model.dim)
    if ti.static(stage == HOLD):
        if ti.static(solver.split and solver.model.has_restitution):
            target = solver.pairs.link[e].target
            if target > 0.0:  # it bounced, nothing presses it together: a split mass could not take the impulse back
                if (solver.before[j] - solver.before[i]).dot(n) > 0.9 * target:
                    held = 0.0
                    solver.pairs.link[e].impulse = held
                    if ti.static(solver.model.has_friction):
                        solver.pairs.link[e].slide = 0.0 * n
        p = -held * n
        if ti.static(solver.model.has_friction):
            slide = solver.pairs.link[e].slide
            slide -= slide.dot(n) * n
            solver.pairs.link[e].slide = slide
            p -= slide
    else:
        if ti.static(stage != NEXT and not solver.warm):
            held = 0.0
        u = ball[j].v - v
        if ti.static(stage != NEXT):
            prepare(solver, i, j, e, c, n, u, stage)
        total = normal(solver, e, c, u.dot(n), held, stage)
        solver.pairs.link[e].impulse = ti.max(0.0, total)
        p = (held - total) * n
        if ti.static(solver.model.has_friction):
            mass = solver.pairs.row[c].mass
            slide = solver.pairs.link[e].slide
            if ti.static(stage != NEXT and not solver.warm):
                slide = ti.Vector.zero(float, solver.model.dim)
            if total > 0.0 or slide.dot(slide) > 0.0:
                law = law_of(solver.pairs, i, j)
                slip = 0.0 * mass
                if ti.static(stage != NEXT):
                    slip = contact_law.viscous_share(solver.model, law, total, mass, solver.threshold, time)
                if ti.static(solver.spins):
                    u -= solver.pairs.row[c].arm * lever(turn + solver.state.turn[j], n)
                    mass *= solver.tangential
                change, slide = contact_law.sliding_impulse(u, n, mass, slide, law.friction * ti.max(0.0, total), slip)
                p -= change
            solver.pairs.link[e].slide = slide
    return p


@ti.func
def prepare(solver: ti.template(), i, j, e, c, n, u, stage: ti.template()):
    """Mass of a contact, and its target speed from the velocities before the solve."""
    alone = solver.model.inverse_mass[i] + solver.model.inverse_mass[j]
    mass = 1.0 / alone
    if ti.static(solver.split):
        mass = ti.min(solver.relaxation / (solver.lightness[i] + solver.lightness[j]), mass)
    solver.pairs.row[c].mass = mass
    if ti.static(solver.model.has_restitution or solver.soft):
        speed = (solver.before[j] - solver.before[i]).dot(n)
        restitution = 0.0 * speed
        if ti.static(solver.model.has_restitution):
            restitution = law_of(solver.pairs, i, j).restitution
        target = contact_law.target_speed(speed, restitution, solver.threshold, stage == FIRST)
        if ti.static(solver.soft):
            depth = solver.pairs.row[c].depth
            fast = speed < -solver.threshold  # an impact: never soft
            if depth <= 0.0:  # it may close the gap, but not go on; what bounces does so when it touches
                target = ti.min(target, ti.select(fast and restitution > 0.0, speed, depth / solver.h[0]))
            if ti.static(stage == FIRST):
                push = ti.min(contact_law.PUSH * depth / solver.h[0], solver.fastest_push)
                solver.pairs.link[e].push = ti.select(fast or depth <= 0.0, -1.0, push)
            else:
                target = ti.max(target, solver.pairs.link[e].target)  # what bounced keeps its speed
        solver.pairs.link[e].target = target


@ti.func
def normal(solver: ti.template(), e, c, u, held, stage: ti.template()):
    """New total normal impulse of the contact in link e, row c."""
    mass = solver.pairs.row[c].mass
    target = 0.0 * u
    if ti.static(solver.model.has_restitution or solver.soft):
        target = solver.pairs.link[e].target
    total = contact_law.normal_impulse(u, target, mass, held)
    if ti.static(solver.soft):
        push = solver.pairs.link[e].push
        if ti.static(stage in (LAST, RELAX)):  # takes back the speed with which the solve before the move pushed
            least = -ti.min(held, mass * ti.max(0.0, push))
            if ti.static(stage == RELAX):
                least += held
            total = ti.max(least, held + (target - u) * mass)
        elif push >= 0.0:
            total = contact_law.soft_impulse(u, target + push, mass, held)
    return total


@ti.func
def share(solver: ti.template(), i, begin, end):
    """Add what the pairs of ball i contribute to the split of masses: their number, and sum n n^T where that is used."""
    for e in range(begin, end):
        j = solver.pairs.link[e].other
        add(solver, solver.count, i, 1)
        add(solver, solver.count, j, 1)
        if ti.static(solver.by_tensor):
            n = solver.pairs.row[e - solver.pairs.turn[0] * solver.pairs.capacity].normal
            T = n.outer_product(n)
            add(solver, solver.tensor, i, T)
            add(solver, solver.tensor, j, T)


@ti.func
def offset(solver: ti.template(), ball: ti.template(), i, begin, end, h):
    """Displacements [m] that separate the pairs of ball i where their own motion does not. Velocities never see them."""
    for e in range(begin, end):
        j = solver.pairs.link[e].other
        row = solver.pairs.row[e - solver.pairs.turn[0] * solver.pairs.capacity]
        depth = row.depth - solver.pairs.slop * ti.min(solver.model.radius[i], solver.model.radius[j])
        depth -= h * ti.max(0.0, row.normal.dot(ball[j].v - ball[i].v))
        lightness = solver.model.inverse_mass[i] + solver.model.inverse_mass[j]
        if ti.static(solver.in_turn):
            depth -= row.normal.dot(solver.offset[j] - solver.offset[i])
        else:
            lightness = solver.lightness[i] + solver.lightness[j]
        if depth > 0.0:
            q = solver.push_out * depth / lightness * row.normal
            add(solver, solver.offset, i, -solver.model.inverse_mass[i] * q)
            add(solver, solver.offset, j, solver.model.inverse_mass[j] * q)
