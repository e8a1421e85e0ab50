"""Springs, and the sticks among them that balls bounce off."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.scene.columns import Column

__all__ = ["SpringMethods"]


class SpringMethods:
    """The part of a Scene that holds springs."""

    pairs = Column("springs", "pairs", "(m, 2) the balls of each spring", (2,), np.int32)
    stiffness = Column("springs", "stiffness", "(m,) N/m")
    damping = Column("springs", "damping", "(m,) N s/m")
    rest_length = Column("springs", "rest_length", "(m,) m")
    collides = Column("springs", "collides", "(m,) bool; True: a stick that balls bounce off", dtype=bool)
    break_strain = Column("springs", "break_strain", "(m,) strain at which it tears; inf: never")

    @property
    def n_springs(self: Any) -> int:
        """Number of springs, sticks included."""
        return self.tables["springs"].rows  # type: ignore[no-any-return]

    def add_springs(
        self: Any,
        pairs: ArrayLike,
        *,
        stiffness: ArrayLike,
        damping: ArrayLike = 0.0,
        rest_length: ArrayLike | None = None,
        collides: bool | Sequence[bool] | NDArray = False,
        break_strain: ArrayLike | None = None,
    ) -> NDArray[np.int32]:
        """Add m springs and return their indices, shape (m,).

        Args:
            pairs: (m, 2) ball indices, or one pair.
            stiffness: one or one per spring, >= 0 [N/m]; damping: along the spring, one or one per spring, >= 0 [N s/m].
            rest_length: one or one per spring, >= 0 [m]; None: the present distance.
            collides: True makes it a stick that balls bounce off; one or one per spring.
            break_strain: (length - rest_length) / rest_length at which it tears for good, > 0 [1]; None or inf: never.
        """
        ij = validation.indices("springs.pairs", validation.many(pairs, 1), self.n_balls, width=2)
        m = len(ij)
        says = "joins a ball to itself; give two different balls"
        validation.require("springs.pairs", ij, ij[:, 0] != ij[:, 1], says=says)
        optional = validation.given(rest_length=rest_length)
        columns: dict[str, NDArray] = {
            "pairs": ij,
            **validation.amounts("springs", m, stiffness=stiffness, damping=damping, **optional),
            "collides": validation.flags("springs.collides", collides, m),
            "break_strain": validation.limits("springs.break_strain", break_strain, m, positive=True),
        }
        if rest_length is None:
            columns["rest_length"] = np.linalg.norm(self.position[ij[:, 1]] - self.position[ij[:, 0]], axis=1)
        _may_tear(columns["collides"], columns["break_strain"], columns["rest_length"])
        return self.tables["springs"].append(m, **columns)  # type: ignore[no-any-return]

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

    def set_springs(
        self: Any,
        springs: Any = slice(None),
        *,
        stiffness: ArrayLike | None = None,
        damping: ArrayLike | None = None,
        rest_length: ArrayLike | None = None,
        break_strain: ArrayLike | None = None,
    ) -> None:
        """Change springs that were added before; what is left None stays.

        Args:
            springs: indices (k,), a bool for each spring of the scene, or a slice; all by default.
            stiffness, damping, rest_length, break_strain: as for `add_springs`, of these k springs.
        """
        index = validation.rows("springs", springs, self.n_springs)
        k = len(index)
        given = validation.given(stiffness=stiffness, damping=damping, rest_length=rest_length)
        new = validation.amounts("springs", k, **given)
        if break_strain is not None:
            new["break_strain"] = validation.limits("springs.break_strain", break_strain, k, positive=True)
        _may_tear(
            self.collides[index],
            new.get("break_strain", self.break_strain[index]),
            new.get("rest_length", self.rest_length[index]),
        )
        self.tables["springs"].replace(index, **new)


def _may_tear(collides: NDArray[np.bool_], strain: NDArray[np.float64], rest_length: NDArray[np.float64]) -> None:
    """Raise SceneError for the first spring (k,) that cannot tear at its strain."""
    both = collides & np.isfinite(strain)
    validation.require("springs.break_strain", ..., ~both, says="a stick, which collides, cannot tear")
    validation.strained(strain, rest_length)
