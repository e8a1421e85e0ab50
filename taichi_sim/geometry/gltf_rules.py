"""Rules of glTF 2.0 for those parts of its JSON that are read."""

from collections.abc import Mapping
from typing import Any

from taichi_sim.common.errors import KeyPath, key_name, short
from taichi_sim.common.validation import MOST_MAGNITUDE
from taichi_sim.geometry.polygons import FormatError

__all__ = ["COMPONENTS", "WIDTHS", "check"]

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
MOST_BYTES = 1 << 40
# see `_check`; a key that ends with ! must be there
PRIMITIVE = {
    "attributes!": {"POSITION": "accessors", "TEXCOORD_0": "accessors"},
    "indices": "accessors",
    "mode": int,
}
DATA = {"bufferView!": "bufferViews", "byteOffset": int}
ACCESSOR = {
    "count!": int,
    "type!": tuple(WIDTHS),
    "componentType!": tuple(COMPONENTS),
    "normalized": bool,
    "bufferView": "bufferViews",
    "byteOffset": int,
    "sparse": {"count!": int, "indices!": {**DATA, "componentType!": tuple(COMPONENTS)}, "values!": DATA},
}
RULES: dict[str, Any] = {
    "asset": {"version": str},
    "extensionsRequired": [str],
    "scene": "scenes",
    "scenes": [{"nodes": ["nodes"]}],
    "nodes": [
        {
            "mesh": "meshes",
            "children": ["nodes"],
            "extensions": {},
            "matrix": 16,
            "rotation": 4,
            "scale": 3,
            "translation": 3,
        }
    ],
    "meshes": [{"primitives!": [PRIMITIVE]}],
    "accessors": [ACCESSOR],
    "bufferViews": [{"buffer!": "buffers", "byteLength!": int, "byteOffset": int, "byteStride": int}],
    "buffers": [{"uri": str}],
}


def check(header: Mapping[str, Any]) -> None:
    """Raise FormatError where the JSON of a file breaks a rule."""
    _check(header, (), header, RULES)


def _check(header: Mapping[str, Any], path: KeyPath, part: Any, rule: Any) -> None:
    """Raise FormatError where a part of the JSON breaks a rule. A rule is a table of those of its keys, a list with that of its
    items, the values that it may have, the list whose item it numbers, how many numbers it is, or its type."""

    def require(kept: bool, allowed: str) -> None:
        if not kept:
            raise FormatError(f"{key_name(path)} is {short(part)}; it must be {allowed}")

    if isinstance(rule, tuple):
        require(part in rule, f"one of {', '.join(map(str, rule))}")
    elif isinstance(rule, dict):
        require(isinstance(part, dict), "a table")
        for key, inner in rule.items():
            name = key.removesuffix("!")
            if name in part:
                _check(header, (*path, name), part[name], inner)
            elif name != key:
                raise FormatError(f"{key_name((*path, name))} is missing")
    elif isinstance(rule, list):
        require(isinstance(part, list), "a list")
        for number, one in enumerate(part):
            _check(header, (*path, number), one, rule[0])
    elif isinstance(rule, str):
        parts = header.get(rule)
        there = len(parts) if isinstance(parts, list) else 0
        require(type(part) is int and 0 <= part < there, f"the number of one of the {there} {rule}, counted from 0")
    elif isinstance(rule, int):
        numbers = isinstance(part, list) and len(part) == rule and all(type(one) in (int, float) for one in part)
        require(numbers and all(abs(one) <= MOST_MAGNITUDE for one in part), f"{rule} numbers")
    elif rule is int:
        require(type(part) is int and 0 <= part <= MOST_BYTES, "a whole number of at least 0")
    else:
        require(type(part) is rule, "true or false" if rule is bool else "a text")
