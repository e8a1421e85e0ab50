"""Sweeps over all pairs, each once, in a fixed order.

The balls, in the order of the sorted grid, are cut into blocks longer than any pair reaches. A block writes to itself and the
next one only, so even blocks can run at the same time, then odd ones: the bits are the same for any number of threads, and for
one that does all in turn, also where each pair changes velocities at once (Gauss-Seidel).
"""

from taichi_sim.kernels.contacts import contact_law, pair_impacts
from taichi_sim.kernels.contacts.pairs import GRAIN, NONE, forget, law_of, zero_slide
from taichi_sim.kernels.vectors import cross, lever, unit

from taichi_sim.device.engine import ti

# What a sweep does. MEASURE finds which pairs touch and sums what they hold from before; FIRST is the first pass of a solve, NEXT
# a later one, SETTLE one of those of kernels.settle; BOUNCE one of those that follow where restitution is a matter of its own,
# see energy_limiter; LIMIT bounds what contacts keep of it; LAST belongs to the short solve at the end of a step, RELAX follows a
# move without one; OFFSET undoes overlap.
MEASURE, FIRST, NEXT, SETTLE, BOUNCE, LIMIT, LAST, RELAX, OFFSET = range(9)


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
    end = ti.min(begin + solver.pairs.length[0], solver.n)
    if ti.static(stage == MEASURE and solver.strikes):
        fast = 0
        for k in range(begin, end):
            fast |= measure(solver, solver.pairs, ball, solver.pairs.grid.order[k])
        solver.mark[b] = fast
        solver.struck[b] = fast
    elif ti.static(stage == LIMIT):
        if solver.struck[b] > 0:
            for k in range(begin, end):
                pair_impacts.limit(solver, ball, solver.pairs.grid.order[k])
    else:
        for k in range(begin, end):
            row_of(solver, ball, solver.pairs.grid.order[k], time, stage)


@ti.func
def row_of(solver: ti.template(), ball: ti.template(), i, time, stage: ti.template()):
    """The pairs that ball i lists."""
    if ti.static(stage == MEASURE):
        measure(solver, solver.pairs, ball, i)
    else:
        begin = solver.pairs.first[i]
        end = begin + solver.pairs.touching[i]
        if ti.static(stage == OFFSET):
            offset(solver, ball, i, begin, end, time)
        elif ti.static(solver.in_turn):
            solve_in_turn(solver, ball, i, begin, end, time, stage)
        else:
            solve_at_once(solver, ball, i, begin, end, time, stage)


@ti.func
def measure(solver: ti.template(), pairs: ti.template(), ball: ti.template(), i):
    """Normals and depths of the listed pairs of ball i that touch, or nearly; moves these to the front of its list.

    So the passes need not ask which touch: what touches changes little from step to step, but not from entry to entry.
    Sums the changes of velocity that the impulses held from before make, and how many pairs touch each ball. Returns whether
    any closes fast.
    """
    fast = 0
    x, radius, w = ball[i].x, solver.model.radius[i], solver.model.inverse_mass[i]
    begin = pairs.first[i]
    end = begin
    total, twist = ti.Vector.zero(float, solver.model.dim), zero_spin(solver)
    for e in range(begin, begin + pairs.number[i]):
        link = pairs.link[e]
        j = link.other
        r = ball[j].x - x
        sum = radius + solver.model.radius[j]
        reach = sum * (1.0 + pairs.gap)
        if ti.static(solver.foresees):
            # as far as either comes in a step, should the other be stopped, too: overlap would push back
            here, there = ball[i].v.dot(r), -ball[j].v.dot(r)
            reach += ti.max(0.0, ti.max(here + there, ti.max(here, there))) / (sum * solver.rate[0])
        if r.dot(r) < reach * reach:
            n, d = unit(r, i, j)
            pairs.row[end].normal = n
            pairs.row[end].depth = sum - d
            if ti.static(solver.strikes):
                if (ball[j].v - ball[i].v).dot(n) < -pair_impacts.ALERT * solver.threshold[0]:
                    fast = 1
                    solver.stirred[i] = 0
                pairs.row[end].lister = i
                pairs.row[end].next = pairs.latest[j]
                pairs.latest[j] = end
            if ti.static(not solver.split):
                pairs.row[end].mass = 1.0 / (w + solver.model.inverse_mass[j])
            if ti.static(solver.spins):
                pairs.row[end].arm = d / sum
            if e > end:
                pairs.link[e] = pairs.link[end]
                pairs.link[end] = link
            if ti.static(solver.warm):
                p = held_impulse(solver, ball, i, j, end, n)
                total += p
                add(solver, solver.carry, j, -solver.model.inverse_mass[j] * p)
                if ti.static(solver.spins):
                    t = torque(solver, end, p)
                    twist += t
                    add(
                        solver, solver.carry_spin, j, (solver.model.spin_response(j) * solver.model.inverse_mass[j]) * t
                    )
            if ti.static(solver.counts):
                add(solver, solver.count, j, 1)
            if ti.static(solver.by_tensor):
                T = n.outer_product(n)
                add(solver, solver.tensor, i, T)
                add(solver, solver.tensor, j, T)
            end += 1
        elif ti.static(solver.warm):
            forget(pairs, e)
    pairs.touching[i] = end - begin
    if ti.static(solver.warm):
        add(solver, solver.carry, i, w * total)
        if ti.static(solver.spins):
            add(solver, solver.carry_spin, i, (solver.model.spin_response(i) * w) * twist)
    if ti.static(solver.counts):
        add(solver, solver.count, i, end - begin)
    return fast


