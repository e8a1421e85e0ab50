"""One Newton round of an implicit step on springs, with conjugate gradients that never form a matrix.

Unknown are the velocities v at the end of a stage of s seconds, where x = p + s v and v = q + s w F(x, v). Its residual, an
impulse, is r = m (q - v) + s F; its matrix A = M + s C + s^2 K has for each spring the block

    s c n n^T + s^2 k (n n^T + max(0, 1 - l / d) (I - n n^T)) = g g^T + b I,

without the negative part of the geometric stiffness of compressed springs, so that A is positive definite at any step. Scalar
products are summed in double precision, where the device has it, and in parts of a fixed length: the same bits for any number
of threads.
"""

import taichi as ti

from .direction import unit

PART = 1024  # balls whose terms of a scalar product one thread sums

# Numbers that steer the loops, in double precision.
RESIDUAL, FORCE, SCALE, POTENTIAL, BEFORE, LEFT, MOVED, GAIN, RZ, TARGET, STEP, RESTART, ROUNDS, TURNS, TRIES = range(
    15
)
PASSES, WORST, MISSES, SOLVED, NOISE, EARLIER, SIZE = range(15, 22)


@ti.func
def linearise(a, b, i, j, spring, s, damped: ti.template()):
    """Impulse s F on ball i, g and b of the spring's block, and its potential; a, b: places, velocities of balls i and j."""
    n, d = unit(b.x - a.x, i, j)
    u = (b.v - a.v).dot(n)
    k = s * spring.stiffness
    pull = k * (d - spring.rest_length)
    rate = s * k
    across = 0.0 * k
    potential = 0.5 * spring.stiffness * (d - spring.rest_length) ** 2
    if d > spring.rest_length:
        across = rate * (1.0 - spring.rest_length / d)
    if ti.static(damped):
        pull += s * spring.damping * u
        potential += 0.5 * s * spring.damping * u * u
        rate += s * spring.damping
    return pull * n, ti.sqrt(rate - across) * n, across, potential
