"""Hooke's law with damping along the spring, and the orders in which it can be summed.

Ball i feels k (d - l) n + c (u . n) n, n along r from it to ball j, d = |r|, u = v_j - v_i. Loops read old positions and
velocities from `ball` (a struct field with x and v side by side: one cache line serves both) and set impulses [N s] of all
balls: `impulse` takes h times the elastic force, `damping_impulse` takes `tau` times the damping force when `what.apart`, else
`impulse` takes both.
"""

from typing import NamedTuple

from taichi_sim.kernels.loops import list_entry
from taichi_sim.kernels.reductions import even_then_odd
from taichi_sim.kernels.vectors import unit

from taichi_sim.device.engine import ti


class Terms(NamedTuple):
    """Terms of the law that a loop sums, fixed when it is compiled."""

    elastic: bool  # k (d - l) n
    damped: bool  # c (u . n) n
    apart: bool  # damping apart from the rest


@ti.func
def factors(spring, stretch, inverse, closing, h, tau, what: ti.template()):
    """The law over r, which needs no unit vector: h k (1 - l / d) and tau c (u . r) / d^2. stretch: 1 - l / d, inverse: 1 / d,
    closing: u . r."""
    along, drag = ti.cast(0.0, float), ti.cast(0.0, float)
    if ti.static(what.elastic):
        along = h * spring.stiffness * stretch
    if ti.static(what.damped):
        drag = tau * spring.damping * closing * inverse * inverse
    return along, drag


@ti.func
def tension(spring, scale, d, inverse, closing, damped: ti.template()):
    """The law along n: `scale` times k (d - l) + c (u . r) / d."""
    pull = scale * spring.stiffness * (d - spring.rest_length)
    if ti.static(damped):
        pull += scale * spring.damping * inverse * closing
    return pull


@ti.func
def energy(stiffness, elongation):
    """The elastic part of the law summed up: k (d - l)^2 / 2 [J]."""
    return 0.5 * stiffness * elongation * elongation


@ti.func
def law(a, b, i, j, spring, h, tau, what: ti.template()):
    """Elastic and damping impulse on ball i (state a) from a spring to ball j (state b)."""
    r = b.x - a.x
    square = r.dot(r)
    inverse, stretch = ti.cast(1.0, float), -spring.rest_length
    if square > 0.0:
        inverse = ti.rsqrt(square)
        stretch = 1.0 - spring.rest_length * inverse
    else:
        r, _ = unit(r, i, j)
    along, drag = factors(spring, stretch, inverse, (b.v - a.v).dot(r), h, tau, what)
    f, g = ti.Vector.zero(float, r.n), ti.Vector.zero(float, r.n)
    if ti.static(what.elastic):
        f = along * r
    if ti.static(what.damped):
        g = drag * r
    return f, g


@ti.func
def spring_entry(springs: ti.template(), i, t):
    """The entry of spring t that ball i lists."""
    e = list_entry(springs, i, t)
    if ti.static(springs.placed):
        e = springs.place[e]
    return e


@ti.func
def stored(ball: ti.template(), springs: ti.template(), i, real: ti.template()):
    """Elastic energy [J] of the springs that ball i lists."""
    total = ti.cast(0.0, real)
    for t in range(springs.start[i + 1] - springs.start[i]):
        spring = springs.spring[spring_entry(springs, i, t)]
        _, d = unit(ball[spring.other].x - ball[i].x, i, spring.other)
        total += energy(ti.cast(spring.stiffness, real), ti.cast(d - spring.rest_length, real))
    return total


@ti.func
def gather(ball: ti.template(), springs: ti.template(), impulse: ti.template(), damping_impulse: ti.template(), h, tau,
           what: ti.template()):  # fmt: skip
    """Each ball sums its own springs in their order: no atomics, the same bits for any number of threads."""
    for i in range(springs.n):
        a = ball[i]
        f = ti.Vector.zero(float, springs.dim)
        g = ti.Vector.zero(float, springs.dim)
        for t in range(springs.start[i + 1] - springs.start[i]):
            spring = springs.spring[list_entry(springs, i, t)]
            df, dg = law(a, ball[spring.other], i, spring.other, spring, h, tau, what)
            f += df
            g += dg
        store(impulse, damping_impulse, i, f, g, what)


@ti.func
def store(impulse: ti.template(), damping_impulse: ti.template(), i, f, g, what: ti.template()):
    """Write what `add` would add to cleared fields."""
    if ti.static(what.apart):
        impulse[i] = f
        damping_impulse[i] = g
    else:
        impulse[i] = f + g


@ti.func
def add(impulse: ti.template(), damping_impulse: ti.template(), i, f, g, what: ti.template()):
    """Plain, not atomic: `field[i] += f` alone would be an atomic in Taichi."""
    if ti.static(what.apart):
        impulse[i] = impulse[i] + f
        damping_impulse[i] = damping_impulse[i] + g
    else:
        impulse[i] = impulse[i] + (f + g)


@ti.func
def sum_block(b, ball: ti.template(), springs: ti.template(), impulse: ti.template(), damping_impulse: ti.template(), h, tau,
              what: ti.template()):  # fmt: skip
    """The springs whose lower ball lies in block b, each once; before that, an even block clears what the next one adds to."""
    if b % 2 == 0:
        for i in range(b * springs.block, ti.min((b + 2) * springs.block, springs.n)):
            zero = ti.Vector.zero(float, springs.dim)
            store(impulse, damping_impulse, i, zero, zero, what)
    for i in range(b * springs.block, ti.min((b + 1) * springs.block, springs.n)):
        a = ball[i]
        f = ti.Vector.zero(float, springs.dim)
        g = ti.Vector.zero(float, springs.dim)
        for e in range(springs.start[i], springs.start[i + 1]):
            spring = springs.spring[e]
            df, dg = law(a, ball[spring.other], i, spring.other, spring, h, tau, what)
            f += df
            g += dg
            add(impulse, damping_impulse, spring.other, -df, -dg, what)
        add(impulse, damping_impulse, i, f, g, what)


@ti.func
def blocks(ball: ti.template(), springs: ti.template(), impulse: ti.template(), damping_impulse: ti.template(), h, tau,
           what: ti.template()):  # fmt: skip
    """Each spring once, without atomics, from its lower ball (a half edge list): blocks of balls are longer than any spring's
    index distance, so that a block writes to itself and the next one only."""
    even_then_odd(springs.blocks, sum_block, (ball, springs, impulse, damping_impulse, h, tau, what))


@ti.func
def scatter(ball: ti.template(), springs: ti.template(), impulse: ti.template(), damping_impulse: ti.template(), h, tau,
            what: ti.template()):  # fmt: skip
    """Each spring once, with atomic adds at both ends: any order, so the last bits vary from run to run."""
    for i in range(springs.n):
        zero = ti.Vector.zero(float, springs.dim)
        store(impulse, damping_impulse, i, zero, zero, what)
    for e in range(springs.m):
        spring = springs.spring[e]
        i, j = spring.one, spring.other
        f, g = law(ball[i], ball[j], i, j, spring, h, tau, what)
        if ti.static(what.apart):
            impulse[i] += f
            impulse[j] -= f
            damping_impulse[i] += g
            damping_impulse[j] -= g
        else:
            impulse[i] += f + g
            impulse[j] -= f + g
