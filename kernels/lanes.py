"""Springs eight at a time, each once, for scenes that fit into a processor's cache.

What each spring gives is written down first, component by component, then every ball adds up its own: no spring waits for
another one, so that the compiler can work out a group of eight in the lanes of vector registers. That asks for terms without
branches, and for stores that come after all loads. The order of each sum is fixed.
"""

import taichi as ti

from .springs import law, store

WIDTH = 8
NEAR = 1e-30  # m^2; ends that are nearer to each other than that are left to a law with branches


@ti.func
def term(a, b, spring, h, tau, elastic: ti.template(), damped: ti.template()):
    """kernels.springs.law for ends apart, both impulses side by side; the square of the distance."""
    r = b.x - a.x
    square = r.dot(r)
    inverse = ti.rsqrt(ti.max(square, NEAR))
    f = ti.Vector.zero(float, r.n)
    g = ti.Vector.zero(float, r.n)
    if ti.static(elastic):
        f = h * spring.stiffness * (1.0 - spring.rest_length * inverse) * r
    if ti.static(damped):
        g = tau * spring.damping * (b.v - a.v).dot(r) * inverse * inverse * r
    return f, g, square


@ti.func
def springs(ball: ti.template(), table: ti.template(), impulse: ti.template(), jump: ti.template(), h, tau,
            elastic: ti.template(), damped: ti.template(), apart: ti.template()):  # fmt: skip
    """See kernels.springs."""
    dim = ti.static(ball.x.n)
    for group in range(table.groups):
        e = group * WIDTH
        f = ti.Matrix.zero(float, WIDTH, dim)
        g = ti.Matrix.zero(float, WIDTH, dim)
        nearest = ti.cast(1.0, float)
        for q in ti.static(range(WIDTH)):
            spring = table.spring[e + q]
            df, dg, square = term(ball[spring.one], ball[spring.other], spring, h, tau, elastic, damped)
            nearest = ti.min(nearest, square)
            for a in ti.static(range(dim)):
                f[q, a] = df[a] if ti.static(apart) else df[a] + dg[a]
                g[q, a] = dg[a]
        note(table, e, f, 0)
        if ti.static(apart):
            note(table, e, g, dim)
        if nearest < NEAR:
            for k in range(e, e + WIDTH):
                spring = table.spring[k]
                i, j = spring.one, spring.other
                df, dg = law(ball[i], ball[j], i, j, spring, h, tau, elastic, damped)
                for a in ti.static(range(dim)):
                    table.given[a * table.padded + k] = df[a] if ti.static(apart) else df[a] + dg[a]
                    if ti.static(apart):
                        table.given[(dim + a) * table.padded + k] = dg[a]
    for i in range(table.n):
        f = total(table, i, 0, dim)
        g = ti.Vector.zero(float, dim)
        if ti.static(apart):
            g = total(table, i, dim, dim)
        store(impulse, jump, i, f, g, apart)


@ti.func
def sums(part: ti.template(), table: ti.template(), h):
    """part.sum[i] = part.own(i) + the terms of all springs of ball i, see kernels.half. part.term may have no branch."""
    for group in range(table.groups):
        e = group * WIDTH
        f = ti.Matrix.zero(float, WIDTH, part.dim)
        for q in ti.static(range(WIDTH)):
            df = part.term(table.spring[e + q].one, table.spring[e + q].other, e + q, h)
            for a in ti.static(range(part.dim)):
                f[q, a] = df[a]
        note(table, e, f, 0)
    for i in range(table.n):
        part.sum[i] = part.own(i) + total(table, i, 0, part.dim)


@ti.func
def in_turn(part: ti.template(), table: ti.template(), h):
    """For all springs e from ball i to ball j part.take(i, j, part.give(i, j, e, h)), each seeing what those before it changed;
    part.change(i, j, e, h) is the same for ends that may coincide. Springs of a group share no ball, see forces.waves."""
    ti.loop_config(serialize=True)
    for group in range(table.groups):
        e = group * WIDTH
        f = ti.Matrix.zero(float, WIDTH, part.dim)
        nearest = ti.cast(1.0, float)
        for q in ti.static(range(WIDTH)):
            df, square = part.give(table.spring[e + q].one, table.spring[e + q].other, e + q, h)
            nearest = ti.min(nearest, square)
            for a in ti.static(range(part.dim)):
                f[q, a] = df[a]
        if nearest < NEAR:
            for k in range(e, e + WIDTH):
                part.change(table.spring[k].one, table.spring[k].other, k, h)
        else:
            for q in ti.static(range(WIDTH)):
                df = ti.Vector([f[q, a] for a in ti.static(range(part.dim))])
                part.take(table.spring[e + q].one, table.spring[e + q].other, df)


@ti.func
def note(table: ti.template(), e, f, first: ti.template()):
    """Write down what springs e to e + WIDTH give, from component `first` on."""
    for a in ti.static(range(f.m)):
        for q in ti.static(range(WIDTH)):
            table.given[(first + a) * table.padded + e + q] = f[q, a]


@ti.func
def total(table: ti.template(), i, first: ti.template(), dim: ti.template()):
    """Sum of what the springs of ball i give it: those that list it first, then those that list it second, which take it."""
    f = ti.Vector.zero(float, dim)
    for e in range(table.start[i], table.start[i + 1]):
        for a in ti.static(range(dim)):
            f[a] += table.given[(first + a) * table.padded + e]
    for k in range(table.second_start[i], table.second_start[i + 1]):
        e = table.second[k]
        for a in ti.static(range(dim)):
            f[a] -= table.given[(first + a) * table.padded + e]
    return f
