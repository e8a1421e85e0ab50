"""Checks of plain numbers and arrays: one sentence that names the place, the value and what is allowed."""

import ast
import inspect
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common.errors import SceneError
from taichi_sim.common.printable import printable

__all__ = [
    "amounts",
    "as_array",
    "attributes_read",
    "bits",
    "call",
    "colour",
    "colours",
    "direction",
    "flags",
    "given",
    "indices",
    "limits",
    "many",
    "name",
    "number",
    "one_of",
    "per_item",
    "require",
    "rows",
    "rows_of_vectors",
    "strained",
    "tables",
    "vector",
    "vectors",
    "whole",
]

FUNCTION_MARKS = ("_is_taichi_function", "_is_quadrants_function")  # what either engine leaves on a function of its own
MOST_MAGNITUDE = (
    1e50  # products and powers of such numbers, as shapes and bounds form them, stay finite in double precision
)
LEAST_POSITIVE = 1 / MOST_MAGNITUDE  # and do not vanish
MOST_WHOLE = 2**63 - 1
MOST_NAME = 200  # characters


def as_array(value: Any) -> NDArray[Any]:
    """Array of a value, as NumPy makes it. Rows of different lengths, of which NumPy makes none, give an array of objects
    without a shape."""
    try:
        return np.asarray(value)
    except ValueError:
        array = np.empty((), dtype=object)
        array[()] = value
        return array


def _mixes(value: Any) -> bool:
    """Truth values in a list, or in lists within it, which NumPy takes for numbers where there are others."""
    if not isinstance(value, (list, tuple)):
        return False
    kinds = set(map(type, value))
    return not kinds.isdisjoint((bool, np.bool_)) or (not kinds.isdisjoint((list, tuple)) and any(map(_mixes, value)))


def _array(where: str, value: ArrayLike, what: str, most: float = MOST_MAGNITUDE) -> NDArray[np.float64]:
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "iuf" or _mixes(value):
            raise ValueError
        array = array.astype(np.float64)
    except (TypeError, ValueError):
        raise SceneError(where, value, says=f"is not {what}") from None
    require(where, array, np.isfinite(array), "a finite number")
    require(where, array, np.abs(array) <= most, f"at most {most:g} in magnitude")
    return array


def require(where: str, value: Any, good: Any, allowed: str = "", says: str = "") -> None:
    """Raise SceneError about the first item or row that is not good: `mass[3]` of many, `mass` where it is a lone number.
    allowed, says: as of SceneError; a value `...` is not shown."""
    if not np.all(good):
        first = np.unravel_index(int(np.argmin(good)), np.shape(good))
        shown = ... if value is ... else np.asarray(value)[first]
        raise SceneError(where + "".join(f"[{i}]" for i in first), shown, allowed, says=says)


def _shape(where: str, array: NDArray, good: bool, allowed: str) -> None:
    if not good:
        raise SceneError(where, says=f"shape {array.shape} does not fit; it must be {allowed}")


def _bounds(where: str, array: NDArray, low: float | None, high: float | None, positive: bool) -> None:
    if positive:
        require(where, array, array > 0, "greater than 0")
        require(where, array, array >= LEAST_POSITIVE, f"at least {LEAST_POSITIVE:g}")
    if low is not None and high is not None:
        require(where, array, (array >= low) & (array <= high), f"from {low:g} to {high:g}")
    elif low is not None:
        require(where, array, array >= low, f"at least {low:g}")
    elif high is not None:
        require(where, array, array <= high, f"at most {high:g}")


def number(
    where: str, value: Any, *, low: float | None = None, high: float | None = None, positive: bool = False
) -> float:
    """One finite number within its bounds, as a float. Raises SceneError."""
    array = _array(where, value, "a number", MOST_MAGNITUDE if high is None else max(MOST_MAGNITUDE, high))
    if array.ndim != 0:
        raise SceneError(where, value, says="is not one number")
    _bounds(where, array, low, high, positive)
    return float(array)


def whole(where: str, value: Any, low: int, high: int | None = None) -> int:
    """One whole number within its bounds. Raises SceneError."""
    fits = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not fits or value < low or value > (MOST_WHOLE if high is None else high):
        allowed = f"of at least {low}" if high is None else f"from {low} to {high}"
        raise SceneError(where, value, f"a whole number {allowed}")
    return int(value)


def one_of(where: str, value: Any, words: Iterable[Any], more: str = "") -> None:
    """Raise SceneError where a value is none of these; more: what else it may be."""
    allowed = list(words)
    if not any(value is word or (isinstance(value, str) and value == word) for word in allowed):
        raise SceneError(where, value, f"one of {', '.join(map(repr, allowed))}{more}")


