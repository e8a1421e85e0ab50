"""Impacts among balls that change velocities in turn (Gauss-Seidel): each by itself, before what rests is held.

Newton's law between two bodies, u' = -e u, is exact for one pair; asked of many contacts at once it is not, and adds energy
where an iteration has not converged. So pairs that close fast bounce one after another, as many times as it takes until none
does: each bounce keeps momentum and never adds energy, and at e = 1 without friction all of it stays. What then still closes is
slow, or does not bounce, and is stopped by the iterations (target speed 0), whose impulses only take energy. Walls take their
turn with the pairs of the balls that touch others.

Speed that forces gave a pair since contacts were last looked for is a load and no impact: it is held, not thrown back.

Blocks (see pair_sweeps) in which nothing closes fast, nor in those beside them, are passed over, and in the others the balls
none of whose contacts may have changed: `stirred` is 0 where one closes fast at first, then the round that follows the last
impact on the ball, or on one that it lists; else CALM.
"""

import math

from taichi_sim.kernels.contacts import contact_law, wall_impacts
from taichi_sim.kernels.contacts.kinds import FAST
from taichi_sim.kernels.contacts.pair_sweeps import torque, zero_spin
from taichi_sim.kernels.contacts.pairs import GRAIN, law_of
from taichi_sim.kernels.vectors import lever

from taichi_sim.device.engine import ti

PARALLEL_ROUNDS = 2  # rounds on all threads; what goes on bouncing is little, and one thread does it
IMPACT_ROUNDS = 24  # of impacts in one step; what closes fast after them is stopped, or at e = 1 left to the next step
CALM = -1
NO_ROW = -1
SPENT_PART = 0.02  # of an approach speed: a contact has lost the rest after so many bounces that e^k is less
STILL = 0.01  # of the threshold: what moves less rests
ALERT = 0.5  # of the threshold: what closes faster may be fast once forces have acted


@ti.func
def kick(solver: ti.template(), i, j, n):
    """Approach speed that forces gave balls i and j along n since contacts were last looked for, negative where they pull them
    apart."""
    u = 0.0 * n[0]
    if ti.static(solver.loaded):
        u = -(solver.kicked[j] - solver.kicked[i]).dot(n)
    return u


@ti.func
def is_lossless(solver: ti.template(), i, j):
    """Whether all speed comes back: such a pair, once it has bounced, parts by itself; to be pushed as well would be a gain."""
    lossless = False
    if ti.static(solver.model.has_restitution):
        lossless = law_of(solver.pairs, i, j).restitution >= 1.0
    return lossless


@ti.func
def note_kicks(solver: ti.template(), ball: ti.template()):
    """What forces changed since contacts were last looked for."""
    if ti.static(solver.loaded):
        for i in range(solver.n):
            solver.kicked[i] = ball[i].v - solver.still[i]


