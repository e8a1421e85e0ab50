"""A look at all contacts: how many, how deep, and which approach speeds the solver left. No part of a step."""

import taichi as ti

NUMBER, DEPTH, PART, SQUARE, DEEPEST, LARGEST_PART, FASTEST = range(7)  # members of a tally
SUMS = 4  # of them: number, depths [m], parts of a radius, squares of approach speeds [m^2/s^2]; the rest are largest values


@ti.func
def nothing():
    """The tally of no contact."""
    return ti.Vector([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


@ti.func
def one(depth, radius, u):
    """The tally of one contact: overlap [m], radius of the smaller ball [m], normal speed [m/s], negative on approach."""
    left = ti.max(0.0, -u)
    return ti.Vector([1.0, depth, depth / radius, left * left, depth, depth / radius, left])


@ti.func
def join(a, b):
    """The tally of two sets of contacts."""
    total = a
    for k in ti.static(range(7)):
        total[k] = a[k] + b[k] if ti.static(k < SUMS) else ti.max(a[k], b[k])
    return total
