"""The keys of a scene file and their types, as pydantic models; values are judged where the scene is built.

A table that stands for a function (`[[balls]]`: Scene.add_balls, `[[cloth]]`: shapes.cloth, ...) takes the arguments
of that function, read from its signature, and says of each what the docstring says: a new argument there is a new key here.
"""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Annotated, Any, Literal, get_type_hints

from annotated_types import Ge, Le
from numpy.typing import ArrayLike
from pydantic import BaseModel, Field, create_model

from taichi_sim import shapes
from taichi_sim.common.docstrings import described
from taichi_sim.files.toml_settings import Output, Simulation
from taichi_sim.files.toml_types import Strict, key_of, typed
from taichi_sim.scene import collider_shapes
from taichi_sim.scene.part import Part
from taichi_sim.scene.parts import PARTS
from taichi_sim.scene.pins import Members
from taichi_sim.scene.scene import Scene

__all__ = [
    "ALIASES",
    "COLLIDERS",
    "SHAPES",
    "TABLES",
    "Document",
    "keys_at",
    "what_is_allowed",
]

MOST_BODIES = 1_000_000
ALIASES = {"color": "colour", "color_range": "colour_range"}  # other spellings that a scene file may use
SHAPES: dict[str, Callable[..., shapes.Shape]] = {function.__name__: function for function in shapes.BUILT_IN}
SHARED = {name for function in shapes.BUILT_IN for name in inspect.signature(function).parameters}  # their arguments


def _arguments(name: str, function: Callable[..., Any], in_file: Iterable[str] = (), /, **more: Any) -> type[BaseModel]:
    """A model with the arguments of a function (its first, the scene, aside) and `more` keys of the file alone.

    in_file: of those that are needed, such as may lie in the table's file instead.
    """
    if inspect.isclass(function):  # what its bases annotate stands for what their modules mean by it
        hints = get_type_hints(function, include_extras=True)
        parameters = [p.replace(annotation=hints[p.name]) for p in inspect.signature(function).parameters.values()]
    else:
        parameters = list(inspect.signature(function, eval_str=True).parameters.values())[1:]
    says = described(shapes.__doc__, SHARED) if name in SHAPES else {}
    says |= _says(function, [p.name for p in parameters])
    fields = {}
    for parameter in parameters:
        default = None if parameter.name in in_file else parameter.default
        default = ... if default is inspect.Parameter.empty else default
        fields[parameter.name] = (typed(parameter.annotation), key_of(default, says.get(parameter.name, "")))
    doc = (inspect.getdoc(function) or "").split("\n\n")[0].replace("\n", " ")
    model: type[BaseModel] = create_model(name, __base__=Strict, __doc__=doc, **(fields | more))
    model.model_config["json_schema_extra"] = {"x-in-file": list[Any](in_file)} if in_file else {}
    return model


def _says(function: Any, names: Sequence[str]) -> dict[str, str]:
    """Descriptions of arguments, by name, from the docstring of a function, or those of a class and its bases."""
    says: dict[str, str] = {}
    for one in reversed(inspect.getmro(function)) if inspect.isclass(function) else (function,):
        says |= described(one.__doc__, names)
    return says


def _colliders() -> type[BaseModel]:
    """A model with the arguments of all colliders; which of them a `shape` takes and needs is judged where it is built."""
    fields: dict[str, Any] = {
        name: (field.annotation, None) for model in COLLIDERS.values() for name, field in model.model_fields.items()
    }
    fields |= {"shape": (Literal[tuple(COLLIDERS)], ...)}
    doc = "A solid body of infinite mass, which stands where it is or moves along its path and pushes balls."
    return create_model("colliders", __base__=Strict, __doc__=doc, **fields)


_file: dict[str, Any] = {
    "file": (str | None, key_of(None, "an .npz that holds the longer of these arrays, each under its key")),
    "prefix": (str, key_of("", "what its name in the file begins with")),
}
_name: dict[str, Any] = {
    "name": (
        str | None,
        key_of(None, "what other tables, and files for other programs, call it; in Python `scene.set_name`"),
    )
}
_group: dict[str, Any] = {
    "balls": (
        str | None,
        key_of(None, "a name, of a shape or of balls, within which balls are counted; all balls otherwise"),
    )
}
_body: dict[str, Any] = {
    "body": (
        Annotated[int, Ge(0), Le(MOST_BODIES)],
        key_of(0, "a number that balls share which do not collide with each other; 0: none"),
    )
}
_many = {
    "vertices": (typed(ArrayLike | None), key_of(None, "(v, 3) of a mesh given by hand [m]")),
    "triangles": (typed(ArrayLike | None), key_of(None, "(t, 3) vertices of its triangles")),
}