def name(where: str, value: Any) -> str:
    """A name, which goes into messages and into the heads of files: a text of at most MOST_NAME characters, without line breaks
    and control characters. Raises SceneError."""
    if not isinstance(value, str) or not value:
        raise SceneError(where, value, "a text")
    if len(value) > MOST_NAME:
        raise SceneError(where, value, f"a text of at most {MOST_NAME} characters")
    if printable(value) != value or "\n" in value or "\t" in value:
        raise SceneError(where, value, "a text in one line, without control characters")
    return value


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
    _shape(where, array, array.shape in ((), (n,)), f"one number or {n} of them")
    _bounds(where, array, low, high, positive)
    return np.broadcast_to(array, (n,)).astype(np.float64)


def amounts(table: str, n: int, **values: ArrayLike) -> dict[str, NDArray[np.float64]]:
    """Columns of n rows of a table, by name: numbers of at least 0, one or one per row. Raises SceneError."""
    return {name: per_item(f"{table}.{name}", value, n, low=0) for name, value in values.items()}


def given(**optional: Any) -> dict[str, Any]:
    """Those of optional arguments that are not None, by name."""
    return {name: value for name, value in optional.items() if value is not None}


def limits(where: str, value: ArrayLike | None, n: int, **bounds: Any) -> NDArray[np.float64]:
    """Numbers within `bounds`, see `per_item`, one or one per item, infinite or None where there is no limit, as an array of
    shape (n,). Raises SceneError."""
    if value is None:
        return np.full(n, np.inf)
    given = as_array(value)
    if given.dtype.kind != "f":
        return per_item(where, value, n, **bounds)
    never = np.isposinf(given)
    finite = per_item(where, np.where(never, 1.0, given), n, **bounds)
    return np.where(np.broadcast_to(never, (n,)), np.inf, finite)


def strained(strain: NDArray[np.float64], rest_length: NDArray[np.float64]) -> None:
    """Raise SceneError where a spring without a rest length should tear at a finite strain (m,)."""
    says = "this spring has rest length 0, so it has no strain; give it a rest length, or leave break_strain out"
    require("springs.break_strain", ..., ~np.isfinite(strain) | (rest_length != 0.0), says=says)


def vectors(where: str, value: ArrayLike, n: int | None, dim: int) -> NDArray[np.float64]:
    """Finite vectors as an array of shape (n, dim). n None: as many as given; else one vector serves all. SceneError."""
    array = _array(where, value, f"a list of {dim}-vectors")
    if n is None and array.ndim == 1 and array.size == 0:
        array = array.reshape(0, dim)
    if n is None:
        _shape(where, array, array.ndim == 2 and array.shape[1] == dim, f"(n, {dim})")
        return array.copy()
    _shape(where, array, array.shape in ((dim,), (n, dim)), f"({dim},) or ({n}, {dim})")
    return np.broadcast_to(array, (n, dim)).copy()


def rows_of_vectors(where: str, value: ArrayLike, n: int, count: int, dim: int) -> NDArray[np.float64]:
    """Finite numbers as an array of shape (n, count, dim), of one also (count, dim). Raises SceneError."""
    array = _array(where, value, f"a list of {count} {dim}-vectors for each of {n}")
    _shape(where, array, array.shape in ((count, dim)[: 2 * (n == 1)], (n, count, dim)), f"({n}, {count}, {dim})")
    return array.reshape(n, count, dim).copy()


def vector(where: str, value: ArrayLike, dim: int) -> NDArray[np.float64]:
    """One finite vector as an array of shape (dim,). Raises SceneError."""
    array = _array(where, value, f"a vector of {dim} numbers")
    _shape(where, array, array.shape == (dim,), f"({dim},)")
    return array.copy()


def direction(where: str, value: ArrayLike, dim: int) -> NDArray[np.float64]:
    """One finite vector as an array of shape (dim,), not all 0. Raises SceneError."""
    array = vector(where, value, dim)
    if not array.any():
        raise SceneError(where, array, "a vector that has a direction")
    return array


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
    array = as_array(value)
    if array.size == 0 and array.dtype != object:
        return np.zeros((0,) if width is None else (0, width), dtype=np.int32)
    if array.dtype.kind not in "iu" or _mixes(value):
        raise SceneError(where, value, says="is not a list of integers")
    fits = array.ndim == 1 if width is None else array.ndim == 2 and array.shape[1] == width
    _shape(where, array, fits, "(k,)" if width is None else f"(k, {width})")
    good = ((array >= 0) & (array < limit)).reshape(len(array), -1).all(axis=1)
    allowed = f"from 0 to {limit - 1}" if limit else "but there is none"
    require(where, array, good, says=f"is not allowed; it must name a {what}, {allowed}")
    return array.astype(np.int32)


