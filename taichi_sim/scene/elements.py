"""Elements: what exerts forces on balls besides gravity, springs and contacts. A further kind is a file like `bending.py`, a line
in each list here, and its kernels in a file of the room `forces` that has its name."""

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
        return sum(element.count(self) for element in ELEMENTS if element.has_volume)

    def excluded_pairs(self: Any) -> NDArray[np.int32]:
        """Balls (p, 2) that do not collide, as a spring, a membrane, a solid or a brick joins them: each pair once, the lower
        ball first, sorted."""
        pairs = [np.sort(self.pairs, axis=1)]
        for corners in (element.corners(self) for element in ELEMENTS if element.excludes_contact):
            ends = corners[:, np.stack(np.triu_indices(corners.shape[1], 1), axis=1)]
            pairs.append(np.sort(ends.reshape(-1, 2), axis=1))
        return np.unique(np.concatenate(pairs), axis=0)

    def joined(self: Any) -> NDArray[np.bool_]:
        """Mask (n,) of the balls that belong to a spring or to an element."""
        joined = np.zeros(self.n_balls, dtype=bool)
        for balls in (self.pairs, *(element.corners(self) for element in ELEMENTS)):
            joined[balls] = True
        return joined

    def loose(self: Any) -> NDArray[np.bool_]:
        """Mask (n,) of the balls that are not pinned and belong to no body, spring or element."""
        return ~self.pinned & (self.body == 0) & ~self.joined()  # type: ignore[no-any-return]
