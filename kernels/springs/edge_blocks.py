"""Loops over springs, each once, that change or sum something at both of its ends.

The table lists each spring with its lower ball (a half list). Balls are cut into blocks longer than any spring reaches, so a
block writes to itself and the next one only: even blocks run at the same time, then odd ones, with the same bits for any number
of threads, also where each spring reads what the one before it wrote (Gauss-Seidel).
"""

from taichi_sim.kernels.springs.law import GRAIN

from taichi_sim.device.engine import ti


@ti.func
def sums(part: ti.template(), table: ti.template(), h):
    """part.sum[i] = part.own(i) + the terms of all springs of ball i.

    part.term(i, j, e, h) is what spring e adds at its lower ball i and takes at its other one, j.
    """
    if ti.static(table.order == "atomic"):
        for i in range(table.n):
            part.sum[i] = part.own(i)
        for e in range(table.m):
            i, j = table.spring[e].one, table.spring[e].other
            f = part.term(i, j, e, h)
            part.sum[i] += f
            part.sum[j] -= f
    else:
        for k in range((table.blocks + 1) // 2 * GRAIN):
            if k % GRAIN == 0:
                b = k // GRAIN * 2
                for i in range(b * table.block, ti.min((b + 2) * table.block, table.n)):
                    part.sum[i] = part.own(i)
                sums_of_block(b, part, table, h)
        for k in range(table.blocks // 2 * GRAIN):
            if k % GRAIN == 0:
                sums_of_block(k // GRAIN * 2 + 1, part, table, h)


@ti.func
def sums_of_block(b, part: ti.template(), table: ti.template(), h):
    """The springs whose lower ball lies in block b."""
    for i in range(b * table.block, ti.min((b + 1) * table.block, table.n)):
        total = ti.Vector.zero(float, part.dim)
        for e in range(table.start[i], table.start[i + 1]):
            j = table.spring[e].other
            f = part.term(i, j, e, h)
            total += f
            part.sum[j] = part.sum[j] - f  # a bare -= would be atomic
        part.sum[i] = part.sum[i] + total


@ti.func
def in_turn(part: ti.template(), table: ti.template(), h):
    """part.change(i, j, e, h) for all springs e, i its lower ball, each seeing what those before it changed."""
    for k in range((table.blocks + 1) // 2 * GRAIN):
        if k % GRAIN == 0:
            change_block(k // GRAIN * 2, part, table, h)
    for k in range(table.blocks // 2 * GRAIN):
        if k % GRAIN == 0:
            change_block(k // GRAIN * 2 + 1, part, table, h)


@ti.func
def change_block(b, part: ti.template(), table: ti.template(), h):
    """The springs whose lower ball lies in block b, in their order."""
    for i in range(b * table.block, ti.min((b + 1) * table.block, table.n)):
        for e in range(table.start[i], table.start[i + 1]):
            part.change(i, table.spring[e].other, e, h)
