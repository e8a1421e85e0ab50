"""Further iterations where an impact came to rest in a crowd, until what they change is slow.

Two iterations suffice for what rests, for they start from the impulses of the step before. An impact has no such start: what
two of them leave of it goes on approaching, and comes back as overlap. So blocks in which something closed fast (pair_impacts)
have iterations of their own.

A light ball between heavy ones converges as slowly as the ratio of masses: each iteration of the two contacts takes the same part
of what is left. So each island of balls that touch goes on along the change that an iteration made, see line_search, as far as no
contact would pull. An iteration takes the contacts of the balls that the one before still changed fast: where crowds flow, some
contact far away goes on changing long after most are done.

There a soft contact yields to the load that it bears alone: to an impact of heavy balls it would yield by their speed. It pushes
out what overlaps, as in all iterations: some contact of a pile at rest may close fast in each step, and rigid ones would sink.
"""

from taichi_sim.kernels.contacts import pair_impacts, pair_solve, wall_impacts
from taichi_sim.kernels.contacts.line_search import FURTHEST_EXTENSION, best_extension, last_change

from taichi_sim.device.engine import ti

UNEQUAL_ITERATIONS = 64  # at most, in one step, where masses differ much
# elsewhere: each lets go of a part of what soft contacts accumulated; with more a heap in a drum overlaps deeper
LIKE_ITERATIONS = 8
PARALLEL_ITERATIONS = 6  # of these on all threads; what goes on changing is little, and one thread does it


@ti.func
def settle(solver: ti.template(), ball: ti.template()):
    """Iterations over the blocks that were struck and those beside them."""
    if ti.static(solver.plan.line_search):
        settle_islands(solver, ball)
    else:
        settle_blocks(solver, ball)


@ti.func
def settle_blocks(solver: ti.template(), ball: ti.template()):
    """Iterations, each over the contacts of the balls that the one before still changed fast."""
    for b in range(solver.pairs.blocks[0]):
        solver.block_is_active[b] = solver.block_was_struck[b]
    rounds = ti.static(pair_impacts.IMPACT_ROUNDS)
    pair_impacts.repeat_until_calm(solver, ball, iterate_ball, rounds, PARALLEL_ITERATIONS, LIKE_ITERATIONS, 0.0)


@ti.func
def iterate_ball(solver: ti.template(), ball: ti.template(), i, now, time):
    """Iteration `now` of the contacts that ball i lists, and its walls; returns 1 if it changed anything fast."""
    busy = 0
    for t in range(solver.pairs.touching[i]):
        if pair_solve.solve_in_turn(solver, ball, i, t, t + 1, time, pair_solve.NEXT) > solver.threshold[0]:
            busy = 1
            disturb(solver, i, now)
            disturb(solver, solver.pairs.link[solver.pairs.first[i] + t].other, now)
    if ti.static(solver.plan.walls):
        p, t = solver.walls.gather(ball, solver, i, time)
        solver.apply(i, p, t)
        if solver.model.inverse_mass[i] * p.norm() > solver.threshold[0]:
            busy = 1
            disturb(solver, i, now)
    return busy


@ti.func
def disturb(solver: ti.template(), i, now):
    """The iteration after `now` looks at all contacts of ball i."""
    pair_impacts.disturb(solver, i, pair_impacts.IMPACT_ROUNDS + now + 1)


@ti.func
def settle_islands(solver: ti.template(), ball: ti.template()):
    """Many iterations over the contacts of the balls that the one before still changed fast, each followed by a line search of
    every island, on one thread."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        going = False
        for b in range(solver.pairs.blocks[0]):
            solver.block_is_active[b] = solver.block_was_struck[b]
            if solver.block_was_struck[b] > 0:
                going = True
        if going:
            find_islands(solver)
            now = 0
            while going and now < UNEQUAL_ITERATIONS:
                iterate_islands(solver, ball, now)
                extend(solver, ball, now)
                now += 1
                going = is_going(solver, now)


@ti.func
def is_going(solver: ti.template(), now):
    """True if iteration `now` has anything to do."""
    going = False
    for b in range(solver.pairs.blocks[0]):
        if solver.block_is_active[now % 2 * solver.block_limit + b] > 0:
            going = True
    return going


@ti.func
def is_near(solver: ti.template(), b):
    """True if block b or one beside it was struck."""
    return pair_impacts.is_marked_near(solver, solver.block_was_struck, 0, b)


@ti.func
def is_taken(solver: ti.template(), b, now):
    """True if iteration `now` takes block b: it or one beside it is active, and one of these was struck."""
    active = pair_impacts.is_marked_near(solver, solver.block_is_active, now % 2 * solver.block_limit, b)
    return active and is_near(solver, b)


@ti.func
def end_of(solver: ti.template(), b, taken):
    """End of block b's range of places in the order of iterations; its beginning (an empty range) if it is not `taken`."""
    begin = b * solver.pairs.block_length[0]
    return ti.select(taken, ti.min(begin + solver.pairs.block_length[0], solver.n), begin)


