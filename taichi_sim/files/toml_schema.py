"""The keys of a scene file and their types, as pydantic models; values are judged where the scene is built.

A table that stands for a function (`[[balls]]`: Scene.add_balls, `[[cloth]]`: shapes.cloth, ...) takes the arguments
of that function, read from its signature, and says of each what the docstring says: a new argument there is a new key here.
"""

import inspect
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import is_dataclass
from os import PathLike
from typing import Annotated, Any, Literal, Union, get_args, get_origin, is_typeddict

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import ArrayLike, NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    PositiveInt,
    TypeAdapter,
    ValidationInfo,
    WithJsonSchema,
    create_model,
)
from pydantic.errors import PydanticUserError
from pydantic_core import PydanticCustomError

from taichi_sim import shapes
from taichi_sim.analysis.methods import BUILT_IN_METHODS, BUILT_IN_RULES, VERLET
from taichi_sim.common.docstrings import described, unit_of
from taichi_sim.scene import collider_shapes
from taichi_sim.scene.camera_path import MOST_APERTURE, CameraPath
from taichi_sim.scene.looks import Look
from taichi_sim.scene.overlay import Overlay
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
    "Output",
    "Simulation",
    "keys_at",
    "what_is_allowed",
]

MOST_BODIES = 1_000_000
METHODS, RULES = ("auto", *BUILT_IN_METHODS), ("auto", *BUILT_IN_RULES)

SHAPES: dict[str, Callable[..., shapes.Shape]] = {function.__name__: function for function in shapes.BUILT_IN}
SHARED = {name for function in shapes.BUILT_IN for name in inspect.signature(function).parameters}  # their arguments

Seconds = Annotated[FiniteFloat, Gt(0)]


ALIASES = {"color": "colour", "color_range": "colour_range"}  # other spellings that a scene file may use


class Strict(BaseModel):
    """Base of the tables: no unknown keys, no conversion of one type into another."""

    model_config = ConfigDict(strict=True, extra="forbid")


def _key(default: Any, says: str) -> Any:
    """A key of a table: its default, `...` where it is needed, and what it means, with its unit, see common/docstrings.py."""
    unit = unit_of(says)
    return Field(default, description=says or None, json_schema_extra={"x-unit": unit} if unit else None)


class Simulation(Strict):
    """[simulation]: arguments of ts.Simulation; what is absent is left to its defaults."""

    dt: Seconds | Literal["auto"] = _key("auto", "time step [s], or auto: 1 ms, or less where that is not safe")
    tolerance: Annotated[FiniteFloat, Gt(0), Lt(1)] | None = _key(
        None,
        "in place of dt: the error allowed in a simulated second, the largest of any ball, as a part of the scene's size [1]",
    )
    integrator: Literal[METHODS] = _key(  # type: ignore[valid-type]
        VERLET.name, "the method; auto: verlet, or an implicit one with its step where that takes far less time"
    )
    precision: Literal["f32", "f64"] = _key("f32", "of the numbers: f32 single, f64 double")
    arch: Literal["auto", "cpu", "cuda", "vulkan", "metal"] = _key(
        "auto", "what computes; auto: a GPU if one works, else the CPU"
    )
    contacts: Literal[RULES] = _key("auto", "how contacts are solved")  # type: ignore[valid-type]
    contact_iterations: PositiveInt | Literal["auto"] = _key("auto", "of each contact solve; more make contacts harder")
    accumulate: Literal["auto", "ordered", "gather", "atomic"] = _key("auto", "in which order impulses are added")
    driver: Literal["auto", "fused", "parallel"] = _key(
        "auto", "how steps are launched; auto: fused for small scenes and on one thread"
    )
    spin: Literal["auto", True, False] = _key(
        "auto", "whether balls turn; auto: loose ones, where a material has friction"
    )
    substeps: PositiveInt | Literal["auto"] = _key("auto", "parts that each step is divided into")
    settle: bool | Annotated[FiniteFloat, Gt(0), Lt(1)] = _key(
        False,
        "bring the scene to rest before its clock starts: true, or the net force that may be left, as a part of the mean weight"
        " of a ball [1]; true: 0.001",
    )
    threads: PositiveInt = _key(1, "CPU threads")


Pixels = Annotated[int, Ge(16), Le(8192)]
Share = Annotated[FiniteFloat, Ge(0), Le(1)]


def _rising(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] >= pair[1]:
        raise PydanticCustomError("rising", "two numbers, the lower first")
    return pair


def _within_a_frame(shutter: float, about: ValidationInfo) -> float:
    """A shutter [s] that is closed before it opens for the next frame."""
    fps = about.data.get("fps")
    if fps is not None and shutter * fps > 1 + 1e-9:
        raise PydanticCustomError("within_a_frame", "at most 1 / fps, {most} s", {"most": float(f"{1 / fps:.4g}")})
    return shutter


