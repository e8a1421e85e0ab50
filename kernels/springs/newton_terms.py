"""One iteration of Newton's method for an implicit step on springs, with conjugate gradients that never form a matrix.

Unknown are the velocities v at the end of a stage of s seconds, where x = p + s v and v = q + s w F(x, v). Its residual, an
impulse, is r = m (q - v) + s F; its matrix A = M + s C + s^2 K has for each spring the block

    (s c + s^2 k) n n^T + s^2 max(0, T / d) (I - n n^T) = along r r^T + across I

with the tension T, that of damping included, without what is negative, so that A is positive definite at any step. Scalar
products are summed in double precision, where the device has it, and in parts of a fixed length: the same bits for any number
of threads.
"""

from taichi_sim.kernels.springs import padded_blocks
from taichi_sim.kernels.springs.law import energy, tension
from taichi_sim.kernels.vectors import unit

from taichi_sim.device.engine import ti


@ti.func
def linearise(a, b, i, j, spring, s, dim: ti.template(), damped: ti.template()):
    """Impulse s F on ball i, and r, along, across of the block along r r^T + across I of a spring; a, b: padded places p at the
    start of the stage and velocities of balls i and j, as f and r are. The difference of p + s v is not taken of sums: their
    rounding grows with the distance from the origin."""
    u = b.v - a.v
    r = (b.x - a.x) + s * u
    square = padded_blocks.dot(r, r, dim)
    inverse = ti.rsqrt(ti.max(square, padded_blocks.COINCIDENT))
    d = square * inverse
    if square < padded_blocks.COINCIDENT:
        n, _ = unit(padded_blocks.cut(r, dim), i, j)
        r = padded_blocks.pad(n, dim)
        inverse = 1.0
    pull = tension(spring, s, d, inverse, padded_blocks.dot(u, r, dim), damped)
    rate = s * (s * spring.stiffness)
    across = ti.max(0.0 * rate, s * inverse * pull)
    if ti.static(damped):
        rate += s * spring.damping
    return inverse * pull * r, r, (rate - across) * inverse * inverse, across


@ti.func
def potential(r, u, before, spring, s, damped: ti.template()):
    """Part of a spring in the potential of a stage, its ends r [m] apart with the relative velocity u [m/s]. Damping acts along
    `before` [m], their way before a change: it has a potential only along a direction that stays."""
    phi = energy(spring.stiffness, r.norm() - spring.rest_length)
    if ti.static(damped):
        rate = u.dot(before) / ti.max(before.norm(), ti.sqrt(padded_blocks.COINCIDENT))
        phi += 0.5 * s * spring.damping * rate * rate
    return phi
