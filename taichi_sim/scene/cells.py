"""Cells: tetrahedra, in 2D triangles, that keep their volume."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.scene.columns import Column
from taichi_sim.scene.part import Columns, Element, Quadratic

__all__ = ["CELLS", "CRUSHED", "CellMethods", "cell_volumes"]

Floats = NDArray[np.float64]
CRUSHED = 0.5  # of its rest volume: a cell that has less resists with its crush modulus, too
FLAT_CELL = 1e-9  # of the cube of its longest edge: a cell of less volume is flat
ROOM = 2.0  # times the stiffness at rest: cells that are stretched by a fifth in all directions


class CellMethods:
    """The part of a Scene that holds cells."""

    cells = Column("cells", "corners", "(c, dim + 1) balls of each cell", ("dim + 1",), np.int32)
    bulk_modulus = Column("cells", "bulk_modulus", "(c,) Pa, in 2D N/m")
    crush_modulus = Column(
        "cells", "crush_modulus", "(c,) Pa, in 2D N/m, of cells of less than half of their rest volume"
    )
    rest_volume = Column("cells", "rest_volume", "(c,) m^3, in 2D m^2; positive")
    cells_together = Column("cells", "together", "(c,) a number that cells in one have, or -1", dtype=np.int32)

    def cells_act(self) -> bool:
        """True if any cell exerts a force; others are only watched, see `Simulation.inverted`."""
        return bool(self.bulk_modulus.any() or self.crush_modulus.any())

    def add_cells(
        self: Any,
        corners: ArrayLike,
        *,
        bulk_modulus: ArrayLike,
        crush_modulus: ArrayLike = 0.0,
        rest_volume: ArrayLike | None = None,
        together: ArrayLike | None = None,
    ) -> NDArray[np.int32]:
        """Add c cells that resist a change of volume and return their indices, shape (c,).

        A cell, a tetrahedron in 3D and a triangle in 2D, stores bulk_modulus V0 (V / V0 - 1)^2 / 2, V with its sign: one that
        is turned inside out is driven back through flatness. Below half of its rest volume it stores besides crush_modulus V0
        (V / V0 - 1/2)^2 / 2.

        Args:
            corners: (c, dim + 1) balls, or one cell, in any order.
            bulk_modulus: one or one per cell, >= 0 [Pa, in 2D N/m].
            crush_modulus: one or one per cell, >= 0 [Pa, in 2D N/m]: keeps cells from being crushed, and does not change how they
                respond to small strains.
            rest_volume: V0, one or one per cell, > 0 [m^3, in 2D m^2]; None: the present volume, whose orientation then counts as
                positive.
            together: (c,) whole numbers: cells with the same one, from 0 on, resist a change of their volumes' sum alone, as one
                of their mean modulus; -1 or None: each its own.
        """
        ij = validation.corners("cells.corners", corners, self.n_balls, self.dim + 1)
        c = len(ij)
        moduli = validation.amounts("cells", c, bulk_modulus=bulk_modulus, crush_modulus=crush_modulus)
        present = cell_volumes(self.position, ij)
        if rest_volume is None:
            edge = np.abs(self.position[ij] - self.position[ij[:, :1]]).max(axis=(1, 2), initial=0.0)
            says = "is flat now; give a rest_volume, or corners that span a volume"
            validation.require("cells.corners", ij, np.abs(present) > FLAT_CELL * edge**self.dim, says=says)
            ij[present < 0] = ij[present < 0][:, [1, 0, *range(2, self.dim + 1)]]
            rest = np.abs(present)
        else:
            rest = validation.per_item("cells.rest_volume", rest_volume, c, positive=True)
        shared = validation.per_item("cells.together", -1 if together is None else together, c, low=-1)
        validation.require("cells.together", shared, shared == np.round(shared), "a whole number")
        before = int(self.cells_together.max(initial=-1)) + 1
        shared = np.where(shared < 0, -1, shared + before).astype(np.int32)
        return self.tables["cells"].append(c, corners=ij, rest_volume=rest, together=shared, **moduli)  # type: ignore[no-any-return]


class _Cells(Columns, Element):
    name, method, counted = "cells", "add_cells", ("corners",)
    assumed: ClassVar = {"together": -1}
    is_implicit = has_volume = True
    work = 4
    features: ClassVar = {"cells that act": lambda scene: scene.cells_act()}

    def acts(self, scene: Any) -> bool:
        return bool(scene.cells_act())

    def energies(self, scene: Any, x: Floats, whole: NDArray[np.bool_]) -> list[float]:
        cells = np.where(scene.cells_together < 0, np.arange(len(scene.cells)), len(scene.cells) + scene.cells_together)
        one = np.unique(cells, return_inverse=True)[1]
        volume = np.bincount(one, cell_volumes(x, scene.cells) * whole)
        rest = np.bincount(one, scene.rest_volume * whole)
        part = np.divide(volume, rest, out=np.ones_like(rest), where=rest > 0)
        terms = ((scene.bulk_modulus, part - 1.0), (scene.crush_modulus, np.minimum(part - CRUSHED, 0.0)))
        return [
            0.5 * float(np.sum(np.bincount(one, modulus * scene.rest_volume * whole) * strain**2))
            for modulus, strain in terms
        ]

    def stiffness(self, scene: Any) -> list[Quadratic]:
        """Quadratic forms by the gradients of volumes at rest, with room for stretching."""
        strength = (ROOM * scene.bulk_modulus + scene.crush_modulus) / scene.rest_volume
        return [Quadratic(scene.cells, _gradients(scene), strength)]


CELLS = _Cells()


def cell_volumes(x: NDArray, corners: NDArray) -> NDArray[np.float64]:
    """Signed volumes (c,) [m^3, in 2D m^2] of tetrahedra (triangles) with `corners` (c, dim + 1) at x (n, dim) [m]."""
    sides = x[corners[:, 1:]] - x[corners[:, :1]]
    if x.shape[1] == 2:
        return 0.5 * (sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    return np.einsum("ci,ci->c", sides[:, 0], np.cross(sides[:, 1], sides[:, 2])) / 6.0


def _gradients(scene: Any) -> Floats:
    """Gradients (c, dim + 1, dim) of each cell's volume, scaled to its volume at rest."""
    x = scene.position[scene.cells]
    if scene.dim == 2:
        sides = [x[:, (k + 2) % 3] - x[:, (k + 1) % 3] for k in range(3)]
        gradient = 0.5 * np.stack([np.stack([-s[:, 1], s[:, 0]], axis=1) for s in sides], axis=1)
        now = 0.5 * np.abs(np.linalg.det(x[:, 1:] - x[:, :1]))
    else:
        faces = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))
        normals = [np.cross(x[:, b] - x[:, a], x[:, c] - x[:, a]) for a, b, c in faces]
        gradient = np.stack(normals, axis=1) / -6.0
        now = np.abs(np.linalg.det(x[:, 1:] - x[:, :1])) / 6.0
    # the rest shape is not known, only its volume: the present one, as much larger or smaller
    ratio = np.divide(scene.rest_volume, now, out=np.ones_like(now), where=now > 0)
    return gradient * ratio[:, None, None] ** ((scene.dim - 1) / scene.dim)
