"""Scene files: TOML to Scene. The way back is `Scene.save`.

Tables are read in a fixed order, whatever their order in the file: materials, balls, the shapes (cloth, jelly, rope,
wheel, pile, truss, net, balloon, tower), springs, attachments, cells, bending, gases, moving pins, wind, walls, colliders,
triangles, embedded_surfaces, probes. Springs that name no group therefore count all balls in this order.
"""

import difflib
import inspect
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common import validation
from taichi_sim.common.atomic_file import arrays_in
from taichi_sim.common.errors import SceneError
from taichi_sim.files.toml_lines import key_name, line_of
from taichi_sim.scene.camera_path import CameraPath
from taichi_sim.scene.colliders import shape_of
from taichi_sim.scene.scene import Scene
from taichi_sim.shapes.base import Shape

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

if TYPE_CHECKING:
    from pydantic import BaseModel

__all__ = ["Reader", "load_scene"]

_Path = tuple[str | int, ...]
_KEY = re.compile(r"^(?:\w+(?:\[\d+\])?\.|material '.*?': )?(?P<key>\w[\w\[\].]*): (?P<what>.*)$", re.DOTALL)
_ALLOWED = re.compile(r"^(?:Input|List|Tuple|Value) should (?:be|have) (?:a valid |an instance of )?")
_PLAIN = {
    "integer": "a whole number",
    "boolean": "true or false",
    "string": "a text",
    "tuple": "a list",
    "Sequence": "a list",
}


def load_scene(path: str | os.PathLike[str], *, tables: Mapping[str, Callable[..., Any]] | None = None) -> Scene:
    """Read a scene file. `scene.settings` then holds its [simulation] table, `scene.output` its [output] table.

    tables: user-defined ones, name to a function that is called with the scene and the keys of each `[[name]]`, after balls and
    shapes are there. A `ts.shapes.Shape` that it returns gets the key `name`, if there is one, as other shapes do.

    Raises SceneError with one message that names the file, the line, the key's path (`springs[3].pairs[12]`), the
    value and what is allowed; FileNotFoundError when there is no such file.
    """
    file = Path(path)
    if not file.is_file():
        raise FileNotFoundError(f"{file}: there is no such scene file")
    try:
        text = file.read_text(encoding="utf-8")
        document = tomllib.loads(text)
    except UnicodeDecodeError as error:
        raise SceneError(f"{file}: is not a text in UTF-8: {error.reason} at byte {error.start}") from None
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"{file}: is not valid TOML: {error}") from None
    return Reader(file, text, document, tables).scene()


