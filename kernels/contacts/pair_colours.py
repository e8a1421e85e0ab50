"""Pairs in turn where thousands of threads are to have work: by colours.

The world is cut into blocks of two cells a side in 2^dim ways, each moved by a cell along some of the axes. Cells are as wide as
any pair reaches that a search lists, so along each axis the balls of a pair lie in one cell or in two side by side: in one block
either of the ways that are moved along this axis, or of those that are not. So each pair lies whole in a block of some way, the
first of which is its colour. Blocks of one colour share no ball: a thread takes each of them, its pairs one after another, and
the bits are the same whatever threads do. Balls move by less than the skin until the next search, so all this holds as long as
lists do: what counts is where balls were at the last search.

In 3D a block holds 15 balls of one size. Along each axis a pair crosses the border of blocks of the first way with a
probability of 1/4, so of their 90 pairs the first colour has 38, the others 13 or fewer: a thread takes 90 in all colours
together, where blocks of one way that were coloured like a chessboard would have 90 in each.

Where balls lie in levels by size, each level has colours of its own, for the pairs whose larger ball is of that level. Both balls
list a pair, and keep what it accumulated; the larger one solves it, or that of the lower number.
"""

from taichi_sim.kernels.contacts.pair_lists import pair_entry
from taichi_sim.kernels.contacts.spatial_hash import (
    CELL_LIMIT,
    FINE_CELLS,
    bucket_of,
    cell_of,
    level_of,
    run,
    same_row,
)

from taichi_sim.device.engine import ti

EVERY_COLOUR = -1  # where pairs have none
SOLVED_BY_OTHER = -1  # as the colour of a link
NO_LINK = -1
COLOUR_SHIFT = 24  # bits of a place in the list of a ball; those above hold a colour
MOST_COLOURS = 16  # a launch each in every iteration


@ti.func
def square_cell(x, grid: ti.template(), level):
    """Cell of a position, as wide along x as across."""
    cell = cell_of(x, grid, level)
    cell[0] = (cell[0] + FINE_CELLS * CELL_LIMIT) // FINE_CELLS - CELL_LIMIT  # rounded down, below 0 too
    return cell


@ti.func
def corner_of_block(cell, way):
    """The lowest cell of the block of one way that holds a cell."""
    corner = cell
    for a in ti.static(range(cell.n)):
        moved = (way >> a) & 1
        corner[a] = (((cell[a] + moved) >> 1) << 1) - moved
    return corner


@ti.func
def colour_of(pairs: ti.template(), i, j):
    """Colour of the pair of ball i with ball j, which it lists, or SOLVED_BY_OTHER. Where rounding has put the cells of two that
    only just reach each other further apart than they are, nobody solves it: they cannot touch before the next search."""
    ways = ti.static(1 << pairs.grid.dim)
    mine, other = level_of(pairs.model.radius[i], pairs.grid), level_of(pairs.model.radius[j], pairs.grid)
    colour = SOLVED_BY_OTHER
    if mine > other or (mine == other and i < j):
        a = square_cell(pairs.grid.origin[i], pairs.grid, mine)
        b = square_cell(pairs.grid.origin[j], pairs.grid, mine)
        way = 0
        for axis in ti.static(range(pairs.grid.dim)):
            if a[axis] >> 1 != b[axis] >> 1:
                way += ti.static(1 << axis)
        one, two = corner_of_block(a, way), corner_of_block(b, way)
        together = True
        for axis in ti.static(range(pairs.grid.dim)):
            together = together and one[axis] == two[axis]
        if together:
            colour = mine * ways + way
    return colour


@ti.func
def stretches(grid: ti.template(), level, corner, row):
    """The cells of a block in one of its rows: the first of them, and the sorted copies in their buckets: from `first` to `last`
    and, where they go around the end of a table, from `again` to `end`."""
    cell = corner
    cell[0] *= FINE_CELLS
    for a in ti.static(range(1, grid.dim)):
        cell[a] += (row >> (a - 1)) & 1
    bucket = bucket_of(cell, grid, level)
    first, last = run(grid, level, bucket, 2 * FINE_CELLS, 0)
    again, end = run(grid, level, bucket, 2 * FINE_CELLS, 1)
    return cell, first, last, again, end


@ti.func
def is_in_row(grid: ti.template(), level, way, corner, row, k):
    """True if sorted copy k, in a bucket of a row of a block, is of that block: others may share buckets by their hash."""
    inside = True
    if grid.dense[level] == 0:
        cell = square_cell(grid.copy[k].x, grid, level)
        inside = same_row(cell, row) and corner_of_block(cell, way)[0] == corner[0]
    return inside


@ti.func
def each_of_block(grid: ti.template(), k, colour, visit: ti.template(), arguments: ti.template()):
    """visit(i, *arguments) for each ball i in the block of a colour that holds sorted copy k, in an order that the grid fixes."""
    level, way = colour >> ti.static(grid.dim), colour & ti.static((1 << grid.dim) - 1)
    corner = corner_of_block(square_cell(grid.copy[k].x, grid, level), way)
    for row in range(ti.static(1 << (grid.dim - 1))):
        cell, first, last, again, end = stretches(grid, level, corner, row)
        for e in range(last - first + end - again):
            at = first + e
            if at >= last:
                at += again - last
            if is_in_row(grid, level, way, corner, cell, at):
                visit(grid.sorted[at], *arguments)


