"""Contents: all that a scene is, part by part, as plain values by which two scenes can be compared."""

import hashlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from os import PathLike, fspath
from typing import Any

import numpy as np

from taichi_sim.scene.document import document

__all__ = ["contents_of", "described"]


def contents_of(scene: Any) -> dict[str, Any]:
    """Values by the names of the parts that they are of, `balls.mass`, `walls[0]`. How it is shown is no part of it."""
    values, arrays = document(scene)
    parts: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            plain = {key: one for key, one in value.items() if f"{name}.{key}" not in arrays}
            parts |= {name: plain} if plain else {}
        elif value and isinstance(value, list) and isinstance(value[0], dict):
            if name == "materials":  # in their order: balls have their numbers
                parts[name] = [row["name"] for row in value]
            for k, row in enumerate(value):
                called = f"{name}.{row.get('name')}"
                parts[f"{name}[{k}]" if "name" not in row or called in arrays else called] = row
        else:
            parts[name] = value
    return {name: described(value) for name, value in (parts | arrays).items()}


def described(value: Any) -> Any:
    """Plain values as they are, an array by its shape and SHA-256, an object by its class and those of its attributes that are
    any of these."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        array = np.ascontiguousarray(value)
        return f"{array.dtype} {array.shape} {hashlib.sha256(array.tobytes()).hexdigest()}"
    if isinstance(value, PathLike):
        return fspath(value)
    if isinstance(value, Mapping):
        return {str(key): described(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [described(one) for one in value]
    if is_dataclass(value) and not isinstance(value, type):
        return {"class": type(value).__qualname__, **{f.name: described(getattr(value, f.name)) for f in fields(value)}}
    if isinstance(value, type) or not hasattr(value, "__dict__"):
        return getattr(value, "__qualname__", type(value).__qualname__)
    plain = {name: one for name, one in vars(value).items() if isinstance(one, _PLAIN)}
    return {"class": type(value).__qualname__, **described(plain)}


_PLAIN = (bool, int, float, str, np.generic, np.ndarray, PathLike, type(None))
