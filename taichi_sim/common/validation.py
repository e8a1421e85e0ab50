"""Checks of plain numbers and arrays: one sentence that names the place, the value and what is allowed."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common.errors import SceneError

__all__ = ["flags", "indices", "many", "number", "per_item", "short", "strained", "strains", "vector", "vectors"]


MOST = 1e50  # products and powers of such numbers, as shapes and bounds form them, stay finite in double precision


def _place(where: str, bad: NDArray[np.bool_], values: NDArray) -> tuple[str, Any]:
    """Name and value of the first bad item: `mass[3]` for one of many, `mass` for a lone number."""
    if values.ndim == 0:
        return where, values.item()
    first = np.unravel_index(int(np.argmax(bad)), bad.shape)
    return where + "".join(f"[{i}]" for i in first), values[first].item()


def _array(where: str, value: ArrayLike, what: str, most: float = MOST) -> NDArray[np.float64]:
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "iuf":
            raise ValueError
        array = array.astype(np.float64)
    except (TypeError, ValueError):
        raise SceneError(f"{where}: {short(value)} is not {what}") from None
    _require(where, array, np.isfinite(array), "a finite number")
    _require(where, array, np.abs(array) <= most, f"at most {most:g} in magnitude")
    return array


def short(value: object) -> str:
    """A value as text, cut off where that is long."""
    text = repr(value.tolist() if isinstance(value, np.ndarray) else value)
    return text if len(text) <= 60 else text[:57] + "..."


def _require(where: str, array: NDArray, good: NDArray[np.bool_], allowed: str) -> None:
    if not np.all(good):
        place, value = _place(where, ~np.asarray(good), array)
        raise SceneError(f"{place}: {value} is not allowed; it must be {allowed}")


def _bounds(where: str, array: NDArray, low: float | None, high: float | None, positive: bool) -> None:
    if positive:
        _require(where, array, array > 0, "greater than 0")
    if low is not None and high is not None:
        _require(where, array, (array >= low) & (array <= high), f"from {low:g} to {high:g}")
    elif low is not None:
        _require(where, array, array >= low, f"at least {low:g}")


def number(
    where: str, value: Any, *, low: float | None = None, high: float | None = None, positive: bool = False
) -> float:
    """One finite number within its bounds, as a float. Raises SceneError."""
    array = _array(where, value, "a number", MOST if high is None else max(MOST, high))
    if array.ndim != 0:
        raise SceneError(f"{where}: {short(value)} is not one number")
    _bounds(where, array, low, high, positive)
    return float(array)


def per_item(
    where: str,
    value: ArrayLike,
    n: int,
    *,
    low: float | None = None,
    high: float | None = None,
    positive: bool = False,
) -> NDArray[np.float64]:
    """One finite number, or one per item, as an array of shape (n,). Raises SceneError."""
    array = _array(where, value, "a number or a list of numbers")
    if array.shape not in ((), (n,)):
        raise SceneError(f"{where}: shape {array.shape} does not fit; give one number or {n} of them")
    _bounds(where, array, low, high, positive)
    return np.broadcast_to(array, (n,)).astype(np.float64)


def strains(where: str, value: ArrayLike | None, n: int) -> NDArray[np.float64]:
    """Positive strains, one or one per item, infinite or None where nothing breaks, as an array of shape (n,). SceneError."""
    if value is None:
        return np.full(n, np.inf)
    try:
        given = np.asarray(value)
    except ValueError:  # rows of different lengths
        given = np.zeros((0, 0))
    if given.dtype.kind != "f":
        return per_item(where, value, n, positive=True)
    never = np.isposinf(given)
    finite = per_item(where, np.where(never, 1.0, given), n, positive=True)
    return np.where(np.broadcast_to(never, (n,)), np.inf, finite)


def strained(strain: NDArray[np.float64], rest_length: NDArray[np.float64]) -> None:
    """Raise SceneError where a spring without a rest length should tear at a finite strain (m,)."""
    none = np.isfinite(strain) & (rest_length == 0.0)
    if none.any():
        raise SceneError(
            f"springs.break_strain[{int(np.argmax(none))}]: this spring has rest length 0, so it has no strain; give it a rest"
            " length, or leave break_strain out"
        )


def vectors(where: str, value: ArrayLike, n: int | None, dim: int) -> NDArray[np.float64]:
    """Finite vectors as an array of shape (n, dim). n None: as many as given; else one vector serves all. SceneError."""
    array = _array(where, value, f"a list of {dim}-vectors")
    if n is None and array.ndim == 1 and array.size == 0:
        array = array.reshape(0, dim)
    if n is None and (array.ndim != 2 or array.shape[1] != dim):
        raise SceneError(f"{where}: shape {array.shape} does not fit; it must be (n, {dim})")
    if n is not None and array.shape not in ((dim,), (n, dim)):
        raise SceneError(f"{where}: shape {array.shape} does not fit; it must be ({dim},) or ({n}, {dim})")
    return array.copy() if n is None else np.broadcast_to(array, (n, dim)).copy()


def vector(where: str, value: ArrayLike, dim: int) -> NDArray[np.float64]:
    """One finite vector as an array of shape (dim,). Raises SceneError."""
    array = _array(where, value, f"a vector of {dim} numbers")
    if array.shape != (dim,):
        raise SceneError(f"{where}: shape {array.shape} does not fit; it must be ({dim},)")
    return array.copy()


def many(value: Any, item_ndim: int) -> Any:
    """`value`, or a list of it where it is a single item: one vector for one ball, one pair for one spring.

    What NumPy cannot make an array of (lists of unequal lengths) is passed on as it is, for the check that follows to name.
    """
    try:
        single = np.ndim(value) == item_ndim and np.size(value) > 0
    except (TypeError, ValueError):
        return value
    return [value] if single else value


def indices(
    where: str, value: ArrayLike, limit: int, width: int | None = None, what: str = "ball"
) -> NDArray[np.int32]:
    """Integers from 0 to limit - 1, numbers of `what`, as an array of shape (k,), or (k, width). Raises SceneError."""
    try:
        array = np.asarray(value)
    except ValueError:
        raise SceneError(f"{where}: {short(value)} is not a list of integers") from None
    if array.size == 0:
        return np.zeros((0,) if width is None else (0, width), dtype=np.int32)
    if array.dtype.kind not in "iu":
        raise SceneError(f"{where}: {short(value)} is not a list of integers")
    if array.ndim != (1 if width is None else 2) or (width is not None and array.shape[1] != width):
        raise SceneError(f"{where}: shape {array.shape} does not fit; it must be (k{f', {width}' if width else ','})")
    allowed = f"a {what}, from 0 to {limit - 1}" if limit else f"a {what}, but there is none"
    bad = ((array < 0) | (array >= limit)).reshape(len(array), -1).any(axis=1)
    if bad.any():
        first = int(np.argmax(bad))
        raise SceneError(f"{where}[{first}]: {array[first].tolist()} is not allowed; it must name {allowed}")
    return array.astype(np.int32)


def flags(where: str, value: bool | Sequence[bool] | NDArray, n: int) -> NDArray[np.bool_]:
    """A bool, or one per item, as an array of shape (n,). Raises SceneError."""
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        array = np.zeros(0)
    if array.dtype != np.bool_ or array.shape not in ((), (n,)):
        raise SceneError(f"{where}: {short(value)} does not fit; give true, false or a list of {n} of them")
    return np.broadcast_to(array, (n,)).copy()