@ti.func
def all_rounds(solver: ti.template(), ball: ti.template(), time):
    """Impacts until nothing closes fast that bounces."""
    if ti.static(not solver.serial):
        for now in ti.static(range(PARALLEL_ROUNDS)):
            for parity in ti.static(range(2)):
                for g in range((solver.pairs.blocks[0] + 1 - parity) // 2 * GRAIN):
                    if g % GRAIN == 0:
                        one_block(solver, ball, g // GRAIN * 2 + parity, now, time)
    ti.loop_config(serialize=True)
    for _ in range(1):
        first = ti.static(0 if solver.serial else PARALLEL_ROUNDS)
        going, now = True, first
        while going and now < IMPACT_ROUNDS:
            going = False
            for parity in range(2):
                for g in range((solver.pairs.blocks[0] + 1 - parity) // 2):
                    if one_block(solver, ball, 2 * g + parity, now, time) > 0:
                        going = True
            now += 1


@ti.func
def is_near(solver: ti.template(), flags: ti.template(), first, b):
    """Whether block b or one beside it is marked in `flags`, which hold the first block at `first`."""
    near = flags[first + b] > 0
    if b > 0:
        near = near or flags[first + b - 1] > 0
    if b + 1 < solver.pairs.blocks[0]:
        near = near or flags[first + b + 1] > 0
    return near


@ti.func
def one_block(solver: ti.template(), ball: ti.template(), b, now, time):
    """Round `now` of the balls of block b, if it or one beside it is marked; notes whether anything bounced. Viscous friction
    acts in the first, for `time` seconds."""
    from_, to = now % 2 * solver.most_blocks, (now + 1) % 2 * solver.most_blocks
    bounced = 0
    if is_near(solver, solver.mark, from_, b):
        begin = b * solver.pairs.length[0]
        for k in range(begin, ti.min(begin + solver.pairs.length[0], solver.n)):
            i = solver.pairs.grid.order[k]
            if solver.stirred[i] >= now:
                bounced |= one_ball(solver, ball, i, now, ti.select(now == 0, time, 0.0))
    solver.mark[to + b] = bounced
    if bounced > 0:
        solver.struck[b] = 1
    return bounced


@ti.func
def stir(solver: ti.template(), i, now):
    """From round `now` on, look at all contacts of ball i again: its velocity has changed."""
    if solver.model.inverse_mass[i] > 0.0:
        solver.stirred[i] = now
        c = solver.pairs.latest[i]
        while c != NO_ROW:
            solver.stirred[solver.pairs.row[c].lister] = now
            c = solver.pairs.row[c].next


@ti.func
def bounces_on(solver: ti.template(), i, j, restitution):
    """Whether so few impacts of ball i or j in this step are past that restitution leaves speed for another."""
    on = True
    if ti.static(not solver.accelerates):
        number = ti.max(solver.rebounds[i], solver.rebounds[j])
        on = number * ti.log(restitution) > ti.static(math.log(SPENT_PART))
    return on


@ti.func
def one_ball(solver: ti.template(), ball: ti.template(), i, now, time):
    """Impacts of ball i with the balls that it lists, then with walls; whether there were any."""
    bounced = 0
    begin = solver.pairs.first[i]
    w = solver.model.inverse_mass[i]
    for c in range(begin, begin + solver.pairs.touching[i]):
        if solver.pairs.row[c].depth > 0.0:
            j = solver.pairs.link[c].other
            n = solver.pairs.row[c].normal
            u = ball[j].v - ball[i].v
            pressed = kick(solver, i, j, n)
            closing = -(u.dot(n) + ti.max(0.0, pressed))
            if closing > solver.threshold[0]:
                law = law_of(solver.pairs, i, j)
                if law.restitution > 0.0 and bounces_on(solver, i, j, law.restitution):
                    bounced = 1
                    solver.rebounds[i] = solver.rebounds[i] + 1
                    solver.rebounds[j] = solver.rebounds[j] + 1
                    other = solver.model.inverse_mass[j]
                    mass = 1.0 / (w + other)
                    total = contact_law.rebound(law.restitution, u.dot(n), pressed) / (w + other)
                    p = -total * n
                    if ti.static(solver.model.has_friction):
                        slip, sideways = u, mass
                        if ti.static(solver.spins):
                            slip -= solver.pairs.row[c].arm * lever(solver.state.spin[i] + solver.state.spin[j], n)
                            sideways *= contact_law.sideways(solver, i, j)
                        change, _ = contact_law.friction_impulse(
                            solver.model, law, n, u, slip, mass, sideways, 0.0 * p, total, solver.threshold[0], time
                        )
                        p -= change
                    t = zero_spin(solver)
                    if ti.static(solver.spins):
                        t = torque(solver, c, p)
                    solver.apply(i, p, t)
                    solver.apply(j, -p, t)
                    stir(solver, i, now + 1)
                    stir(solver, j, now + 1)
    if ti.static(solver.among):
        if wall_impacts.bounce(solver.walls, ball, solver, i, time) > 0:
            bounced = 1
            stir(solver, i, now + 1)
    return bounced


@ti.func
def limit_block(solver: ti.template(), ball: ti.template(), b, begin, end, time, how: ti.template()):
    """Limit what the contacts of a block accumulated, where anything in it was struck."""
    if solver.struck[b] > 0:
        for k in range(begin, end):
            limit(solver, solver.pairs.grid.order[k])


@ti.func
def limit(solver: ti.template(), i):
    """Of what the contacts of ball i accumulated in an impact, what may be a load: the next solve starts with it."""
    begin = solver.pairs.first[i]
    for c in range(begin, begin + solver.pairs.touching[i]):
        j = solver.pairs.link[c].other
        accumulated = solver.pairs.link[c].impulse
        most = wall_impacts.bound(solver, solver.pairs.row[c].start, i, j)
        if accumulated > most:
            solver.pairs.link[c].impulse = most
            if ti.static(solver.model.has_friction):
                solver.pairs.link[c].slide = most / accumulated * solver.pairs.link[c].slide
    if ti.static(solver.among):
        wall_impacts.limit(solver.walls, solver, i)


@ti.func
def alert(solver: ti.template()):
    """Mark the blocks of balls that arrive fast at a wall among others."""
    for b in range(solver.pairs.blocks[0]):
        begin = b * solver.pairs.length[0]
        for k in range(begin, ti.min(begin + solver.pairs.length[0], solver.n)):
            if solver.walls.crowded[solver.pairs.grid.order[k]] == FAST:
                solver.mark[b] = 1
                solver.struck[b] = 1
                solver.stirred[solver.pairs.grid.order[k]] = 0