@ti.func
def held_impulse(solver: ti.template(), ball: ti.template(), i, j, e, n):
    """Impulse [N s] on ball i that its contact with j in link e holds from before, along the present normal."""
    held = solver.pairs.link[e].impulse
    if ti.static((solver.split or solver.limits_energy) and solver.model.has_restitution):
        aim = solver.pairs.link[e].aim
        if NONE < aim < 0.0:  # it bounced, nothing presses it together: a split mass could not take the impulse back
            if (ball[j].v - ball[i].v).dot(n) > 0.0:
                held = 0.0
                forget_impulse(solver.pairs, e)
    p = -held * n
    if ti.static(solver.model.has_friction):
        slide = solver.pairs.link[e].slide
        if ti.static(solver.model.dim == 2):
            p -= slide * tangent(n)
        else:
            slide -= slide.dot(n) * n
            solver.pairs.link[e].slide = slide
            p -= slide
    return p


@ti.func
def forget_impulse(pairs: ti.template(), e):
    """Link e holds no impulse any more."""
    pairs.link[e].impulse = 0.0
    if ti.static(pairs.model.has_friction):
        pairs.link[e].slide = zero_slide(pairs)


@ti.func
def tangent(n):
    """The normal turned by 90 degrees."""
    return ti.Vector([-n[1], n[0]])


@ti.func
def solve_in_turn(solver: ti.template(), ball: ti.template(), i, begin, end, time, stage: ti.template()):
    """Each pair changes the velocities that the next one sees. Returns the largest change of a relative velocity [m/s]."""
    most = ti.cast(0.0, float)
    v = ball[i].v
    w = solver.model.inverse_mass[i]
    turn = zero_spin(solver)
    if ti.static(solver.spins):
        turn = solver.state.spin[i]
    for c in range(begin, end):
        j = solver.pairs.link[c].other
        p = pair(solver, ball, i, j, c, v, turn, time, stage)
        v += w * p
        ball[j].v = ball[j].v - solver.model.inverse_mass[j] * p
        most = ti.max(most, (w + solver.model.inverse_mass[j]) * p.norm())
        if ti.static(solver.spins):
            t = torque(solver, c, p)
            turn += w * (solver.model.spin_response(i) * t)
            t = solver.model.spin_response(j) * t
            solver.state.spin[j] = solver.state.spin[j] + solver.model.inverse_mass[j] * t
    ball[i].v = v
    if ti.static(solver.spins):
        solver.state.spin[i] = turn
    return most


@ti.func
def solve_at_once(solver: ti.template(), ball: ti.template(), i, begin, end, time, stage: ti.template()):
    """All pairs see the old velocities; impulses are summed in `push` and `twist`, to be applied at the end."""
    v = ball[i].v
    total = ti.Vector.zero(float, solver.model.dim)
    turn, twist = zero_spin(solver), zero_spin(solver)
    if ti.static(solver.spins):
        turn = solver.state.spin[i]
    for c in range(begin, end):
        j = solver.pairs.link[c].other
        p = pair(solver, ball, i, j, c, v, turn, time, stage)
        total += p
        add(solver, solver.push, j, -p)
        if ti.static(solver.spins):
            t = torque(solver, c, p)
            twist += t
            add(solver, solver.twist, j, t)
    add(solver, solver.push, i, total)
    if ti.static(solver.spins):
        add(solver, solver.twist, i, twist)


