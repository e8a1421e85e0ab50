"""Loops over as much as there is to do.

On a CPU a loop over nothing costs nothing. On a device a loop of a length that a kernel finds out costs another launch, of one
thread, for the length: there it always goes to the most that it may be, and what is beyond does nothing.
"""

from taichi_sim.device.engine import ti

SLICE = 32  # lists that are stored together on a device: as many as threads run in step there


@ti.func
def each(
    count: ti.template(), most: ti.template(), fixed: ti.template(), visit: ti.template(), arguments: ti.template()
):
    """visit(i, *arguments) for each i below `count`, which is at most `most`. fixed: whether the loop always goes up to that."""
    if ti.static(fixed):
        for i in range(most):
            if i < count:
                visit(i, *arguments)
    else:
        for i in range(count):
            visit(i, *arguments)


@ti.func
def list_entry(lists: ti.template(), i, t):
    """Entry t of list i of `lists`: one behind the other from `start` on, or, for neighbouring threads of a device to read
    neighbouring entries, in slices of SLICE lists, which hold all first entries, then all second ones, and so on."""
    e = lists.start[i] + t
    if ti.static(lists.sliced):
        e = lists.slice_start[i // SLICE] + t * SLICE + i % SLICE
    return e
