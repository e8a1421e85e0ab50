"""Elements: what exerts forces on balls besides gravity, springs and contacts. A further kind is a file like `bending.py`, a line
in each list here, and its kernels in the room `forces`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.scene.bending import BENDING, BendingMethods
from taichi_sim.scene.bricks import BRICKS, BrickMethods
from taichi_sim.scene.cells import CELLS, CellMethods
from taichi_sim.scene.gases import GASES, GasMethods
from taichi_sim.scene.membranes import MEMBRANES, MembraneMethods
from taichi_sim.scene.part import Element
from taichi_sim.scene.solids import SOLIDS, SolidMethods
from taichi_sim.scene.wind import WIND, WindMethods

__all__ = ["ELEMENTS", "Elements"]

ELEMENTS: tuple[Element, ...] = (MEMBRANES, CELLS, BRICKS, SOLIDS, BENDING, GASES, WIND)


class Elements(MembraneMethods, CellMethods, BrickMethods, SolidMethods, BendingMethods, GasMethods, WindMethods):
    """The part of a Scene that holds them; every `add_` raises SceneError and then changes nothing."""

    def has_elements(self) -> bool:
        """True if forces besides gravity, springs and contacts act."""
        return any(element.acts(self) for element in ELEMENTS)

    def n_volumes(self: Any) -> int:
        """Number of cells, bricks and solids, which can be turned inside out."""
        return len(self.cells) + len(self.bricks) + len(self.solids)

    def joined(self: Any) -> NDArray[np.bool_]:
        """Mask (n,) of the balls that belong to a spring or to an element."""
        joined = np.zeros(self.n_balls, dtype=bool)
        for balls in (self.pairs, *(element.corners(self) for element in ELEMENTS)):
            joined[balls] = True
        return joined

    def loose(self: Any) -> NDArray[np.bool_]:
        """Mask (n,) of the balls that are not pinned and belong to no body, spring or element."""
        return ~self.pinned & (self.body == 0) & ~self.joined()  # type: ignore[no-any-return]

    def attach(
        self: Any,
        one: ArrayLike,
        other: ArrayLike,
        *,
        stiffness: ArrayLike,
        damping: ArrayLike = 0.0,
        rest_length: ArrayLike | None = None,
        break_strain: ArrayLike | None = None,
    ) -> NDArray[np.int32]:
        """Join balls of two objects, the k-th of `one` to the k-th of `other`, and return the springs, shape (k,).

        Args:
            one, other: (k,) balls. Those that a spring joins do not collide.
            stiffness: one or one per spring, >= 0 [N/m]; damping: along the spring, one or one per spring, >= 0 [N s/m].
            rest_length: one or one per spring, >= 0 [m]; None: the present distance.
            break_strain: strain at which it tears for good, > 0 [1]; None: never.
        """
        a = validation.indices("attachments.one", np.atleast_1d(validation.as_array(one)), self.n_balls)
        b = validation.indices("attachments.other", np.atleast_1d(validation.as_array(other)), self.n_balls)
        if len(a) != len(b):
            says = f"names {len(b)} balls and attachments.one {len(a)}; each needs its partner"
            raise SceneError("attachments.other", says=says)
        return self.add_springs(
            np.stack([a, b], axis=1),
            stiffness=stiffness,
            damping=damping,
            rest_length=rest_length,
            break_strain=break_strain,
        )
