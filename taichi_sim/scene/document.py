"""Document: a scene as plain values and arrays, and back.

State files and recordings hold it, scene files have its tables, digests are made of it. What comes back is judged as what is
added by hand is."""

from collections.abc import Mapping
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import KeyPath, SceneError, about, key_name
from taichi_sim.common.plain import plain
from taichi_sim.scene.collision_groups import Groups
from taichi_sim.scene.part import Part, Row
from taichi_sim.scene.parts import PARTS

__all__ = ["document", "fill", "saved"]

ARRAY = "array"  # the only key of what stands in the place of an array: its name among them


def document(scene: Any) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """Plain values, by the tables of a scene file, and arrays, by names like "balls.mass" and "gases.0.triangles"."""
    values: dict[str, Any] = {"dim": scene.dim, "gravity": scene.gravity.tolist(), "groups": list(scene.groups.names)}
    arrays: dict[str, NDArray] = {}
    for part in PARTS:
        rows: list[Row] = []
        for k, row in enumerate(part.rows(scene)):
            place = ".".join(map(str, _place(part, k)))
            own = {key: f"{place}.{key}" for key, value in row.items() if isinstance(value, np.ndarray)}
            arrays |= {name: row[key] for key, name in own.items()}
            rows.append(plain(row | {key: {ARRAY: name} for key, name in own.items()}))
        if rows:
            values[part.name] = rows[0] if part.is_one else rows
    return values, arrays


def saved(scene: Any) -> Any:
    """The scene as a file can hold it: colliders of the user's own replaced, see `Collider.saved`. Raises SceneError."""
    held = copy(scene)
    held.colliders = [collider.saved(f"colliders[{k}]") for k, collider in enumerate(scene.colliders)]
    return held


def fill(scene: Any, values: Mapping[str, Any], arrays: Mapping[str, NDArray]) -> None:
    """Add to an empty scene what `document` gave. Raises SceneError that names what is wrong, and what is allowed."""
    names = values.get("groups")
    if not isinstance(names, (list, tuple)) or not names or len(set(map(str, names))) < len(names):
        raise SceneError("groups", names, "a list of different names")
    with scene.all_or_nothing():
        scene.groups = Groups(())
        scene.groups.bits("groups", names)
        for part in PARTS:
            for k, row in enumerate(_rows(part, values)):
                place = key_name(_place(part, k))
                with about(place):
                    validation.call(
                        place, part.restorer(scene), {key: _value(place, key, row[key], arrays) for key in row}
                    )
            if part.name == "materials" and [one.name for one in scene.materials] != [
                row["name"] for row in _rows(part, values)
            ]:
                raise SceneError("materials", says="must begin with the one called 'default'")


def _rows(part: Part, values: Mapping[str, Any]) -> list[Row]:
    """Rows that the document has of a part."""
    given = values.get(part.name, [])
    return validation.tables({part.name: [given] if part.is_one and given != [] else given}, part.name)


def _place(part: Part, k: int) -> KeyPath:
    """Path of a row."""
    return (part.name,) if part.is_one else (part.name, k)


def _value(place: str, key: str, value: Any, arrays: Mapping[str, NDArray]) -> Any:
    """Value of a key, or the array that it names. Raises SceneError where there is no such array."""
    if not isinstance(value, dict) or list(value) != [ARRAY]:
        return value
    if value[ARRAY] not in arrays:
        raise SceneError(f"{place}.{key}", says=f"is missing; there is no array {value[ARRAY]!r}")
    return arrays[value[ARRAY]]