@ti.func
def iterate_islands(solver: ti.template(), ball: ti.template(), now):
    """Iteration `now`, in turn; notes which balls it took, what it changed, and where that was fast."""
    for b in range(solver.pairs.blocks[0]):
        busy = 0
        for k in range(b * solver.pairs.block_length[0], end_of(solver, b, is_taken(solver, b, now))):
            i = solver.pairs.grid.order[k]
            if is_struck(solver, i) and (now == 0 or solver.disturbed[i] >= pair_impacts.IMPACT_ROUNDS + now):
                solver.last_iteration[i] = now
                r = root_of(solver, i)
                begin_island(solver, r, now)
                for t in range(solver.pairs.touching[i]):
                    c = solver.pairs.first[i] + t
                    j = solver.pairs.link[c].other
                    solver.pairs.contact[c].previous_impulse = solver.pairs.link[c].impulse
                    change = pair_solve.solve_in_turn(solver, ball, i, t, t + 1, 0.0, pair_solve.AFTER_IMPACTS)
                    if solver.model.inverse_mass[i] == 0.0:
                        r = root_of(solver, j)
                        begin_island(solver, r, now)
                    add_change(solver, ball, i, j, c, r)
                    if change > solver.threshold[0]:
                        busy = 1
                        disturb(solver, i, now)
                        disturb(solver, j, now)
                if ti.static(solver.plan.walls):
                    if ti.static(solver.plan.walls_in_turn):
                        wall_impacts.note(solver.walls, i)
                    p, t = solver.walls.gather(ball, solver, i, 0.0)
                    solver.apply(i, p, t)
                    if solver.model.inverse_mass[i] * p.norm() > solver.threshold[0]:
                        busy = 1
                        disturb(solver, i, now)
                    if ti.static(solver.plan.walls_in_turn):
                        if solver.model.inverse_mass[i] > 0.0:
                            add_change_by_walls(solver, i, r)
        solver.block_is_active[(now + 1) % 2 * solver.block_limit + b] = busy


@ti.func
def begin_island(solver: ti.template(), r, now):
    """Clear the sums of the island of root r, if iteration `now` has not asked for it before."""
    if solver.island_iteration[r] != now:
        solver.island_iteration[r] = now
        solver.slope[r], solver.curvature[r], solver.longest_extension[r] = 0.0, 0.0, FURTHEST_EXTENSION


@ti.func
def is_struck(solver: ti.template(), i):
    """True if ball i is pinned, or in an island in which something closed fast."""
    return solver.island_was_struck[root_of(solver, i)] > 0 or solver.model.inverse_mass[i] == 0.0


@ti.func
def root_of(solver: ti.template(), i):
    """The ball that stands for the island of ball i."""
    r = i
    while solver.island[r] != r:
        solver.island[r] = solver.island[solver.island[r]]
        r = solver.island[r]
    return r


@ti.func
def find_islands(solver: ti.template()):
    """Give the same root to balls of the struck blocks that touch, directly or through loose others."""
    for b in range(solver.pairs.blocks[0]):
        listed = is_near(solver, b) or is_near(solver, ti.max(0, b - 1))  # blocks list balls of the next one
        for k in range(b * solver.pairs.block_length[0], end_of(solver, b, listed)):
            i = solver.pairs.grid.order[k]
            solver.island[i] = i
            solver.island_was_struck[i] = 0
            solver.last_iteration[i], solver.last_extension[i], solver.island_iteration[i] = -1, -1, -1
            solver.velocity_change[i] = ti.Vector.zero(float, solver.model.dim)
    for b in range(solver.pairs.blocks[0]):
        for k in range(b * solver.pairs.block_length[0], end_of(solver, b, is_near(solver, b))):
            i = solver.pairs.grid.order[k]
            for c in range(solver.pairs.first[i], solver.pairs.first[i] + solver.pairs.touching[i]):
                j = solver.pairs.link[c].other
                if solver.model.inverse_mass[i] * solver.model.inverse_mass[j] > 0.0:
                    one, two = root_of(solver, i), root_of(solver, j)
                    solver.island[ti.max(one, two)] = ti.min(one, two)
    for b in range(solver.pairs.blocks[0]):
        for k in range(b * solver.pairs.block_length[0], end_of(solver, b, is_near(solver, b))):
            i = solver.pairs.grid.order[k]
            if solver.disturbed[i] != pair_impacts.UNDISTURBED:
                solver.island_was_struck[root_of(solver, i)] = 1
                for c in range(solver.pairs.first[i], solver.pairs.first[i] + solver.pairs.touching[i]):
                    solver.island_was_struck[root_of(solver, solver.pairs.link[c].other)] = 1