class Reader:
    """Builds a Scene from one parsed document; every error leaves it with the file, the line and the key's path."""

    def __init__(
        self, file: Path, text: str, document: dict[str, Any], tables: Mapping[str, Callable[..., Any]] | None = None
    ) -> None:
        self.file, self.text, self.document, self.tables = file, text, document, tables or {}
        self.groups: dict[str, NDArray[np.int32]] = {}

    def scene(self) -> Scene:
        from taichi_sim.files.toml_schema import SHAPES

        model: Any = self._validated()
        with self._at():
            scene = Scene(model.dim, model.gravity)
            scene.settings, scene.output = _given(model.simulation), _given(model.output)
        for index, table in enumerate(model.materials):
            with self._at("materials", index):
                scene.add_material(**_given(table))
        self._balls(scene, model.balls)
        for name, add in SHAPES.items():
            for index, table in enumerate(getattr(model, name)):
                with self._at(name, index):
                    arguments = _given(table)
                    group = arguments.pop("name", None)
                    if "mesh" in arguments and isinstance(arguments["mesh"], str):
                        arguments["mesh"] = self.file.parent / arguments["mesh"]
                    self._name(group, add(scene, **arguments).balls)
        self._user_defined(scene)
        for index, table in enumerate(model.springs):
            with self._at("springs", index):
                arguments = self._with_file(("springs", index), table, ("pairs", "stiffness"))
                arguments["pairs"] = self._members(scene, "springs.pairs", arguments, 2)
                scene.add_springs(**arguments)
        self._elements(scene, model)
        self._walls(scene, model.walls)
        for index, table in enumerate(model.colliders):
            with self._at("colliders", index):
                arguments = self._with_file(("colliders", index), table, ())
                if "mesh" in arguments:
                    arguments["mesh"] = self.file.parent / arguments["mesh"]
                scene.add_collider(shape_of(arguments))
        for index, table in enumerate(model.triangles):
            with self._at("triangles", index):
                arguments = self._with_file(("triangles", index), table, ("triangles",))
                arguments["triangles"] = self._members(scene, "triangles.triangles", arguments, 3)
                scene.add_triangles(**arguments)
        for index, table in enumerate(model.embedded_surfaces):
            with self._at("embedded_surfaces", index):
                arguments = self._with_file(("embedded_surfaces", index), table, ("corners", "weights", "triangles"))
                balls = self._group(scene, arguments)
                for name in ("corners", "covers"):
                    if name in arguments:
                        arguments[name] = _within(balls, f"embedded_surfaces.{name}", arguments[name])
                scene.add_embedded_surface(**arguments)
        for index, table in enumerate(model.probes):
            with self._at("probes", index):
                arguments = self._with_file(("probes", index), table, ())
                if "balls" in arguments:
                    arguments["balls"] = self._chosen(scene, "probes.balls", arguments, "balls", "members")
                elif "members" in arguments:
                    raise SceneError("members: count within a group of balls; balls must be the name of one")
                scene.add_probe(**arguments)
        with self._at("output", "camera"):
            self._camera(scene)
        if scene.n_balls == 0:
            raise SceneError(f"{self.file}: holds no ball; a scene needs at least one, from [[balls]] or a shape")
        return scene

    def _balls(self, scene: Scene, tables: "Sequence[BaseModel]") -> None:
        highest = max((table.body for table in tables), default=0)  # type: ignore[attr-defined]
        while highest > 0 and scene.new_body() < highest:
            pass  # so that no shape in the same scene takes a number that the file uses
        for index, table in enumerate(tables):
            with self._at("balls", index):
                arguments = self._with_file(("balls", index), table, ("position", "radius"))
                group = arguments.pop("name", None)
                self._name(group, scene.add_balls(**arguments))

    def _user_defined(self, scene: Scene) -> None:
        for name, function in self.tables.items():
            given = self.document.get(name, [])
            for index, table in enumerate(given if isinstance(given, list) else [given]):
                with self._at(name, index):
                    keys = dict(table) if isinstance(table, dict) else {name: table}
                    group = keys.pop("name", None)
                    try:
                        inspect.signature(function).bind(scene, **keys)
                    except TypeError as error:
                        raise SceneError(str(error)) from None
                    made = function(scene, **keys)
                    if isinstance(made, Shape):
                        self._name(group, made.balls)
                    elif group is not None:
                        raise SceneError("name: is not allowed; what this table adds is no shape")

    def _elements(self, scene: Scene, model: Any) -> None:
        for index, table in enumerate(model.attachments):
            with self._at("attachments", index):
                arguments = _given(table)
                for side in ("one", "other"):
                    arguments[side] = self._chosen(scene, f"attachments.{side}", arguments, side, f"{side}_members")
                scene.attach(**arguments)
        parts = (
            ("cells", "corners", scene.dim + 1, scene.add_cells, ("corners", "bulk_modulus")),
            ("bending", "corners", 4, scene.add_bending, ("corners", "weights", "stiffness")),
            ("gases", "triangles", 3, scene.add_gas, ("triangles",)),
        )
        for name, key, width, add, needed in parts:
            for index, table in enumerate(getattr(model, name)):
                with self._at(name, index):
                    arguments = self._with_file((name, index), table, needed)
                    arguments[key] = self._members(scene, f"{name}.{key}", arguments, width)
                    add(**arguments)
        for index, table in enumerate(model.moving_pins):
            with self._at("moving_pins", index):
                arguments = self._with_file(("moving_pins", index), table, ("balls",))
                arguments["balls"] = self._chosen(scene, "moving_pins.balls", arguments, "balls", "members")
                scene.add_moving_pins(**arguments)
        if model.wind is not None:
            with self._at("wind"):
                scene.add_wind(**_given(model.wind))

    def _chosen(self, scene: Scene, where: str, arguments: dict[str, Any], key: str, members: str) -> NDArray[np.int32]:
        """The balls that `key` names, a group or numbers in the scene, or of a group those of `members`."""
        value, chosen = arguments.pop(key), arguments.pop(members, None)
        if not isinstance(value, str):
            if chosen is not None:
                raise SceneError(f"{members}: count within a group of balls; {key} must be the name of one")
            return validation.indices(where, value, scene.n_balls)
        if value not in self.groups:
            raise SceneError(f"{key}: {value!r} is not a name in this file; {_one_of(value, list(self.groups))}")
        balls = self.groups[value]
        return (
            balls
            if chosen is None
            else balls[validation.indices(f"{where.partition('.')[0]}.{members}", chosen, len(balls))]
        )

    def _walls(self, scene: Scene, tables: "Sequence[BaseModel]") -> None:
        for index, table in enumerate(tables):
            with self._at("walls", index):
                arguments = _given(table)
                scene.add_wall(**arguments)
                normal = np.asarray(arguments["normal"], dtype=np.float64)
                if abs(np.linalg.norm(normal) - 1.0) < 4e-16:  # unit to rounding: a saved scene comes back bit for bit
                    scene.walls[-1] = replace(scene.walls[-1], normal=tuple(normal.tolist()))

    def _camera(self, scene: Scene) -> None:
        """Check [output.camera]; a name to follow becomes its balls."""
        camera = scene.output.get("camera")
        if camera is None:
            return
        name = camera.get("follow")
        if isinstance(name, str):
            if name not in self.groups:
                raise SceneError(
                    f"camera.follow: {name!r} is not a name in this file; {_one_of(name, list(self.groups))}"
                )
            camera["follow"] = self.groups[name].tolist()
        CameraPath.of(camera, scene.dim, scene.n_balls)

    # Parts of a table ----------------------------------------------------------------------------------------------

    def _name(self, name: str | None, balls: NDArray[np.int32]) -> None:
        if name is None:
            return
        if name in self.groups:
            raise SceneError(f"name: {name!r} exists already; every group of balls needs its own name")
        self.groups[name] = balls

    def _members(self, scene: Scene, where: str, arguments: dict[str, Any], width: int) -> NDArray[np.int32]:
        """The scene's balls that a table of springs or triangles names within its group."""
        balls = self._group(scene, arguments)
        value = arguments[where.partition(".")[2]]
        if width == 2 and np.shape(value) == (2,):
            value = [value]
        return balls[validation.indices(where, value, len(balls), width=width)]

    def _group(self, scene: Scene, arguments: dict[str, Any]) -> NDArray[np.int32]:
        """The balls that a table counts within: its group's, or all."""
        group = arguments.pop("balls", None)
        if group is None:
            return np.arange(scene.n_balls, dtype=np.int32)
        if group in self.groups:
            return self.groups[group]
        raise SceneError(f"balls: {group!r} is not a name in this file; {_one_of(group, list(self.groups))}")

    def _with_file(self, place: _Path, table: "BaseModel", needed: Sequence[str]) -> dict[str, Any]:
        """The keys of a table, together with the arrays from the .npz that its `file` names."""
        arguments = _given(table)
        name, prefix = arguments.pop("file", None), arguments.pop("prefix", "")
        if name is not None:
            named = place[0] in ("moving_pins", "probes")  # there `balls` may be numbers
            own = ("file", "prefix", "name") if named else ("file", "prefix", "name", "balls")
            known = [key for key in type(table).model_fields if key not in own]
            for key, array in arrays_in(self.file.parent / name, prefix).items():
                if key not in known:
                    raise SceneError(f"file: {name!r} holds the array {prefix + key!r}; {_one_of(key, known)}")
                if key in arguments:
                    raise SceneError(f"{key}: stands in the table and in {name!r}; give it once")
                arguments[key] = array
        for key in needed:
            if arguments.get(key) is None:
                raise SceneError(f"{key}: is missing; give it here or in a `file`")
        return arguments

    # Errors --------------------------------------------------------------------------------------------------------

    @contextmanager
    def _at(self, *place: str | int) -> Iterator[None]:
        """Give an error from within the block its file, line and path."""
        try:
            yield
        except SceneError as error:
            found = _KEY.match(str(error))
            key, what = found.group("key", "what") if found else ("", str(error))
            names = tuple(int(n) if n.isdigit() else n for n in re.findall(r"\w+", key))
            own = (
                () if names in (place[:1], place) else names
            )  # a shape's error about itself: `cloth: needs a scene in 3D`
            raise self._error(_fitting(self.document, place + own), what) from error

    def _error(self, path: _Path, what: str) -> SceneError:
        line = line_of(self.text, path)
        place = str(self.file) if line is None else f"{self.file}, line {line}"
        return SceneError(f"{place}: {key_name(path)}: {what}" if path else f"{place}: {what}")

    def _validated(self) -> "BaseModel":
        from pydantic import ValidationError

        from taichi_sim.files.toml_schema import Document

        try:
            return Document.model_validate(
                _frozen({name: table for name, table in self.document.items() if name not in self.tables})
            )
        except ValidationError as error:
            problems = error.errors(include_url=False)
        unknown = next((p for p in problems if p["type"] == "extra_forbidden"), None)
        if unknown is not None:
            raise self._error(unknown["loc"], _unknown(unknown["loc"]))
        first = problems[0]
        path = _known(self.document, first["loc"])
        if first["type"] == "missing":
            missing = (*path, *first["loc"][len(path) : len(path) + 1])
            raise self._error(missing, f"is missing; {_wanted(missing)}")
        here = [p for p in problems if _known(self.document, p["loc"]) == path]
        same = [("a list, each " if _of_items(p["loc"], path) else "") + _allowed(p["msg"]) for p in here]
        raise self._error(path, self._refusal(path, same))

    def _refusal(self, path: _Path, allowed: list[str]) -> str:
        value: Any = self.document
        for part in path:
            value = value[part]
        if len(path) == 1 and isinstance(value, dict):
            return f"is written as one table; there may be several of them: write [[{path[0]}]]"
        shown = repr(value) if len(repr(value)) <= 60 else repr(value)[:57] + "..."
        return f"{shown} is not allowed; it must be {' or '.join(dict.fromkeys(allowed))}"


