"""Directions between balls, also where two of them coincide."""

from taichi_sim.device.engine import ti


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


@ti.func
def cross(n, p):
    """n x p: a scalar in 2D."""
    if ti.static(n.n == 2):
        return n[0] * p[1] - n[1] * p[0]
    else:
        return n.cross(p)


@ti.func
def tangent(n):
    """The vector n turned by 90 degrees, in 2D."""
    return ti.Vector([-n[1], n[0]])


@ti.func
def part_across(q, n):
    """Part of the vector q at right angles to the unit vector n: a scalar along `tangent` in 2D."""
    if ti.static(n.n == 2):
        return tangent(n).dot(q)
    else:
        return q - q.dot(n) * n


@ti.func
def lever(s, n):
    """s x n, for a spin s that is a scalar in 2D."""
    if ti.static(n.n == 2):
        return tangent(n) * s
    else:
        return s.cross(n)


@ti.func
def zero_scalar_in_2d(dim: ti.template()):
    """0 of what is a scalar in 2D and a vector in 3D: a spin, an angular impulse."""
    if ti.static(dim == 2):
        return ti.cast(0.0, float)
    else:
        return ti.Vector.zero(float, 3)


@ti.func
def product(a, b, dim: ti.template()):
    """Scalar product of two such."""
    if ti.static(dim == 2):
        return a * b
    else:
        return a.dot(b)
