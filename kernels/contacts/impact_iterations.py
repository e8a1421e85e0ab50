"""Further iterations where an impact came to rest among others, until what they change is slow.

Two iterations hold what rests, for they start from the impulses of the step before. An impact has no such start: what two of
them leave of it goes on approaching, and comes back as overlap. So blocks in which something closed fast (pair_impacts) have
iterations of their own.

A light ball between heavy ones converges as slowly as the ratio of masses: each iteration of the two contacts takes the same part
of what is left. What iterations lessen is the kinetic energy less the work of the target speeds. Along the change that one made
that is a parabola, so each island of balls that touch goes on along it to the least, as far as no contact would pull: an exact
line search.

There these iterations are rigid and push nothing out: a soft contact gives way to what it carries, which should be a load; to an
impact of heavy balls it would give way by their speed.
"""

from taichi_sim.kernels.contacts import pair_impacts, pair_solve, wall_impacts
from taichi_sim.kernels.contacts.pairs import GRAIN

from taichi_sim.device.engine import ti

UNEQUAL_ITERATIONS = 64  # at most, in one step, where masses differ much
LIKE_ITERATIONS = (
    8  # elsewhere: each lets go of a part of what soft contacts hold; with more a heap in a drum overlaps deeper
)
PARALLEL_ITERATIONS = 6  # of these on all threads; what goes on changing is little, and one thread does it
FURTHEST_EXTENSION = 1e6  # times the change of an iteration
SMALLEST_CHANGE = 1e-30  # J: below it nothing has changed


@ti.func
def settle(solver: ti.template(), ball: ti.template()):
    """Iterations over the blocks that were struck and those beside them."""
    if ti.static(solver.accelerates):
        settle_islands(solver, ball)
    else:
        settle_blocks(solver, ball)


