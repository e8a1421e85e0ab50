"""Parameters: values of a scene that are set by their paths, like `materials.rubber.restitution`, without editing its file."""

import inspect
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from operator import eq
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from taichi_sim.common.errors import KeyPath, SceneError, did_you_mean, key_name, path_of, short
from taichi_sim.files.toml_schema import Document
from taichi_sim.scene.scene import Scene

__all__ = ["changed_scene", "changing", "put", "python_scene_with"]

SINGLE = (
    ("simulation",),
    ("output",),
    ("wind",),
    ("output", "camera"),
    ("output", "overlay"),
)  # tables that a file has once, or not at all
PATH = re.compile(r"[^.\[\]]+(\.[^.\[\]]+|\[[0-9]{1,18}\])*")


def changed_scene(file: Path, parameters: Mapping[str, Any], allow_outside: bool = False) -> Scene:
    """The scene of a TOML file with other values. Raises SceneError, which names the path, for what the file does not have."""
    from taichi_sim.files.toml_document import parsed
    from taichi_sim.files.toml_reader import Reader

    text, document = parsed(file)
    with changing(file, document, parameters):
        return Reader(file, text, document, None, allow_outside).scene()


@contextmanager
def changing(file: Path, document: dict[str, Any], parameters: Mapping[str, Any]) -> Iterator[None]:
    """Set values in what a file says. Errors meanwhile name the file, and no line of it where another value stands."""
    changed = []
    try:
        changed += [put(document, path, value) for path, value in parameters.items()]
        yield
    except SceneError as error:
        error.file = file
        if error.path and any(all(map(eq, error.path, path)) for path in changed):
            error.line = None  # another value stands there
        raise


def python_scene_with(file: Path, made: Any, parameters: Mapping[str, Any]) -> Scene:
    """The scene that the function `made` of a Python file returns. Parameters are arguments of that function, or else paths in
    the scene as it would be saved. Raises SceneError, which names the path and the arguments."""
    takes = inspect.signature(made).parameters
    own = {name: value for name, value in parameters.items() if name in takes}
    scene: Scene = made(**own)
    rest = {path: value for path, value in parameters.items() if path not in own}
    if not rest:
        return scene
    with TemporaryDirectory(prefix="taichi_sim_scene_") as folder:
        saved = Path(folder) / "scene.toml"
        scene.save(saved)
        try:
            return changed_scene(saved, rest)
        except SceneError as error:
            error.file, error.line = file, None
            if takes and error.value is ... and error.path in map(path_of, rest):
                error.says += f"; arguments of scene(): {', '.join(takes)}"
            raise


def put(document: dict[str, Any], path: str, value: Any) -> KeyPath:
    """Set a value in what a scene file says; its path without names. Raises SceneError, which says what there is, for a path that
    leads nowhere."""
    if not (PATH.fullmatch(path) and path.isprintable()):
        raise SceneError((), path, says="is no path; write it like materials.rubber.restitution or gravity[1]")
    parts = path_of(path)
    if len(parts) == 1 and parts[0] not in Document.model_fields:
        raise SceneError(parts, says=f"is not a known key; {did_you_mean(str(parts[0]), list(Document.model_fields))}")
    node: Any = document
    keys = []
    for depth in range(len(parts)):
        keys.append(_key(node, parts, depth))
        if depth < len(parts) - 1:
            node = node.setdefault(keys[-1], {}) if isinstance(node, dict) else node[keys[-1]]
    node[keys[-1]] = value
    return tuple(keys)


def _key(node: Any, parts: KeyPath, depth: int) -> str | int:
    """Key or index of the part at that depth in a table or a list."""
    part, last = parts[depth], depth == len(parts) - 1
    if isinstance(node, dict) and isinstance(part, str) and (part in node or last or parts[: depth + 1] in SINGLE):
        return part
    if isinstance(node, list) and isinstance(part, int) and part < len(node):
        return part
    if isinstance(node, list):
        for k, entry in enumerate(node):
            if isinstance(entry, dict) and entry.get("name") == part:
                return k
    raise _nowhere(node, parts, depth)


def _nowhere(node: Any, parts: KeyPath, depth: int) -> SceneError:
    here = key_name(parts[:depth]) or "the file"
    if isinstance(node, dict):
        for table, entries in node.items() if depth == 0 else ():
            if isinstance(entries, list) and any(isinstance(e, dict) and e.get("name") == parts[0] for e in entries):
                rest = [part for part in parts[1:] if part != 0]
                meant = key_name([table, *parts[:1], *rest])
                return SceneError(
                    parts, says=f"is no table of a scene; {parts[0]} is a name in {table}; did you mean {meant}?"
                )
        return SceneError(parts, says=f"is not in this scene; {did_you_mean(str(parts[depth]), list(node))}")
    if isinstance(node, list):
        names = [str(one["name"]) for one in node if isinstance(one, dict) and "name" in one]
        what = f"{here}[0] to [{len(node) - 1}]" if len(node) > 1 else f"{here}[0]"
        named = f"; or, by name, {', '.join(names)}" if names else ""
        return SceneError(parts, says=f"is not in this scene; there is {what}{named}")
    return SceneError(parts, says=f"is not in this scene; {here} is {short(node)}, which has no parts")
