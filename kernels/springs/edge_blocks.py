"""Loops over springs, each once, that change or sum something at both of its ends.

Springs are listed with their lower ball (a half edge list), and blocks of balls run as in `law.blocks`, also where each spring
reads what the one before it wrote (Gauss-Seidel).
"""

from taichi_sim.kernels.reductions import even_then_odd, odd_then_even

from taichi_sim.device.engine import ti


@ti.func
def sums(total: ti.template(), springs: ti.template(), h):
    """total.sum[i] = total.own(i) + the terms of all springs of ball i.

    total.term(i, j, e, h) is what spring e adds at its lower ball i and takes at its other one, j; in the order "ends" each of
    them asks for its own. They are vectors of total.dim numbers of total.type.
    """
    if ti.static(springs.order == "ends"):
        for i in range(springs.n):
            mine = total.own(i)
            for k in range(springs.end_start[i], springs.end_start[i + 1]):
                e = springs.end_spring[k]
                one, other = springs.spring[e].one, springs.spring[e].other
                mine += total.term(i, ti.select(one == i, other, one), e, h)
            total.sum[i] = mine
    elif ti.static(springs.order == "atomic"):
        for i in range(springs.n):
            total.sum[i] = total.own(i)
        for e in range(springs.m):
            i, j = springs.spring[e].one, springs.spring[e].other
            f = total.term(i, j, e, h)
            total.sum[i] += f
            total.sum[j] -= f
    else:
        even_then_odd(springs.blocks, sum_block, (total, springs, h))


@ti.func
def sum_block(b, total: ti.template(), springs: ti.template(), h):
    """The springs whose lower ball lies in block b; before that, an even block sets what the next one adds to."""
    if b % 2 == 0:
        for i in range(b * springs.block, ti.min((b + 2) * springs.block, springs.n)):
            total.sum[i] = total.own(i)
    for i in range(b * springs.block, ti.min((b + 1) * springs.block, springs.n)):
        mine = ti.Vector.zero(total.type, total.dim)
        for e in range(springs.start[i], springs.start[i + 1]):
            j = springs.spring[e].other
            f = total.term(i, j, e, h)
            mine += f
            total.sum[j] = total.sum[j] - f  # a bare -= would be atomic
        total.sum[i] = total.sum[i] + mine


@ti.func
def there_and_back(sweep: ti.template(), springs: ti.template(), h):
    """sweep.change(i, j, e, h) for all springs e, i its lower ball, in order and then in the reverse order, each seeing what
    those before it changed: by colours, whose springs share no ball, or by blocks."""
    one_way(sweep, springs, h, False)
    one_way(sweep, springs, h, True)


@ti.func
def one_way(sweep: ti.template(), springs: ti.template(), h, reverse: ti.template()):
    """The first half of `there_and_back`, or the second one."""
    if ti.static(springs.order == "colours"):
        last = ti.static(len(springs.colours) - 2)
        for step in ti.static(range(last + 1)):
            c = ti.static(last - step if reverse else step)
            for e in range(springs.colours[c], springs.colours[c + 1]):
                sweep.change(springs.spring[e].one, springs.spring[e].other, e, h)
    elif ti.static(reverse):
        odd_then_even(springs.blocks, change_block, (sweep, springs, h, True))
    else:
        even_then_odd(springs.blocks, change_block, (sweep, springs, h, False))


@ti.func
def change_block(b, sweep: ti.template(), springs: ti.template(), h, reverse: ti.template()):
    """The springs whose lower ball lies in block b, in their order or in the reverse one."""
    begin, end = b * springs.block, ti.min((b + 1) * springs.block, springs.n)
    for k in range(end - begin):
        i = end - 1 - k if ti.static(reverse) else begin + k
        first, behind = springs.start[i], springs.start[i + 1]
        for t in range(behind - first):
            e = behind - 1 - t if ti.static(reverse) else first + t
            sweep.change(i, springs.spring[e].other, e, h)
