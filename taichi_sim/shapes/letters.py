"""Text, and drawings from SVG files: as jelly, cloth or colliders."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError, about
from taichi_sim.common.spelling import takes_color
from taichi_sim.common.warn import warn
from taichi_sim.geometry import outlines, polygon_mesh
from taichi_sim.scene.mesh_colliders import Mesh
from taichi_sim.scene.pins import chosen
from taichi_sim.scene.scene import Scene
from taichi_sim.shapes import jelly_material
from taichi_sim.shapes.base import Pins, Shape, affordable, moved, or_default, with_preset
from taichi_sim.shapes.cloth import cloth
from taichi_sim.shapes.jelly import JELLY_DENSITY, of_body

__all__ = ["svg", "text"]

KINDS = ("jelly", "cloth", "collider")
SPACINGS = 12  # in the height, by default
SLICES = 4  # depths in the height, by default
SPECK = 0.1  # of the spacing: what is smaller would only shorten the steps of all
EDGE_BALL = 0.05  # of the spacing: balls at the ends of the sticks that are a collider in 2D
ELASTIC = ("density", "young_modulus", "poisson_ratio")
WOVEN = ("mass_per_area", "stretch_stiffness", "bending_rigidity")
MOVES = ("damping", "radius", "velocity", "pinned", "self_collision", "surface_collision")
TAKES = {"jelly": {*ELASTIC, "plane", *MOVES}, "cloth": {*WOVEN, *MOVES}, "collider": set()}


@takes_color
def text(
    scene: Scene,
    text: str,
    height: float = 1.0,
    *,
    font: str | None = None,
    kind: str = "jelly",
    spacing: float | None = None,
    depth: float | None = None,
    density: float | None = None,
    young_modulus: float | None = None,
    poisson_ratio: float | None = None,
    plane: str | None = None,
    mass_per_area: float | None = None,
    stretch_stiffness: float | None = None,
    bending_rigidity: float | None = None,
    damping: float | None = None,
    radius: float | None = None,
    velocity: Sequence[float] | None = None,
    pinned: Pins = False,
    material: str = "default",
    position: Sequence[float] | None = None,
    rotation: float | Sequence[float] | None = None,
    scale: float = 1.0,
    colour: Sequence[float] | None = None,
    self_collision: bool = False,
    surface_collision: bool = False,
) -> Shape:
    """Letters, each a body of its own, in the x-y plane; the middle of the first base line is at the origin.

    Their outlines are filled with triangles about the spacing wide, with holes and corners kept. Cloth and, in 2D, jelly are
    these triangles; in 3D jelly is extruded along z, to both sides of the plane, and filled with tetrahedra. Parts of a letter
    that do not touch, as of an i, are bodies of their own. It takes packages: pip install "taichi-sim[text]".

    Args:
        text: what it says; lines end with a line break. height: of a capital letter [m].
        font: a family that is installed, with :bold or :italic behind it, or a file .ttf or .otf; "DejaVu Sans:bold" by default.
        kind: "jelly", "cloth" (in 3D), or "collider": solid and still, in 2D its outline of sticks between pinned balls.
        spacing: of the balls [m]; a twelfth of the height by default.
        depth: of jelly and colliders in 3D along z [m]; a quarter of the height by default.
        density: of jelly [kg/m^3, in 2D kg/m^2]; young_modulus: of jelly [Pa, in 2D N/m]; poisson_ratio: of jelly [1].
        plane: of jelly in 2D, "stress" or "strain", see `jelly`.
        mass_per_area: of cloth [kg/m^2]; stretch_stiffness: of cloth [N/m]; bending_rigidity: of cloth [N m].
        radius: of each ball [m]; 0.45 of the spacing by default, 0.25 with surface_collision. Jelly in 2D without a radius is
            drawn as its filled area in place of its balls.
    """
    given = {name: value for name, value in locals().items() if name not in ("scene", "text", "font")}
    tall = validation.number("text.height", height, positive=True)
    return _add(scene, "text", lambda: outlines.text_outlines("text", text, tall, font), given)


@takes_color
def svg(
    scene: Scene,
    file: str | PathLike[str],
    height: float = 1.0,
    *,
    kind: str = "jelly",
    spacing: float | None = None,
    depth: float | None = None,
    density: float | None = None,
    young_modulus: float | None = None,
    poisson_ratio: float | None = None,
    plane: str | None = None,
    mass_per_area: float | None = None,
    stretch_stiffness: float | None = None,
    bending_rigidity: float | None = None,
    damping: float | None = None,
    radius: float | None = None,
    velocity: Sequence[float] | None = None,
    pinned: Pins = False,
    material: str = "default",
    position: Sequence[float] | None = None,
    rotation: float | Sequence[float] | None = None,
    scale: float = 1.0,
    colour: Sequence[float] | None = None,
    self_collision: bool = False,
    surface_collision: bool = False,
) -> Shape:
    """The filled areas of a drawing in an SVG file, as `text` makes bodies of letters; the middle of its lower side is at the
    origin.

    Areas that do not touch, or have different colours, are bodies of their own. Lines without a filling are left out.
    So are, of jelly and cloth, pieces smaller than a tenth of the spacing, with a warning.

    Args:
        file: an .svg file. height: of all of it [m].
        kind: "jelly", "cloth" (in 3D), or "collider": solid and still, in 2D its outline of sticks between pinned balls.
        spacing: of the balls [m]; a twelfth of the height by default.
        depth: of jelly and colliders in 3D along z [m]; a quarter of the height by default.
        density: of jelly [kg/m^3, in 2D kg/m^2]; young_modulus: of jelly [Pa, in 2D N/m]; poisson_ratio: of jelly [1].
        plane: of jelly in 2D, "stress" or "strain", see `jelly`.
        mass_per_area: of cloth [kg/m^2]; stretch_stiffness: of cloth [N/m]; bending_rigidity: of cloth [N m].
        radius: of each ball [m]; 0.45 of the spacing by default, 0.25 with surface_collision. Jelly in 2D without a radius is
            drawn as its filled area in place of its balls.
        colour: sRGB in 0..1 [1]; the drawing's own otherwise.
    """
    given = {name: value for name, value in locals().items() if name not in ("scene", "file")}
    tall = validation.number("svg.height", height, positive=True)
    return _add(scene, "svg", lambda: outlines.drawing_outlines("svg", file, tall), given)


def _add(scene: Scene, shape: str, read: Any, given: dict[str, Any]) -> Shape:
    """Bodies of the outlines that `read` gives, all of them or none."""
    kind, dim, height = given["kind"], scene.dim, float(given["height"])
    validation.one_of(f"{shape}.kind", kind, KINDS)
    if kind == "cloth" and dim == 2:
        raise SceneError(f"{shape}.kind", kind, says='needs a scene with dim = 3; in 2D take "jelly" or "collider"')
    for name in {*ELASTIC, "plane", *WOVEN, *MOVES} - TAKES[kind]:
        if given[name] is not None and given[name] is not False:
            raise SceneError(f"{shape}.{name}", says=f'is not for kind = "{kind}"')
    if given["depth"] is not None and (dim == 2 or kind == "cloth"):
        raise SceneError(f"{shape}.depth", says="is for jelly and colliders in a scene with dim = 3")
    spacing = or_default(f"{shape}.spacing", given["spacing"], height / SPACINGS)
    depth = or_default(f"{shape}.depth", given["depth"], height / SLICES)
    layers = max(1, round(depth / spacing))
    found = read() if kind == "collider" else _without_specks(shape, read(), spacing)
    balls = sum(one.polygon.area for one in found) / spacing**2 * (layers + 2 if kind == "jelly" and dim == 3 else 2)
    affordable(f"{shape}.spacing", spacing, balls, 0, solids=6 * balls)
    meshes = [polygon_mesh.filled(f"{shape}.spacing", one.polygon, spacing) for one in found]
    placed = {name: given[name] for name in ("position", "rotation", "scale")}
    made: list[Shape] = []
    own: list[NDArray] = []
    faces: list[NDArray] = []
    with scene.all_or_nothing():
        for one, (points, triangles, _) in zip(found, meshes):
            looks = {
                "material": given["material"],
                "colour": one.colour if given["colour"] is None else given["colour"],
            }
            with about(shape):
                if kind == "collider":
                    made.append(_collider(scene, shape, points, triangles, spacing, depth, looks, placed))
                elif kind == "cloth":
                    upright = np.column_stack([points, np.zeros(len(points))])
                    own.append(upright)
                    faces.append(triangles)
                    made.append(_cloth(scene, shape, upright, triangles, spacing, given, looks, placed))
                else:
                    if dim == 3:
                        points, cells = polygon_mesh.extruded(points, triangles, depth, layers)
                        body = jelly_material.simplices(points, cells)
                    else:
                        body = jelly_material.simplices(points, triangles)
                    own.append(points)
                    faces.append(body.triangles if dim == 3 else triangles)
                    made.append(_jelly(scene, shape, body, height, spacing, given, looks, placed))
        if kind != "collider":
            _pin(scene, shape, made, own, faces, given["pinned"])
    return Shape.of(made)


def _without_specks(shape: str, found: list[outlines.Outline], spacing: float) -> list[outlines.Outline]:
    """Those outlines that are not far smaller than the spacing [m]; all, if each is. Warns of what is left out."""
    sizes = np.array([np.ptp(np.reshape(one.polygon.bounds, (2, 2)), axis=0).max() for one in found])
    kept = [one for one, size in zip(found, sizes) if size >= SPECK * spacing]
    if not kept or len(kept) == len(found):
        return found
    first = int(np.argmin(sizes))
    x, y = np.reshape(found[first].polygon.bounds, (2, 2)).mean(axis=0)
    warn(
        f"{shape}: {len(found) - len(kept)} of {len(found)} pieces are left out: they are smaller than {SPECK:g} of the"
        f" spacing, {spacing:.3g} m; the smallest is {sizes[first]:.3g} m wide, at ({x:.3g}, {y:.3g}) m; a finer spacing keeps"
        " them"
    )
    return kept


def _radius(given: dict[str, Any], spacing: float) -> float:
    """Radius [m] of balls that leave no gap, or, where triangles collide, of smaller ones."""
    return (0.25 if given["surface_collision"] else 0.45) * spacing * float(given["scale"])


def _cloth(
    scene: Scene,
    shape: str,
    points: NDArray,
    triangles: NDArray,
    spacing: float,
    given: dict[str, Any],
    looks: dict[str, Any],
    placed: dict[str, Any],
) -> Shape:
    ball = or_default(f"{shape}.radius", given["radius"], _radius(given, spacing))
    names = (*WOVEN, "damping", "self_collision", "surface_collision", "velocity")
    more = {name: given[name] for name in names} | looks | placed
    return cloth(scene, mesh=(points, triangles), radius=ball, **more)


def _jelly(
    scene: Scene,
    shape: str,
    body: jelly_material.Simplices,
    height: float,
    spacing: float,
    given: dict[str, Any],
    looks: dict[str, Any],
    placed: dict[str, Any],
) -> Shape:
    factor = validation.number(f"{shape}.scale", placed["scale"], positive=True)
    if factor != 1.0:
        body = jelly_material.simplices(body.points * factor, body.cells)
    density, young, ratio = with_preset(scene, given["material"], {name: given[name] for name in ELASTIC}).values()
    mass = float(body.volume.sum()) * or_default(f"{shape}.density", density, JELLY_DENSITY[scene.dim])
    elastic: dict[str, Any] = {"young_modulus": young, "poisson_ratio": ratio, "plane": given["plane"]}
    more = {name: given[name] for name in ("damping", "radius", "velocity", "self_collision", "surface_collision")}
    still = {"position": placed["position"], "rotation": placed["rotation"]}
    ball = _radius(given, spacing)
    return of_body(scene, shape, body, mass, height * factor, ball, **elastic, **more, **looks, **still)


def _collider(
    scene: Scene,
    shape: str,
    points: NDArray,
    triangles: NDArray,
    spacing: float,
    depth: float,
    looks: dict[str, Any],
    placed: dict[str, Any],
) -> Shape:
    """A solid prism in 3D; in 2D its outline as sticks between balls that stay."""
    if scene.dim == 3:
        vertices, cells = polygon_mesh.extruded(points, triangles, depth, 1)
        labels = {one.label for one in scene.colliders}
        name = next(name for k in itertools.count() if (name := f"{shape}_{k}") not in labels)
        scene.add_collider(Mesh(mesh=(vertices, jelly_material.surface_of(cells)), name=name, **looks, **placed))
        return Shape(np.zeros(0, dtype=np.int32))
    edges = polygon_mesh.outer_edges(triangles)
    used, ends = np.unique(edges, return_inverse=True)
    x = moved(shape, points[used], **placed)
    balls = scene.add_balls(x, radius=EDGE_BALL * spacing, pinned=True, body=scene.new_body(), **looks)
    scene.new_object("outline", balls)
    return Shape(balls, scene.add_springs(balls[ends.reshape(-1, 2)], stiffness=0.0, collides=True))


def _pin(
    scene: Scene, shape: str, made: Sequence[Shape], own: list[NDArray], faces: list[NDArray], pinned: Pins
) -> None:
    """Pin balls of all letters together."""
    if pinned is False:
        return
    balls = np.concatenate([one.balls for one in made])
    first = np.cumsum([0, *(len(points) for points in own)])
    triangles = np.concatenate([face + start for face, start in zip(faces, first)])
    held = chosen(f"{shape}.pinned", pinned, scene.position[balls], np.concatenate(own), triangles)
    scene.set_balls(balls, pinned=held)