def _chosen(key: str, members: str, needed: bool) -> dict[str, Any]:
    """Keys that name balls, and those of them that are meant."""
    named: Any = str | tuple[int, ...]
    says = (
        f"those of the balls named by `{key}` that are meant: numbers within them, or words or shapes, as for `pinned`"
    )
    return {
        key: (
            named if needed else named | None,
            key_of(... if needed else None, "a name, of a shape or of balls, or ball numbers in the scene"),
        ),
        members: (typed(Members | None), key_of(None, says)),
    }


COLLIDERS: Mapping[str, type[BaseModel]] = {
    name: _arguments(
        name,
        kind,
        ("mesh",) if name == "mesh" else (),
        shape=(Literal[name], key_of(..., "which shape it has")),  # type: ignore[valid-type]
        **(_many | _file if name == "mesh" else {}),
    )
    for name, kind in collider_shapes.SHAPES.items()
}


def _table(part: Part) -> type[BaseModel]:
    """The model of a part's table. Arrays without a default may lie in its file, if it has one."""
    method = getattr(Scene, part.method)
    more: dict[str, Any] = _group if part.counted else {}
    for key, members in part.chosen.items():
        more = more | _chosen(key, members, needed=not part.has_file)
    if part.name == "balls":
        more = _name | more | _body
    if not part.has_file:
        return _arguments(part.name, method, **more)
    arrays = [one.name for one in inspect.signature(method, eval_str=True).parameters.values() if _is_needed_array(one)]
    return _arguments(part.name, method, arrays, **more, **_file)


def _is_needed_array(parameter: inspect.Parameter) -> bool:
    return parameter.default is inspect.Parameter.empty and parameter.annotation is ArrayLike


TABLES: dict[str, type[BaseModel]] = {}
for _part in PARTS:
    TABLES[_part.name] = _colliders() if _part.name == "colliders" else _table(_part)
    if _part.name == "balls":  # shapes are added after them
        TABLES |= {name: _arguments(name, function, **_name) for name, function in SHAPES.items()}

SINGLE = {part.name for part in PARTS if part.is_single}
_document: dict[str, Any] = {
    "format": (Literal[1], key_of(..., "of the file: 1")),
    "dim": (Literal[2, 3], key_of(2, "dimensions of the scene")),
    "gravity": (typed(ArrayLike | None), key_of(None, "acceleration (dim,) [m/s^2]; none by default")),
    "simulation": (Simulation, Field(default_factory=Simulation, description=Simulation.__doc__)),
    "output": (Output, Field(default_factory=Output, description=Output.__doc__)),
    **{
        name: (model | None, key_of(None, model.__doc__ or ""))
        if name in SINGLE
        else (tuple[model, ...], key_of((), model.__doc__ or ""))  # type: ignore[valid-type]
        for name, model in TABLES.items()
    },
}
Document: type[BaseModel] = create_model("Document", __base__=Strict, **_document)


# Errors ------------------------------------------------------------------------------------------------------------

ALLOWED = {  # by the types of pydantic's errors, filled in from their context
    "greater_than": "greater than {gt}",
    "greater_than_equal": "greater than or equal to {ge}",
    "less_than": "less than {lt}",
    "less_than_equal": "less than or equal to {le}",
    "finite_number": "a finite number",
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "string_type": "a text",
    "tuple_type": "a list",
    "is_instance_of": "a list",
    "sequence_str": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "too_short": "a list of {min_length} or more",
    "too_long": "a list of {max_length} at most",
    "literal_error": "{expected}",
}


def what_is_allowed(problem: Mapping[str, Any]) -> str:
    """Words for what a value must be, from one of the errors of pydantic's ValidationError."""
    words = ALLOWED.get(problem["type"])
    context = {k: int(v) if isinstance(v, float) and v.is_integer() else v for k, v in problem.get("ctx", {}).items()}
    return str(problem["msg"]) if words is None else words.format(**context)


def keys_at(path: Sequence[str | int]) -> list[str]:
    """Keys that may stand beside the last name of a path: for ("balls", 0, "masss") all keys of the table `balls`. Empty for a
    table that is not known."""
    tables: dict[str, Any] = {"simulation": Simulation, "output": Output, **TABLES}
    model = tables.get(str(path[0])) if len(path) > 1 else Document
    return [] if model is None else list(model.model_fields)
