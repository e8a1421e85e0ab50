"""Grid: the spatial hash of all balls, rebuilt where they are now."""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.kernels.contacts import parallel_search
from taichi_sim.kernels.contacts import spatial_hash as loops
from taichi_sim.kernels.reductions import LONG_PART

__all__ = ["Grid"]


BUCKETS_PER_BALL = 4  # with fewer, other rows share the buckets and every ball looks at twice as many candidates
SKIN = 0.15  # of each radius
LEVEL_STEP = 2.0  # of the radius from level to level, or more where that would make too many of them
MOST_LEVELS = 8
# buckets: the few balls of a coarse level then mostly have a bucket for each cell of their box
FEWEST_BUCKETS_OF_LEVEL = 1 << 13
FEWER_CANDIDATES = 4.0  # times fewer candidates: only then levels make up for what they cost


@ti.data_oriented
class Grid:
    """Cells as wide as the largest ball, so that every pair that may touch lies in neighbouring rows. Memory is O(balls).
    Where it pays, levels of balls by size, each with its own cells: a ball looks at its own level and at coarser ones.

    Pairs are looked for with radii enlarged by `skin` + `gap` times, and stay listed until some ball has moved by `skin` times
    its own radius: two balls that are not listed cannot have met before. Small balls among large ones list few neighbours so.
    Nothing is looked for while cells hold more than `pair_limit` pairs. parallel: as parallel_search does it.
    """

    def __init__(
        self,
        model: Model,
        fields: Fields,
        skin: float,
        gap: float,
        pair_limit: int,
        parallel: bool = False,
    ) -> None:
        self.model, self.parallel = model, parallel
        self.n, self.dim = model.n, model.dim
        self.skin, self.enlarged = skin, 1.0 + skin + gap  # of a radius; times a radius
        self.margin = 1.001  # for rounded coordinates
        bounds = levels(model.scene.radius, model.dim)  # largest radius [m] of each level, the finest first
        self.levels = len(bounds)
        level = np.searchsorted(bounds, model.scene.radius)
        balls = np.bincount(level, minlength=self.levels)
        self.largest = fields.reals(np.array(bounds))  # (levels) m, radius in each
        # (levels) 1/m, of a cell across x
        self.inverse_width = fields.reals(1.0 / (2.0 * np.array(bounds) * self.enlarged * self.margin))
        fewest = 64 if self.levels == 1 else FEWEST_BUCKETS_OF_LEVEL
        sizes = [max(fewest, 1 << int(np.ceil(np.log2(max(1, BUCKETS_PER_BALL * n))))) for n in balls.tolist()]
        self.size = sum(sizes)  # buckets of all levels; `chunk` of them one thread sums
        self.chunk = parallel_search.SUMMED_BUCKETS if parallel or self.size < 4096 else 1024
        self.size = -(-self.size // self.chunk) * self.chunk
        if self.levels > 1:
            self.table_size = fields.integers(np.array(sizes))  # (levels) buckets
            self.table_first = fields.integers(np.cumsum([0, *sizes[:-1]]))  # (levels) the first of these
            self.top = fields.integers(self.levels * model.dim)  # the highest cell in which a search may look
        else:
            self.extent = fields.integers(model.dim)  # cells of the box around all balls
        if self.levels == 1 and not parallel:
            self.slabs = max(self.chunk, self.size // 4)
            # slab: where its balls begin; rank: place of a ball in the order by slabs
            self.slab, self.rank = fields.integers(self.slabs + 1), fields.integers(self.n)
            # slab_axis: across which slabs lie; slab_shift: bits of the cells of one
            self.slab_axis, self.slab_shift = fields.integers(1), fields.integers(1)
        self.count = fields.integers(self.size)  # balls in a bucket, while it is made
        self.start = fields.integers(self.size + 1)  # the first sorted copy of a bucket
        self.partial = fields.integers(self.size // self.chunk)  # sums over chunks
        if parallel:
            self.second_parts = -(-self.size // parallel_search.SUMMED_BUCKETS**2)
            self.second_partial = fields.integers(self.second_parts)  # sums of these
            self.copy_of = fields.integers(self.n)  # the sorted copy of each ball
        self.bucket = fields.integers(self.n)  # of each ball
        # sorted: the ball of each sorted copy; order: balls in the order of iterations
        self.sorted, self.order = fields.integers(self.n), fields.integers(self.n)
        self.origin = fields.vectors(self.n, model.dim)  # m, of each ball at the last search
        # stale: 1, the last search does not hold any more; searches: number
        self.stale, self.searches = fields.integers(1), fields.integers(1)
        # how much each loop of the present search has to do: all or nothing. parts: one thread measures the box of each
        self.work = fields.table(dict.fromkeys(("balls", "buckets", "parts", "ranked", "slabs"), ti.i32), 1)
        # pairs in crowded cells: in the last search, at most in one that was given up, and for which there is memory
        self.crowded_pairs, self.most_crowded_pairs = fields.reals(1), fields.reals(1)
        self.pair_limit = fields.reals(np.array([float(pair_limit)]))
        self.parts = 1 if parallel else -(-self.n // LONG_PART)
        # cells: the lowest and the highest of each part and level
        self.low, self.high = (fields.cells(self.levels * self.parts, model.dim) for _ in range(2))
        # corner: the lowest cell in which a search may look; pitch: of rows, where they lie side by side
        self.corner, self.pitch = (fields.integers(self.levels * model.dim) for _ in range(2))
        self.dense = fields.integers(self.levels)  # (levels) 1: rows lie side by side
        vector = ti.types.vector(model.dim, fields.real)
        # [m] of each ball as it was when the grid was made
        self.copy = fields.table({"x": vector, "radius": fields.real}, self.n)

    @property
    def widest(self) -> float:
        """Width of the coarsest level's cells [m]."""
        return 1.0 / float(self.inverse_width[self.levels - 1])

    @ti.func
    def expire(self):
        """Ask for a new search, whatever has moved."""
        ti.loop_config(serialize=True)
        for _ in range(1):
            self.stale[0] = 1
            if ti.static(self.parallel):
                parallel_search.expect_anything(self)

    @ti.func
    def watch(self, i, x):
        """Ask for a new search when ball i, now at x, has moved by the skin."""
        if ti.static(self.skin > 0.0):
            d = x - self.origin[i]
            if d.dot(d) > (self.skin * self.model.radius[i]) ** 2:
                self.stale[0] = 1

    @ti.func
    def build(self, ball: ti.template()):
        """Sort the balls into cells where the last search no longer holds."""
        if ti.static(self.parallel):
            parallel_search.build(ball, self)
        else:
            loops.decide_work(self)
            loops.build(ball, self)


def levels(radius: NDArray[np.float64], dim: int) -> list[float]:
    """Largest radius [m] in each level, the finest first: one level, or only those that hold balls.

    The number of candidates that a level's balls look at goes with the number of balls in a level and the size of its cells.
    """
    largest, smallest = float(np.max(radius)), float(np.min(radius))
    step = max(LEVEL_STEP, (largest / smallest) ** (1.0 / MOST_LEVELS) * (1.0 + 1e-9))
    order = np.sort(radius)
    bounds: list[float] = []
    while len(order):
        bounds.insert(0, float(order[-1]))
        order = order[: np.searchsorted(order, bounds[0] / step)]
    balls = np.bincount(np.searchsorted(bounds, radius), minlength=len(bounds)) / len(radius)
    load = balls * (np.array(bounds) / largest) ** dim
    return bounds if float(balls @ np.cumsum(load[::-1])[::-1]) * FEWER_CANDIDATES < 1.0 else bounds[-1:]