# Types and meanings -------------------------------------------------------------------------------------------------

COLLIDER = "x-collider"  # in a schema: a table that describes one of that name
_number = {"type": "number"}
_list = {"type": "array", "items": _number}
NUMBERS = {"anyOf": [_number, _list, {"type": "array", "items": _list}]}  # what NumPy makes an array of
ARRAY_LIKE = set(get_args(ArrayLike)) or {ArrayLike}  # up to NumPy 2.4 a union, which joins the one around it


def _typed(annotation: Any) -> Any:
    """The type of an argument; what pydantic has no word for the function itself checks, and editors get a schema of."""
    if _is_known(annotation):
        return annotation
    return Annotated[Any, WithJsonSchema(_schema(annotation))]


def _is_known(annotation: Any) -> bool:
    """True if pydantic can judge a type: without described tables, which it takes from Python 3.12 on only."""
    if _has_tables(annotation):
        return False
    try:
        TypeAdapter(annotation)
    except PydanticUserError:
        return False
    return True


def _has_tables(annotation: Any) -> bool:
    return is_typeddict(annotation) or any(_has_tables(part) for part in get_args(annotation))


def _schema(annotation: Any) -> dict[str, Any]:
    """A JSON schema of a type that may hold arrays, paths or tables."""
    if annotation is ArrayLike or _is_array(annotation):
        return NUMBERS
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin in (Union, types.UnionType):
        arrays = ARRAY_LIKE.issubset(parts)
        rest = [p for p in parts if p is not types.NoneType and not (arrays and p in ARRAY_LIKE)]
        if any(get_origin(p) is Sequence for p in rest):
            rest = [p for p in rest if not _is_array(p)]  # in a file these are lists, too
        return {"anyOf": [_schema(part) for part in rest] + NUMBERS["anyOf"] * arrays}
    if annotation is PathLike or origin is PathLike:
        return {"type": "string"}
    if annotation in collider_shapes.SHAPES.values():
        return {COLLIDER: next(name for name, kind in collider_shapes.SHAPES.items() if kind is annotation)}
    if is_typeddict(annotation) or is_dataclass(annotation):
        return _object(annotation)
    if origin is tuple and parts[-1:] != (Ellipsis,):
        return {"type": "array", "prefixItems": [_schema(part) for part in parts], "maxItems": len(parts)}
    if origin in (tuple, list, Sequence):
        return {"type": "array", "items": _schema(parts[0])}
    return TypeAdapter(annotation).json_schema()


def _is_array(annotation: Any) -> bool:
    """True if a type is NumPy's of arrays, which has a name of its own from NumPy 2.5 on."""
    return annotation is NDArray or get_origin(annotation) in (np.ndarray, NDArray)


def _object(table: Any, **more: Any) -> dict[str, Any]:
    """A JSON schema of a table that is described as a typed dictionary or a dataclass; more: other types for some keys."""
    fields = inspect.get_annotations(table, eval_str=True)
    says = described(table.__doc__, fields)
    properties = {}
    for name, annotation in fields.items():
        unit = {"x-unit": unit_of(says[name])} if name in says and unit_of(says[name]) else {}
        properties[name] = _schema(more.get(name, annotation)) | {"description": says.get(name, ""), **unit}
    needed = {"required": sorted(table.__required_keys__)} if is_typeddict(table) else {}
    return {"type": "object", "properties": properties, "additionalProperties": False, **needed}


def _arguments(name: str, function: Callable[..., Any], in_file: Iterable[str] = (), /, **more: Any) -> type[BaseModel]:
    """A model with the arguments of a function (its first, the scene, aside) and `more` keys of the file alone.

    in_file: of those that are needed, such as may lie in the table's file instead.
    """
    parameters = list(inspect.signature(function, eval_str=True).parameters.values())
    if not inspect.isclass(function):
        parameters = parameters[1:]
    says = described(shapes.__doc__, SHARED) if name in SHAPES else {}
    says |= _says(function, [p.name for p in parameters])
    fields = {}
    for parameter in parameters:
        default = None if parameter.name in in_file else parameter.default
        default = ... if default is inspect.Parameter.empty else default
        fields[parameter.name] = (_typed(parameter.annotation), _key(default, says.get(parameter.name, "")))
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


