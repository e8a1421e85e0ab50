"""Planes: the walls of a scene, half spaces that balls stay out of."""

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.kernels.contacts.collision_groups import meets
from taichi_sim.kernels.contacts.nearby_colliders import FAR_GAP

__all__ = ["Planes"]


@ti.data_oriented
class Planes:
    """Walls as planes n . x = offset, with their materials and, where scenes have groups, the groups that they hold."""

    def __init__(self, model: Model, fields: Fields) -> None:
        walls = model.scene.walls
        self.model, self.count = model, len(walls)
        columns = {"normal": ti.types.vector(model.dim, fields.real), "offset": fields.real, "material": ti.i32}
        if model.has_groups:
            columns |= {"group": ti.i32, "mask": ti.i32}
        values = {name: np.array([getattr(wall, name) for wall in walls]) for name in columns}
        self.wall = fields.table(columns, self.count, values)

    @ti.func
    def gap(self, x, i, k):
        """Distance [m] from the surface of ball i at x to wall k, negative inside; far where they do not collide."""
        gap = self.wall[k].normal.dot(x) - self.wall[k].offset - self.model.radius[i]
        if ti.static(self.model.has_groups):
            if not meets(self.model.group[i], self.model.mask[i], self.wall[k].group, self.wall[k].mask):
                gap = FAR_GAP
        return gap
