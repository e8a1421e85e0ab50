"""Sums over balls in double precision, in parts of a fixed length: the same bits for any number of threads."""

from taichi_sim.device.engine import ti

GRAIN = 32  # Taichi hands loop indices to CPU threads in runs of at least this many: one run holds one part
PART = 1024  # balls whose terms one thread sums; parts are added in order
BAD, SPEED, KINETIC, ELASTIC, GRAVITY, WEIGHT, SIZE = range(7)  # members of a row


@ti.func
def each_on_a_thread(count: ti.template(), visit: ti.template(), arguments: ti.template(), first: ti.template() = 0,
                     stride: ti.template() = 1):  # fmt: skip
    """visit(c, *arguments) for `count` numbers c = first, first + stride, ...: each, much work as it is, on one thread."""
    for k in range(count * GRAIN):
        if k % GRAIN == 0:
            visit(k // GRAIN * stride + first, *arguments)


@ti.func
def good(ball, far):
    """Whether x and v are numbers below `far`. One by one: a comparison with nan is false, and a maximum may drop it."""
    fine = True
    for a in ti.static(range(ball.x.n)):
        fine = fine and ti.abs(ball.x[a]) < far and ti.abs(ball.v[a]) < far
    return fine
