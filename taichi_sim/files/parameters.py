"""Parameters: values of a scene that are set by their paths, like `materials.rubber.restitution`, without editing its file."""

import inspect
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from taichi_sim.common.errors import SceneError, did_you_mean, key_name, path_of
from taichi_sim.files.toml_schema import Document
from taichi_sim.scene.scene import Scene

__all__ = ["changed_scene", "put", "python_scene_with"]

SINGLE = ("simulation", "output", "wind")  # tables that a file has once, or not at all


def changed_scene(file: Path, parameters: Mapping[str, Any], allow_outside: bool = False) -> Scene:
    """The scene of a TOML file with other values. Raises SceneError, which names the path, for what the file does not have."""
    from taichi_sim.files.toml_reader import Reader, parsed

    text, document = parsed(file)
    for path, value in parameters.items():
        try:
            put(document, path, value)
        except SceneError as error:
            error.file = file
            raise
    return Reader(file, text, document, None, allow_outside).scene()


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
            if takes:
                error.says += f"; arguments of scene(): {', '.join(takes)}"
            raise


def put(document: dict[str, Any], path: str, value: Any) -> None:
    """Set a value in what a scene file says. Raises SceneError, which says what there is, for a path that leads nowhere."""
    parts = path_of(path)
    if len(parts) == 1 and parts[0] not in Document.model_fields:
        raise SceneError(parts, says=f"is not a known key; {did_you_mean(str(parts[0]), list(Document.model_fields))}")
    node: Any = document
    for depth, part in enumerate(parts[:-1]):
        node = _step(node, parts, depth, part)
    last = parts[-1]
    fits = isinstance(node, dict) and isinstance(last, str)
    if not fits and not (isinstance(node, list) and isinstance(last, int) and last < len(node)):
        raise _nowhere(node, parts, len(parts) - 1)
    node[last] = value


def _step(node: Any, parts: tuple[str | int, ...], depth: int, part: str | int) -> Any:
    if isinstance(node, dict) and part in node:
        return node[part]
    if isinstance(node, dict) and depth == 0 and part in SINGLE:
        return node.setdefault(part, {})
    if isinstance(node, list) and isinstance(part, int) and part < len(node):
        return node[part]
    if isinstance(node, list) and isinstance(part, str):
        for entry in node:
            if isinstance(entry, dict) and entry.get("name") == part:
                return entry
    raise _nowhere(node, parts, depth)


def _nowhere(node: Any, parts: tuple[str | int, ...], depth: int) -> SceneError:
    here = key_name(parts[:depth]) or "the file"
    if isinstance(node, dict):
        for table, entries in node.items() if depth == 0 else ():
            if isinstance(entries, list) and any(isinstance(e, dict) and e.get("name") == parts[0] for e in entries):
                rest = [part for part in parts[1:] if part != 0]
                meant = key_name([table, *parts[:1], *rest])
                return SceneError(parts, says=f"is no table of this scene, but a {table} has that name: {meant}")
        return SceneError(parts, says=f"is not in this scene; {did_you_mean(str(parts[depth]), list(node))}")
    if isinstance(node, list):
        names = [str(one["name"]) for one in node if isinstance(one, dict) and "name" in one]
        what = f"{here}[0] to [{len(node) - 1}]" if len(node) > 1 else f"{here}[0]"
        named = f"; or, by name, {', '.join(names)}" if names else ""
        return SceneError(parts, says=f"is not in this scene; there is {what}{named}")
    return SceneError(parts, says=f"is not in this scene; {here} is {node!r}, which has no parts")
