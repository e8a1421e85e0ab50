"""Tearing: springs that break for good where they are stretched too far."""

from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from taichi_sim.fields import Fields
from taichi_sim.forces.springs import Springs
from taichi_sim.model import Model

__all__ = ["Tearing"]


@ti.data_oriented
class Tearing:
    """Looks at all springs after each substep; those longer than `limit` [m] lose their stiffness and damping.

    `torn` (as the springs are stored) marks them; `kept`: the same in the last state known to be good.
    """

    def __init__(self, model: Model, springs: Springs, fields: Fields) -> None:
        scene = model.scene
        self.springs, self.n, self.m = springs, model.n, scene.n_springs
        springs.tearing = self
        number = springs.number
        tears = np.isfinite(scene.break_strain)
        limit = np.full(self.m, np.inf)  # also of what has no length at rest
        limit[tears] = scene.rest_length[tears] * (1.0 + scene.break_strain[tears])
        self._real = np.float64 if fields.real == ti.f64 else np.float32
        # a number that is larger than any length, but not infinite, which single precision would refuse
        stored = np.where(number < 0, np.inf, limit[number])
        self.limit = fields.reals(np.minimum(stored, 1e30))
        self.torn, self.kept = fields.integers(springs.padded), fields.integers(springs.padded)
        self.stiffness = np.where(number < 0, 0.0, scene.stiffness[number])

    @ti.func
    def look(self, ball: ti.template()):
        """Mark and cut what is too long. Where both balls list a spring, both come to the same."""
        for i in range(self.n):
            for e in range(self.springs.start[i], self.springs.start[i + 1]):
                place = e
                if ti.static(self.springs.order == "waves"):
                    place = self.springs.place[e]
                r = ball[self.springs.spring[place].other].x - ball[i].x
                if r.dot(r) > self.limit[place] * self.limit[place]:
                    self._cut(place)

    @ti.func
    def _cut(self, place):
        self.torn[place] = 1
        self.springs.spring[place].stiffness = 0.0
        if ti.static(self.springs.damped):
            self.springs.spring[place].damping = 0.0

    def keep(self) -> None:
        """Remember the present state as good."""
        self.kept.copy_from(self.torn)

    def restore(self) -> None:
        """Return to the state last kept."""
        if not np.array_equal(self.torn.to_numpy(), self.kept.to_numpy()):
            self._set(self.kept.to_numpy())

    def _set(self, torn: NDArray[Any]) -> None:
        self.torn.from_numpy(torn)
        self.springs.spring.stiffness.from_numpy(np.where(torn > 0, 0.0, self.stiffness).astype(self._real))
        self.springs.set_damping(self.springs.given)

    def whole(self) -> NDArray[np.bool_]:
        """Which of the springs, as they are stored, are not torn."""
        return self.torn.to_numpy() == 0

    @property
    def springs_torn(self) -> NDArray[np.bool_]:
        """(m,) in the scene's order."""
        torn = np.zeros(self.m, dtype=bool)
        number = self.springs.number
        torn[number[number >= 0]] = self.torn.to_numpy()[number >= 0] > 0
        return torn

    def tear(self, torn: NDArray[np.bool_]) -> None:
        """Take over which springs (m,) are torn, from a file or from before lists grew."""
        number = self.springs.number
        self._set(np.where(number < 0, 0, torn[number]).astype(np.int32))
        self.keep()