def corners(where: str, value: ArrayLike, limit: int, width: int) -> NDArray[np.int32]:
    """Different balls of each element, of one or of many, (e, width). Raises SceneError."""
    found = indices(where, many(value, 1), limit, width=width)
    ordered = np.sort(found, axis=1)
    different = (ordered[:, 1:] != ordered[:, :-1]).all(axis=1)
    require(where, found, different, says=f"names a ball twice; give {width} different")
    return found


def rows(where: str, value: Any, n: int) -> NDArray[np.int64]:
    """Indices (k,) of rows named by indices, by a bool each or by a slice. Raises SceneError."""
    if isinstance(value, slice):
        return np.arange(n)[value]
    array = np.atleast_1d(as_array(value))
    if array.dtype == np.bool_:
        return np.flatnonzero(flags(where, array, n))
    return indices(where, array, n, what=where.removesuffix("s")).astype(np.int64)


def bits(where: str, value: ArrayLike) -> NDArray[np.int32]:
    """Integers of 32 bits with a sign, (k,). Raises SceneError."""
    array = as_array(value)
    if array.dtype.kind not in "iu":
        raise SceneError(where, value, says="is not a list of integers")
    _shape(where, array, array.ndim == 1, "(k,)")
    require(where, array, (array >= -(2**31)) & (array < 2**31), "an integer of 32 bits")
    return array.astype(np.int32)


def colour(where: str, value: Sequence[float]) -> tuple[float, float, float]:
    """One colour from 0 to 1. Raises SceneError."""
    red, green, blue = per_item(where, value, 3, low=0, high=1).tolist()
    return red, green, blue


def colours(where: str, value: ArrayLike) -> NDArray[np.float64]:
    """Colours (k, 3) from 0 to 1, those that are left to the renderer nan. Raises SceneError."""
    array = as_array(value)
    if array.dtype.kind != "f":
        raise SceneError(where, value, says="is not a list of colours")
    _shape(where, array, array.ndim == 2 and array.shape[1] == 3, "(k, 3)")
    none = np.isnan(array).all(axis=1, keepdims=True)
    require(where, array, none | ((array >= 0) & (array <= 1)), "from 0 to 1, or all three nan")
    return array.astype(np.float64)


def tables(given: Any, name: str) -> list[dict[str, Any]]:
    """The list of tables of that name in plain values from a file. Raises SceneError."""
    value = given.get(name) if isinstance(given, Mapping) else None
    if not isinstance(value, list) or not all(isinstance(one, dict) for one in value):
        raise SceneError(name, value, "a list of tables")
    return value


def call(where: str, function: Callable[..., Any], arguments: Mapping[str, Any]) -> Any:
    """Call a function with arguments from a file. Raises SceneError where it does not take them, or needs more."""
    try:
        inspect.signature(function).bind(**arguments)
    except TypeError as error:
        raise SceneError(where, says=str(error)) from None
    return function(**arguments)


def flags(where: str, value: bool | Sequence[bool] | NDArray, n: int) -> NDArray[np.bool_]:
    """A bool, or one per item, as an array of shape (n,). Raises SceneError."""
    array = as_array(value)
    if array.dtype != np.bool_ or array.shape not in ((), (n,)):
        raise SceneError(where, value, says=f"does not fit; give true, false or a list of {n} of them")
    return np.broadcast_to(array, (n,)).copy()


def taichi_function(where: str, owner: Any, name: str, parameters: str) -> None:
    """Raise SceneError unless a user's object has a Taichi function of that name with these parameters."""
    kind = type(owner).__name__
    if isinstance(owner, type):
        raise SceneError(where, says=f"{owner.__name__} is a class; give an object, {owner.__name__}(...)")
    function = getattr(owner, name, None)
    if not callable(function):
        raise SceneError(where, says=f"{kind} has no function {name}({parameters})")
    taken = [name for name in inspect.signature(function).parameters if name != "self"]  # which Quadrants shows
    if len(taken) != len(parameters.split(",")):
        raise SceneError(where, says=f"{kind}.{name} takes ({', '.join(taken)}); it must take ({parameters})")
    if not any(getattr(function, mark, False) for mark in FUNCTION_MARKS):
        raise SceneError(where, says=f"{kind}.{name} is not a Taichi function; write @ti.func above it")


def attributes_read(function: Any, parameter: int) -> set[str]:
    """Attributes that a method reads of one of its parameters, self not counted; none where its source is not at hand."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    except (OSError, TypeError):
        return set()
    name = tree.body[0].args.args[parameter + 1].arg  # type: ignore[attr-defined]
    return {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == name
    }