# Words -------------------------------------------------------------------------------------------------------------


def _allowed(message: str) -> str:
    """What is allowed, from a message of pydantic: `Input should be a valid number` -> `a number`."""
    words = _ALLOWED.sub("", message).split(" after validation")[0]
    if words in _PLAIN:
        return _PLAIN[words]
    return f"a {words}" if words in ("number", "dictionary") else words


def _of_items(location: Sequence[str | int], path: _Path) -> bool:
    """Whether an error of pydantic at `path` is about the items of a list that the value might be."""
    return any(isinstance(part, int) for part in location[len(path) :])


def _wanted(path: _Path) -> str:
    return "the first line of a scene file is `format = 1`" if path == ("format",) else "this table needs it"


def _unknown(path: _Path) -> str:
    """An unknown key's message: the closest of the keys that its table knows."""
    from taichi_sim.files.toml_schema import TABLES, Document, Output, Simulation, Wind

    key = str(path[-1])
    table = (
        {"simulation": Simulation, "output": Output, "wind": Wind, **TABLES}.get(str(path[0]))
        if len(path) > 1
        else Document
    )
    known = list(table.model_fields) if table is not None else []  # type: ignore[attr-defined]
    return f"is not a known key; {_one_of(key, known)}"


def _one_of(word: str, known: Sequence[str]) -> str:
    """`did you mean 'mass'?`, or all that there is."""
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.6)
    if close:
        return f"did you mean {close[0]!r}?"
    return f"there are {', '.join(known)}" if known else "there are none"


