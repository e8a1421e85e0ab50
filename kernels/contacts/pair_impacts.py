"""Impacts among balls that change velocities in turn (Gauss-Seidel): each by itself, before what rests is solved.

Newton's law between two bodies, u' = -e u, is exact for one pair; asked of many contacts at once it is not, and adds energy
where an iteration has not converged. So pairs that close fast bounce one after another, as many times as it takes until none
does: each bounce keeps momentum and never adds energy, and at e = 1 without friction all of it stays. What then still closes is
slow, or does not bounce, and is stopped by the iterations (target speed 0), whose impulses only take energy. Walls take their
turn with the pairs of the balls that touch others.

Speed that forces gave a pair since contacts were last looked for is a load and no impact: it is borne, not thrown back.

Blocks (see pair_sweeps) in which nothing closes fast, nor in those beside them, are passed over, and in the others the balls
none of whose contacts may have changed: those with a `disturbed` before the present round.
"""

import math

from taichi_sim.kernels.contacts import contact_law, struck_pairs, touch_times, wall_impacts
from taichi_sim.kernels.contacts.kinds import BALL_ARRIVING
from taichi_sim.kernels.contacts.pairs import law_of
from taichi_sim.kernels.contacts.warm_start import keep_at_most, largest_load
from taichi_sim.kernels.reductions import even_then_odd
from taichi_sim.kernels.vectors import cross, lever, unit, zero_scalar_in_2d

from taichi_sim.device.engine import ti

PARALLEL_IMPACT_ROUNDS = 2  # rounds on all threads; what goes on bouncing is little, and one thread does it
IMPACT_ROUNDS = 24  # of impacts in one step; what closes fast after them is stopped, or at e = 1 left to the next step
UNDISTURBED = -1  # as `disturbed`
NO_CONTACT = -1  # the end of a chain
SPENT_SPEED = 0.02  # of an approach speed: a contact has lost the rest after so many bounces that e^k is less
RESTING_SPEED = 0.01  # of the threshold: what moves less rests
TOUCHING = 1e-3  # of the distance of two balls at touch: less overlap is rounding, and not in the way of a shift
FAST_APPROACH = 0.5  # of the threshold: what closes faster may be fast once forces have acted


@ti.func
def approach_from_forces(solver: ti.template(), i, j, n):
    """Approach speed that forces gave balls i and j along n since contacts were last looked for, negative where they pull them
    apart."""
    u = 0.0 * n[0]
    if ti.static(solver.plan.loaded):
        u = -(solver.from_forces[j].v - solver.from_forces[i].v).dot(n)
    return u


@ti.func
def is_lossless(solver: ti.template(), i, j, n):
    """True if all speed comes back: such a pair, once it has bounced, parts by itself; to be pushed as well would be a gain."""
    lossless = False
    if ti.static(solver.model.has_restitution):
        lossless = law_of(solver.pairs, i, j, n).restitution >= 1.0
    return lossless


@ti.func
def rests(solver: ti.template(), i, j, speed, depth):
    """True if the pair hardly separates (`speed` [m/s]) and overlaps by more [m] than its balls move in one step. A packing
    that a shock has gone through looks like this; such pairs do not bounce."""
    way = (solver.velocity_before[i].norm() + solver.velocity_before[j].norm()) / solver.rate[0]
    return ti.abs(speed) <= RESTING_SPEED * solver.threshold[0] and depth > way


@ti.func
def note_velocity_from_forces(solver: ti.template(), ball: ti.template()):
    """Note the velocity [m/s] that forces gave every ball since contacts were last looked for."""
    if ti.static(solver.plan.loaded):
        for i in range(solver.n):
            solver.from_forces[i].v = ball[i].v - solver.velocity_when_found[i]


@ti.func
def all_rounds(solver: ti.template(), ball: ti.template(), time):
    """Impacts until nothing closes fast that bounces."""
    repeat_until_calm(solver, ball, impacts_of_ball, 0, PARALLEL_IMPACT_ROUNDS, IMPACT_ROUNDS, time)


