"""Loops over springs, each once, that change or sum something at both of its ends.

Springs are listed with their lower ball (a half edge list), and blocks of balls run as `law.each_block` says, also where each
spring reads what the one before it wrote (Gauss-Seidel).
"""

from taichi_sim.kernels.springs.law import each_block

from taichi_sim.device.engine import ti


@ti.func
def sums(part: ti.template(), springs: ti.template(), h):
    """part.sum[i] = part.own(i) + the terms of all springs of ball i.

    part.term(i, j, e, h) is what spring e adds at its lower ball i and takes at its other one, j.
    """
    if ti.static(springs.order == "atomic"):
        for i in range(springs.n):
            part.sum[i] = part.own(i)
        for e in range(springs.m):
            i, j = springs.spring[e].one, springs.spring[e].other
            f = part.term(i, j, e, h)
            part.sum[i] += f
            part.sum[j] -= f
    else:
        each_block(springs, sum_block, (part, springs, h))


@ti.func
def sum_block(b, part: ti.template(), springs: ti.template(), h):
    """The springs whose lower ball lies in block b; before that, an even block sets what the next one adds to."""
    if b % 2 == 0:
        for i in range(b * springs.block, ti.min((b + 2) * springs.block, springs.n)):
            part.sum[i] = part.own(i)
    for i in range(b * springs.block, ti.min((b + 1) * springs.block, springs.n)):
        total = ti.Vector.zero(float, part.dim)
        for e in range(springs.start[i], springs.start[i + 1]):
            j = springs.spring[e].other
            f = part.term(i, j, e, h)
            total += f
            part.sum[j] = part.sum[j] - f  # a bare -= would be atomic
        part.sum[i] = part.sum[i] + total


@ti.func
def in_turn(part: ti.template(), springs: ti.template(), h):
    """part.change(i, j, e, h) for all springs e, i its lower ball, each seeing what those before it changed."""
    each_block(springs, change_block, (part, springs, h))


@ti.func
def change_block(b, part: ti.template(), springs: ti.template(), h):
    """The springs whose lower ball lies in block b, in their order."""
    for i in range(b * springs.block, ti.min((b + 1) * springs.block, springs.n)):
        for e in range(springs.start[i], springs.start[i + 1]):
            part.change(i, springs.spring[e].other, e, h)
