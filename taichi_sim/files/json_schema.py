"""The JSON Schema of scene files, from the models that the reader uses, for editors and validators."""

from typing import Any

from taichi_sim.files.toml_schema import ALIASES, COLLIDERS, Document
from taichi_sim.files.toml_types import COLLIDER

__all__ = ["scene_schema"]

VECTOR = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 3}
DRAFT = "https://json-schema.org/draft/2020-12/schema"


def scene_schema() -> dict[str, Any]:
    """Types, bounds, defaults and needed keys of every table; each key has a `description` and, if it is a quantity, `x-unit`.

    What depends on the scene, how many balls there are or its dimensions, only the reader knows.
    """
    schema = Document.model_json_schema()
    definitions: dict[str, Any] = schema.pop("$defs")
    for name, model in COLLIDERS.items():
        definitions[f"collider_{name}"] = model.model_json_schema()
    definitions["colliders"] = {"oneOf": [{"$ref": f"#/$defs/collider_{name}"} for name in COLLIDERS]}
    for table in schema["properties"].values():
        if "$ref" in table:
            table.setdefault("description", definitions[table["$ref"].rsplit("/", 1)[-1]].get("description", ""))
    return {
        "$schema": DRAFT,
        **_table(
            schema | {"title": "Scene file of taichi_sim", "description": "Lengths in m, masses in kg, times in s."}
        ),
        "$defs": {name: _table(table) for name, table in definitions.items()},
    }


def _table(schema: dict[str, Any]) -> dict[str, Any]:
    """The schema of a table as TOML has it, which knows no null."""
    if "properties" not in schema:
        return schema
    properties = {key: _plain(value) for key, value in schema["properties"].items()}
    for other, key in ALIASES.items():
        if key in properties:
            properties[other] = properties[key] | {"description": f"another spelling of {key}"}
    table = schema | {"properties": properties}
    elsewhere = table.pop("x-in-file", None)
    if elsewhere:
        table["anyOf"] = [{"required": [*table.get("required", []), *elsewhere]}, {"required": ["file"]}]
    if "mesh" in properties and "vertices" in properties:
        table["anyOf"].append({"required": ["vertices", "triangles"]})
    return table


def _plain(value: Any) -> Any:
    """Without null, and without the titles that repeat names."""
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if not isinstance(value, dict):
        return value
    if COLLIDER in value:
        return {"$ref": f"#/$defs/collider_{value[COLLIDER]}"}
    result = {
        key: {name: _plain(item) for name, item in part.items()} if key == "properties" else _plain(part)
        for key, part in value.items()
        if key != "title" and not (key == "default" and part is None)
    }
    if str(result.get("description", "")).startswith("(dim,)"):
        return {key: result[key] for key in ("description", "x-unit", "default") if key in result} | VECTOR
    if "x-unit" in result and not _holds_numbers(result):
        del result["x-unit"]
    if "anyOf" in result:
        kinds = [kind for kind in result.pop("anyOf") if kind != {"type": "null"}]
        flat = [one for kind in kinds for one in (kind["anyOf"] if list(kind) == ["anyOf"] else [kind])]
        result |= {"anyOf": flat} if len(flat) > 1 else flat[0]
    return result


def _holds_numbers(schema: dict[str, Any]) -> bool:
    """True if a value may be a number, or a list of them."""
    parts = [
        *([schema["items"]] if "items" in schema else []),
        *schema.get("anyOf", ()),
        *schema.get("prefixItems", ()),
    ]
    return schema.get("type") in ("number", "integer") or any(_holds_numbers(part) for part in parts)
