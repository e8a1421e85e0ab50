"""Bodies: balls that springs, elements or a gas join. What a solver leaves of the momentum of free ones is given to them whole,
and what it leaves of the energy of any is known."""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.geometry.graph import components
from taichi_sim.kernels.reductions import LONG_PART, each_part
from taichi_sim.scene.scene import Scene

__all__ = ["FreeBodies", "StageWork"]

GIVEN_PART = 0.5  # of the energy that a step of the method takes: what its solution may give back


def _gas_surfaces(scene: Scene) -> NDArray[np.int64]:
    """Pairs of balls (k, 2) that the gases of a scene join."""
    pairs = [np.stack([np.full(g.triangles.size, g.triangles[0, 0]), g.triangles.ravel()], axis=1) for g in scene.gases]
    return np.concatenate([np.zeros((0, 2), dtype=np.int64), *pairs])


class _Members:
    """The `chosen` balls in the order of their bodies, for sums over bodies in parts of at most LONG_PART balls: `member` (k,),
    and how many each body has, `count`; part c begins at `begin[c]`, body b at `part[b]`."""

    def __init__(self, label: NDArray[np.integer], chosen: NDArray[np.integer]) -> None:
        self.member = chosen[np.argsort(label[chosen], kind="stable")]
        first, self.count = np.unique(label[self.member], return_index=True, return_counts=True)[1:]
        begins = [np.arange(f, f + c, LONG_PART) for f, c in zip(first, self.count)]
        self.parts = sum(len(b) for b in begins)
        self.begin = np.append(np.concatenate([*begins, [0]])[:-1], len(self.member))
        self.part = np.append(0, np.cumsum([len(b) for b in begins])).astype(np.int32)


@ti.data_oriented
class FreeBodies:
    """Shifts the velocities of each free body together, so that its momentum is what it should be: conjugate gradients find
    this, the softest of all modes, last. ties: (k, 2) balls that elements join."""

    def __init__(self, model: Model, ties: NDArray, fields: Fields) -> None:
        scene = model.scene
        label = components(model.n, np.concatenate([scene.pairs, ties, _gas_surfaces(scene)]))
        tied = np.zeros(model.n, dtype=bool)
        tied[label[scene.pinned]] = True
        single = np.bincount(label, minlength=model.n) == 1  # solved exactly anyway
        free = np.flatnonzero(~tied[label] & ~single[label])
        members = _Members(label, free)
        member, count = members.member, members.count
        self.dim, self.members, self.bodies, self.parts = model.dim, len(member), len(count), members.parts
        self.member = fields.integers(member)
        self.body_of = fields.integers(np.repeat(np.arange(len(count)), count))
        self.begin, self.part = fields.integers(members.begin), fields.integers(members.part)
        mass = np.bincount(np.repeat(np.arange(len(count)), count), scene.mass[member], len(count))
        self.mass = fields.reals(mass if len(mass) else 1)
        self.inverse_mass = model.inverse_mass
        self.sum = fields.doubles(max(1, self.parts) * self.dim)
        self.wide = fields.wide
        self.shift = fields.vectors(max(1, self.bodies), self.dim)
        body_of_ball = np.full(model.n, -1)
        body_of_ball[member] = np.repeat(np.arange(len(count)), count)
        self.body_of_ball = fields.integers(body_of_ball)

    @ti.func
    def _collect(self, table: ti.template(), target: ti.template(), part):
        """shift = the momentum that each body has by the velocities `target` (n), less `part` of what table.v gives it, over its
        mass. A sum of its springs' impulses would be off by the rounding of large numbers."""
        each_part(self.parts, self._collect_part, (table, target, part))
        for k in range(self.bodies):
            total = ti.Vector.zero(self.wide, self.dim)
            for c in range(self.part[k], self.part[k + 1]):
                for a in ti.static(range(self.dim)):
                    total[a] += self.sum[c * self.dim + a]
            self.shift[k] = ti.cast(total, float) / self.mass[k]

    @ti.func
    def _collect_part(self, c, table: ti.template(), target: ti.template(), part):
        total = ti.Vector.zero(self.wide, self.dim)
        for e in range(self.begin[c], self.begin[c + 1]):
            i = self.member[e]
            w = ti.cast(self.inverse_mass[i], self.wide)
            for a in ti.static(range(self.dim)):
                total[a] += (ti.cast(target[i][a], self.wide) - part * ti.cast(table[i].v[a], self.wide)) / w
        for a in ti.static(range(self.dim)):
            self.sum[c * self.dim + a] = total[a]

    @ti.func
    def share(self, table: ti.template(), target: ti.template()):
        """Velocities table.v of each body += what gives it the momentum that the velocities `target` (n) [m/s] have: they know
        nothing of its springs, which give it none."""
        self._collect(table, target, 1.0)
        for e in range(self.members):
            i = self.member[e]
            table[i].v = table[i].v + self.shift[self.body_of[e]]

    @ti.func
    def find_means(self, table: ti.template(), target: ti.template()):
        """The velocity of each body's centre of mass by `target`, for `mean`; until the next `share`."""
        self._collect(table, target, 0.0)

    @ti.func
    def mean(self, i):
        """Velocity [m/s] of the centre of mass of ball i's body; 0 where that has a pin. See `find_means`."""
        v = ti.Vector.zero(float, self.dim)
        k = self.body_of_ball[i]
        if k >= 0:
            v = self.shift[k]
        return v


