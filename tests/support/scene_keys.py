"""The tables of keys in docs/scenes.md, made from the schema: `make docs` writes them, a test holds the page against them."""

import re
from collections import defaultdict
from pathlib import Path

from taichi_sim.files.json_schema import scene_schema
from taichi_sim.files.toml_schema import ALIASES, COLLIDERS, SHAPES

PAGE = Path(__file__).parents[2] / "docs" / "scenes.md"
BEGIN, END = "<!-- from here on `make docs` writes what docstrings say -->", "<!-- up to here -->"
FAMILIES = {
    "shapes": {name: name for name in SHAPES},
    "colliders": {name: f"collider_{name}" for name in COLLIDERS},
}


def tables():
    """Title to rows (key, unit, default, text, where): one for the file, one for each table, one for what many share."""
    schema = scene_schema()
    definitions = schema["$defs"]
    top = {key: one for key, one in schema["properties"].items() if "$ref" not in str(one)}
    result = {"At the top of the file": rows(top, schema)}
    result["[simulation]"] = rows(definitions["Simulation"]["properties"], definitions["Simulation"])
    output = definitions["Output"]
    result["[output]"] = rows(output["properties"], output)
    camera = output["properties"]["camera"]
    result["[output.camera]"] = rows(camera["properties"], camera)
    result["[[output.camera.path]]"] = rows(
        camera["properties"]["path"]["items"]["properties"], camera["properties"]["path"]["items"]
    )
    looks = output["properties"]["looks"]["items"]
    result["[[output.looks]]"] = rows(looks["properties"], looks)
    overlay = output["properties"]["overlay"]
    result["[output.overlay]"] = rows(overlay["properties"], overlay)
    for key in ("probes", "marks"):
        items = overlay["properties"][key]["items"]
        result[f"[[output.overlay.{key}]]"] = rows(items["properties"], items)
    result["[wind]"] = rows(definitions["wind"]["properties"], definitions["wind"])
    for name in schema["properties"]:
        if name in SHAPES or name in ("simulation", "output", "wind") or name in top:
            continue
        if name != "colliders":
            result[f"[[{name}]]"] = rows(definitions[name]["properties"], definitions[name])
    for family, members in FAMILIES.items():
        result |= shared(family, {name: definitions[one] for name, one in members.items()})
    keyframe = definitions["collider_box"]["properties"]["path"]["items"]["anyOf"][0]
    result["Keyframes: `path` of [[colliders]] and [[moving_pins]]"] = rows(keyframe["properties"], keyframe)
    keyframe = definitions["motors"]["properties"]["path"]["items"]["anyOf"][0]
    result["Keyframes: `path` of [[motors]]"] = rows(keyframe["properties"], keyframe)
    return result


def rows(properties, table):
    needed = {
        *table.get("required", ()),
        *(key for way in table.get("anyOf", [])[:1] for key in way.get("required", ())),
    }
    return [
        (key, one.get("x-unit", ""), "needed" if key in needed else default(one), one["description"])
        for key, one in properties.items()
        if key not in ALIASES
    ]


def default(one):
    value = one.get("default")
    return "" if value in (None, [], "", {}) else str(value).lower() if isinstance(value, bool) else f"{value}"


def shared(family, members):
    """Rows that several tables of a kind share come first, once."""
    found = defaultdict(list)
    for name, table in members.items():
        for row in rows(table["properties"], table):
            found[row].append(name)
    many = {row: names for row, names in found.items() if len(names) > 1}
    result = {f"What {family} share": [(*row, members_said(names, members)) for row, names in many.items()]}
    for name, table in members.items():
        title = f"[[{name}]]" if family == "shapes" else f'[[colliders]] with shape = "{name}"'
        result[title] = [row for row in rows(table["properties"], table) if row not in many]
    return result


def members_said(names, members):
    if len(names) == len(members):
        return "all"
    left = [name for name in members if name not in names]
    return "all but " + ", ".join(left) if len(left) < len(names) else ", ".join(names)


def markdown():
    """The part of the page between the marks."""
    lines = [BEGIN]
    for title, entries in tables().items():
        last = " | in" if entries and len(entries[0]) == 5 else ""
        lines += [
            "",
            f"### {title}",
            "",
            f"| key | unit | default | means{last} |",
            "|---|---|---|---|" + "---|" * bool(last),
        ]
        for key, unit, otherwise, text, *where in entries:
            cells = [
                f"`{key}`",
                unit,
                (otherwise and f"`{otherwise}`" * (otherwise != "needed")) or otherwise,
                text,
                *where,
            ]
            lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join([*lines, "", END])


def page(text):
    """The page with the part between the marks made anew."""
    return re.sub(re.escape(BEGIN) + ".*?" + re.escape(END), lambda _: markdown(), text, flags=re.DOTALL)


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text()))