@ti.func
def settle_blocks(solver: ti.template(), ball: ti.template()):
    """Iterations, each over the contacts of the balls that the one before still changed fast."""
    for b in range(solver.pairs.blocks[0]):
        solver.mark[b] = solver.struck[b]
    if ti.static(not solver.serial):
        for now in ti.static(range(PARALLEL_ITERATIONS)):
            for parity in ti.static(range(2)):
                for g in range((solver.pairs.blocks[0] + 1 - parity) // 2 * GRAIN):
                    if g % GRAIN == 0:
                        iterate_block(solver, ball, g // GRAIN * 2 + parity, now)
    ti.loop_config(serialize=True)
    for _ in range(1):
        going, now = True, ti.static(0 if solver.serial else PARALLEL_ITERATIONS)
        while going and now < LIKE_ITERATIONS:
            going = False
            for parity in range(2):
                for g in range((solver.pairs.blocks[0] + 1 - parity) // 2):
                    if iterate_block(solver, ball, 2 * g + parity, now) > 0:
                        going = True
            now += 1


@ti.func
def iterate_block(solver: ti.template(), ball: ti.template(), b, now):
    """Iteration `now` of the contacts of block b, if it or one beside it is marked; notes whether it changed anything fast."""
    from_, to = now % 2 * solver.most_blocks, (now + 1) % 2 * solver.most_blocks
    first = ti.select(now == 0, 0, pair_impacts.IMPACT_ROUNDS + now)  # so that rounds and iterations count on
    busy = 0
    if pair_impacts.is_near(solver, solver.mark, from_, b):
        begin = b * solver.pairs.length[0]
        for k in range(begin, ti.min(begin + solver.pairs.length[0], solver.n)):
            i = solver.pairs.grid.order[k]
            if solver.stirred[i] >= first:
                for c in range(solver.pairs.first[i], solver.pairs.first[i] + solver.pairs.touching[i]):
                    if pair_solve.solve_in_turn(solver, ball, i, c, c + 1, 0.0, pair_solve.NEXT) > solver.threshold[0]:
                        busy = 1
                        pair_impacts.stir(solver, i, pair_impacts.IMPACT_ROUNDS + now + 1)
                        pair_impacts.stir(solver, solver.pairs.link[c].other, pair_impacts.IMPACT_ROUNDS + now + 1)
                if ti.static(solver.has_walls):
                    p, t = solver.walls.gather(ball, solver, i, 0.0)
                    solver.apply(i, p, t)
                    if solver.model.inverse_mass[i] * p.norm() > solver.threshold[0]:
                        busy = 1
                        pair_impacts.stir(solver, i, pair_impacts.IMPACT_ROUNDS + now + 1)
    solver.mark[to + b] = busy
    if busy > 0:
        solver.struck[b] = 1
    return busy


@ti.func
def settle_islands(solver: ti.template(), ball: ti.template()):
    """Many iterations, each followed by a line search of every island, on one thread."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        going = False
        for b in range(solver.pairs.blocks[0]):
            if solver.struck[b] > 0:
                going = True
        if going:
            find_islands(solver)
            done = 0
            while going and done < UNEQUAL_ITERATIONS:
                change = iterate_islands(solver, ball)
                extend(solver, ball)
                going = change > solver.threshold[0]
                done += 1


@ti.func
def is_near(solver: ti.template(), b):
    """Whether block b or one beside it was struck."""
    return pair_impacts.is_near(solver, solver.struck, 0, b)


@ti.func
def end_of(solver: ti.template(), b):
    """Behind the last place of block b in the order of iterations; its first where the block is passed over."""
    begin = b * solver.pairs.length[0]
    return ti.select(is_near(solver, b), ti.min(begin + solver.pairs.length[0], solver.n), begin)


@ti.func
def iterate_islands(solver: ti.template(), ball: ti.template()):
    """All contacts of the islands that were struck, in turn; the largest change of a relative velocity [m/s]."""
    most = ti.cast(0.0, float)
    for b in range(solver.pairs.blocks[0]):
        for k in range(b * solver.pairs.length[0], end_of(solver, b)):
            i = solver.pairs.grid.order[k]
            if is_struck(solver, i):
                begin = solver.pairs.first[i]
                end = begin + solver.pairs.touching[i]
                for c in range(begin, end):
                    solver.pairs.row[c].noted = solver.pairs.link[c].impulse
                most = ti.max(
                    most, pair_solve.solve_in_turn(solver, ball, i, begin, end, 0.0, pair_solve.AFTER_IMPACTS)
                )
                if ti.static(solver.has_walls):
                    if ti.static(solver.among):
                        wall_impacts.note(solver.walls, i)
                    p, t = solver.walls.gather(ball, solver, i, 0.0)
                    solver.apply(i, p, t)
                    most = ti.max(most, solver.model.inverse_mass[i] * p.norm())
    return most


@ti.func
def is_struck(solver: ti.template(), i):
    """Whether ball i is pinned, or of an island in which something closed fast."""
    return solver.awake[root_of(solver, i)] > 0 or solver.model.inverse_mass[i] == 0.0


@ti.func
def root_of(solver: ti.template(), i):
    """The ball that stands for the island of ball i."""
    r = i
    while solver.island[r] != r:
        solver.island[r] = solver.island[solver.island[r]]
        r = solver.island[r]
    return r


@ti.func
def reach_of(solver: ti.template(), b):
    """The same of block b where a block that is not passed over lists any of its balls."""
    begin = b * solver.pairs.length[0]
    listed = is_near(solver, b)
    if b > 0:
        listed = listed or is_near(solver, b - 1)
    return ti.select(listed, ti.min(begin + solver.pairs.length[0], solver.n), begin)


@ti.func
def find_islands(solver: ti.template()):
    """Balls of the struck blocks that touch, directly or through loose others, get the same root."""
    for b in range(solver.pairs.blocks[0]):
        for k in range(b * solver.pairs.length[0], reach_of(solver, b)):
            i = solver.pairs.grid.order[k]
            solver.island[i] = i
            solver.awake[i] = 0
    for b in range(solver.pairs.blocks[0]):
        for k in range(b * solver.pairs.length[0], end_of(solver, b)):
            i = solver.pairs.grid.order[k]
            for c in range(solver.pairs.first[i], solver.pairs.first[i] + solver.pairs.touching[i]):
                j = solver.pairs.link[c].other
                if solver.model.inverse_mass[i] * solver.model.inverse_mass[j] > 0.0:
                    one, two = root_of(solver, i), root_of(solver, j)
                    solver.island[ti.max(one, two)] = ti.min(one, two)
    for b in range(solver.pairs.blocks[0]):
        for k in range(b * solver.pairs.length[0], end_of(solver, b)):
            i = solver.pairs.grid.order[k]
            if solver.stirred[i] != pair_impacts.CALM:
                solver.awake[root_of(solver, i)] = 1
                for c in range(solver.pairs.first[i], solver.pairs.first[i] + solver.pairs.touching[i]):
                    solver.awake[root_of(solver, solver.pairs.link[c].other)] = 1


@ti.func
def extend(solver: ti.template(), ball: ti.template()):
    """Each island goes on along the normal impulses of the last iteration, to the least of what iterations lessen."""
    blocks = solver.pairs.blocks[0]
    for b in range(blocks):
        for k in range(b * solver.pairs.length[0], reach_of(solver, b)):
            i = solver.pairs.grid.order[k]
            solver.way[i] = ti.Vector.zero(float, solver.model.dim)
            solver.slope[i], solver.bend[i], solver.far[i] = 0.0, 0.0, FURTHEST_EXTENSION
    for b in range(blocks):
        for k in range(b * solver.pairs.length[0], end_of(solver, b)):
            i = solver.pairs.grid.order[k]
            if is_struck(solver, i):
                sum_changes(solver, i)
    for b in range(blocks):
        for k in range(b * solver.pairs.length[0], reach_of(solver, b)):
            i = solver.pairs.grid.order[k]
            w = solver.model.inverse_mass[i]
            if w > 0.0:
                r = root_of(solver, i)
                solver.slope[r] = solver.slope[r] + ball[i].v.dot(solver.way[i]) / w
                solver.bend[r] = solver.bend[r] + solver.way[i].dot(solver.way[i]) / w
    for b in range(blocks):
        for k in range(b * solver.pairs.length[0], reach_of(solver, b)):
            i = solver.pairs.grid.order[k]
            solver.state.kick(i, times(solver, i) * solver.way[i])
        for k in range(b * solver.pairs.length[0], end_of(solver, b)):
            i = solver.pairs.grid.order[k]
            if is_struck(solver, i):
                go_on(solver, i)


@ti.func
def go_on(solver: ti.template(), i):
    """Add to what the contacts of ball i accumulated what its island goes on by."""
    for c in range(solver.pairs.first[i], solver.pairs.first[i] + solver.pairs.touching[i]):
        accumulated = solver.pairs.link[c].impulse
        one = ti.select(solver.model.inverse_mass[i] > 0.0, i, solver.pairs.link[c].other)
        change = times(solver, one) * (accumulated - solver.pairs.row[c].noted)
        solver.pairs.link[c].impulse = ti.max(0.0, accumulated + change)
    if ti.static(solver.among):
        wall_impacts.go_on(solver.walls, i, times(solver, i))


@ti.func
def sum_changes(solver: ti.template(), i):
    """What the last iteration changed by the normal impulses of the contacts of ball i, and how far these may go on."""
    w = solver.model.inverse_mass[i]
    for c in range(solver.pairs.first[i], solver.pairs.first[i] + solver.pairs.touching[i]):
        j = solver.pairs.link[c].other
        accumulated = solver.pairs.link[c].impulse
        change = accumulated - solver.pairs.row[c].noted
        if accumulated < -wall_impacts.SPENT * change:  # it stays out, lest it stops the whole island
            solver.pairs.row[c].noted = accumulated
            change = 0.0
        p = change * solver.pairs.row[c].normal
        solver.way[i] = solver.way[i] - w * p
        solver.way[j] = solver.way[j] + solver.model.inverse_mass[j] * p
        r = root_of(solver, ti.select(w > 0.0, i, j))
        if change < 0.0:
            solver.far[r] = ti.min(solver.far[r], accumulated / -change)
        if ti.static(solver.soft):
            solver.slope[r] = solver.slope[r] - ti.min(0.0, solver.pairs.row[c].depth * solver.rate[0]) * change
    if ti.static(solver.among):
        p, far, work = wall_impacts.changed(solver.walls, i)
        solver.way[i] = solver.way[i] + w * p
        r = root_of(solver, i)
        solver.far[r] = ti.min(solver.far[r], far)
        solver.slope[r] = solver.slope[r] - work


@ti.func
def times(solver: ti.template(), i):
    """How many times what the last iteration changed the island of ball i goes on."""
    r = root_of(solver, i)
    best = -solver.slope[r] / ti.max(solver.bend[r], SMALLEST_CHANGE)
    return ti.max(0.0, ti.min(best, solver.far[r]))