@ti.func
def zero_spin(solver: ti.template()):
    """A turn of nothing: a scalar in 2D."""
    if ti.static(solver.model.dim == 2):
        return ti.cast(0.0, float)
    else:
        return ti.Vector.zero(float, 3)


@ti.func
def torque(solver: ti.template(), c, p):
    """What impulse p on the lister of the contact in row c does to the turn of either ball, in units of its radius."""
    return solver.pairs.row[c].arm * cross(solver.pairs.row[c].normal, p)


@ti.func
def add(solver: ti.template(), table: ti.template(), i, change):
    """table[i] += change; atomic only where balls are not taken in a fixed order."""
    if ti.static(solver.atomic):
        table[i] += change
    else:
        table[i] = table[i] + change


@ti.func
def pair(solver: ti.template(), ball: ti.template(), i, j, c, v, turn, time, stage: ti.template()):
    """Further impulse [N s] on ball i (at velocity v, turn) from its pair with j in link c; -impulse acts on j."""
    n = solver.pairs.row[c].normal
    held = solver.pairs.link[c].impulse
    if ti.static(stage not in (NEXT, SETTLE, BOUNCE) and not solver.warm):
        held = 0.0
    u = ball[j].v - v
    if ti.static(stage not in (NEXT, SETTLE, BOUNCE)):
        if ti.static(solver.strikes):
            prepare_in_turn(solver, i, j, c, n, held, stage)
        else:
            prepare(solver, i, j, c, n, stage)
    total = normal(solver, c, u.dot(n), held, stage)
    solver.pairs.link[c].impulse = ti.max(0.0, total)
    if ti.static(solver.soft and stage == SETTLE):  # it does not push out any more: nothing is to be taken back
        solver.pairs.link[c].aim = ti.min(0.0, solver.pairs.link[c].aim)
    p = (held - total) * n
    if ti.static(solver.model.has_friction):
        mass = solver.pairs.row[c].mass
        slide = solver.pairs.link[c].slide
        if ti.static(stage not in (NEXT, SETTLE, BOUNCE) and not solver.warm):
            slide = slide * 0.0
        law = law_of(solver.pairs, i, j)
        slip = 0.0 * mass
        if ti.static(stage not in (NEXT, SETTLE, BOUNCE)):
            slip = contact_law.viscous_share(solver.model, law, total, mass, solver.threshold[0], u, time)
        arm = 0.0 * mass
        if ti.static(solver.spins):
            arm = solver.pairs.row[c].arm
            mass *= contact_law.sideways(solver, i, j)
        bound = law.friction * ti.max(0.0, total)
        if ti.static(solver.model.dim == 2):
            s = tangent(n).dot(u)
            if ti.static(solver.spins):
                s -= arm * (turn + solver.state.spin[j])
            change, slide = contact_law.sliding_impulse_2d(solver.model, s, mass, slide, bound, slip)
            solver.pairs.link[c].slide = slide
            p -= change * tangent(n)
        else:
            if total > 0.0 or slide.dot(slide) > 0.0:
                if ti.static(solver.spins):
                    u -= arm * lever(turn + solver.state.spin[j], n)
                change, slide = contact_law.sliding_impulse(solver.model, u, n, mass, slide, bound, slip)
                p -= change
            solver.pairs.link[c].slide = slide
    return p


