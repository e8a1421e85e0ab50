"""Scene files: TOML to Scene. The way back is `Scene.save`.

Tables are read in the order of scene.parts.PARTS, whatever their order in the file, and shapes after the balls, in that of
shapes.BUILT_IN. Springs that name no group therefore count all balls in this order.
"""

import inspect
import os
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.probe_readings import units_of
from taichi_sim.common import validation
from taichi_sim.common.atomic_file import not_there, require_file
from taichi_sim.common.errors import KeyPath, SceneError, did_you_mean, key_name
from taichi_sim.common.npz import read_npz
from taichi_sim.files.toml_document import Parsed, located, parsed
from taichi_sim.geometry.outlines import FONT_FILES
from taichi_sim.scene.camera_path import CameraPath, require_depth
from taichi_sim.scene.looks import Look, Subjects
from taichi_sim.scene.overlay import Overlay
from taichi_sim.scene.part import Part
from taichi_sim.scene.parts import PARTS
from taichi_sim.scene.pins import chosen as chosen_balls
from taichi_sim.scene.pins import ends, is_described
from taichi_sim.scene.scene import Scene
from taichi_sim.shapes.base import Shape

if TYPE_CHECKING:
    from pydantic import BaseModel

__all__ = ["Reader", "load_scene"]


def load_scene(
    path: str | os.PathLike[str],
    *,
    tables: Mapping[str, Callable[..., Any]] | None = None,
    allow_outside: bool = False,
) -> Scene:
    """Read a scene file. `scene.settings` then holds its [simulation] table, `scene.output` its [output] table.

    A scene file can do no more than describe a scene: it reads arrays and meshes from its own folder and the folders in it. With
    allow_outside it may name files anywhere. What is too large for the memory that is free is refused before it is made.

    tables: user-defined ones, name to a function that is called with the scene and the keys of each `[[name]]`, after balls and
    shapes are there. A `ts.shapes.Shape` that it returns gets the key `name`, if there is one, as other shapes do.

    Raises SceneError with one message that names the file, the line, the key's path (`springs[3].pairs[12]`), the
    value and what is allowed; FileNotFoundError when there is no such file, another OSError
    for a folder, a pipe or a device.
    """
    if not isinstance(path, (str, os.PathLike)):
        raise SceneError("path", path, "the name of a scene file")
    file = Path(path)
    if not file.is_file():
        raise not_there(file, "scene file")
    return Reader(file, *parsed(file), tables, allow_outside).scene()


