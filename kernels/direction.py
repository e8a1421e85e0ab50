"""Directions between balls, also where two of them coincide."""

import taichi as ti


@ti.func
def unit(r, i, j):
    """Unit vector along r (from ball i to ball j) and its length.

    Coincident balls take an axis that depends on the pair alone and changes sign with its order, so that both ends
    still get opposite impulses whichever of them asks.
    """
    squared = r.dot(r)
    n = r * 0.0
    length = r[0] * 0.0
    if squared > 0.0:
        inverse = ti.rsqrt(squared)
        n = r * inverse
        length = squared * inverse
    else:
        axis = (i + j) % ti.static(r.n)
        for a in ti.static(range(r.n)):
            if a == axis:
                n[a] = ti.select(i < j, 1.0, -1.0)
            else:
                n[a] = 0.0
    return n, length
