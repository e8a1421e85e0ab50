"""Cloth: a flat sheet, or a shell from a surface mesh."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError, about, following
from taichi_sim.common.spelling import takes_color
from taichi_sim.common.warn import warn
from taichi_sim.geometry import mesh as meshes
from taichi_sim.scene.membranes import require_coupling, require_folding
from taichi_sim.scene.scene import Scene
from taichi_sim.shapes import cloth_material
from taichi_sim.shapes.base import (
    DAMPING_RATIO,
    Bends,
    Part,
    Pins,
    Shape,
    Springs,
    affordable,
    at_least_0,
    bends_along,
    build,
    counts,
    exclusive,
    given_of,
    lattice_pairs,
    lengths,
    or_default,
    stable_stiffness,
    surface_part,
    with_preset,
)
from taichi_sim.shapes.mesh_bending import mesh_bends

__all__ = ["cloth"]

CLOTH_DENSITY = 0.2  # kg/m^2, a cotton sheet
SHEAR_SHARE = 0.5  # of a cloth's stiffness, in its diagonals
STRETCH_STIFFNESS = 100.0  # N/m: 2 % at the top of a cotton sheet that hangs 1 m
SHEAR_PART = 0.2  # of the stretch stiffness
BENDING_RIGIDITY = 1e-5  # N m, cotton
SIGNED = ("coupling", "warp_angle")
BENDING_SHARE = 0.002  # of a stiffness that is stable at 1 ms: the default bending is no more, and stable at 16 ms


@takes_color
def cloth(
    scene: Scene,
    size: Sequence[float] | None = None,
    resolution: Sequence[int] | None = None,
    mesh: str | PathLike[str] | tuple[ArrayLike, ArrayLike] | None = None,
    *,
    mass: float | None = None,
    stiffness: float | None = None,
    bending_stiffness: float | None = None,
    mass_per_area: float | None = None,
    stretch_stiffness: float | None = None,
    shear_stiffness: float | None = None,
    bending_rigidity: float | None = None,
    bending_weft: float | None = None,
    warp: float | None = None,
    weft: float | None = None,
    shear: float | None = None,
    coupling: float | None = None,
    warp_angle: float | None = None,
    young_modulus: float | None = None,
    poisson_ratio: float | None = None,
    thickness: float | None = None,
    damping: float | None = None,
    folds: bool = False,
    radius: float | None = None,
    velocity: Sequence[float] | None = None,
    pinned: Pins = False,
    material: str = "default",
    position: Sequence[float] | None = None,
    rotation: Sequence[float] | None = None,
    scale: float = 1.0,
    colour: Sequence[float] | None = None,
    self_collision: bool = False,
    surface_collision: bool = False,
    break_strain: float | None = None,
    up: Literal["y", "z"] | None = None,
) -> Shape:
    """A sheet of cloth, or a shell from a surface mesh, in 3D.

    The sheet lies in the x-z plane from the origin toward +x and +z; ball (i, j) along x and z has index
    i * resolution[1] + j. It has springs to the next balls and along one diagonal of each square, in turns (half as stiff), and
    a bending element (see `Scene.add_bending`) for each three balls in a row. A mesh keeps its coordinates: vertices are balls,
    edges springs. Where it is flat it has bending elements, and an edge where it is folded has a spring between the two vertices
    that face each other.

    With any of mass_per_area, stretch_stiffness, shear_stiffness and bending_rigidity it is made of a material and the same at
    every resolution: balls weigh what the area around them does, and springs and elements at the border count half.

    With warp, or with young_modulus and thickness, triangles take the place of springs, see Scene.add_membranes: a sheet or a
    mesh then has exactly the material that is given, with directions of its own.

    Args:
        size: along x and z [m], (1, 1) by default; resolution: balls along x and z, at least 2, (32, 32) by default.
        mesh: an OBJ, PLY, STL or GLB file, or (vertices (v, 3) [m], triangles (t, 3)), in place of size and resolution.
        mass: of all of it [kg], shared out equally (by area in a material); 0.2 kg per m^2 of the sheet by default.
        stiffness: of each spring [N/m].
        bending_stiffness: of each three balls in a row [N/m]: the bending rigidity of a grid over the square of its spacing. By
            default that of 1e-5 N m, or less where that would not be stable at 16 ms.
        mass_per_area: in place of mass [kg/m^2]; 0.2.
        stretch_stiffness: force per width and strain along the threads [N/m]; 100.
        shear_stiffness: the same across them [N/m]; a fifth of it by default. A mesh has none of its own: a third of it.
        bending_rigidity: moment per width and curvature [N m]; 1e-5, or that of a plate of the thickness; bending_weft: the same
            along the weft, that along the warp by default [N m]. Without warp_angle the warp runs along x.
        warp: of a fabric of triangles, the force per width and strain along the warp [N/m], which runs along x, on a mesh as far
            as a triangle allows (along z where it faces x); weft: the same across it, the warp's by default [N/m]; coupling:
            force along one by strain along the other [N/m], 0; shear: force per width and angle of shear [N/m], a fifth of the
            warp.
        warp_angle: of the warp, from x toward z [degrees]; 0. Of a fabric of `taichi-sim materials` it alone makes triangles,
            with the threads of that fabric.
        young_modulus: of a sheet of triangles that is alike in all directions [Pa]; thickness: of it [m], which times the
            density of a preset is its mass per area; poisson_ratio: of it, 0.3 by default [1].
        folds: triangles give way to compression as a sheet that folds below their size, so that a coarse cloth drapes as a
            fine one does. For triangles longer than the folds; explicit steps take as long, implicit ones up to 1.6 times.
        damping: of each spring [N s/m]; in a material of the sheet, shared out as the stretch stiffness is; of triangles, force
            per width and rate of strain along the warp [N s/m]. A tenth of the critical damping of neighbouring balls by
            default.
        radius: of each ball [m]; 0.45 of the smaller spacing, or 0.4 of the mean edge of a mesh; 5/9 of that with the next.
        break_strain: of all springs, at which each tears for good [1], see Scene.add_springs; never by default. The
            edges of triangles then carry springs of zero stiffness, which only tear.
        surface_collision: nothing goes through its triangles, itself and other such surfaces included, see Scene.add_triangles.
        up: axis of the mesh that points up, "y" or "z"; y by default, with a warning for STL and PLY, which do not tell.
    """
    if scene.dim != 3:
        raise SceneError("cloth", says="a cloth needs a scene with dim = 3; in 2D use rope or jelly")
    woven = {
        "mass_per_area": mass_per_area,
        "stretch_stiffness": stretch_stiffness,
        "shear_stiffness": shear_stiffness,
        "bending_rigidity": bending_rigidity,
        "bending_weft": bending_weft,
    }
    threads = {"warp": warp, "weft": weft, "shear": shear, "coupling": coupling}
    if warp is None and (warp_angle is not None or any(value is not None for value in threads.values())):
        threads = with_preset(scene, material, threads)
    sheet = {"young_modulus": young_modulus, "poisson_ratio": poisson_ratio, "thickness": thickness}
    if any(value is not None for value in sheet.values()):
        solid = with_preset(
            scene, material, {"young_modulus": young_modulus, "poisson_ratio": poisson_ratio, "density": None}
        )
        density = solid.pop("density")
        sheet |= solid
        if mass is None and mass_per_area is None and density is not None and thickness is not None:
            woven["mass_per_area"] = density * validation.number("cloth.thickness", thickness, positive=True)
    weave, woven["bending_rigidity"] = _weave(
        threads | {"warp_angle": warp_angle},
        sheet,
        {"stretch_stiffness": stretch_stiffness, "shear_stiffness": shear_stiffness, "stiffness": stiffness,
         "bending_stiffness": bending_stiffness},
        bending_rigidity,
    )  # fmt: skip
    if stiffness is None and bending_stiffness is None:
        but = ["mass_per_area"] * (mass is not None) + ["shear_stiffness"] * (mesh is not None)
        but += ["bending_weft"] * (woven["bending_rigidity"] is not None)
        woven = with_preset(scene, material, woven, but)
    exclusive("cloth", woven, {"stiffness": stiffness, "bending_stiffness": bending_stiffness})
    exclusive("cloth", {"mass_per_area": woven["mass_per_area"]}, {"mass": mass})
    factor = validation.number("cloth.scale", scale, positive=True)
    grid: Any
    if mesh is None:
        if up is not None:
            raise SceneError("cloth.up", says="is for a mesh; give position and rotation instead")
        grid = _grid(size, resolution)
        surface, spacing, area = grid[0], float(grid[2].min()), float(grid[3].prod())
    elif size is not None or resolution is not None:
        raise SceneError("cloth.mesh", says="takes the place of size and resolution; give one or the other")
    else:
        grid, surface = None, meshes.given_surface("cloth", mesh, up)
        cloth_material.require_sheet(surface)
        if wrong := meshes.flaws(surface, closed=False):
            warn(f"cloth.mesh: {'; '.join(wrong)}. It does not bend like a sheet there; mend the mesh, if that matters")
        spacing, area = _mean_edge(surface), meshes.surface_area(surface)
    area = area * factor**2
    total = or_default("cloth.mass", mass, CLOTH_DENSITY * area)
    thinner = surface_part("cloth", surface_collision)
    spacing *= factor
    ball_radius = or_default("cloth.radius", radius, (0.45 if grid is not None else 0.4) * thinner * spacing)
    drag = at_least_0("cloth.damping", damping)
    if validation.flags("cloth.folds", folds, 1)[0] and weave is None:
        raise SceneError("cloth.folds", says="is for a cloth of triangles; give warp, warp_angle or young_modulus")
    if folds and weave is not None:
        require_folding("cloth.weft", weave.warp, weave.weft, 0.0)
    if drag and weave is not None and weave.warp == 0:
        raise SceneError("cloth.damping", says="acts along the warp as its stiffness does; give a warp above 0")
    strength = 0.0
    masses: float | NDArray = total
    rest = limit = None
    if weave is not None:
        angle = 0.0 if warp_angle is None else np.radians(validation.number("cloth.warp_angle", warp_angle))
        made = cloth_material.Fabric(
            or_default("cloth.mass_per_area", woven["mass_per_area"], total / area), max(weave.warp, weave.weft), 0.0,
            *_rigidities(woven), angle,
        )  # fmt: skip
        whole = meshes.Surface(surface.vertices * factor, surface.triangles)
        parts = cloth_material.of_triangles(whole, None if grid is None else (grid[1], grid[2] * factor), made)
        rest = cloth_material.along_warp(whole, angle)
        limit = cloth_material.folding_limit(rest, made) if folds else None
        time = spacing * DAMPING_RATIO * np.sqrt(made.mass_per_area / made.stretch) if made.stretch > 0 else 0.0
        if drag is not None:
            time = drag / weave.warp if drag > 0 else 0.0
        masses, bends, drag = parts.mass, parts.bends, None
        kinds = [Springs(pairs, 0.0, k) for pairs, k in parts.springs]
        if break_strain is not None:
            kinds.append(Springs(meshes.unique_edges(surface.triangles), 0.0, 0.0))
    elif all(value is None for value in woven.values()):
        kinds, across, bends = _springs(surface, grid)
        usual = [*kinds, Springs(across.pairs, np.minimum(BENDING_SHARE * across.weight, 1.0))]
        stable = stable_stiffness(usual, len(surface.vertices), total, bends.times(BENDING_SHARE))
        strength = at_least_0("cloth.stiffness", stiffness, stable)
        soft = min(BENDING_RIGIDITY / spacing**2, BENDING_SHARE * stable)
        bending = at_least_0("cloth.bending_stiffness", bending_stiffness, soft)
        kinds.append(Springs(across.pairs, 0.0, np.minimum(bending * across.weight, strength)))
        bends = bends.times(bending)
    else:
        cotton = _fabric(woven, total / area, grid is None)
        if grid is None:
            parts = cloth_material.of_mesh(meshes.Surface(surface.vertices * factor, surface.triangles), cotton)
        else:
            parts = cloth_material.of_sheet(grid[1], grid[2] * factor, cotton)
        masses, bends = parts.mass, parts.bends
        kinds = [Springs(pairs, 0.0, k) for pairs, k in parts.springs]
        if drag is not None:
            drag = drag / cotton.stretch * np.concatenate([k for _, k in parts.springs])
    placed: dict[str, Any] = {"velocity": velocity, "position": position, "rotation": rotation, "scale": factor}
    part = Part(masses, ball_radius, pinned, material, colour, self_collision, surface_collision, **placed)
    more: dict[str, Any] = {"bends": bends, "break_strain": break_strain, "uv": surface.uv if grid is None else grid[4]}
    made_of = {
        "balls.mass": given_of(mass=mass, mass_per_area=mass_per_area, mesh=mesh, size=size, scale=scale),
        "springs.stiffness": given_of(stretch_stiffness=stretch_stiffness, shear_stiffness=shear_stiffness),
        "springs.damping": given_of(damping=damping),
        "bending.stiffness": given_of(
            bending_rigidity=bending_rigidity, bending_weft=bending_weft, bending_stiffness=bending_stiffness,
            young_modulus=young_modulus if bending_rigidity is None else None, thickness=thickness, size=size,
        ),
        "membranes.damping": given_of(damping=damping),
    }  # fmt: skip
    with scene.all_or_nothing(), about("cloth"), following(made_of):
        shape = build(
            scene, "cloth", surface.vertices, kinds, surface.triangles, part, strength, drag, made_of=made_of, **more
        )
        if weave is not None:
            scene.add_membranes(shape.triangles, **weave._asdict(), damping=time, compression_limit=limit, rest=rest)
    return shape


def _weave(
    threads: dict[str, float | None],
    sheet: dict[str, float | None],
    springs: dict[str, float | None],
    rigidity: float | None,
) -> tuple[cloth_material.Weave | None, float | None]:
    """Stiffness of triangles, None where there are none, and the bending rigidity [N m] that goes with it."""
    exclusive("cloth", threads, sheet)
    exclusive("cloth", threads | sheet, springs)
    given = {name: at_least_0(f"cloth.{name}", value) for name, value in threads.items() if name not in SIGNED}
    if any(value is not None for value in threads.values()):
        if given["warp"] is None:
            raise SceneError("cloth.warp", says="is missing; give it, or the material of a fabric")
        weft = given["weft"] if given["weft"] is not None else given["warp"]
        shear = given["shear"] if given["shear"] is not None else SHEAR_PART * given["warp"]
        coupling = threads["coupling"]
        both = 0.0 if coupling is None else validation.number("cloth.coupling", coupling)
        if not (given["warp"] or weft or shear):
            raise SceneError("cloth.warp", given["warp"], "greater than 0 where weft and shear are not")
        require_coupling("cloth.coupling", both, given["warp"], weft)
        return cloth_material.Weave(given["warp"], weft, shear, both), rigidity
    if all(value is None for value in sheet.values()):
        return None, rigidity
    for name in ("young_modulus", "thickness"):
        if sheet[name] is None:
            raise SceneError(f"cloth.{name}", says="is missing; a sheet of triangles has young_modulus and thickness")
    modulus, thick = (
        validation.number(f"cloth.{name}", sheet[name], positive=True) for name in ("young_modulus", "thickness")
    )
    given_ratio = sheet["poisson_ratio"]
    ratio = 0.3 if given_ratio is None else validation.number("cloth.poisson_ratio", given_ratio, low=-0.999, high=0.5)
    plane = modulus * thick / (1 - ratio**2)
    plate = plane * thick**2 / 12 if rigidity is None else rigidity
    with following(dict.fromkeys(("cloth.warp", "cloth.bending_rigidity"), ("young_modulus", "thickness"))):
        validation.number("cloth.warp", plane)
        if rigidity is None:
            validation.number("cloth.bending_rigidity", plate)
    return cloth_material.Weave(plane, plane, 0.5 * (1 - ratio) * plane, ratio * plane), plate


def _fabric(woven: dict[str, float | None], default_mass: float, of_mesh: bool) -> cloth_material.Fabric:
    stretch = or_default("cloth.stretch_stiffness", woven["stretch_stiffness"], STRETCH_STIFFNESS)
    if of_mesh and woven["shear_stiffness"] is not None:
        raise SceneError(
            "cloth.shear_stiffness", says="a mesh has none of its own, but a third of the stretch stiffness"
        )
    return cloth_material.Fabric(
        or_default("cloth.mass_per_area", woven["mass_per_area"], default_mass),
        stretch,
        at_least_0("cloth.shear_stiffness", woven["shear_stiffness"], SHEAR_PART * stretch),
        *_rigidities(woven),
    )


def _rigidities(woven: dict[str, float | None]) -> tuple[float, float]:
    """Bending rigidity along warp and weft [N m]."""
    rigidity = at_least_0("cloth.bending_rigidity", woven["bending_rigidity"], BENDING_RIGIDITY)
    return rigidity, at_least_0("cloth.bending_weft", woven["bending_weft"], rigidity)


def _grid(size: Sequence[float] | None, resolution: Sequence[int] | None) -> tuple:
    """The surface of a flat sheet, its balls along x and z, their spacing, its size (2,) [m] and places on it (n, 2)."""
    extent = lengths("cloth.size", (1.0, 1.0) if size is None else size, 2)
    number = counts("cloth.resolution", (32, 32) if resolution is None else resolution, 2, 2)
    balls = number[0] * number[1]
    affordable("cloth.resolution", resolution, balls, 4 * balls, bends=3 * balls)
    i, j = np.meshgrid(*map(np.arange, number), indexing="ij")
    spacing = extent / (np.array(number) - 1)
    points = np.stack([i * spacing[0], np.zeros(i.shape), j * spacing[1]], axis=-1).reshape(-1, 3)
    index = np.arange(i.size).reshape(number)
    here, right, up, across = index[:-1, :-1], index[1:, :-1], index[:-1, 1:], index[1:, 1:]
    turn = cloth_material.turned(number)
    corners = [here, up, np.where(turn, across, right)], [right, np.where(turn, here, up), across]  # seen from +y
    triangles = np.concatenate([np.stack([c.ravel() for c in three], axis=1) for three in corners])
    uv = np.stack([i, j], axis=-1).reshape(-1, 2) / (np.array(number) - 1)
    return meshes.Surface(points, triangles), number, spacing, extent, uv


def _springs(surface: meshes.Surface, grid: Any) -> tuple[list[Springs], Springs, Bends]:
    """Springs of a sheet or shell of equal balls; springs across folded edges, and bending elements, both for a bending stiffness
    of 1 N/m."""
    if grid is None:
        edges = meshes.unique_edges(surface.triangles)
        bends, pairs, strength = mesh_bends(surface)
        free = ~np.isin(_key(np.sort(pairs, axis=1)), _key(edges))  # in a tetrahedron the facing vertices share an edge
        return [Springs(edges, 1.0)], Springs(pairs[free], strength[free]), bends
    number = grid[1]
    index = np.arange(number[0] * number[1]).reshape(number)
    sides = Springs(lattice_pairs(number, (1, 0), (0, 1)), 1.0)
    diagonals = Springs(cloth_material.diagonals(index), SHEAR_SHARE * cloth_material.evened(number))
    bends = bends_along(index, 1.0).plus(bends_along(index.T, 1.0))
    return [sides, diagonals], Springs(np.zeros((0, 2), dtype=np.int64), 0.0), bends


def _mean_edge(surface: meshes.Surface) -> float:
    x, edges = surface.vertices, meshes.unique_edges(surface.triangles)
    return float(np.linalg.norm(x[edges[:, 1]] - x[edges[:, 0]], axis=1).mean())


def _key(pairs: NDArray) -> NDArray[np.int64]:
    return pairs[:, 0].astype(np.int64) << 32 | pairs[:, 1]
