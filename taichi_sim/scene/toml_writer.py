"""Scene to TOML, with the large arrays in an .npz beside it. The scene that comes back is the same, bit for bit."""

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.atomic_file import replacing, require_name
from taichi_sim.common.plain import plain
from taichi_sim.scene.collision_groups import EVERY, ONLY
from taichi_sim.scene.embedded_surfaces import EmbeddedSurface

__all__ = ["save_scene"]

MOST_INLINE = 200  # numbers; a longer array goes to the .npz


class _Arrays:
    """The arrays that go to the .npz, and the rule which they are."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.arrays: dict[str, NDArray] = {}

    def table(self, prefix: str, columns: dict[str, NDArray], **plain: Any) -> dict[str, Any]:
        """One TOML table: plain keys, short columns in place, long ones in the file under prefix + key."""
        table, long = dict(plain), False
        for key, column in columns.items():
            if column.size > MOST_INLINE:
                self.arrays[prefix + key] = column
                long = True
            else:
                table[key] = column.tolist()
        return table | ({"file": self.name, "prefix": prefix} if long else {})


def save_scene(scene: Any, path: str | os.PathLike[str]) -> None:
    """Write a scene file; arrays of more than 200 numbers go to `<stem>_arrays.npz` beside it. Each is replaced whole.

    Springs and triangles are written as they are, not as the shapes that made them, textures in its folder by their place
    there. Raises OSError where the file
    cannot be written.
    """
    import tomli_w

    file = Path(path)
    require_name(file)
    arrays_file = file.with_name(file.stem + "_arrays.npz")  # not x.npz, which `run -o` may be asked to write
    store = _Arrays(arrays_file.name)
    document = _document(scene, store)
    for look in document.get("output", {}).get("looks") or ():
        if "texture" in look:
            look["texture"] = _from(file, look["texture"])
    text = tomli_w.dumps(document).encode()
    with replacing(file) as out:
        out.write(text)
        if store.arrays:
            with replacing(arrays_file) as arrays:
                np.savez(arrays, **store.arrays)  # type: ignore[arg-type]


def _from(file: Path, name: str) -> str:
    """A path as a scene file names it: from its folder, where it lies there, so that both may be moved; else as it is."""
    folder, place = file.resolve().parent, Path(name).resolve()
    return place.relative_to(folder).as_posix() if place.is_relative_to(folder) else name


def _document(scene: Any, store: _Arrays) -> dict[str, Any]:
    document: dict[str, Any] = {"format": 1, "dim": scene.dim, "gravity": scene.gravity.tolist()}
    for name, table in (("simulation", scene.settings), ("output", scene.output)):
        if table:
            document[name] = {key: _plain(value) for key, value in table.items() if value is not None}
    tables = {
        "materials": _materials(scene),
        "balls": _balls(scene, store),
        "springs": _springs(scene, store),
        **_elements(scene, store),
        "walls": [
            {"normal": list(wall.normal), "offset": wall.offset, "material": scene.materials[wall.material].name}
            | _groups(scene, wall.group, wall.mask)
            for wall in scene.walls
        ],
    }
    tables["colliders"] = [
        _collider(collider.saved(f"colliders[{k}]").given, store, k) for k, collider in enumerate(scene.colliders)
    ]
    if len(scene.triangles):
        columns = {"triangles": scene.triangles, "collides": _one(scene.solid)}
        tables["triangles"] = [store.table("triangles_", columns)]
    tables["objects"] = [
        store.table(f"objects_{k}_", {"balls": one.balls} | ({} if one.uv is None else {"uv": one.uv}), name=one.name)
        for k, one in enumerate(scene.objects)
    ]
    tables["embedded_surfaces"] = [_surface(surface, store, k) for k, surface in enumerate(scene.embedded_surfaces)]
    tables["probes"] = [
        store.table(f"probes_{k}_", probe.arrays(), name=probe.name, kind=probe.kind, **probe.plain())
        for k, probe in enumerate(scene.probes)
    ]
    return document | {name: rows for name, rows in tables.items() if rows}


def _plain(value: Any) -> Any:
    """Plain values as TOML has them, which knows no None: a key without a value is left out."""
    value = plain(value)
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items() if one is not None}
    return [_plain(one) for one in value] if isinstance(value, list) else value


def _materials(scene: Any) -> list[dict[str, Any]]:
    rows = []
    for material in scene.materials:
        row: dict[str, Any] = {
            "name": material.name,
            "restitution": material.restitution,
            "friction": material.friction,
            "viscous_friction": material.viscous_friction,
        }
        rows.append(row if material.colour is None else row | {"colour": list(material.colour)})
    return rows


def _collider(given: dict[str, Any], store: _Arrays, number: int) -> dict[str, Any]:
    """The arguments of a collider; a mesh as the triangles that it has, not as the file that they came from."""
    plain = {key: value for key, value in given.items() if key != "mesh"}
    if "mesh" not in given:
        return plain
    return store.table(
        f"colliders_{number}_", {k: getattr(given["mesh"], k) for k in ("vertices", "triangles")}, **plain
    )


def _surface(surface: EmbeddedSurface, store: _Arrays, number: int) -> dict[str, Any]:
    columns = {name: getattr(surface, name) for name in ("corners", "weights", "triangles")}
    if len(surface.covers):
        columns["covers"] = surface.covers
    return store.table(
        f"embedded_surfaces_{number}_", columns, **({} if surface.colour is None else {"colour": list(surface.colour)})
    )


def _groups(scene: Any, group: int, mask: int) -> dict[str, Any]:
    """The keys for collision groups, where they are not the default."""
    keys: dict[str, Any] = {} if group == ONLY else {"group": scene.groups.listed(group)}
    return keys if mask == EVERY else keys | {"collides_with": scene.groups.listed(mask)}


def _balls(scene: Any, store: _Arrays) -> list[dict[str, Any]]:
    """One table for each run of balls that share material, body, groups and colour, which a table has once."""
    shared = np.column_stack(
        [scene.material, scene.body, scene.group, scene.mask, np.nan_to_num(scene.colour, nan=-1.0)]
    )
    starts = np.flatnonzero(np.any(shared[1:] != shared[:-1], axis=1)) + 1
    rows = []
    for number, run in enumerate(np.split(np.arange(scene.n_balls), starts)):
        if not len(run):
            continue
        first = run[0]
        plain: dict[str, Any] = {"material": scene.materials[scene.material[first]].name}
        if scene.body[first]:
            plain["body"] = int(scene.body[first])
        plain |= _groups(scene, int(scene.group[first]), int(scene.mask[first]))
        if not np.isnan(scene.colour[first]).any():
            plain["colour"] = scene.colour[first].tolist()
        if scene.pinned[run].all():
            plain["pinned"] = True
        columns = {"position": scene.position[run], "mass": _one(scene.mass[run]), "radius": _one(scene.radius[run])}
        if np.any(scene.velocity[run]):
            columns["velocity"] = scene.velocity[run]
        if scene.pinned[run].any() and "pinned" not in plain:
            columns["pinned"] = np.flatnonzero(scene.pinned[run])
        rows.append(store.table(f"balls_{number}_", columns, **plain))
    return rows


def _springs(scene: Any, store: _Arrays) -> list[dict[str, Any]]:
    if not scene.n_springs:
        return []
    columns = {"pairs": scene.pairs, "rest_length": scene.rest_length}
    columns |= {name: _one(getattr(scene, name)) for name in ("stiffness", "damping", "collides")}
    if np.isfinite(scene.break_strain).any():
        columns["break_strain"] = _one(scene.break_strain)
    return [store.table("springs_", columns)]


def _elements(scene: Any, store: _Arrays) -> dict[str, Any]:
    about = scene.elements()
    tables: dict[str, Any] = {} if about["wind"] is None else {"wind": {k: _plain(v) for k, v in about["wind"].items()}}
    if len(scene.cells):
        columns = {"corners": scene.cells, "rest_volume": scene.rest_volume, "bulk_modulus": _one(scene.bulk_modulus)}
        if scene.crush_modulus.any():
            columns["crush_modulus"] = _one(scene.crush_modulus)
        if np.any(scene.cells_together >= 0):
            columns["together"] = scene.cells_together
        tables["cells"] = [store.table("cells_", columns)]
    if len(scene.bends):
        columns = {"corners": scene.bends, "weights": scene.bend_weights}
        columns |= {"stiffness": _one(scene.bend_stiffness), "damping": _one(scene.bend_damping)}
        if scene.bend_hinge.any():
            columns["hinge"] = _one(scene.bend_hinge)
        tables["bending"] = [store.table("bending_", columns)]
    tables["gases"] = [
        store.table(f"gases_{k}_", {"triangles": gas.triangles}, pressure=gas.pressure, outside=gas.outside)
        for k, gas in enumerate(scene.gases)
    ]
    tables["moving_pins"] = [
        store.table(f"moving_pins_{k}_", {"balls": pins.balls}, **{key: _plain(v) for key, v in pins.given.items()})
        for k, pins in enumerate(scene.moving_pins)
    ]
    tables["motors"] = [
        store.table(
            f"motors_{k}_",
            {"springs": motor.springs} | ({"phase": _one(motor.phase)} if motor.phase.any() else {}),
            **{key: _plain(v) for key, v in motor.given.items()},
        )
        for k, motor in enumerate(scene.motors)
    ]
    return tables


def _one(column: NDArray) -> NDArray:
    """One value where all are the same, for the file to be short."""
    return column[0] if len(column) and np.all(column == column[0]) else column