class Output(Strict):
    """[output]: how `taichi-sim run` makes pictures of the scene, where the command line does not say."""

    fps: Seconds = _key(60.0, "frames per simulated second [1/s]")
    duration: Seconds = _key(5.0, "simulated time [s]")
    size: tuple[Pixels, Pixels] = _key((1280, 720), "width and height of the pictures [pixels]")
    stage: Literal["day", "paper", "dusk", "studio", "blueprint"] = _key(
        "day", "the light, the ground and what lies behind"
    )
    background: tuple[Share, Share, Share] | None = _key(None, "sRGB in 0..1 [1]; that of the stage otherwise")
    ambient_occlusion: bool = _key(True, "soft shadow where surfaces are close, in 3D")
    shadow: bool = _key(True, "that of the sun, in 3D")
    transparent: bool = _key(False, "PNG frames with alpha, without background and ground")
    shadow_catcher: bool = _key(False, "in a transparent picture, the shadows on the ground as black with alpha, in 3D")
    colour: Literal["object", "strain", "speed"] = _key("object", "what colours show")
    colour_range: Annotated[tuple[FiniteFloat, FiniteFloat], AfterValidator(_rising)] | None = _key(
        None, "strain [1] or speed [m/s] that get the first and the last colour"
    )
    subdivide: Literal[0, 1, 2] = _key(0, "how many times each triangle of a surface is divided into four, smoothly")
    crease: Annotated[FiniteFloat, Ge(0), Le(180)] = _key(
        40.0, "between triangles at the start, from which their edge is sharp, in 3D; not where subdivide is [degrees]"
    )
    shutter: Annotated[FiniteFloat, Ge(0), AfterValidator(_within_a_frame)] = _key(
        0.0, "how long the shutter is open, for motion blur; at most 1 / fps [s]"
    )
    aperture: Annotated[FiniteFloat, Ge(0), Le(MOST_APERTURE)] = _key(
        0.0, "diameter of the lens, for depth of field about the camera's target, in 3D [m]"
    )
    exposures: Annotated[int, Ge(1), Le(256)] = _key(
        16, "pictures in the mean of one with a shutter or an aperture; each takes as long as a picture [1]"
    )
    looks: Annotated[tuple[dict[str, Any], ...] | None, WithJsonSchema({"type": "array", "items": _object(Look)})] = (
        _key(None, "how the surfaces of shapes and colliders look, in 3D")
    )
    camera: Annotated[
        dict[str, Any] | None, WithJsonSchema(_object(CameraPath, follow=str | int | tuple[int, ...]))
    ] = _key(None, "where the camera stands, and how it moves")
    overlay: Annotated[dict[str, Any] | None, WithJsonSchema(_object(Overlay))] = _key(
        None, "text, curves and marks over the pictures"
    )


def _colliders() -> type[BaseModel]:
    """A model with the arguments of all colliders; which of them a `shape` takes and needs is judged where it is built."""
    fields: dict[str, Any] = {
        name: (field.annotation, None) for model in COLLIDERS.values() for name, field in model.model_fields.items()
    }
    fields |= {"shape": (Literal[tuple(COLLIDERS)], ...)}
    doc = "A solid body of infinite mass, which stands where it is or moves along its path and pushes balls."
    return create_model("colliders", __base__=Strict, __doc__=doc, **fields)


_file: dict[str, Any] = {
    "file": (str | None, _key(None, "an .npz that holds the longer of these arrays, each under its key")),
    "prefix": (str, _key("", "what its name in the file begins with")),
}
_name: dict[str, Any] = {
    "name": (
        str | None,
        _key(None, "what other tables, and files for other programs, call it; in Python `scene.set_name`"),
    )
}
_group: dict[str, Any] = {
    "balls": (
        str | None,
        _key(None, "a name, of a shape or of balls, within which balls are counted; all balls otherwise"),
    )
}
_body: dict[str, Any] = {
    "body": (
        Annotated[int, Ge(0), Le(MOST_BODIES)],
        _key(0, "a number that balls share which do not collide with each other; 0: none"),
    )
}
_many = {
    "vertices": (_typed(ArrayLike | None), _key(None, "(v, 3) of a mesh given by hand [m]")),
    "triangles": (_typed(ArrayLike | None), _key(None, "(t, 3) vertices of its triangles")),
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
            _key(... if needed else None, "a name, of a shape or of balls, or ball numbers in the scene"),
        ),
        members: (_typed(Members | None), _key(None, says)),
    }


COLLIDERS: Mapping[str, type[BaseModel]] = {
    name: _arguments(
        name,
        kind,
        ("mesh",) if name == "mesh" else (),
        shape=(Literal[name], _key(..., "which shape it has")),  # type: ignore[valid-type]
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
    "format": (Literal[1], _key(..., "of the file: 1")),
    "dim": (Literal[2, 3], _key(2, "dimensions of the scene")),
    "gravity": (_typed(ArrayLike | None), _key(None, "acceleration (dim,) [m/s^2]; none by default")),
    "simulation": (Simulation, Field(default_factory=Simulation, description=Simulation.__doc__)),
    "output": (Output, Field(default_factory=Output, description=Output.__doc__)),
    **{
        name: (model | None, _key(None, model.__doc__ or ""))
        if name in SINGLE
        else (tuple[model, ...], _key((), model.__doc__ or ""))  # type: ignore[valid-type]
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
