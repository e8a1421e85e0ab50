"""Springs in blocks, see kernels.springs, on copies of positions and velocities whose rows fill vector registers.

A row of three numbers is loaded, subtracted and stored one by one, a row of four at once: for scenes that fit into a
processor's cache, where arithmetic and not memory is the limit, that takes a third to half of the time.
"""

from taichi_sim.kernels.springs.law import GRAIN, law, store

from taichi_sim.device.engine import ti

NEAR = 1e-30  # m^2; ends that are nearer to each other than that are left to the law of kernels.springs


def width(dim: int) -> int:
    """Numbers in a row."""
    return 2 if dim == 2 else 4


@ti.func
def pad(v, dim: ti.template()):
    """A vector as a row, zeros behind it."""
    row = ti.Vector.zero(float, ti.static(width(dim)))
    for a in ti.static(range(dim)):
        row[a] = v[a]
    return row


@ti.func
def cut(row, dim: ti.template()):
    """The vector of a row."""
    v = ti.Vector.zero(float, dim)
    for a in ti.static(range(dim)):
        v[a] = row[a]
    return v


@ti.func
def dot(a, b, dim: ti.template()):
    """Scalar product of two rows."""
    total = a[0] * b[0]
    for k in ti.static(range(1, dim)):
        total += a[k] * b[k]
    return total


@ti.func
def block(b, ball: ti.template(), table: ti.template(), h, tau,
          elastic: ti.template(), damped: ti.template(), apart: ti.template()):  # fmt: skip
    """The springs whose lower ball lies in block b, each once."""
    dim = ti.static(table.dim)
    for i in range(b * table.block, ti.min((b + 1) * table.block, table.n)):
        x, v = table.row[i].x, table.row[i].v
        f = ti.Vector.zero(float, ti.static(width(dim)))
        g = ti.Vector.zero(float, ti.static(width(dim)))
        for e in range(table.start[i], table.start[i + 1]):
            spring = table.spring[e]
            j = spring.other
            r = table.row[j].x - x
            square = dot(r, r, dim)
            inverse = ti.rsqrt(ti.max(square, NEAR))
            along, drag = ti.cast(0.0, float), ti.cast(0.0, float)
            if ti.static(elastic):
                along = h * spring.stiffness * (1.0 - spring.rest_length * inverse)
            if ti.static(damped):
                drag = tau * spring.damping * dot(table.row[j].v - v, r, dim) * inverse * inverse
            if ti.static(not apart):
                along += drag
            df = along * r
            dg = drag * r
            if square < NEAR:
                one, other = law(ball[i], ball[j], i, j, spring, h, tau, elastic, damped)
                df = pad(one if ti.static(apart) else one + other, dim)
                dg = pad(other, dim)
            f += df
            table.sum[j] = table.sum[j] - df  # a bare -= would be atomic
            if ti.static(apart):
                g += dg
                table.rest[j] = table.rest[j] - dg
        table.sum[i] = table.sum[i] + f
        if ti.static(apart):
            table.rest[i] = table.rest[i] + g


@ti.func
def springs(ball: ti.template(), table: ti.template(), impulse: ti.template(), jump: ti.template(), h, tau,
            elastic: ti.template(), damped: ti.template(), apart: ti.template()):  # fmt: skip
    """See kernels.springs.blocks."""
    dim = ti.static(table.dim)
    for i in range(table.n):
        table.row[i].x = pad(ball[i].x, dim)
        if ti.static(damped):
            table.row[i].v = pad(ball[i].v, dim)
        table.sum[i] = ti.Vector.zero(float, ti.static(width(dim)))
        if ti.static(apart):
            table.rest[i] = ti.Vector.zero(float, ti.static(width(dim)))
    for k in range((table.blocks + 1) // 2 * GRAIN):
        if k % GRAIN == 0:
            block(k // GRAIN * 2, ball, table, h, tau, elastic, damped, apart)
    for k in range(table.blocks // 2 * GRAIN):
        if k % GRAIN == 0:
            block(k // GRAIN * 2 + 1, ball, table, h, tau, elastic, damped, apart)
    for i in range(table.n):
        f, g = cut(table.sum[i], dim), ti.Vector.zero(float, dim)
        if ti.static(apart):
            g = cut(table.rest[i], dim)
        store(impulse, jump, i, f, g, apart)
