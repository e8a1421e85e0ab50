"""The keys of a scene file and their types, as pydantic models; values are judged where the scene is built.

A table that stands for a function (`[[balls]]`: Scene.add_balls, `[[cloth]]`: shapes.cloth, ...) takes the arguments
of that function, read from its signature: a new argument there is a new key here.
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Le, Lt
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    PositiveInt,
    TypeAdapter,
    create_model,
)
from pydantic.errors import PydanticSchemaGenerationError
from pydantic_core import PydanticCustomError

from taichi_sim import shapes
from taichi_sim.analysis.methods import BUILT_IN_METHODS, VERLET
from taichi_sim.scene import colliders
from taichi_sim.scene.scene import Scene

__all__ = ["SHAPES", "TABLES", "Document", "Output", "Simulation", "Wind", "keys_at", "what_is_allowed"]

MOST_BODIES = 1_000_000

# the shapes a scene file may name, in the order in which they are added
SHAPES: dict[str, Callable[..., shapes.Shape]] = {
    function.__name__: function
    for function in (
        shapes.cloth,
        shapes.jelly,
        shapes.rope,
        shapes.wheel,
        shapes.pile,
        shapes.truss,
        shapes.net,
        shapes.balloon,
        shapes.tower,
    )
}

Seconds = Annotated[FiniteFloat, Gt(0)]


class Strict(BaseModel):
    """No unknown keys, no conversion of one type into another."""

    model_config = ConfigDict(strict=True, extra="forbid")


class Simulation(Strict):
    """[simulation]: arguments of Simulation; what is absent is left to its defaults."""

    dt: Seconds | Literal["auto"] = "auto"
    tolerance: Annotated[FiniteFloat, Gt(0), Lt(1)] | None = None
    integrator: Literal[tuple(BUILT_IN_METHODS)] = VERLET.name  # type: ignore[valid-type]
    precision: Literal["f32", "f64"] = "f32"
    arch: Literal["auto", "cpu", "cuda", "vulkan", "metal"] = "auto"
    contacts: Literal["auto", "gauss_seidel", "jacobi", "sum", "off"] = "auto"
    contact_iterations: PositiveInt | Literal["auto"] = "auto"
    accumulate: Literal["auto", "ordered", "gather", "atomic"] = "auto"
    driver: Literal["auto", "fused", "parallel"] = "auto"
    spin: Literal["auto", True, False] = "auto"
    substeps: PositiveInt | Literal["auto"] = "auto"
    threads: PositiveInt = 1


Pixels = Annotated[int, Ge(16), Le(8192)]
Share = Annotated[FiniteFloat, Ge(0), Le(1)]


def _rising(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] >= pair[1]:
        raise PydanticCustomError("rising", "two numbers, the lower first")
    return pair


class Output(Strict):
    """[output]: how `taichi-sim run` makes pictures of the scene, where the command line does not say."""

    fps: Seconds = 60.0  # 1/s
    duration: Seconds = 5.0  # s
    size: tuple[Pixels, Pixels] = (1280, 720)
    background: tuple[Share, Share, Share] | None = None  # sRGB
    ambient_occlusion: bool = False
    shadow: bool = True
    transparent: bool = False  # PNG frames with alpha, without background and ground
    colour: Literal["object", "strain", "speed"] = "object"
    colour_range: Annotated[tuple[FiniteFloat, FiniteFloat], AfterValidator(_rising)] | None = None  # strain, or m/s
    subdivide: Literal[0, 1, 2] = 0  # surfaces, so many times
    camera: dict[str, Any] | None = None  # the fields of CameraPath, judged there


def _field(parameter: inspect.Parameter) -> tuple[Any, Any]:
    """Type and default of one argument; what pydantic has no word for (ArrayLike) the function itself checks."""
    annotation = parameter.annotation
    try:
        TypeAdapter(annotation)
    except PydanticSchemaGenerationError:
        annotation = Any
    return annotation, ... if parameter.default is inspect.Parameter.empty else parameter.default


def _arguments(function: Callable[..., Any], **more: Any) -> type[BaseModel]:
    """A model with the arguments of a function (its first, the scene, aside) and `more` keys of the file alone."""
    fields: dict[str, Any] = {
        name: _field(parameter)
        for name, parameter in list(inspect.signature(function, eval_str=True).parameters.items())[1:]
    }
    return create_model(function.__name__, __base__=Strict, **(fields | more))


def _optional(model: type[BaseModel], *names: str) -> type[BaseModel]:
    """The same with some required keys made optional, because they may lie in the table's file instead."""
    fields: dict[str, Any] = {name: (model.model_fields[name].annotation, None) for name in names}
    return create_model(model.__name__, __base__=model, **fields)


