"""Received: the impulses that balls give the walls and colliders whose probes ask for them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.scene.probes import bodies_of

__all__ = ["Received"]


@ti.data_oriented
class Received:
    """`sum` (n times bodies) [N s]: what each ball gave each body since the last good state, so that threads need no atomics and
    single precision keeps its digits; `total` (bodies, dim), in float64, until then. scaled: a solve may take back part of what
    it gave (kernels.contacts.energy_limiter), from what stood in `mark`.
    """

    def __init__(self, model: Model, fields: Fields, scaled: bool) -> None:
        scene = model.scene
        bodies = bodies_of(scene)
        self.model, self.n, self.count, self.scaled = model, model.n, len(bodies), scaled
        self.total = np.zeros((self.count, model.dim))
        number = {body: k for k, body in enumerate(bodies)}
        planes = [number.get(("wall", k), -1) for k in range(len(scene.walls))]
        solids = [number.get(("collider", k), -1) for k in range(len(scene.colliders))]
        # number of each wall and each collider among the bodies, or -1
        self.plane = fields.integers(np.array([*planes, -1]))  # a field may not be empty
        self.solid = fields.integers(np.array([*solids, -1]))
        self.sum = fields.vectors(self.n * self.count, model.dim)
        if scaled:
            self.mark = fields.vectors(self.n * self.count, model.dim)

    @ti.func
    def add(self, i, body, p):
        """Ball i, which gets p, gives as much to a body; -1: nobody asked."""
        if body >= 0:
            self.sum[i * self.count + body] = self.sum[i * self.count + body] - p

    @ti.func
    def note(self, i):
        """Mark the start of the impulses of ball i that `scale` may change."""
        if ti.static(self.scaled):
            for e in range(i * self.count, (i + 1) * self.count):
                self.mark[e] = self.sum[e]

    @ti.func
    def scale(self, i, less):
        """Scale by 1 + less the impulses that ball i gave since `note`."""
        for e in range(i * self.count, (i + 1) * self.count):
            self.sum[e] = self.sum[e] + less * (self.sum[e] - self.mark[e])

    def keep(self) -> None:
        """The present state is good."""
        self.total = self.value()
        self.sum.fill(0)

    def restore(self) -> None:
        """Return to the state last kept."""
        self.sum.fill(0)

    def live(self) -> list[Any]:
        """Fields that a substep changes."""
        return [self.sum]

    def renew(self) -> None:
        """Take note that the values of `live` were put back."""

    def value(self) -> NDArray[np.float64]:
        """(bodies, dim) N s since the start."""
        given = self.sum.to_numpy()[: self.n * self.count].astype(np.float64)
        return self.total + given.reshape(self.n, self.count, self.model.dim).sum(axis=0)

    def stored(self) -> dict[str, NDArray]:
        """Arrays of the state last kept, by name."""
        return {"received": self.total}

    def put_back(self, stored: Mapping[str, NDArray]) -> None:
        """Take over what `stored` gave."""
        self.set(stored["received"])

    def set(self, total: NDArray[np.float64] | None) -> None:
        """Continue from a total (bodies, dim) [N s]; None: 0."""
        self.total = np.zeros_like(self.total) if total is None else total.copy()
        self.sum.fill(0)
