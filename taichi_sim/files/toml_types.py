"""Types of the keys of scene files: as pydantic judges them, and as a JSON schema where it has no word for them."""

import inspect
import types
from collections.abc import Sequence
from dataclasses import is_dataclass
from os import PathLike
from typing import Annotated, Any, Union, get_args, get_origin, is_typeddict

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, WithJsonSchema
from pydantic.errors import PydanticUserError

from taichi_sim.common.docstrings import described, unit_of
from taichi_sim.scene import collider_shapes

__all__ = ["COLLIDER", "Strict", "key_of", "table_schema", "typed"]

COLLIDER = "x-collider"  # in a schema: a table that describes one of that name
_number = {"type": "number"}
_list = {"type": "array", "items": _number}
NUMBERS = {"anyOf": [_number, _list, {"type": "array", "items": _list}]}  # what NumPy makes an array of
ARRAY_LIKE = set(get_args(ArrayLike)) or {ArrayLike}  # up to NumPy 2.4 a union, which joins the one around it


class Strict(BaseModel):
    """Base of the tables: no unknown keys, no conversion of one type into another."""

    model_config = ConfigDict(strict=True, extra="forbid")


def key_of(default: Any, says: str) -> Any:
    """A key of a table: its default, `...` where it is needed, and what it means, with its unit, see common/docstrings.py."""
    unit = unit_of(says)
    return Field(default, description=says or None, json_schema_extra={"x-unit": unit} if unit else None)


def typed(annotation: Any) -> Any:
    """The type of an argument; what pydantic has no word for the function itself checks, and editors get a schema of."""
    if _is_known(annotation):
        return annotation
    return Annotated[Any, WithJsonSchema(_schema(annotation))]


def _is_known(annotation: Any) -> bool:
    """True if pydantic can judge a type: without described tables, which it takes from Python 3.12 on only."""
    if _has_tables(annotation):
        return False
    try:
        TypeAdapter(annotation)
    except PydanticUserError:
        return False
    return True


def _has_tables(annotation: Any) -> bool:
    return is_typeddict(annotation) or any(_has_tables(part) for part in get_args(annotation))


def _schema(annotation: Any) -> dict[str, Any]:
    """A JSON schema of a type that may hold arrays, paths or tables."""
    if annotation is ArrayLike or _is_array(annotation):
        return NUMBERS
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin in (Union, types.UnionType):
        arrays = ARRAY_LIKE.issubset(parts)
        rest = [p for p in parts if p is not types.NoneType and not (arrays and p in ARRAY_LIKE)]
        if any(get_origin(p) is Sequence for p in rest):
            rest = [p for p in rest if not _is_array(p)]  # in a file these are lists, too
        return {"anyOf": [_schema(part) for part in rest] + NUMBERS["anyOf"] * arrays}
    if annotation is PathLike or origin is PathLike:
        return {"type": "string"}
    if annotation in collider_shapes.SHAPES.values():
        return {COLLIDER: next(name for name, kind in collider_shapes.SHAPES.items() if kind is annotation)}
    if is_typeddict(annotation) or is_dataclass(annotation):
        return table_schema(annotation)
    if origin is tuple and parts[-1:] != (Ellipsis,):
        return {"type": "array", "prefixItems": [_schema(part) for part in parts], "maxItems": len(parts)}
    if origin in (tuple, list, Sequence):
        return {"type": "array", "items": _schema(parts[0])}
    return TypeAdapter(annotation).json_schema()


def _is_array(annotation: Any) -> bool:
    """True if a type is NumPy's of arrays, which has a name of its own from NumPy 2.5 on."""
    return annotation is NDArray or get_origin(annotation) in (np.ndarray, NDArray)


def table_schema(table: Any, **more: Any) -> dict[str, Any]:
    """A JSON schema of a table that is described as a typed dictionary or a dataclass; more: other types for some keys."""
    fields = inspect.get_annotations(table, eval_str=True)
    says = described(table.__doc__, fields)
    properties = {}
    for name, annotation in fields.items():
        unit = {"x-unit": unit_of(says[name])} if name in says and unit_of(says[name]) else {}
        properties[name] = _schema(more.get(name, annotation)) | {"description": says.get(name, ""), **unit}
    needed = {"required": sorted(table.__required_keys__)} if is_typeddict(table) else {}
    return {"type": "object", "properties": properties, "additionalProperties": False, **needed}