@ti.func
def prepare(solver: ti.template(), i, j, c, n, stage: ti.template()):
    """Mass of a contact where it is split, its target speed from the velocities before the solve, and its aim."""
    if ti.static(solver.split):
        alone = 1.0 / (solver.model.inverse_mass[i] + solver.model.inverse_mass[j])
        solver.pairs.row[c].mass = ti.min(solver.relaxation / (solver.lightness[i] + solver.lightness[j]), alone)
    if ti.static(solver.pairs.has_aim):
        speed = (solver.before[j] - solver.before[i]).dot(n)
        restitution = 0.0 * speed
        if ti.static(solver.model.has_restitution):
            restitution = law_of(solver.pairs, i, j).restitution
        target = contact_law.target_speed(speed, restitution, solver.threshold[0], stage == FIRST)
        fast = speed < -solver.threshold[0]  # an impact: never soft
        aim = ti.cast(NONE, float)
        if ti.static(solver.model.has_restitution):
            aim = ti.select(fast and target > 0.0, -target, aim)
        if ti.static(solver.soft):
            depth = solver.pairs.row[c].depth
            if depth <= 0.0:  # it may close the gap, but not go on; what bounces does so when it touches
                target = ti.min(target, ti.select(fast and restitution > 0.0, speed, depth * solver.rate[0]))
                aim = NONE
            elif not fast:
                aim = ti.min(contact_law.PUSH * depth * solver.rate[0], solver.fastest_push * solver.threshold[0])
        if ti.static(stage == FIRST):
            solver.pairs.link[c].aim = aim
        elif ti.static(solver.soft):
            aim = solver.pairs.link[c].aim
            if aim > NONE:  # what was held stays so, what bounced keeps its speed
                target = ti.max(target, ti.max(0.0, ti.min(-aim, speed)))
        solver.pairs.row[c].target = target


@ti.func
def prepare_in_turn(solver: ti.template(), i, j, c, n, held, stage: ti.template()):
    """Mass and aim of a contact where impacts come first, see kernels.hits. What closes fast is left alone (mass 0) by the solve
    that ends a step, whose one pass is for what rests; and by the others if it bounces at e = 1, or before it touches: they
    would take its energy."""
    depth = solver.pairs.row[c].depth
    speed = (solver.before[j] - solver.before[i]).dot(n)
    fast = speed + ti.max(0.0, pair_impacts.kick(solver, i, j, n)) < -solver.threshold[0]
    mass = 1.0 / (solver.model.inverse_mass[i] + solver.model.inverse_mass[j])
    if ti.static(stage != FIRST):
        mass = ti.select(fast, 0.0, mass)
    elif ti.static(solver.model.has_restitution):
        e = law_of(solver.pairs, i, j).restitution
        if fast and e > 0.0 and (e >= 1.0 or depth <= 0.0):
            mass = 0.0
    solver.pairs.row[c].mass = mass
    if ti.static(stage == FIRST and solver.warm):
        solver.pairs.row[c].target = held
    if ti.static(stage == FIRST and solver.soft):
        aim = ti.cast(NONE, float)
        rests = (
            held > 0.0
            or ti.abs(speed) <= pair_impacts.STILL * solver.threshold[0]
            or not pair_impacts.is_lossless(solver, i, j)
        )
        if depth > 0.0 and not fast and rests:
            aim = ti.min(contact_law.PUSH * depth * solver.rate[0], solver.fastest_push * solver.threshold[0])
        solver.pairs.link[c].aim = aim


@ti.func
def normal(solver: ti.template(), c, u, held, stage: ti.template()):
    """New total normal impulse of the contact in row c."""
    mass = solver.pairs.row[c].mass
    target = 0.0 * u
    if ti.static(solver.strikes):
        if ti.static(solver.soft):  # it may close the gap, but not go on
            target = ti.min(0.0, solver.pairs.row[c].depth * solver.rate[0])
    elif ti.static(solver.pairs.has_aim):
        target = solver.pairs.row[c].target
        if ti.static(solver.limits_energy and stage in (FIRST, NEXT)):  # what touches is stopped first
            target = ti.select(solver.pairs.row[c].depth > 0.0, 0.0, target)
    total = contact_law.normal_impulse(u, target, mass, held)
    if ti.static(solver.soft and stage != SETTLE):
        aim = solver.pairs.link[c].aim
        if ti.static(stage in (LAST, RELAX)):  # takes back the speed with which the solve before the move pushed
            least = -ti.min(held, mass * ti.max(0.0, aim))
            if ti.static(stage == RELAX):
                least += held
            total = ti.max(least, held + (target - u) * mass)
        elif aim >= 0.0:
            total = contact_law.soft_impulse(u, target + aim, mass, held)
    return total


@ti.func
def offset(solver: ti.template(), ball: ti.template(), i, begin, end, h):
    """Displacements [m] that separate the pairs of ball i where their own motion does not. Velocities never see them."""
    for c in range(begin, end):
        j = solver.pairs.link[c].other
        row = solver.pairs.row[c]
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
