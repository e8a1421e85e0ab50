"""Springs in blocks, see kernels.springs.law, on copies of positions and velocities padded so that they fill vector registers.

A vector of three numbers is loaded, subtracted and stored one by one, one of four at once: for scenes that fit into a
processor's cache, where arithmetic and not memory is the limit, that takes a third to half of the time.
"""

from taichi_sim.kernels.reductions import even_then_odd
from taichi_sim.kernels.springs.law import factors, law, store

from taichi_sim.device.engine import ti

COINCIDENT = 1e-30  # m^2; ends that are nearer to each other than that are left to law.law


def width(dim: int) -> int:
    """Numbers in a padded vector."""
    return 2 if dim == 2 else 4


@ti.func
def pad(v, dim: ti.template()):
    """A vector with zeros behind it."""
    padded = ti.Vector.zero(float, ti.static(width(dim)))
    for a in ti.static(range(dim)):
        padded[a] = v[a]
    return padded


@ti.func
def cut(padded, dim: ti.template()):
    """The vector without them."""
    v = ti.Vector.zero(float, dim)
    for a in ti.static(range(dim)):
        v[a] = padded[a]
    return v


@ti.func
def dot(a, b, dim: ti.template()):
    """Scalar product of two padded vectors."""
    total = a[0] * b[0]
    for k in ti.static(range(1, dim)):
        total += a[k] * b[k]
    return total


@ti.func
def sum_block(b, ball: ti.template(), springs: ti.template(), h, tau, what: ti.template()):
    """The springs whose lower ball lies in block b, each once."""
    dim = ti.static(springs.dim)
    for i in range(b * springs.block, ti.min((b + 1) * springs.block, springs.n)):
        x, v = springs.phase[i].x, springs.phase[i].v
        f = ti.Vector.zero(float, ti.static(width(dim)))
        g = ti.Vector.zero(float, ti.static(width(dim)))
        for e in range(springs.start[i], springs.start[i + 1]):
            spring = springs.spring[e]
            j = spring.other
            r = springs.phase[j].x - x
            square = dot(r, r, dim)
            inverse = ti.rsqrt(ti.max(square, COINCIDENT))
            closing = ti.cast(0.0, float)
            if ti.static(what.damped):
                closing = dot(springs.phase[j].v - v, r, dim)
            along, drag = factors(spring, 1.0 - spring.rest_length * inverse, inverse, closing, h, tau, what)
            if ti.static(not what.apart):
                along += drag
            df = along * r
            dg = drag * r
            if square < COINCIDENT:
                one, other = law(ball[i], ball[j], i, j, spring, h, tau, what)
                df = pad(one if ti.static(what.apart) else one + other, dim)
                dg = pad(other, dim)
            f += df
            springs.sum[j] = springs.sum[j] - df  # a bare -= would be atomic
            if ti.static(what.apart):
                g += dg
                springs.damping_sum[j] = springs.damping_sum[j] - dg
        springs.sum[i] = springs.sum[i] + f
        if ti.static(what.apart):
            springs.damping_sum[i] = springs.damping_sum[i] + g


@ti.func
def blocks(ball: ti.template(), springs: ti.template(), impulse: ti.template(), damping_impulse: ti.template(), h, tau,
           what: ti.template()):  # fmt: skip
    """Sum impulses in blocks as law.blocks does, with padded vectors."""
    dim = ti.static(springs.dim)
    for i in range(springs.n):
        springs.phase[i].x = pad(ball[i].x, dim)
        if ti.static(what.damped):
            springs.phase[i].v = pad(ball[i].v, dim)
        springs.sum[i] = ti.Vector.zero(float, ti.static(width(dim)))
        if ti.static(what.apart):
            springs.damping_sum[i] = ti.Vector.zero(float, ti.static(width(dim)))
    even_then_odd(springs.blocks, sum_block, (ball, springs, h, tau, what))
    for i in range(springs.n):
        f, g = cut(springs.sum[i], dim), ti.Vector.zero(float, dim)
        if ti.static(what.apart):
            g = cut(springs.damping_sum[i], dim)
        store(impulse, damping_impulse, i, f, g, what)