@ti.data_oriented
class StageWork:
    """The energy that an unsolved rest of an implicit stage gives to each body; what another takes may not hide it. Joints at
    pinned balls do not count. Sets two of a stage's numbers: `excess` [J], what bodies are given beyond what they may, and
    `gained`, the largest part of a body's kinetic energy that it was given beyond what the method takes.

    ties: (k, 2) balls that elements join. worth: the part of the kinetic energy that is not rounding in the verdict on a
    solution.
    """

    def __init__(self, model: Model, ties: NDArray, fields: Fields, rounding: float, worth: float) -> None:
        scene, self.model = model.scene, model
        self.rounding, self.worth = rounding, worth
        ties = np.concatenate([scene.pairs, ties])
        joined = np.concatenate([ties[~scene.pinned[ties].any(axis=1)], _gas_surfaces(scene)])
        members = _Members(components(model.n, joined), np.flatnonzero(~scene.pinned))
        self.bodies, self.parts = len(members.count), members.parts
        self.member, self.begin, self.part = map(fields.integers, (members.member, members.begin, members.part))
        self.wide = fields.wide
        self.sum = fields.table(dict.fromkeys(("given", "taken", "kinetic"), self.wide), self.parts)  # J

    @ti.func
    def find(self, base: ti.template(), residual: ti.template(), first: ti.template(), bodies: ti.template(),
             number: ti.template()):  # fmt: skip
        """Residual (n) [kg m/s] of the velocities base.v, which were `first` (n) before the stage; bodies: FreeBodies, whose
        means are those of this stage: what the residual gives counts in the frame of each."""
        each_part(self.parts, self._find_part, (base, residual, first, bodies))
        ti.loop_config(serialize=True)
        for _ in range(1):
            excess = gained = ti.cast(0.0, self.wide)
            for b in range(self.bodies):
                given = taken = kinetic = ti.cast(0.0, self.wide)
                for c in range(self.part[b], self.part[b + 1]):
                    given += self.sum[c].given
                    taken += self.sum[c].taken
                    kinetic += self.sum[c].kinetic
                excess += ti.max(0.0, given - GIVEN_PART * taken - self.rounding * kinetic)
                gain = given - taken
                if gain > self.worth * kinetic and gain > 0.0:
                    gained = ti.max(gained, gain / ti.max(gain, kinetic))
            number[0].excess = excess
            number[0].gained = gained

    @ti.func
    def _find_part(self, c, base: ti.template(), residual: ti.template(), first: ti.template(), bodies: ti.template()):
        given = taken = kinetic = ti.cast(0.0, self.wide)
        for e in range(self.begin[c], self.begin[c + 1]):
            i = self.member[e]
            w = self.model.inverse_mass[i]
            v = base[i].v
            u, change = v - bodies.mean(i), v - first[i]
            given -= ti.cast(residual[i].dot(u), self.wide)
            taken += ti.cast(0.5 * change.dot(change) / w, self.wide)
            kinetic += ti.cast(0.5 * u.dot(u) / w, self.wide)
        self.sum[c].given = given
        self.sum[c].taken = taken
        self.sum[c].kinetic = kinetic
