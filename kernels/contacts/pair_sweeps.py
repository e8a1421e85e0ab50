"""The order in which pairs are taken: each once, the same for any number of threads.

The balls, in the order of the sorted grid, are cut into blocks longer than any pair reaches. A block writes to itself and the
next one only, so even blocks can run at the same time, then odd ones: the bits are the same for any number of threads, and for
one that does all in turn, also where each pair changes velocities at once (Gauss-Seidel). Where both balls of a pair list it,
each writes to itself alone, and any order will do.
"""

from taichi_sim.kernels.contacts.pair_lists import pair_entry
from taichi_sim.kernels.reductions import even_then_odd
from taichi_sim.kernels.vectors import cross

from taichi_sim.device.engine import ti


@ti.func
def each_block(solver: ti.template(), ball: ti.template(), visit: ti.template(), time, how: ti.template()):
    """visit(solver, ball, b, begin, end, time, how) for each block b, which has the places from begin to end in the grid's order;
    where impulses are added by atomics, in any order, for each ball. how: what visit does, fixed when it is compiled."""
    if ti.static(solver.plan.atomic):
        for k in range(solver.n):
            visit(solver, ball, k, k, k + 1, time, how)
    elif ti.static(solver.plan.serial):
        for parity in range(2):
            for g in range((solver.pairs.blocks[0] + 1 - parity) // 2):
                one_block(2 * g + parity, solver, ball, visit, time, how)
    else:
        even_then_odd(solver.pairs.blocks[0], one_block, (solver, ball, visit, time, how))


@ti.func
def one_block(b, solver: ti.template(), ball: ti.template(), visit: ti.template(), time, how: ti.template()):
    """Visit block b."""
    begin = b * solver.pairs.block_length[0]
    visit(solver, ball, b, begin, ti.min(begin + solver.pairs.block_length[0], solver.n), time, how)


@ti.func
def each_ball(
    solver: ti.template(), ball: ti.template(), visit: ti.template(), then: ti.template(), time, how: ti.template()
):
    """visit(solver, ball, i, time, how) for each ball i, block by block; then, unless it is None, then(ball, i, time, how)
    for each ball."""
    each_block(solver, ball, balls_of_block, time, (visit, how))
    if ti.static(then):
        each_end(solver, ball, then, time, how)


@ti.func
def each_end(solver: ti.template(), ball: ti.template(), then: ti.template(), time, how: ti.template()):
    """then(ball, i, time, how) for each ball i, in a loop of its own."""
    for i in range(solver.n):
        then(ball, i, time, how)


@ti.func
def balls_of_block(solver: ti.template(), ball: ti.template(), b, begin, end, time, task: ti.template()):
    """The balls of block b."""
    for k in range(begin, end):
        task[0](solver, ball, solver.pairs.grid.order[k], time, task[1])


@ti.func
def own_pairs(solver: ti.template(), ball: ti.template(), i, time, task: ti.template()):
    """visit(ball, i, j, c, *arguments) for each pair c of ball i that touches or nearly does: i solves it, j is the other ball.
    task: visit and arguments."""
    for t in range(solver.pairs.touching[i]):
        c = pair_entry(solver.pairs, solver.pairs.first[i], t)
        task[0](ball, i, solver.pairs.link[c].other, c, *task[1])


@ti.func
def add(solver: ti.template(), table: ti.template(), i, change):
    """table[i] += change; atomic only where balls are not taken in a fixed order."""
    if ti.static(solver.plan.atomic):
        table[i] += change
    else:
        table[i] = table[i] + change


@ti.func
def add_to_other(solver: ti.template(), table: ti.template(), j, change):
    """table[j] += change for the ball that does not list the pair. Where impulses are gathered, that ball sums them itself."""
    if ti.static(not solver.plan.gathers):
        add(solver, table, j, change)


@ti.func
def torque(solver: ti.template(), c, p):
    """Angular impulse on either ball of pair c, in units of its radius, by impulse p on the first."""
    return solver.pairs.contact[c].arm * cross(solver.pairs.contact[c].normal, p)