class Reader(Parsed):
    """Builds a Scene from one parsed document."""

    def __init__(
        self,
        file: Path,
        text: str,
        document: dict[str, Any],
        tables: Mapping[str, Callable[..., Any]] | None = None,
        allow_outside: bool = False,
    ) -> None:
        from taichi_sim.files.toml_schema import Document

        self.tables = tables or {}
        super().__init__(file, text, document, self.tables)
        self.allow_outside = allow_outside
        known = {"format", "dim", "gravity", "simulation", "output", *Document.model_fields}
        for name, function in self.tables.items():
            if name in known or not callable(function):
                why = "is a table that scene files have already" if name in known else f"{function!r} is no function"
                raise ValueError(f"tables: {name}: {why}")
        self.groups: dict[str, NDArray[np.int32]] = {}
        self._named_at: dict[str, str] = {}  # the tables that have these names

    def scene(self) -> Scene:
        self._spell()
        model: Any = self._validated()
        with self._at():
            scene = Scene(model.dim, model.gravity)
            scene.locate = partial(located, self.file, self.text)
            scene.settings, scene.output = _given(model.simulation), _given(model.output)
        for part in PARTS:
            for place, table in _tables(model, part.name):
                with self._at(*place):
                    arguments = self._arguments(scene, part, table)
                    group = arguments.pop("name", None) if part.name == "balls" else None
                    self._name(scene, place, group, part.add(scene, arguments))
            if part.name == "balls":
                self._shapes(scene, model)
                self._user_defined(scene)
        with self._at("output", "camera"):
            self._camera(scene)
        self._looks(scene)
        with self._at("output"):
            require_depth(scene.output.get("aperture", 0.0), scene.dim)
        with self._at("output", "overlay"):
            if "overlay" in scene.output:
                Overlay.of(scene.output["overlay"], scene.dim, units_of(scene))
        if scene.n_balls == 0:
            says = "holds no ball; a scene needs at least one, from [[balls]] or a shape"
            raise SceneError((), says=says, file=self.file)
        return scene

    def _shapes(self, scene: Scene, model: Any) -> None:
        from taichi_sim.files.toml_schema import SHAPES

        for name, add in SHAPES.items():
            for place, table in _tables(model, name):
                with self._at(*place):
                    arguments = self._with_files(_given(table))
                    group = arguments.pop("name", None)
                    before = len(scene.colliders)
                    self._name(scene, place, group, add(scene, **arguments).balls)
                    solid = range(before, len(scene.colliders))
                    for k in solid if group else ():
                        scene.set_collider_name(k, group if len(solid) == 1 else f"{group}_{k - before}")

    def _user_defined(self, scene: Scene) -> None:
        for name, function in self.tables.items():
            given = self.document.get(name, [])
            for index, table in enumerate(given if isinstance(given, list) else [given]):
                with self._at(name, index):
                    if not isinstance(table, dict):
                        raise SceneError((name, index), table, f"a table, [[{name}]]")
                    keys = dict(table)
                    group = keys.pop("name", None)
                    try:
                        inspect.signature(function).bind(scene, **keys)
                    except TypeError as error:
                        raise SceneError((name, index), says=str(error)) from None
                    try:
                        made = function(scene, **keys)
                    except SceneError:
                        raise
                    except (TypeError, ValueError) as error:
                        raise SceneError((name, index), says=str(error)) from error
                    if isinstance(made, Shape):
                        self._name(scene, (name, index), group, made.balls)
                    elif group is not None:
                        raise SceneError("table.name", says="is not allowed; what this table adds is no shape")

    def _arguments(self, scene: Scene, part: Part, table: "BaseModel") -> dict[str, Any]:
        """Arguments from a table of a part, with the scene's numbers of balls, and with files found beside the scene's."""
        arguments = self._with_arrays(part, table)
        if part.counted:
            group = arguments.pop("balls", None)
            balls = np.arange(scene.n_balls, dtype=np.int32) if group is None else self._named("table.balls", group)
            for key in part.counted:
                if key in arguments:
                    arguments[key] = _within(balls, f"{part.name}.{key}", arguments[key])
        for key, members in part.chosen.items():
            if key in arguments:
                arguments[key] = self._chosen(scene, f"{part.name}.{key}", arguments, key, members)
            elif members in arguments:
                says = f"count within `{key}`, which is missing; it must be the name of a group"
                raise SceneError(("table", members), says=says)
        return self._with_files(arguments)

    def _chosen(self, scene: Scene, where: str, arguments: dict[str, Any], key: str, members: str) -> NDArray[np.int32]:
        """The balls that `key` names, a group or numbers in the scene, or of a group those of `members`."""
        value, chosen = arguments.pop(key), arguments.pop(members, None)
        if not isinstance(value, str):
            if chosen is not None:
                raise SceneError(("table", members), says=f"count within a group; {key} must be the name of one")
            return validation.indices(where, value, scene.n_balls)
        balls = self._named(where, value)
        if chosen is None:
            return balls
        if is_described(chosen):
            within = np.full(scene.n_balls, -1, dtype=np.int64)
            within[balls] = np.arange(len(balls))
            triangles = within[scene.triangles]
            inside = triangles[(triangles >= 0).all(axis=1)]
            words = ends(len(balls)) if self._named_at[value].startswith("rope[") else {}
            return balls[chosen_balls(f"table.{members}", chosen, scene.position[balls], None, inside, words)]
        return balls[validation.indices(f"table.{members}", chosen, len(balls))]

    def _named(self, where: str, name: str) -> NDArray[np.int32]:
        """The balls of a group."""
        if name not in self.groups:
            raise SceneError(where, name, says=f"is not a name in this file; {did_you_mean(name, self.groups)}")
        return self.groups[name]

    def _camera(self, scene: Scene) -> None:
        """Check [output.camera]; a name to follow becomes its balls."""
        camera = scene.output.get("camera")
        if camera is None:
            return
        name = camera.get("follow")
        if isinstance(name, str):
            camera["follow"] = self._named("camera.follow", name).tolist()
        CameraPath.of(camera, scene.dim, scene.n_balls)

    def _looks(self, scene: Scene) -> None:
        """Check [[output.looks]]; textures lie beside the file."""
        subjects, seen = Subjects.of_scene(scene), list[Look]()
        for k, look in enumerate(scene.output.get("looks") or ()):
            with self._at("output", "looks", k):
                if isinstance(look.get("texture"), str):
                    look["texture"] = str(self._beside("texture", look["texture"]))
                seen.append(Look.of_table(f"looks[{k}]", look, subjects, seen))
                seen[k].sizes(f"looks[{k}]")

    # Parts of a table ----------------------------------------------------------------------------------------------

    def _name(self, scene: Scene, place: KeyPath, name: str | None, balls: NDArray[np.int32]) -> None:
        if name is None:
            return
        if name in self.groups:
            says = f"is the name of {self._named_at[name]} already; every group of balls needs its own"
            raise SceneError("table.name", name, says=says)
        if len(balls):
            scene.set_name(balls, name)
        self.groups[name], self._named_at[name] = balls, key_name(place)

    def _with_files(self, arguments: dict[str, Any]) -> dict[str, Any]:
        """Arguments whose files lie beside the scene's."""
        for key in ("mesh", "file", "font"):
            named = arguments.get(key)
            if isinstance(named, str) and (key != "font" or named.lower().endswith(FONT_FILES)):
                arguments[key] = self._beside(key, named)
        return arguments

    def _with_arrays(self, part: Part, table: "BaseModel") -> dict[str, Any]:
        """The keys of a table, together with the arrays from the .npz that its `file` names."""
        arguments = _given(table)
        name, prefix = arguments.pop("file", None), arguments.pop("prefix", "")
        if name is not None:
            own = ("file", "prefix", "name", *(["balls"] if part.counted else []))
            known = [key for key in type(table).model_fields if key not in own]
            for key, array in self._arrays(name, prefix).items():
                if key not in known:
                    says = f"holds the array {prefix + key!r}; {did_you_mean(key, known)}"
                    raise SceneError("table.file", name, says=says)
                if key in arguments:
                    raise SceneError(("table", key), says=f"stands in the table and in {name!r}; give it once")
                arguments[key] = array
        needed: Any = type(table).model_config.get("json_schema_extra", {})
        for key in needed.get("x-in-file", ()):
            if arguments.get(key) is None:
                raise SceneError(("table", key), says="is missing; give it here or in a `file`")
        return arguments

    def _arrays(self, name: str, prefix: str) -> dict[str, NDArray]:
        """The arrays of an .npz beside the scene file whose names begin with `prefix`, without it."""
        file = self._beside("file", name)
        try:
            found = read_npz(file, prefix)
        except FileNotFoundError:
            raise SceneError("table.file", file, says="is not there; it must be an existing .npz file") from None
        except SceneError as error:
            raise SceneError("table.file", file, says=error.says) from None
        if not found:
            raise SceneError("table.file", file, says=f"holds no array whose name begins with {prefix!r}")
        return found

    def _beside(self, key: str, name: str) -> Path:
        """A file that the scene file names, from its own folder on."""
        folder, file = self.file.parent, self.file.parent / name
        try:
            outside = not file.resolve().is_relative_to(folder.resolve())
        except (OSError, RuntimeError, ValueError) as error:  # a circle of links, a zero byte
            raise SceneError(("table", key), name, says=f"is no name of a file: {error}") from None
        if outside and not self.allow_outside:
            says = (
                "lies outside the folder of the scene; if you trust the scene, allow it with --allow-outside, in Python"
                " ts.load_scene(..., allow_outside=True)"
            )
            raise SceneError(("table", key), name, says=says)
        try:
            require_file(file)
        except ValueError as error:
            raise SceneError(("table", key), name, says=f"cannot be read: {error}") from None
        return file


# Data --------------------------------------------------------------------------------------------------------------


def _tables(model: Any, name: str) -> Iterator[tuple[KeyPath, Any]]:
    """The tables of that name, each with its place in the file."""
    tables = getattr(model, name)
    if isinstance(tables, tuple):
        yield from (((name, index), table) for index, table in enumerate(tables))
    elif tables is not None:
        yield (name,), tables


def _given(table: Any) -> dict[str, Any]:
    """The keys that the file gives, the rest being left to the defaults of the function."""
    given = {name: getattr(table, name) for name in type(table).model_fields if name in table.model_fields_set}
    for name, value in given.items():
        try:
            np.shape(value if name != "path" else ())  # keyframes are no vectors
        except ValueError:
            says = "its lists differ in length; give every vector as many numbers"
            raise SceneError(("table", name), says=says) from None
    return given


def _within(balls: NDArray[np.int32], where: str, value: Any) -> NDArray[np.int32]:
    """Numbers within `balls`, (k,) or (k, width), as the scene's."""
    shape = np.shape(value)
    return balls[validation.indices(where, value, len(balls), width=shape[1] if len(shape) == 2 else None)]