def _colliders() -> type[BaseModel]:
    """A model with the arguments of all colliders; which of them a `shape` takes and needs is judged where it is built."""
    fields: dict[str, Any] = {
        name: (_field(parameter)[0], None)
        for kind in colliders.SHAPES.values()
        for name, parameter in inspect.signature(kind, eval_str=True).parameters.items()
    }
    fields |= {"shape": (Literal[tuple(colliders.SHAPES)], ...), "mesh": (str | None, None)}
    return create_model("colliders", __base__=Strict, **fields, vertices=(Any, None), triangles=(Any, None), **_file)


_file: dict[str, Any] = {"file": (str | None, None), "prefix": (str, "")}
_name: dict[str, Any] = {"name": (str | None, None)}
_group: dict[str, Any] = {"balls": (str | None, None)}
_led: dict[str, Any] = {"balls": (str | tuple[int, ...] | None, None), "members": (tuple[int, ...] | None, None)}
_joined: dict[str, Any] = {
    side + end: (kind, default)
    for side in ("one", "other")
    for end, kind, default in (("", str | tuple[int, ...], ...), ("_members", tuple[int, ...] | None, None))
}
_body: dict[str, Any] = {"body": (Annotated[int, Ge(0), Le(MOST_BODIES)], 0)}

TABLES: Mapping[str, type[BaseModel]] = {
    "materials": _arguments(Scene.add_material),
    "balls": _optional(_arguments(Scene.add_balls, **_name, **_file, **_body), "position", "radius"),
    **{name: _arguments(function, **_name) for name, function in SHAPES.items()},
    "springs": _optional(_arguments(Scene.add_springs, **_group, **_file), "pairs", "stiffness"),
    "attachments": _arguments(Scene.attach, **_joined),
    "cells": _optional(_arguments(Scene.add_cells, **_group, **_file), "corners", "bulk_modulus"),
    "bending": _optional(_arguments(Scene.add_bending, **_group, **_file), "corners", "weights", "stiffness"),
    "gases": _optional(_arguments(Scene.add_gas, **_group, **_file), "triangles"),
    "moving_pins": _arguments(Scene.add_moving_pins, **_led, **_file),
    "walls": _arguments(Scene.add_wall),
    "colliders": _colliders(),
    "triangles": _optional(_arguments(Scene.add_triangles, **_group, **_file), "triangles"),
    "probes": _arguments(Scene.add_probe, **_led, **_file),
    "objects": _optional(_arguments(Scene.set_name, **_file), "balls"),
    "embedded_surfaces": _optional(
        _arguments(Scene.add_embedded_surface, **_group, **_file), "corners", "weights", "triangles"
    ),
}

Wind = _arguments(Scene.add_wind)

_document: dict[str, Any] = {
    "format": (Literal[1], ...),
    "dim": (Literal[2, 3], 2),
    "gravity": (Any, None),
    "simulation": (Simulation, Field(default_factory=Simulation)),
    "output": (Output, Field(default_factory=Output)),
    "wind": (Wind | None, None),
    **{name: (tuple[model, ...], ()) for name, model in TABLES.items()},  # type: ignore[valid-type]
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
    """What a value must be, of one of the errors of pydantic's ValidationError."""
    words = ALLOWED.get(problem["type"])
    context = {k: int(v) if isinstance(v, float) and v.is_integer() else v for k, v in problem.get("ctx", {}).items()}
    return str(problem["msg"]) if words is None else words.format(**context)


def keys_at(path: Sequence[str | int]) -> list[str]:
    """The keys that the table has in which the last name of a path stands."""
    tables: dict[str, Any] = {"simulation": Simulation, "output": Output, "wind": Wind, **TABLES}
    model = tables.get(str(path[0])) if len(path) > 1 else Document
    return [] if model is None else list(model.model_fields)
