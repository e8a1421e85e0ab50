"""Places of the entries of a ball's list of pairs.

On a CPU a list lies in one piece, for the cache line that a thread has fetched to hold its next entries. On a device
neighbouring threads have neighbouring balls, and what they read at the same time has to be side by side: the first entries of
all balls, then the second ones, and so on. What a ball's own entries cannot take lies in a pool, in one piece on either.
"""

from taichi_sim.device.engine import ti


@ti.func
def pair_entry(pairs: ti.template(), first, t):
    """Entry t of the list that begins with entry `first`."""
    e = first + t
    if ti.static(pairs.interleaved):
        if first < pairs.pool_start:
            e = first + t * pairs.model.n
    return e