@ti.func
def extend(solver: ti.template(), ball: ti.template(), now):
    """Each island goes on along the normal impulses of iteration `now`, to the least of what iterations lessen. What that changes
    fast is looked at again."""
    for b in range(solver.pairs.blocks[0]):
        for k in range(b * solver.pairs.block_length[0], end_of(solver, b, is_taken(solver, b, now))):
            visit_taken(solver, ball, solver.pairs.grid.order[k], now, add_to_parabola)
    for b in range(solver.pairs.blocks[0]):
        busy = 0
        for k in range(b * solver.pairs.block_length[0], end_of(solver, b, is_taken(solver, b, now))):
            i = solver.pairs.grid.order[k]
            busy |= visit_taken(solver, ball, i, now, change_again)
            if solver.last_iteration[i] == now:
                extend_contacts(solver, i)
        if busy > 0:
            solver.block_is_active[(now + 1) % 2 * solver.block_limit + b] = 1


@ti.func
def visit_taken(solver: ti.template(), ball: ti.template(), i, now, visit: ti.template()):
    """visit(solver, ball, i, now), and for the balls that i lists, those that can move, if iteration `now` took its contacts; a
    ball may be visited several times. Returns 1 if any of these is 1."""
    found = 0
    if solver.last_iteration[i] == now:
        if solver.model.inverse_mass[i] > 0.0:
            found = visit(solver, ball, i, now)
        for c in range(solver.pairs.first[i], solver.pairs.first[i] + solver.pairs.touching[i]):
            j = solver.pairs.link[c].other
            if solver.model.inverse_mass[j] > 0.0:
                found |= visit(solver, ball, j, now)
    return found


@ti.func
def add_to_parabola(solver: ti.template(), ball: ti.template(), i, now):
    """Add what the change of ball i does to the energy along the change of its island, once."""
    if solver.last_extension[i] != now:
        solver.last_extension[i] = now
        r, w = root_of(solver, i), solver.model.inverse_mass[i]
        change = solver.velocity_change[i]
        solver.slope[r] = solver.slope[r] + ball[i].v.dot(change) / w
        solver.curvature[r] = solver.curvature[r] + change.dot(change) / w
    return 0


@ti.func
def change_again(solver: ti.template(), ball: ti.template(), i, now):
    """Change ball i as often as its island goes on; once, for then nothing is left. Returns 1 if that is fast."""
    change = times(solver, i) * solver.velocity_change[i]
    solver.velocity_change[i] = ti.Vector.zero(float, solver.model.dim)
    solver.state.kick(i, change)
    fast = 0
    if change.norm() > solver.threshold[0]:
        fast = 1
        disturb(solver, i, now)
    return fast


@ti.func
def extend_contacts(solver: ti.template(), i):
    """Add to what the contacts of ball i accumulated what its island goes on by."""
    for c in range(solver.pairs.first[i], solver.pairs.first[i] + solver.pairs.touching[i]):
        accumulated = solver.pairs.link[c].impulse
        one = ti.select(solver.model.inverse_mass[i] > 0.0, i, solver.pairs.link[c].other)
        change = times(solver, one) * (accumulated - solver.pairs.contact[c].previous_impulse)
        solver.pairs.link[c].impulse = ti.max(0.0, accumulated + change)
    if ti.static(solver.plan.walls_in_turn):
        wall_impacts.extend(solver.walls, i, times(solver, i))


@ti.func
def add_change(solver: ti.template(), ball: ti.template(), i, j, c, r):
    """Add to the sums of the island of root r what an iteration changed by the normal impulse of contact c of balls i and j,
    and limit how far this may go on."""
    accumulated = solver.pairs.link[c].impulse
    change, longest = last_change(solver.pairs.contact, c, accumulated, solver.longest_extension[r])
    solver.longest_extension[r] = longest
    p = change * solver.pairs.contact[c].normal
    solver.velocity_change[i] = solver.velocity_change[i] - solver.model.inverse_mass[i] * p
    solver.velocity_change[j] = solver.velocity_change[j] + solver.model.inverse_mass[j] * p
    given = -pair_solve.present_target(solver, i, j, c, accumulated)  # m/s, that the island's own balls do not change
    if solver.model.inverse_mass[i] == 0.0:
        given -= ball[i].v.dot(solver.pairs.contact[c].normal)
    if solver.model.inverse_mass[j] == 0.0:
        given += ball[j].v.dot(solver.pairs.contact[c].normal)
    solver.slope[r] = solver.slope[r] + given * change


@ti.func
def add_change_by_walls(solver: ti.template(), i, r):
    """Add to the sums of the island of root r what an iteration changed by the walls of ball i, and limit how far this may go
    on."""
    p, longest, work = wall_impacts.changed(solver.walls, i)
    solver.velocity_change[i] = solver.velocity_change[i] + solver.model.inverse_mass[i] * p
    solver.longest_extension[r] = ti.min(solver.longest_extension[r], longest)
    solver.slope[r] = solver.slope[r] - work


@ti.func
def times(solver: ti.template(), i):
    """Number of times that the island of ball i repeats what the last iteration changed."""
    r = root_of(solver, i)
    return best_extension(solver.slope[r], solver.curvature[r], solver.longest_extension[r])