# Data --------------------------------------------------------------------------------------------------------------


def _given(table: Any) -> dict[str, Any]:
    """The keys that the file gives, the rest being left to the defaults of the function."""
    given = {name: getattr(table, name) for name in type(table).model_fields if name in table.model_fields_set}
    for name, value in given.items():
        try:
            np.shape(value if name != "path" else ())  # keyframes are no vectors
        except ValueError:
            raise SceneError(f"{name}: its lists differ in length; give every vector as many numbers") from None
    return given


def _within(balls: NDArray[np.int32], where: str, value: Any) -> NDArray[np.int32]:
    """Numbers within `balls`, (k,) or (k, width), as the scene's."""
    shape = np.shape(value)
    return balls[validation.indices(where, value, len(balls), width=shape[1] if len(shape) == 2 else None)]


def _frozen(value: Any) -> Any:
    """Lists as tuples, all the way down: what the strict models take for a sequence of any kind."""
    if isinstance(value, dict):
        return {key: _frozen(item) for key, item in value.items()}
    return tuple(_frozen(item) for item in value) if isinstance(value, list) else value


def _known(document: Any, path: Sequence[str | int]) -> _Path:
    """The leading part of a path that exists in the document: pydantic's own goes on into the members of a union."""
    for depth, part in enumerate(path):
        fits = isinstance(document, dict) and part in document
        fits = fits or (isinstance(document, list) and isinstance(part, int) and part < len(document))
        if not fits:
            return tuple(path[:depth])
        document = document[part]
    return tuple(path)


def _fitting(document: Any, path: _Path) -> _Path:
    """The path without an index 0 that the document does not have: one vector was checked as a list of one."""
    for depth, part in enumerate(path):
        shorter = path[:depth] + path[depth + 1 :]
        if part == 0 and len(_known(document, path)) < len(path) and _known(document, shorter) == shorter:
            return shorter
    return path
