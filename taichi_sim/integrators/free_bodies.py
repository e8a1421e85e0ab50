"""Free bodies: balls that springs or a gas join, none of them pinned. What a solver leaves of their momentum is given to them
whole."""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.geometry.graph import components
from taichi_sim.kernels.springs.law import GRAIN, PART
from taichi_sim.scene.scene import Scene

__all__ = ["FreeBodies", "Members", "gas_surfaces"]


def gas_surfaces(scene: Scene) -> NDArray[np.int64]:
    """Pairs of balls (k, 2) that the gases of a scene join."""
    pairs = [np.stack([np.full(g.triangles.size, g.triangles[0, 0]), g.triangles.ravel()], axis=1) for g in scene.gases]
    return np.concatenate([np.zeros((0, 2), dtype=np.int64), *pairs])


class Members:
    """The `chosen` balls in the order of their bodies, for sums over bodies in parts of at most PART balls: `member` (k,), and
    how many each body has, `count`; part c begins at `begin[c]`, body b at `part[b]`."""

    def __init__(self, label: NDArray[np.integer], chosen: NDArray[np.integer]) -> None:
        self.member = chosen[np.argsort(label[chosen], kind="stable")]
        first, self.count = np.unique(label[self.member], return_index=True, return_counts=True)[1:]
        begins = [np.arange(f, f + c, PART) for f, c in zip(first, self.count)]
        self.parts = sum(len(b) for b in begins)
        self.begin = np.append(np.concatenate([*begins, [0]])[:-1], len(self.member))
        self.part = np.append(0, np.cumsum([len(b) for b in begins])).astype(np.int32)


@ti.data_oriented
class FreeBodies:
    """Shifts the velocities of each free body together, so that its momentum is what it should be: conjugate gradients find
    this, the softest of all modes, last."""

    def __init__(self, model: Model, fields: Fields) -> None:
        scene = model.scene
        label = components(model.n, np.concatenate([scene.pairs, gas_surfaces(scene)]))
        held = np.zeros(model.n, dtype=bool)
        held[label[scene.pinned]] = True
        single = np.bincount(label, minlength=model.n) == 1  # solved exactly anyway
        free = np.flatnonzero(~held[label] & ~single[label])
        members = Members(label, free)
        member, count = members.member, members.count
        self.dim, self.members, self.bodies, self.parts = model.dim, len(member), len(count), members.parts
        self.member = fields.integers(member)
        self.body_of = fields.integers(np.repeat(np.arange(len(count)), count))
        self.begin, self.part = fields.integers(members.begin), fields.integers(members.part)
        mass = np.bincount(np.repeat(np.arange(len(count)), count), scene.mass[member], len(count))
        self.mass = fields.reals(mass if len(mass) else 1)
        self.inverse_mass = model.inverse_mass
        self.sum = fields.doubles(max(1, self.parts) * self.dim)
        self.wide = self.sum.dtype
        self.shift = fields.vectors(max(1, self.bodies), self.dim)
        body_of_ball = np.full(model.n, -1)
        body_of_ball[member] = np.repeat(np.arange(len(count)), count)
        self.body_of_ball = fields.integers(body_of_ball)

    @ti.func
    def _collect(self, table: ti.template(), aim: ti.template(), part):
        """shift = the momentum that each body has by the velocities `aim` (n), less `part` of what table.v gives it, over its
        mass. A sum of its springs' impulses would be off by the rounding of large numbers."""
        for k in range(self.parts * GRAIN):
            if k % GRAIN == 0:
                c = k // GRAIN
                total = ti.Vector.zero(self.wide, self.dim)
                for e in range(self.begin[c], self.begin[c + 1]):
                    i = self.member[e]
                    w = ti.cast(self.inverse_mass[i], self.wide)
                    for a in ti.static(range(self.dim)):
                        total[a] += (ti.cast(aim[i][a], self.wide) - part * ti.cast(table[i].v[a], self.wide)) / w
                for a in ti.static(range(self.dim)):
                    self.sum[c * self.dim + a] = total[a]
        for k in range(self.bodies):
            total = ti.Vector.zero(self.wide, self.dim)
            for c in range(self.part[k], self.part[k + 1]):
                for a in ti.static(range(self.dim)):
                    total[a] += self.sum[c * self.dim + a]
            self.shift[k] = ti.cast(total, float) / self.mass[k]

    @ti.func
    def share(self, table: ti.template(), aim: ti.template()):
        """Velocities table.v of each body += what gives it the momentum that the velocities `aim` (n) [m/s] have: they know
        nothing of its springs, which give it none."""
        self._collect(table, aim, 1.0)
        for e in range(self.members):
            i = self.member[e]
            table[i].v = table[i].v + self.shift[self.body_of[e]]

    @ti.func
    def find_means(self, table: ti.template(), aim: ti.template()):
        """The velocity of each body's centre of mass by `aim`, for `mean`; until the next `share`."""
        self._collect(table, aim, 0.0)

    @ti.func
    def mean(self, i):
        """Of the body of ball i; 0 where it is held."""
        v = ti.Vector.zero(float, self.dim)
        k = self.body_of_ball[i]
        if k >= 0:
            v = self.shift[k]
        return v
