"""Bending: elements of four balls that resist curvature."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.scene.columns import Column
from taichi_sim.scene.part import Columns, Element, Quadratic

__all__ = ["BENDING", "BendingMethods"]


class BendingMethods:
    """The part of a Scene that holds bending elements."""

    bends = Column("bending", "corners", "(b, 4) balls of each bending element", (4,), np.int32)
    bend_weights = Column("bending", "weights", "(b, 4) sum 0 for each", (4,))
    bend_stiffness = Column("bending", "stiffness", "(b,) N/m")
    bend_damping = Column("bending", "damping", "(b,) N s/m")
    bend_hinge = Column("bending", "hinge", "(b,) bool; True: of two sides, one of which may be held", dtype=bool)

    def add_bending(
        self: Any,
        corners: ArrayLike,
        *,
        weights: ArrayLike,
        stiffness: ArrayLike,
        damping: ArrayLike = 0.0,
        hinge: bool | Sequence[bool] | NDArray = False,
    ) -> None:
        """Add b bending elements: forces -w_i sum_j w_j (stiffness x_j + damping v_j) on four balls each.

        The energy is stiffness |sum w_j x_j|^2 / 2, 0 where the element is flat; quadratic, so its force is linear (Bergou et
        al. 2006, "A quadratic bending model for inextensible surfaces"). An element of a rod through balls a, b, c has the
        corners (b, b, a, c) and the weights (-1, -1, 1, 1).

        Args:
            corners: (b, 4) balls; weights: (b, 4) of them [1], the sum of each row 0.
            stiffness: one or one per element, >= 0 [N/m]; damping: one or one per element, >= 0 [N s/m].
            hinge: one or one per element: corners 0 and 1 are the hinge between two sides of a rod or sheet, corners 2 and 3
                their far ends. A side whose balls are all pinned cannot bend. The other one then bears the whole change of
                angle over its own length, so stiffness and damping rise to those of that side: twice, for equal sides. A rod
                or sheet is thus clamped exactly at its last pinned balls. A free corner of the hinge that bears next to none
                of its weight does not count.
        """
        ij = validation.indices("bending.corners", validation.many(corners, 1), self.n_balls, width=4)
        w = validation.vectors("bending.weights", validation.many(weights, 1), None, 4)
        if w.shape != ij.shape:
            says = f"shape {w.shape} does not fit; it must be {ij.shape}, as corners"
            raise SceneError("bending.weights", says=says)
        good = np.abs(w.sum(axis=1)) <= 1e-9 * np.abs(w).max(axis=1, initial=1e-300)
        validation.require("bending.weights", w, good, "four numbers whose sum is 0")
        columns = validation.amounts("bending", len(ij), stiffness=stiffness, damping=damping)
        sides = validation.flags("bending.hinge", hinge, len(ij))
        good = ~sides | (w[:, 2] * w[:, 3] > 0.0)
        validation.require("bending.weights", w, good, "of a hinge: the last two of one sign, and not 0")
        self.tables["bending"].append(len(ij), corners=ij, weights=w, hinge=sides, **columns)

    def held_bending(self: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Stiffness (b,) [N/m] and damping (b,) [N s/m] of the bending elements as they act with the present pins, see
        `add_bending`. The two sides of a hinge are as long as the inverse weights of their far ends. They meet between its
        corners, nearer to the one of more weight. A side counts as held by twice the part of that weight which is held, less 1;
        the other one must be free."""
        held, weights = self.pinned[self.bends], self.bend_weights
        hinge = weights[:, :2].sum(axis=1)
        share = np.divide((weights * held)[:, :2].sum(axis=1), hinge, out=np.zeros(len(hinge)), where=hinge != 0.0)
        fixed = np.where(self.bend_hinge, np.clip(2.0 * share - 1.0, 0.0, 1.0), 0.0)
        size = np.abs(weights[:, [3, 2]])  # of side 2 and 3, as 1 / w2 : 1 / w3
        one = held[:, 2:] & ~held[:, [3, 2]]  # held by its end, while the other side's is free
        free = size.sum(axis=1) - fixed * (one * size).sum(axis=1)
        rise = np.divide(size.sum(axis=1), free, out=np.ones(len(free)), where=free > 0.0)
        return self.bend_stiffness * rise, self.bend_damping * rise

    def set_bending(self: Any, *, stiffness: ArrayLike | None = None, damping: ArrayLike | None = None) -> None:
        """Change all b bending elements: stiffness [N/m], damping [N s/m], one or one per element; what is left None stays."""
        new = validation.amounts("bending", len(self.bends), **validation.given(stiffness=stiffness, damping=damping))
        self.tables["bending"].replace(slice(None), **new)


class _Bending(Columns, Element):
    name, method, counted, title = "bending", "add_bending", ("corners",), "bends"
    is_implicit = is_linear = True
    work = 4
    features: ClassVar = {"damping of bends": lambda scene: np.any(scene.bend_damping > 0)}

    def energies(self, scene: Any, x: NDArray[np.float64], whole: NDArray[np.bool_]) -> list[float]:
        curve = np.einsum("bk,bki->bi", scene.bend_weights, x[scene.bends] - x[scene.bends[:, :1]])
        return [0.5 * float(np.sum((scene.held_bending()[0] * np.sum(curve**2, axis=1))[whole]))]

    def stiffness(self, scene: Any) -> list[Quadratic]:
        """Exact: it is linear."""
        return [Quadratic(scene.bends, scene.bend_weights[:, :, None], scene.held_bending()[0])]

    def damping(self, scene: Any) -> list[Quadratic]:
        return [Quadratic(scene.bends, scene.bend_weights[:, :, None], scene.held_bending()[1])]


BENDING = _Bending()
