"""One iteration of Newton's method for an implicit step on springs, with conjugate gradients that never form a matrix.

Unknown are the velocities v at the end of a stage of s seconds, where x = p + s v and v = q + s w F(x, v). Its residual, an
impulse, is r = m (q - v) + s F; its matrix A = M + s C + s^2 K has for each spring the block

    (s c + s^2 k) n n^T + s^2 max(0, T / d) (I - n n^T) = along r r^T + across I

with the tension T, that of damping included, without what is negative, so that A is positive definite at any step. Damping
is by the rate that the method has for d^2 / 2 as for a place, over d: (d^2 / 2 - e) / (s d), with e of the places that the
stage starts from. So a spring that turns is not strained. With the velocity w of the way that made p of a place, that is
(u . r + s (w . w - u . u) / 2) / d. The second part is bounded where a spring passes through its other end. Scalar
products are summed in double precision, where the device has it, and in parts of a fixed length: the same bits for any number
of threads.
"""

from taichi_sim.kernels.springs import padded_blocks
from taichi_sim.kernels.springs.law import energy, tension
from taichi_sim.kernels.vectors import unit

from taichi_sim.device.engine import ti

MOST_TURN = 0.5  # of a relative velocity: what turns by less than a sixth of a circle in a stage is not strained


@ti.func
def closing(r, u, w, s, dim: ti.template()):
    """u . r, with what the method adds to it, see above."""
    square, half = padded_blocks.dot(u, u, dim), 0.5 * s
    bound = MOST_TURN * ti.sqrt(square * padded_blocks.dot(r, r, dim))
    added = half * (padded_blocks.dot(w, w, dim) - square)
    return padded_blocks.dot(u, r, dim) + ti.max(-bound, ti.min(added, bound))


@ti.func
def linearise(a, b, i, j, spring, s, wide: ti.template(), dim: ti.template(), damped: ti.template()):
    """Impulse s F on ball i, of the type `wide`, and r, along, across of the block along r r^T + across I of a spring.

    a, b: padded places p, `wide`, at the start of the stage and velocities of balls i and j. The impulse is that of the way in
    `wide`: rounding of places comes to forces as large as those that taut springs leave of each other's. The difference of
    p + s v is not taken of sums: their rounding grows with the distance from the origin.
    """
    u = b.v - a.v
    way = (b.x - a.x) + ti.cast(s, wide) * ti.cast(u, wide)
    square = padded_blocks.dot(way, way, dim)
    root = ti.rsqrt(ti.max(square, ti.cast(padded_blocks.COINCIDENT, wide)))
    d = square * root
    if square < padded_blocks.COINCIDENT:
        n, _ = unit(padded_blocks.cut(way, dim), i, j)
        way = ti.cast(padded_blocks.pad(n, dim), wide)
        root = ti.cast(1.0, wide)
    r, inverse = ti.cast(way, float), ti.cast(root, float)
    approach = ti.cast(0.0, float)
    if ti.static(damped):
        approach = closing(r, u, b.w - a.w, s, dim)
    pull = tension(spring, s, d, inverse, approach, damped)  # wide, as d is
    rate = s * (s * spring.stiffness)
    across = ti.max(0.0 * rate, s * inverse * ti.cast(pull, float))
    if ti.static(damped):
        rate += s * spring.damping
    return root * pull * way, r, (rate - across) * inverse * inverse, across


@ti.func
def potential(r, change, before, closing_before, spring, s, damped: ti.template()):
    """Part of a spring in the potential of a stage, its ends r [m] apart, `before` [m] before a change of that. Its rate counts
    as before, closing_before over its length, and by the change of the length."""
    d = r.norm()
    phi = energy(spring.stiffness, d - spring.rest_length)
    if ti.static(damped):
        least, b = ti.sqrt(padded_blocks.COINCIDENT), before.norm()
        rate = closing_before / ti.max(b, least) + change.dot(r + before) / ti.max(s * (d + b), least)
        phi += 0.5 * s * spring.damping * rate * rate
    return phi
