"""Scene to TOML, with the large arrays in an .npz beside it. The scene that comes back is the same, bit for bit."""

import inspect
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.atomic_file import replacing, require_name
from taichi_sim.common.errors import SceneError
from taichi_sim.common.plain import plain
from taichi_sim.scene.document import saved
from taichi_sim.scene.part import Columns, Part, Row, group_keys
from taichi_sim.scene.parts import PARTS

__all__ = ["save_scene"]

MOST_INLINE = 200  # numbers; a longer array goes to the .npz


def save_scene(scene: Any, path: str | os.PathLike[str], output: Mapping[str, Any]) -> None:
    """Write a scene file; arrays of more than 200 numbers go to `<stem>_arrays.npz` beside it. Each is replaced whole.

    output: the table [output], checked. Springs and triangles are written as they are, not as the shapes that made them,
    textures in its folder by their place there. Raises OSError where the file cannot be written, SceneError without a ball.
    """
    import tomlkit

    file = Path(path)
    require_name(file)
    if not scene.n_balls:
        raise SceneError("balls", says="holds no ball; a scene file needs at least one")
    arrays_file = file.with_name(file.stem + "_arrays.npz")  # not x.npz, which `run -o` may be asked to write
    document, long = _document(saved(scene), output, arrays_file.name)
    for look in document.get("output", {}).get("looks") or ():
        if "texture" in look:
            look["texture"] = _from(file, look["texture"])
    text = tomlkit.dumps(document).encode()
    with replacing(file) as out:
        out.write(text)
        if long:
            with replacing(arrays_file) as arrays:
                np.savez(arrays, **long)  # type: ignore[arg-type]


def _from(file: Path, name: str) -> str:
    """A path as a scene file names it: from its folder, where it lies there, so that both may be moved; else as it is."""
    folder, place = file.resolve().parent, Path(name).resolve()
    return place.relative_to(folder).as_posix() if place.is_relative_to(folder) else name


def _document(scene: Any, output: Mapping[str, Any], arrays_file: str) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """Contents of the file, and the arrays that go to the .npz of this name."""
    document: dict[str, Any] = {"format": 1, "dim": scene.dim, "gravity": scene.gravity.tolist()}
    document |= {"simulation": _plain(scene.settings), "output": _plain(output)}
    arrays: dict[str, NDArray] = {}
    for part in PARTS:
        tables = []
        for k, row in enumerate(_runs(scene) if part.name == "balls" else part.rows(scene)):
            row = _short(part, scene, row)
            long = {key: one for key, one in row.items() if isinstance(one, np.ndarray) and one.size > MOST_INLINE}
            prefix = f"{part.name}_{k}_"
            arrays |= {prefix + key: one for key, one in long.items()}
            table = _plain({key: value for key, value in row.items() if key not in long})
            tables.append(table | ({"file": arrays_file, "prefix": prefix} if long else {}))
        document[part.name] = tables[0] if part.is_single and tables else tables
    return {name: value for name, value in document.items() if isinstance(value, int) or len(value)}, arrays


def _plain(value: Any) -> Any:
    """Plain values as TOML has them, which knows no None: a key without a value is left out."""
    value = plain(value)
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items() if one is not None}
    return [_plain(one) for one in value] if isinstance(value, list) else value


def _short(part: Part, scene: Any, row: Row) -> Row:
    """A row with one value for a column where all are the same, and without what the method assumes."""
    parameters = inspect.signature(getattr(scene, part.method)).parameters
    short = {key: _one(value) if isinstance(part, Columns) else value for key, value in row.items()}
    assumed = {key: one.default for key, one in parameters.items() if isinstance(one.default, (bool, int, float))}
    return {
        key: value for key, value in short.items() if isinstance(value, np.ndarray) or value != assumed.get(key, ...)
    }


def _one(column: Any) -> Any:
    """Value that all of a column of quantities or flags have, or the column where they differ; whole numbers count things
    and stay."""
    many = isinstance(column, np.ndarray) and column.ndim == 1 and column.dtype.kind in "fb" and len(column) > 0
    return column[0] if many and np.all(column == column[0]) else column


def _runs(scene: Any) -> Iterator[Row]:
    """Rows of balls: one for each run of them that share material, body, groups and colour, which a table has once."""
    groups = [scene.material, scene.body, scene.group, scene.mask, np.nan_to_num(scene.colour, nan=-1.0)]
    shared = np.column_stack(groups)
    starts = np.flatnonzero(np.any(shared[1:] != shared[:-1], axis=1)) + 1
    for run in np.split(np.arange(scene.n_balls), starts) if scene.n_balls else ():
        first = run[0]
        row: Row = {"material": scene.materials[scene.material[first]].name, "body": scene.body[first]}
        row |= group_keys(scene, int(scene.group[first]), int(scene.mask[first]))
        if not np.isnan(scene.colour[first]).any():
            row["colour"] = scene.colour[first]
        held, moves = scene.pinned[run], np.any(scene.velocity[run])
        row |= {"position": scene.position[run], "mass": scene.mass[run], "radius": scene.radius[run]}
        row |= {"velocity": scene.velocity[run]} if moves else {}
        yield row | {"pinned": bool(held.all()) if held.all() == held.any() else np.flatnonzero(held)}
