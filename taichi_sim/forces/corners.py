"""Corners: elements of several balls, listed for each ball, so that each sums its own forces, without atomics."""

from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from taichi_sim.fields import Fields
from taichi_sim.model import Model

__all__ = ["corners"]


def corners(
    model: Model, fields: Fields, others: NDArray, own: NDArray, columns: dict[str, Any], data: dict[str, NDArray]
) -> tuple[Any, Any]:
    """Fields start (n + 1) and rows, those of ball i from start[i] to start[i + 1], in the order of the elements.

    own: (r,) the ball of each row; others: (r, k) the further balls of its element, as members "a", "b", ...; columns, data: what
    else a row holds, name to Taichi type and (r,) values.
    """
    order = np.argsort(own, kind="stable")
    start = np.zeros(model.n + 1, dtype=np.int32)
    np.cumsum(np.bincount(own, minlength=model.n), out=start[1:])
    names = "abc"[: others.shape[1]]
    typed = {**dict.fromkeys(names, ti.i32), **columns}
    values = {name: others[order, k] for k, name in enumerate(names)}
    values |= {name: value[order] for name, value in data.items()}
    return fields.integers(start), fields.table(typed, len(own), values)