@ti.func
def repeat_until_calm(solver: ti.template(), ball: ti.template(), visit: ti.template(), before: ti.template(),
                      parallel: ti.template(), most: ti.template(), time):  # fmt: skip
    """Rounds of all blocks, see `round_of_block`, until visit has returned 0 for all balls or `most` are done: the first
    `parallel` ones on all threads, where there are several. before: rounds of others, from which `disturbed` counts on."""
    if ti.static(not solver.plan.serial):
        for now in ti.static(range(parallel)):
            even_then_odd(solver.pairs.blocks[0], round_of_block, (solver, ball, visit, before, now, time))
    ti.loop_config(serialize=True)
    for _ in range(1):
        first = ti.static(0 if solver.plan.serial else parallel)
        going, now = True, first
        while going and now < most:
            going = False
            for parity in range(2):
                for g in range((solver.pairs.blocks[0] + 1 - parity) // 2):
                    if round_of_block(2 * g + parity, solver, ball, visit, before, now, time) > 0:
                        going = True
            now += 1


@ti.func
def is_marked_near(solver: ti.template(), flags: ti.template(), first, b):
    """True if block b or one beside it is marked in `flags`, which hold the first block at `first`."""
    near = flags[first + b] > 0
    if b > 0:
        near = near or flags[first + b - 1] > 0
    if b + 1 < solver.pairs.blocks[0]:
        near = near or flags[first + b + 1] > 0
    return near


@ti.func
def round_of_block(
    b, solver: ti.template(), ball: ti.template(), visit: ti.template(), before: ti.template(), now, time
):
    """visit(solver, ball, i, now, time) in round `now` for the balls of block b that are disturbed, if it or one beside it is
    marked; notes whether it returned 1 for any. Viscous friction acts in the first, for `time` seconds."""
    from_, to = now % 2 * solver.block_limit, (now + 1) % 2 * solver.block_limit
    first = ti.select(now == 0, 0, before + now)
    found = 0
    if is_marked_near(solver, solver.block_is_active, from_, b):
        begin = b * solver.pairs.block_length[0]
        for k in range(begin, ti.min(begin + solver.pairs.block_length[0], solver.n)):
            i = solver.pairs.grid.order[k]
            if solver.disturbed[i] >= first:
                found |= visit(solver, ball, i, now, ti.select(now == 0, time, 0.0))
    solver.block_is_active[to + b] = found
    if found > 0:
        solver.block_was_struck[b] = 1
    return found


@ti.func
def disturb(solver: ti.template(), i, now):
    """Mark all contacts of ball i to be looked at again from round `now` on: its velocity has changed."""
    if solver.model.inverse_mass[i] > 0.0:
        solver.disturbed[i] = now
        c = solver.pairs.first_from_others[i]
        while c != NO_CONTACT:
            solver.disturbed[solver.pairs.contact[c].lister] = now
            c = solver.pairs.contact[c].next_from_others


@ti.func
def bounces_on(solver: ti.template(), i, j, restitution):
    """True while restitution^k > SPENT_SPEED, with k the impacts of ball i or j so far in this step, whichever had more. After
    that restitution leaves no speed for another. With a line search it is always True."""
    on = True
    if ti.static(not solver.plan.line_search):
        number = ti.max(solver.impacts[i], solver.impacts[j])
        on = number * ti.log(restitution) > ti.static(math.log(SPENT_SPEED))
    return on


@ti.func
def note_impact(solver: ti.template(), i, since):
    """Note an impact of ball i, so many seconds ago."""
    solver.impacts[i] = solver.impacts[i] + 1
    solver.since_impact[i] = since


@ti.func
def may_shift(solver: ti.template(), ball: ti.template(), i, c, shift):
    """True if nothing is in the way of ball i, which has an impact by contact c, where it comes by `shift` [m]: no wall, nor any
    third ball that it overlaps already, in which it would come deeper."""
    free = True
    if ti.static(solver.plan.walls_in_turn):
        free = free and wall_impacts.may_shift(solver.walls, ball, i, shift, solver.impacts[i])
    if solver.model.inverse_mass[i] > 0.0:
        for other in range(solver.pairs.first[i], solver.pairs.first[i] + solver.pairs.touching[i]):
            free = free and (other == c or not overlap(solver, ball, i, solver.pairs.link[other].other))
        other = solver.pairs.first_from_others[i]
        while free and other != NO_CONTACT:
            free = other == c or not overlap(solver, ball, i, solver.pairs.contact[other].lister)
            other = solver.pairs.contact[other].next_from_others
    return free


@ti.func
def overlap(solver: ti.template(), ball: ti.template(), i, j):
    """True if balls i and j overlap by more than rounding."""
    r, reach = ball[j].x - ball[i].x, solver.model.radius[i] + solver.model.radius[j]
    return r.dot(r) < ((1.0 - TOUCHING) * reach) ** 2


@ti.func
def impacts_of_ball(solver: ti.template(), ball: ti.template(), i, now, time):
    """Impacts of ball i with the balls that it lists, then with walls; whether there were any."""
    bounced = 0
    begin = solver.pairs.first[i]
    for c in range(begin, begin + solver.pairs.touching[i]):
        j = solver.pairs.link[c].other
        measure_again(solver, ball, i, j, c)
        passed = solver.pairs.contact[c].passed
        if passed > 0.0 and passed > ti.min(solver.since_impact[i], solver.since_impact[j]):
            passed = 0.0
            solver.pairs.contact[c].passed = 0.0
        if solver.pairs.contact[c].depth > 0.0 or passed > 0.0:
            n = solver.pairs.contact[c].normal
            if passed > 0.0:
                n, _ = unit(ball[j].x - ball[i].x - passed * (ball[j].v - ball[i].v), i, j)
            closing = contact_law.closing_speed((ball[j].v - ball[i].v).dot(n), approach_from_forces(solver, i, j, n))
            if closing > solver.threshold[0]:
                restitution = law_of(solver.pairs, i, j, n).restitution
                if restitution > 0.0 and bounces_on(solver, i, j, restitution):
                    bounced = 1
                    impact(solver, ball, i, j, c, time)
                    disturb(solver, i, now + 1)
                    disturb(solver, j, now + 1)
    if ti.static(solver.plan.walls_in_turn):
        if wall_impacts.bounce(solver.walls, ball, solver, i, time) > 0:
            bounced = 1
            disturb(solver, i, now + 1)
    return bounced


@ti.func
def impact(solver: ti.template(), ball: ti.template(), i, j, c, time):
    """Impact of balls i and j, which contact c found up to a step late, at the moment when they touched.

    Both go back to where they were then, bounce, and go on for as long: each is shifted by what its velocity changes in that
    time. Whatever the time, that keeps momentum, the centre of mass and angular momentum, and energy where accelerations are
    constant. Where a wall is in the way they bounce where they are.
    """
    reach = solver.model.radius[i] + solver.model.radius[j]
    w, other = solver.model.inverse_mass[i], solver.model.inverse_mass[j]
    u = ball[j].v - ball[i].v
    since = solver.pairs.contact[c].passed
    if since == 0.0:
        since = touch_times.since_touch(solver, ball, i, j, u)
    solver.pairs.contact[c].passed = 0.0
    done = False
    for _ in range(2):  # at the moment of touch, or else, the second time, at once
        if not done:
            r = ball[j].x - ball[i].x - since * u
            n, d = unit(r, i, j)
            forced = approach_from_forces(solver, i, j, n)
            at_touch = touch_times.forced_since(solver, forced, since)
            p = impulse(solver, i, j, n, d / reach, u, at_touch, time)
            shift_i, shift_j = (since * w) * p, (-since * other) * p
            fits = u.dot(n) + 0.5 * at_touch < 0.5 * ti.min(0.0, u.dot(n) + forced)
            fits = fits and may_shift(solver, ball, i, c, shift_i) and may_shift(solver, ball, j, c, shift_j)
            if fits or since == 0.0:
                done = True
                t = zero_scalar_in_2d(solver.model.dim)
                if ti.static(solver.model.spins):
                    t = d / reach * cross(n, p)
                note_impact(solver, i, since)
                note_impact(solver, j, since)
                struck_pairs.note(solver, i, j, n, law_of(solver.pairs, i, j, n).restitution, since)
                solver.apply(i, p, t)
                solver.apply(j, -p, t)
                if since > 0.0:
                    solver.state.shift(i, shift_i)
                    solver.state.shift(j, shift_j)
                    measure_again(solver, ball, i, j, c)
            since = 0.0


@ti.func
def measure_again(solver: ti.template(), ball: ti.template(), i, j, c):
    """Measure contact c anew if impacts may have shifted either ball."""
    if solver.impacts[i] + solver.impacts[j] > 0:
        reach = solver.model.radius[i] + solver.model.radius[j]
        n, d = unit(ball[j].x - ball[i].x, i, j)
        solver.pairs.contact[c].normal = n
        solver.pairs.contact[c].depth = reach - d
        if ti.static(solver.model.spins):
            solver.pairs.contact[c].arm = d / reach


@ti.func
def impulse(solver: ti.template(), i, j, n, arm, u, forced, time):
    """Impulse [N s] on ball i by its impact on ball j along n, with friction; arm: distance of their centres, in parts of that at
    touch; u: relative velocity, of which `forced` along -n [m/s], see approach_from_forces."""
    law = law_of(solver.pairs, i, j, n)
    mass = 1.0 / (solver.model.inverse_mass[i] + solver.model.inverse_mass[j])
    slip, tangential_mass = u, mass
    if ti.static(solver.model.spins):
        slip -= arm * lever(solver.state.spin[i] + solver.state.spin[j], n)
        tangential_mass *= contact_law.tangential_mass_part(solver, i, j)
    return -contact_law.impact_impulse(
        solver.model, law, n, u, forced, slip, mass, tangential_mass, solver.threshold[0], time
    )


@ti.func
def limit_block(solver: ti.template(), ball: ti.template(), b, begin, end, time, how: ti.template()):
    """Limit what the contacts of a block accumulated, where anything in it was struck."""
    if solver.block_was_struck[b] > 0:
        for k in range(begin, end):
            limit(solver, solver.pairs.grid.order[k])


@ti.func
def limit(solver: ti.template(), i):
    """Limit what the contacts of ball i accumulated in an impact to what may be a load: the next solve starts with it."""
    begin = solver.pairs.first[i]
    for c in range(begin, begin + solver.pairs.touching[i]):
        j = solver.pairs.link[c].other
        most = largest_load(solver, solver.pairs.contact[c].starting_impulse, i, j)
        keep_at_most(solver.pairs.link, c, most)
    if ti.static(solver.plan.walls_in_turn):
        wall_impacts.limit(solver.walls, solver, i)


@ti.func
def load_of(solver: ti.template(), i, j, c, accumulated):
    """Part that may be a load [N s] of what contact c of balls i and j accumulated."""
    return ti.min(accumulated, largest_load(solver, solver.pairs.contact[c].starting_impulse, i, j))


@ti.func
def mark_arrivals_at_walls(solver: ti.template()):
    """Mark the blocks of balls that arrive fast at a wall among others."""
    for b in range(solver.pairs.blocks[0]):
        begin = b * solver.pairs.block_length[0]
        for k in range(begin, ti.min(begin + solver.pairs.block_length[0], solver.n)):
            if solver.walls.crowded[solver.pairs.grid.order[k]] == BALL_ARRIVING:
                solver.block_is_active[b] = 1
                solver.block_was_struck[b] = 1
                solver.disturbed[solver.pairs.grid.order[k]] = 0