@ti.func
def is_first_of_block(grid: ti.template(), k, level, way):
    """True if sorted copy k comes before all others of its block."""
    first_of_all = True
    corner = corner_of_block(square_cell(grid.copy[k].x, grid, level), way)
    for row in range(ti.static(1 << (grid.dim - 1))):
        cell, first, last, again, end = stretches(grid, level, corner, row)
        for at in range(first, ti.min(last, k)):
            if is_in_row(grid, level, way, corner, cell, at):
                first_of_all = False
        for at in range(again, ti.min(end, k)):
            if is_in_row(grid, level, way, corner, cell, at):
                first_of_all = False
    return first_of_all


@ti.func
def list_blocks(grid: ti.template(), k):
    """List the blocks of which sorted copy k is the first, one for each way. They stand in any order; what they do has none."""
    ways = ti.static(1 << grid.dim)
    level = level_of(grid.copy[k].radius, grid)
    for way in range(ways):
        if is_first_of_block(grid, k, level, way):
            colour = level * ways + way
            grid.block[colour * grid.n + ti.atomic_add(grid.block_count[colour], 1)] = k


@ti.func
def each_ball(
    solver: ti.template(), ball: ti.template(), visit: ti.template(), then: ti.template(), time, how: ti.template()
):
    """visit(solver, ball, i, colour, time, how) for each ball i that solves pairs of a colour, colour by colour; then, unless it
    is None, then(ball, i, time, how) for each ball. A launch a colour, and one more where balls lie in levels."""
    colours = ti.static(solver.pairs.grid.colours)
    if ti.static(solver.plan.serial):
        for colour in range(colours):
            for b in range(solver.pairs.grid.block_count[colour]):
                one_block(solver, ball, b, colour, visit, None, time, how)
    else:  # at the top level of a kernel only an unrolled loop leaves the inner ones parallel
        last = ti.static(-1 if solver.pairs.grid.levels > 1 else colours - 1)
        for colour in ti.static(range(colours)):
            for b in range(solver.n):
                if b < solver.pairs.grid.block_count[colour]:
                    one_block(solver, ball, b, colour, visit, ti.static(then if colour == last else None), time, how)
    if ti.static(then and (solver.plan.serial or solver.pairs.grid.levels > 1)):
        for i in range(solver.n):
            then(ball, i, time, how)


@ti.func
def one_block(solver: ti.template(), ball: ti.template(), b, colour, visit: ti.template(), then: ti.template(), time,
              how: ti.template()):  # fmt: skip
    """The pairs of a colour in its block b, then what follows for its balls: nobody else has any of them."""
    k = solver.pairs.grid.block[colour * solver.n + b]
    each_of_block(solver.pairs.grid, k, colour, one_ball, (solver, ball, colour, visit, time, how))
    if ti.static(then):
        each_of_block(solver.pairs.grid, k, colour, end_ball, (ball, then, time, how))


@ti.func
def one_ball(i, solver: ti.template(), ball: ti.template(), colour, visit: ti.template(), time, how: ti.template()):
    """Ball i, if it has pairs of a colour."""
    if (solver.pairs.colours[i] >> colour) & 1 == 1:
        visit(solver, ball, i, colour, time, how)


@ti.func
def end_ball(i, ball: ti.template(), then: ti.template(), time, how: ti.template()):
    """Call then(ball, i, time, how) for ball i."""
    then(ball, i, time, how)


@ti.func
def turn(pairs: ti.template(), i, t, colour):
    """Link with turn t among those of ball i, and True if it is of the colour."""
    first = pairs.first[i]
    c, is_its_turn = pair_entry(pairs, first, t), True
    if ti.static(pairs.plan.by_colours):
        word = pairs.turn[c]
        c = pair_entry(pairs, first, word & ti.static((1 << COLOUR_SHIFT) - 1))
        is_its_turn = word >> COLOUR_SHIFT == colour
    return c, is_its_turn


@ti.func
def find_twins(pairs: ti.template(), i):
    """Find the links by which others list the pairs that ball i solves, after a search."""
    for t in range(pairs.number[i]):
        e = pair_entry(pairs, pairs.first[i], t)
        pairs.link[e].twin = NO_LINK
        if pairs.link[e].colour != SOLVED_BY_OTHER:
            j = pairs.link[e].other
            for s in range(pairs.number[j]):
                c = pair_entry(pairs, pairs.first[j], s)
                if pairs.link[c].other == i:
                    pairs.link[e].twin = c


@ti.func
def mirror(pairs: ti.template(), c, how: ti.template()):
    """Copy what link c holds to its twin. A scalar along the normal turned by 90 degrees is the same seen from the other
    ball."""
    twin = pairs.link[c].twin
    if twin != NO_LINK:  # else not all links fit, and the step will be made again
        pairs.link[twin].impulse = pairs.link[c].impulse
        if ti.static(pairs.model.has_friction):
            if ti.static(pairs.model.dim == 2):
                pairs.link[twin].tangential_impulse = pairs.link[c].tangential_impulse
            else:
                pairs.link[twin].tangential_impulse = -pairs.link[c].tangential_impulse
        if ti.static(how.prepares and pairs.plan.soft):
            pairs.link[twin].bias_velocity = pairs.link[c].bias_velocity
        if ti.static(how.prepares and pairs.has_rebounds):
            pairs.link[twin].rebound_speed = pairs.link[c].rebound_speed
