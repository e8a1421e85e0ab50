"""Elements: what exerts forces on balls besides gravity, springs and contacts. A further kind is a file like `bending.py`, a line
in each list here, and its kernels in the room `forces`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

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
