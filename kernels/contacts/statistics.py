"""A look at all contacts: how many, how deep, and which approach speeds the solver left. No part of a step."""

from taichi_sim.device.engine import ti

# members of the statistics of a set of contacts: sums of the number, depths [m], parts of a radius, squares of approach speeds
# [m^2/s^2]; largest values of depth, part, approach speed, approach speed [m/s] of what presses already; and the ball of the
# largest part
NUMBER, DEPTH, PART, SQUARE, DEEPEST, LARGEST_PART, FASTEST, UNSOLVED, BALL = range(9)
SIZE, SUMS = 9, 4


@ti.func
def nothing():
    """Statistics of no contact."""
    return ti.Vector([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


@ti.func
def one(depth, radius, u, presses, ball):
    """Statistics of one contact: overlap [m], radius of the smaller ball [m], normal speed [m/s], negative on approach; whether
    it presses since the last solve, so that it should approach no more; a ball of it."""
    left = ti.max(0.0, -u)
    unsolved = ti.select(presses, left, 0.0)
    return ti.Vector(
        [1.0, depth, depth / radius, left * left, depth, depth / radius, left, unsolved, ti.cast(ball, float)]
    )


@ti.func
def is_old(depth, u, rate):
    """True if two things with the normal speed u touched before the move of the last step already, of 1 / rate seconds: their
    overlap [m] is more than that move can have made of it. Twice as much, since forces change the speed once more."""
    return depth * rate > -2.0 * u


@ti.func
def join(a, b):
    """Statistics of two sets of contacts together."""
    total = a
    for k in ti.static(range(BALL)):
        total[k] = a[k] + b[k] if ti.static(k < SUMS) else ti.max(a[k], b[k])
    if b[LARGEST_PART] > a[LARGEST_PART]:
        total[BALL] = b[BALL]
    return total
