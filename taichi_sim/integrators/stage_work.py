"""StageWork: the energy that an unsolved rest of an implicit stage gives to each body; what another takes may not hide it."""

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.geometry.graph import components
from taichi_sim.integrators.free_bodies import Members, gas_surfaces
from taichi_sim.kernels.springs import newton_terms as parts
from taichi_sim.kernels.springs.law import GRAIN

__all__ = ["StageWork"]

GIVEN = 0.5  # of the energy that a step of the method takes: what its solution may give back


@ti.data_oriented
class StageWork:
    """Sums over the balls that springs or a gas join, not counting joints at pinned balls. Sets two numbers of kernels.implicit:
    EXCESS [J], what bodies are given beyond what they may, and GAINED, the largest part of a body's kinetic energy that it was
    given beyond what the method takes.

    worth: the part of the kinetic energy that is not rounding in the verdict on a solution.
    """

    def __init__(self, model: Model, fields: Fields, rounding: float, worth: float) -> None:
        scene, self.model = model.scene, model
        self.rounding, self.worth = rounding, worth
        joined = np.concatenate([scene.pairs[~scene.pinned[scene.pairs].any(axis=1)], gas_surfaces(scene)])
        members = Members(components(model.n, joined), np.flatnonzero(~scene.pinned))
        self.bodies, self.parts = len(members.count), members.parts
        self.member, self.begin, self.part = map(fields.integers, (members.member, members.begin, members.part))
        self.given, self.taken, self.kinetic = (fields.doubles(max(1, self.parts)) for _ in range(3))
        self.wide = self.given.dtype

    @ti.func
    def find(
        self,
        base: ti.template(),
        residual: ti.template(),
        first: ti.template(),
        bodies: ti.template(),
        number: ti.template(),
    ):
        """residual (n) [kg m/s] of the velocities base.v, which were `first` (n) before the stage; bodies: FreeBodies, whose
        means are those of this stage: what the residual gives counts in the frame of each."""
        for k in range(self.parts * GRAIN):
            if k % GRAIN == 0:
                c = k // GRAIN
                given, taken = ti.cast(0.0, self.wide), ti.cast(0.0, self.wide)
                kinetic = ti.cast(0.0, self.wide)
                for e in range(self.begin[c], self.begin[c + 1]):
                    i = self.member[e]
                    w = self.model.inverse_mass[i]
                    v = base[i].v
                    u, change = v - bodies.mean(i), v - first[i]
                    given -= ti.cast(residual[i].dot(u), self.wide)
                    taken += ti.cast(0.5 * change.dot(change) / w, self.wide)
                    kinetic += ti.cast(0.5 * u.dot(u) / w, self.wide)
                self.given[c] = given
                self.taken[c] = taken
                self.kinetic[c] = kinetic
        ti.loop_config(serialize=True)
        for _ in range(1):
            excess, gained = ti.cast(0.0, self.wide), ti.cast(0.0, self.wide)
            for b in range(self.bodies):
                given, taken = ti.cast(0.0, self.wide), ti.cast(0.0, self.wide)
                kinetic = ti.cast(0.0, self.wide)
                for c in range(self.part[b], self.part[b + 1]):
                    given += self.given[c]
                    taken += self.taken[c]
                    kinetic += self.kinetic[c]
                excess += ti.max(0.0, given - GIVEN * taken - self.rounding * kinetic)
                gain = given - taken
                if gain > self.worth * kinetic and gain > 0.0:
                    gained = ti.max(gained, gain / ti.max(gain, kinetic))
            number[parts.EXCESS] = excess
            number[parts.GAINED] = gained
