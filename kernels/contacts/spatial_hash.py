"""A cell-sorted spatial hash in an unbounded world.

Cells are FINE_CELLS times narrower along x than across. A cell lies in bucket (cx + offset of its row) mod size, so the cells
of a row are neighbours in the table, and any stretch of a row is one run of the sorted copies. Where the box around all balls
holds no more cells than the table has buckets, rows follow one another and no two cells share a bucket; else the rows are
spread by a hash, and different cells may share one. A candidate is accepted only in the row it really lies in (`same_row`), so
that no pair is found twice; far cells that share a bucket are refused by their distance.

Where radii differ much, balls lie in levels by size, the finest first, each with cells and a table of its own: small balls
would else look at thousands of others in cells made for large ones.
"""

from taichi_sim.kernels.reductions import LONG_PART

from taichi_sim.device.engine import ti

CELL_LIMIT = 1 << 28  # cells beyond this are merged: still correct, only slower
MOST_CELLS = 1 << 30  # that are counted: more than any table has
CROWDED_CELL = 64  # balls in a cell from which on their pairs are counted
FINE_CELLS = 3  # a stretch of 2 reach + 1/3 in place of 3 whole cells: two thirds of the candidates


@ti.func
def level_of(radius, grid: ti.template()):
    """Level in which a ball of this radius lies."""
    level = 0
    for k in ti.static(range(1, grid.levels)):
        if radius > grid.largest[k - 1]:
            level = k
    return level


@ti.func
def table(grid: ti.template(), level):
    """First bucket of a level's table, and how many it has."""
    if ti.static(grid.levels == 1):
        return 0, grid.size
    else:
        return grid.table_first[level], grid.table_size[level]


@ti.func
def cell_of(x, grid: ti.template(), level):
    """Integer cell of a position in a level."""
    cell = x * grid.inverse_width[level]
    cell[0] *= FINE_CELLS
    for a in ti.static(range(cell.n)):  # what is not a number is not below the limit either
        cell[a] = ti.select(
            cell[a] > -1.0 * CELL_LIMIT,
            ti.select(cell[a] < 1.0 * CELL_LIMIT, cell[a], 1.0 * CELL_LIMIT),
            -1.0 * CELL_LIMIT,
        )
    return ti.cast(ti.floor(cell), ti.i32)


@ti.func
def row_key(cell):
    """A mixed number for the row (all coordinates but the first)."""
    key = ti.u32(0)
    for a in ti.static(range(1, cell.n)):
        key = (key ^ ti.cast(cell[a], ti.u32)) * ti.u32(2654435761)
        key ^= key >> 15
    return key


@ti.func
def bucket_of(cell, grid: ti.template(), level):
    """Bucket of a cell of a level in its table, whose size is a power of two."""
    key = ti.u32(0)
    if grid.dense[level] == 1:
        at = level * grid.dim
        for a in ti.static(range(1, cell.n)):
            key += ti.cast(cell[a] - grid.corner[at + a], ti.u32) * ti.cast(grid.pitch[at + a], ti.u32)
        key += ti.cast(-grid.corner[at], ti.u32)  # Vulkan cannot negate unsigned numbers
    else:
        key = row_key(cell)
    first, size = table(grid, level)
    return first + ti.cast((ti.cast(cell[0], ti.u32) + key) & ti.cast(size - 1, ti.u32), ti.i32)


@ti.func
def same_row(a, b):
    """True if two cells lie in one row along x."""
    same = True
    for k in ti.static(range(1, a.n)):
        same = same and a[k] == b[k]
    return same


