"""The search of `spatial_hash` and `pairs` for devices, where each ball lists all balls near it: a fixed number of loops, each of
a thread for every ball or every few buckets, which do nothing while the lists of the last search hold.
"""

from taichi_sim.kernels.contacts.pairs import ENDLESS, list_neighbours, store_links
from taichi_sim.kernels.contacts.spatial_hash import (
    CELL_LIMIT,
    CROWDED_CELL,
    bucket_of,
    cell_of,
    level_of,
    place_rows,
)

from taichi_sim.device.engine import ti

SUMMED_BUCKETS = 64  # whose sums one thread makes, and sums of these


@ti.func
def is_due(grid: ti.template()):
    """True if the lists of the last search hold no more."""
    due = True
    if ti.static(grid.skin > 0.0):
        due = grid.stale[0] == 1
    return due


@ti.func
def expect_anything(grid: ti.template()):
    """The box around no ball at all."""
    for level in range(grid.levels):
        for a in ti.static(range(grid.dim)):
            grid.low[level][a] = CELL_LIMIT
            grid.high[level][a] = -CELL_LIMIT


@ti.func
def build(ball: ti.template(), grid: ti.template()):
    """Sort the balls into the grid as spatial_hash.build does: bucket b holds sorted copies start[b] to start[b + 1], by rising
    index."""
    for i in range(grid.n):
        if is_due(grid):
            widen_box(ball, grid, i)
    ti.loop_config(serialize=True)
    for _ in range(1):
        grid.work[0].balls = 0
        if is_due(grid):
            grid.work[0].balls = grid.n
            grid.searches[0] = grid.searches[0] + 1
            grid.crowded_pairs[0] = 0.0
            for level in range(grid.levels):
                place_rows(grid, level, grid.low[level], grid.high[level])
            expect_anything(grid)
    for i in range(grid.n):
        if is_due(grid):
            level = level_of(grid.model.radius[i], grid)
            b = bucket_of(cell_of(ball[i].x, grid, level), grid, level)
            grid.origin[i] = ball[i].x
            grid.bucket[i] = b
            grid.count[b] += 1
            grid.partial[b // SUMMED_BUCKETS] += 1
            grid.second_partial[b // SUMMED_BUCKETS**2] += 1
    for c in range(grid.second_parts):
        if is_due(grid):
            running = 0
            for k in range(c):
                running += grid.second_partial[k]
            for k in range(c * SUMMED_BUCKETS, ti.min((c + 1) * SUMMED_BUCKETS, grid.size // SUMMED_BUCKETS)):
                total = grid.partial[k]
                grid.partial[k] = running
                running += total
    for c in range(grid.size // SUMMED_BUCKETS):
        if is_due(grid):
            place_buckets(grid, c)
    for i in range(grid.n):
        if is_due(grid):
            b = grid.bucket[i]
            grid.order[grid.start[b] + ti.atomic_sub(grid.count[b], 1) - 1] = i
    for k in range(grid.n):
        if is_due(grid) and grid.crowded_pairs[0] <= grid.pair_limit[0]:
            i = grid.order[k]
            first, last = grid.start[grid.bucket[i]], grid.start[grid.bucket[i] + 1]
            at = first
            for other in range(first, last):
                at += ti.select(grid.order[other] < i, 1, 0)
            grid.sorted[at] = i
            grid.copy_of[i] = at
            grid.copy[at].x = ball[i].x
            grid.copy[at].radius = grid.model.radius[i]


@ti.func
def widen_box(ball: ti.template(), grid: ti.template(), i):
    """Enlarge the box of the level of ball i to hold it; looking before writing, as nearly all balls lie inside it already."""
    level = level_of(grid.model.radius[i], grid)
    cell = cell_of(ball[i].x, grid, level)
    for a in ti.static(range(grid.dim)):
        if cell[a] < grid.low[level][a]:
            ti.atomic_min(grid.low[level][a], cell[a])
        if cell[a] > grid.high[level][a]:
            ti.atomic_max(grid.high[level][a], cell[a])


@ti.func
def place_buckets(grid: ti.template(), c):
    """Find where the sorted copies of some buckets begin, and count the pairs in crowded ones; sums are zero again."""
    running = grid.partial[c]
    grid.partial[c] = 0
    if c < grid.second_parts:
        grid.second_partial[c] = 0
    for b in range(c * SUMMED_BUCKETS, (c + 1) * SUMMED_BUCKETS):
        number = grid.count[b]
        grid.start[b] = running
        running += number
        if number > CROWDED_CELL:
            ti.atomic_add(grid.crowded_pairs[0], 0.5 * number * (number - 1.0))
    if (c + 1) * SUMMED_BUCKETS == grid.size:
        grid.start[grid.size] = running


@ti.func
def search(pairs: ti.template()):
    """List for each ball all others within reach, in an order that the grid fixes: see pairs.search, which lists each pair
    once. Each ball has entries of its own; what they cannot take goes to the pool."""
    for i in range(pairs.grid.n):
        if is_due(pairs.grid):
            if i == 0:
                pairs.used[0] = 0
            if ti.static(pairs.plan.warm_starts):
                store_links(pairs, i)
    for i in range(pairs.grid.n):  # by balls, not by copies: most of what is read and written are lists, new and old
        if is_due(pairs.grid):
            if pairs.grid.crowded_pairs[0] <= pairs.grid.pair_limit[0]:
                k = pairs.grid.copy_of[i]
                at = i
                if ti.static(not pairs.interleaved):
                    at *= pairs.block_capacity
                first, found, _ = list_neighbours(pairs, k, at, pairs.block_capacity)
                pairs.first[i] = first
                pairs.number[i] = found
                pairs.touching[i] = found
            elif i == 0:
                pairs.overflow[0] = ENDLESS
                pairs.grid.most_crowded_pairs[0] = ti.max(pairs.grid.most_crowded_pairs[0], pairs.grid.crowded_pairs[0])
                pairs.grid.work[0].balls = 0


@ti.func
def end(grid: ti.template(), i):
    """The lists hold; for each ball i, in a loop after the search."""
    if ti.static(grid.skin > 0.0):
        if i == 0:
            grid.stale[0] = 0
