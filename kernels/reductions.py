"""Work in parts of a fixed size, in an order that does not depend on threads, so that sums have the same bits for any number of
them; and what is summed of balls so, in double precision."""

from taichi_sim.device.engine import ti

GRAIN = 32  # Taichi hands loop indices to CPU threads in runs of at least this many: one run holds one part
PART = 1024  # balls whose terms one thread sums; parts are added in order
BAD, SPEED, KINETIC, ELASTIC, GRAVITY, WEIGHT, SIZE = range(7)  # members of a row


@ti.func
def each_part(count: ti.template(), visit: ti.template(), arguments: ti.template()):
    """visit(part, *arguments) for each part below `count`, on any thread."""
    for k in range(count * GRAIN):
        if k % GRAIN == 0:
            visit(k // GRAIN, *arguments)


@ti.func
def even_then_odd(count: ti.template(), visit: ti.template(), arguments: ti.template()):
    """The same for parts of which one writes to itself and the next: those with even numbers, then the others. At the top level
    of a kernel only an unrolled loop leaves the inner ones parallel."""
    for parity in ti.static(range(2)):
        for k in range((count + 1 - parity) // 2 * GRAIN):
            if k % GRAIN == 0:
                visit(k // GRAIN * 2 + parity, *arguments)


@ti.func
def good(ball, far):
    """Whether x and v are numbers below `far`. One by one: a comparison with nan is false, and a maximum may drop it."""
    fine = True
    for a in ti.static(range(ball.x.n)):
        fine = fine and ti.abs(ball.x[a]) < far and ti.abs(ball.v[a]) < far
    return fine
