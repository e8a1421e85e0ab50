"""Grid: the spatial hash of all balls, rebuilt where they are now."""

import numpy as np
import taichi as ti

from taichi_sim.fields import Fields
from taichi_sim.kernels import grid as loops
from taichi_sim.model import Model

__all__ = ["Grid"]


BUCKETS_PER_BALL = 4  # with fewer, other rows share the buckets and every ball looks at twice as many candidates
SKIN = 0.15  # of each radius
PART = 1024  # balls whose box one thread measures at a time


@ti.data_oriented
class Grid:
    """Cells as wide as the largest ball, so that every pair that may touch lies in neighbouring rows. Memory is O(balls).

    Pairs are looked for with radii enlarged by `skin` + `gap` times, and stay listed until some ball has moved by `skin` times
    its own radius: two balls that are not listed cannot have met before. Small balls among large ones list few neighbours so.
    Nothing is looked for while cells hold more than `most` pairs.
    """

    def __init__(self, model: Model, fields: Fields, skin: float, gap: float, most: int) -> None:
        self.model = model
        self.n, self.dim = model.n, model.dim
        largest = float(np.max(model.scene.radius))
        self.skin, self.enlarged = skin, 1.0 + skin + gap
        self.margin = 1.001  # for rounded coordinates
        self.inverse_cell = 1.0 / (2.0 * largest * self.enlarged * self.margin)
        self.largest, self.width = largest, 1.0 / self.inverse_cell
        self.size = max(64, 1 << int(np.ceil(np.log2(max(1, BUCKETS_PER_BALL * self.n)))))
        self.mask = self.size - 1
        self.chunk = 64 if self.size < 4096 else 1024
        self.count = fields.integers(self.size)
        self.start = fields.integers(self.size + 1)
        self.partial = fields.integers(self.size // self.chunk)
        self.bucket = fields.integers(self.n)
        self.order = fields.integers(self.n)
        self.origin = fields.vectors(self.n, model.dim)
        self.stale, self.work, self.searches = fields.integers(1), fields.integers(3), fields.integers(1)
        self.crowd, self.worst = fields.reals(1), fields.reals(1)  # pairs in crowded cells: in the last search, in any
        self.most = fields.reals(np.array([float(most)]))
        self.part = PART
        self.parts = -(-self.n // PART)
        self.low, self.high = (fields.cells(self.parts, model.dim) for _ in range(2))
        self.corner, self.pitch, self.dense = fields.integers(model.dim), fields.integers(model.dim), fields.integers(1)
        vector = ti.types.vector(model.dim, fields.real)
        self.copy = fields.table({"x": vector, "radius": fields.real}, self.n)

    @ti.func
    def expire(self):
        """Ask for a new search, whatever has moved."""
        ti.loop_config(serialize=True)
        for _ in range(1):
            self.stale[0] = 1

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
        loops.plan(self)
        loops.build(ball, self)