@ti.func
def prefix_sum(count: ti.template(), start: ti.template(), partial: ti.template(), size, chunk):
    """start (size + 1) = exclusive sums of count (size); size is a multiple of chunk, or 0: nothing is done. Clears count."""
    for c in range(size // chunk):
        total = 0
        for b in range(c * chunk, (c + 1) * chunk):
            total += count[b]
        partial[c] = total
    ti.loop_config(serialize=True)
    for _ in range(1):
        running = 0
        for c in range(size // chunk):
            total = partial[c]
            partial[c] = running
            running += total
        if size > 0:
            start[size] = running
    for c in range(size // chunk):
        running = partial[c]
        for b in range(c * chunk, (c + 1) * chunk):
            start[b] = running
            running += count[b]
            count[b] = 0


@ti.func
def sort_run(order: ti.template(), first, last):
    """Insertion sort of order[first:last]: threads filled it in any order, and sums must not depend on that."""
    for a in range(first + 1, last):
        value = order[a]
        b = a - 1
        while b >= first and order[b] > value:
            order[b + 1] = order[b]
            b -= 1
        order[b + 1] = value


@ti.func
def decide_work(grid: ti.template()):
    """`work`: how much the loops below handle: all when some ball has moved too far, else none.

    A loop inside an `if` would not be parallel; a loop over nothing is.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        stale = grid.stale[0] if ti.static(grid.skin > 0.0) else 1
        grid.work[0].balls = stale * grid.n
        grid.work[0].buckets = stale * grid.size
        grid.work[0].parts = stale * grid.parts
        grid.stale[0] = 0
        grid.searches[0] = grid.searches[0] + stale
        grid.crowded_pairs[0] = 0.0


@ti.func
def lay_out(ball: ti.template(), grid: ti.template()):
    """Choose how rows are placed in each level's table, from the box of cells around all its balls."""
    for c in range(grid.work[0].parts):
        end = ti.min((c + 1) * LONG_PART, grid.n)
        if ti.static(grid.levels == 1):
            low = cell_of(ball[c * LONG_PART].x, grid, 0)
            high = low
            for i in range(c * LONG_PART + 1, end):
                cell = cell_of(ball[i].x, grid, 0)
                low = ti.min(low, cell)
                high = ti.max(high, cell)
            grid.low[c] = low
            grid.high[c] = high
        else:
            for level in range(grid.levels):
                grid.low[c * grid.levels + level] = CELL_LIMIT
                grid.high[c * grid.levels + level] = -CELL_LIMIT
            for i in range(c * LONG_PART, end):
                level = level_of(grid.model.radius[i], grid)
                cell = cell_of(ball[i].x, grid, level)
                at = c * grid.levels + level
                grid.low[at] = ti.min(grid.low[at], cell)
                grid.high[at] = ti.max(grid.high[at], cell)
    ti.loop_config(serialize=True)
    for level in range(grid.levels):
        if grid.work[0].parts > 0:
            low = grid.low[level]
            high = grid.high[level]
            for c in range(1, grid.work[0].parts):
                low = ti.min(low, grid.low[c * grid.levels + level])
                high = ti.max(high, grid.high[c * grid.levels + level])
            place_rows(grid, level, low, high)


@ti.func
def place_rows(grid: ti.template(), level, lowest, high):
    """Choose how rows are placed in the table of a level all of whose balls lie in the cells lowest..high."""
    low = ti.min(lowest, high)  # a level may be empty
    cells = 1
    for a in ti.static(range(grid.dim)):
        border = ti.static(2 * FINE_CELLS if a == 0 else 2)  # what a search around a ball may look at
        at = level * grid.dim + a
        grid.corner[at] = low[a] - border
        width = high[a] - low[a] + (2 * border + 1)
        grid.pitch[at] = ti.min(cells, CELL_LIMIT)
        if ti.static(grid.levels > 1):
            grid.top[at] = high[a] + border
        else:
            grid.extent[a] = width
        cells = ti.select(width > MOST_CELLS // cells, MOST_CELLS, cells * width)  # lest it overflow
    grid.dense[level] = ti.select(cells <= table(grid, level)[1], 1, 0)


@ti.func
def clip(grid: ti.template(), level, low, high):
    """The part of the cells low..high that may hold balls of a level: beyond, a table's rows run into each other."""
    for a in ti.static(range(grid.dim)):
        low[a] = ti.max(low[a], grid.corner[level * grid.dim + a])
        high[a] = ti.min(high[a], grid.top[level * grid.dim + a])
    return low, high


@ti.func
def build(ball: ti.template(), grid: ti.template()):
    """Sort the balls into the grid: bucket b holds sorted copies start[b] to start[b + 1], by rising index.

    Where cells hold more pairs than there is memory for, they are left unsorted, and no search may follow.
    """
    lay_out(ball, grid)
    for i in range(grid.work[0].balls):
        level = level_of(grid.model.radius[i], grid)
        b = bucket_of(cell_of(ball[i].x, grid, level), grid, level)
        grid.origin[i] = ball[i].x
        grid.bucket[i] = b
        grid.count[b] += 1
    prefix_sum(grid.count, grid.start, grid.partial, grid.work[0].buckets, grid.chunk)
    for i in range(grid.work[0].balls):
        b = grid.bucket[i]
        grid.sorted[grid.start[b] + ti.atomic_add(grid.count[b], 1)] = i
    for b in range(grid.work[0].buckets):
        grid.count[b] = 0
        first = grid.start[b]
        last = grid.start[b + 1]
        if last - first > CROWDED_CELL:
            ti.atomic_add(grid.crowded_pairs[0], 0.5 * (last - first) * (last - first - 1.0))
        if grid.crowded_pairs[0] <= grid.pair_limit[0]:
            sort_run(grid.sorted, first, last)
        for k in range(first, last):
            grid.order[k] = grid.sorted[k]
            grid.copy[k].x = ball[grid.sorted[k]].x
            grid.copy[k].radius = grid.model.radius[grid.sorted[k]]
    if ti.static(grid.levels == 1):
        order_by_slabs(ball, grid)


@ti.func
def order_by_slabs(ball: ti.template(), grid: ti.template()):
    """Order sweeps by slabs across the longest side of the world where rows are spread by a hash, lest blocks of balls that can
    meet each other reach from one end of the order to the other."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        hashed = grid.work[0].balls > 0 and grid.dense[0] == 0
        grid.work[0].ranked = ti.select(hashed, grid.n, 0)
        grid.work[0].slabs = ti.select(hashed, grid.slabs, 0)
        longest = ti.cast(0, ti.i32)
        for a in ti.static(range(grid.dim)):
            extent = grid.extent[a] // ti.static(FINE_CELLS if a == 0 else 1)
            if extent >= longest:
                longest = extent
                grid.slab_axis[0] = a
                grid.slab_shift[0] = 0
                while (grid.extent[a] >> grid.slab_shift[0]) >= grid.slabs:
                    grid.slab_shift[0] += 1
    for i in range(grid.work[0].ranked):
        cell = cell_of(ball[i].x, grid, 0)
        slab = 0
        for a in ti.static(range(grid.dim)):
            if a == grid.slab_axis[0]:
                slab = (cell[a] - grid.corner[a]) >> grid.slab_shift[0]
        grid.bucket[i] = slab
        grid.count[slab] += 1
    prefix_sum(grid.count, grid.slab, grid.partial, grid.work[0].slabs, grid.chunk)
    ti.loop_config(serialize=True)  # in the order of their numbers: a slab may hold too many balls to sort them
    for i in range(grid.work[0].ranked):
        b = grid.bucket[i]
        grid.rank[i] = grid.slab[b] + grid.count[b]
        grid.count[b] += 1
        grid.order[grid.rank[i]] = i
    for b in range(grid.work[0].slabs):
        grid.count[b] = 0


@ti.func
def run(grid: ti.template(), level, bucket, length, piece: ti.template()):
    """First and last + 1 of the sorted copies in `length` cells from `bucket` on: piece 0, and piece 1 where they go around
    the end of the level's table."""
    first = 0
    last = 0
    begin, size = table(grid, level)
    end = bucket + ti.min(length, size)  # far from the origin single precision has cells only in large strides
    if ti.static(piece == 0):
        first = grid.start[bucket]
        last = grid.start[ti.min(end, begin + size)]
    elif end > begin + size:
        if ti.static(grid.levels > 1):
            first = grid.start[begin]
        last = grid.start[end - size]
    return first, last
