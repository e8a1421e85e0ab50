"""Hooke's law with damping along the spring, and the three orders in which it can be summed.

All loops read old positions and velocities from `ball` (a struct field with x and v side by side: one cache line serves
both) and add impulses [N s]: `impulse` takes h times the elastic force, `jump` takes `tau` times the damping force
when `apart`, else `impulse` takes both. `elastic`, `damped`, `apart` are compile-time flags; what is off costs nothing.
"""

from taichi_sim.kernels.vectors import unit

from taichi_sim.device.engine import ti

GRAIN = 32  # Taichi hands loop indices to CPU threads in runs of at least this many: one run holds one block
PART = 1024  # balls whose terms one thread sums; parts are added in order: the same bits for any number of threads


@ti.func
def law(a, b, i, j, spring, h, tau, elastic: ti.template(), damped: ti.template()):
    """Elastic and damping impulse on ball i (state a) from a spring to ball j (state b).

    F = k (d - l) n along n from i to j; damping c (u . n) n with u = v_j - v_i.
    """
    r = b.x - a.x
    f = ti.Vector.zero(float, r.n)
    g = ti.Vector.zero(float, r.n)
    square = r.dot(r)
    if square > 0.0:  # F = k (1 - l / d) r: no unit vector needed
        inverse = ti.rsqrt(square)
        if ti.static(elastic):
            f = h * spring.stiffness * (1.0 - spring.rest_length * inverse) * r
        if ti.static(damped):
            g = tau * spring.damping * (b.v - a.v).dot(r) * inverse * inverse * r
    else:
        n, _ = unit(r, i, j)
        if ti.static(elastic):
            f = -h * spring.stiffness * spring.rest_length * n
        if ti.static(damped):
            g = tau * spring.damping * (b.v - a.v).dot(n) * n
    return f, g


@ti.func
def gather(ball: ti.template(), table: ti.template(), impulse: ti.template(), jump: ti.template(), h, tau,
           elastic: ti.template(), damped: ti.template(), apart: ti.template()):  # fmt: skip
    """Each ball sums its own springs in their order: no atomics, the same bits for any number of threads."""
    for i in range(table.n):
        a = ball[i]
        f = ti.Vector.zero(float, ball.x.n)
        g = ti.Vector.zero(float, ball.x.n)
        for e in range(table.start[i], table.start[i + 1]):
            spring = table.spring[e]
            df, dg = law(a, ball[spring.other], i, spring.other, spring, h, tau, elastic, damped)
            f += df
            g += dg
        store(impulse, jump, i, f, g, apart)


@ti.func
def store(impulse: ti.template(), jump: ti.template(), i, f, g, apart: ti.template()):
    """Write what `add` would add to cleared fields."""
    if ti.static(apart):
        impulse[i] = f
        jump[i] = g
    else:
        impulse[i] = f + g


@ti.func
def add(impulse: ti.template(), jump: ti.template(), i, f, g, apart: ti.template()):
    """Plain, not atomic: `field[i] += f` alone would be an atomic in Taichi."""
    if ti.static(apart):
        impulse[i] = impulse[i] + f
        jump[i] = jump[i] + g
    else:
        impulse[i] = impulse[i] + (f + g)


@ti.func
def block(b, ball: ti.template(), table: ti.template(), impulse: ti.template(), jump: ti.template(), h, tau,
          elastic: ti.template(), damped: ti.template(), apart: ti.template()):  # fmt: skip
    """The springs whose lower ball lies in block b, each once; they reach at most into block b + 1."""
    for i in range(b * table.block, ti.min((b + 1) * table.block, table.n)):
        a = ball[i]
        f = ti.Vector.zero(float, ball.x.n)
        g = ti.Vector.zero(float, ball.x.n)
        for e in range(table.start[i], table.start[i + 1]):
            spring = table.spring[e]
            df, dg = law(a, ball[spring.other], i, spring.other, spring, h, tau, elastic, damped)
            f += df
            g += dg
            add(impulse, jump, spring.other, -df, -dg, apart)
        add(impulse, jump, i, f, g, apart)


@ti.func
def blocks(ball: ti.template(), table: ti.template(), impulse: ti.template(), jump: ti.template(), h, tau,
           elastic: ti.template(), damped: ti.template(), apart: ti.template()):  # fmt: skip
    """Each spring once, without atomics: blocks are longer than any spring's index distance, so even blocks cannot meet.

    A block writes to itself and the next one only. Even blocks run first, in any order, then odd ones; the sums are the
    same for any number of threads.
    """
    for k in range((table.blocks + 1) // 2 * GRAIN):
        if k % GRAIN == 0:
            b = k // GRAIN * 2
            for i in range(b * table.block, ti.min((b + 2) * table.block, table.n)):
                store(impulse, jump, i, ti.Vector.zero(float, ball.x.n), ti.Vector.zero(float, ball.x.n), apart)
            block(b, ball, table, impulse, jump, h, tau, elastic, damped, apart)
    for k in range(table.blocks // 2 * GRAIN):
        if k % GRAIN == 0:
            block(k // GRAIN * 2 + 1, ball, table, impulse, jump, h, tau, elastic, damped, apart)


@ti.func
def scatter(ball: ti.template(), table: ti.template(), impulse: ti.template(), jump: ti.template(), h, tau,
            elastic: ti.template(), damped: ti.template(), apart: ti.template()):  # fmt: skip
    """Each spring once, with atomic adds at both ends: any order, so the last bits vary from run to run."""
    for i in range(table.n):
        store(impulse, jump, i, ti.Vector.zero(float, ball.x.n), ti.Vector.zero(float, ball.x.n), apart)
    for e in range(table.m):
        spring = table.spring[e]
        i = spring.one
        df, dg = law(ball[i], ball[spring.other], i, spring.other, spring, h, tau, elastic, damped)
        if ti.static(apart):
            impulse[i] += df
            impulse[spring.other] -= df
            jump[i] += dg
            jump[spring.other] -= dg
        else:
            impulse[i] += df + dg
            impulse[spring.other] -= df + dg
