"""[simulation] and [output] of scene files."""

from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Le, Lt
from pydantic import AfterValidator, FiniteFloat, PositiveInt, ValidationInfo, WithJsonSchema
from pydantic_core import PydanticCustomError

from taichi_sim.analysis.methods import BUILT_IN_METHODS, BUILT_IN_RULES, VERLET
from taichi_sim.files.toml_types import Strict, key_of, table_schema
from taichi_sim.scene.camera_path import MOST_APERTURE, CameraPath
from taichi_sim.scene.looks import Look
from taichi_sim.scene.overlay import Overlay

__all__ = ["Output", "Simulation"]

METHODS, RULES = ("auto", *BUILT_IN_METHODS), ("auto", *BUILT_IN_RULES)

Seconds = Annotated[FiniteFloat, Gt(0)]


class Simulation(Strict):
    """[simulation]: arguments of ts.Simulation; what is absent is left to its defaults."""

    dt: Seconds | Literal["auto"] = key_of("auto", "time step [s], or auto: 1 ms, or less where that is not safe")
    tolerance: Annotated[FiniteFloat, Gt(0), Lt(1)] | None = key_of(
        None,
        "in place of dt: the error allowed in a simulated second, the largest of any ball, as a part of the scene's size [1]",
    )
    integrator: Literal[METHODS] = key_of(  # type: ignore[valid-type]
        VERLET.name, "the method; auto: verlet, or an implicit one with its step where that takes far less time"
    )
    precision: Literal["f32", "f64"] = key_of("f32", "of the numbers: f32 single, f64 double")
    arch: Literal["auto", "cpu", "cuda", "vulkan", "metal"] = key_of(
        "auto", "what computes; auto: a GPU if one works, else the CPU"
    )
    contacts: Literal[RULES] = key_of("auto", "how contacts are solved")  # type: ignore[valid-type]
    contact_iterations: PositiveInt | Literal["auto"] = key_of(
        "auto", "of each contact solve; more make contacts harder"
    )
    accumulate: Literal["auto", "ordered", "gather", "atomic"] = key_of("auto", "in which order impulses are added")
    driver: Literal["auto", "fused", "parallel"] = key_of(
        "auto", "how steps are launched; auto: fused for small scenes and on one thread"
    )
    spin: Literal["auto", True, False] = key_of(
        "auto", "whether balls turn; auto: loose ones, where a material has friction"
    )
    substeps: PositiveInt | Literal["auto"] = key_of("auto", "parts that each step is divided into")
    settle: bool | Annotated[FiniteFloat, Gt(0), Lt(1)] = key_of(
        False,
        "bring the scene to rest before its clock starts: true, or the net force that may be left, as a part of the mean weight"
        " of a ball [1]; true: 0.001",
    )
    threads: PositiveInt = key_of(1, "CPU threads")


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


class Output(Strict):
    """[output]: how `taichi-sim run` makes pictures of the scene, where the command line does not say."""

    fps: Seconds = key_of(60.0, "frames per simulated second [1/s]")
    duration: Seconds = key_of(5.0, "simulated time [s]")
    size: tuple[Pixels, Pixels] = key_of((1280, 720), "width and height of the pictures [pixels]")
    stage: Literal["day", "paper", "dusk", "studio", "blueprint"] = key_of(
        "day", "the light, the ground and what lies behind"
    )
    background: tuple[Share, Share, Share] | None = key_of(None, "sRGB in 0..1 [1]; that of the stage otherwise")
    ambient_occlusion: bool = key_of(True, "soft shadow where surfaces are close, in 3D")
    shadow: bool = key_of(True, "that of the sun, in 3D")
    transparent: bool = key_of(False, "PNG frames with alpha, without background and ground")
    shadow_catcher: bool = key_of(
        False, "in a transparent picture, the shadows on the ground as black with alpha, in 3D"
    )
    colour: Literal["object", "strain", "speed"] = key_of("object", "what colours show")
    colour_range: Annotated[tuple[FiniteFloat, FiniteFloat], AfterValidator(_rising)] | None = key_of(
        None, "strain [1] or speed [m/s] that get the first and the last colour"
    )
    subdivide: Literal[0, 1, 2] = key_of(0, "how many times each triangle of a surface is divided into four, smoothly")
    crease: Annotated[FiniteFloat, Ge(0), Le(180)] = key_of(
        40.0, "between triangles at the start, from which their edge is sharp, in 3D; not where subdivide is [degrees]"
    )
    shutter: Annotated[FiniteFloat, Ge(0), AfterValidator(_within_a_frame)] = key_of(
        0.0, "how long the shutter is open, for motion blur; at most 1 / fps [s]"
    )
    aperture: Annotated[FiniteFloat, Ge(0), Le(MOST_APERTURE)] = key_of(
        0.0, "diameter of the lens, for depth of field about the camera's target, in 3D [m]"
    )
    exposures: Annotated[int, Ge(1), Le(256)] = key_of(
        16, "pictures in the mean of one with a shutter or an aperture; each takes as long as a picture [1]"
    )
    looks: Annotated[
        tuple[dict[str, Any], ...] | None, WithJsonSchema({"type": "array", "items": table_schema(Look)})
    ] = key_of(None, "how the surfaces of shapes and colliders look, in 3D")
    camera: Annotated[
        dict[str, Any] | None, WithJsonSchema(table_schema(CameraPath, follow=str | int | tuple[int, ...]))
    ] = key_of(None, "where the camera stands, and how it moves")
    overlay: Annotated[dict[str, Any] | None, WithJsonSchema(table_schema(Overlay))] = key_of(
        None, "text, curves and marks over the pictures"
    )
