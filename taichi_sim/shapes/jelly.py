"""Jelly: a block, or a closed mesh that is filled."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError, about, following
from taichi_sim.common.spelling import takes_color
from taichi_sim.common.warn import warn
from taichi_sim.geometry import mesh as meshes
from taichi_sim.scene.neo_hookean import MOST_RATIO, in_plane_strain, lame
from taichi_sim.scene.scene import Scene
from taichi_sim.shapes import jelly_material
from taichi_sim.shapes.base import (
    DAMPING_RATIO,
    NOTHING_SAID,
    SAFE_MARGIN,
    SAFE_STEP,
    Cells,
    Part,
    Pins,
    Shape,
    Springs,
    affordable,
    at_least_0,
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
from taichi_sim.shapes.filling import filling

__all__ = ["JELLY_DENSITY", "jelly", "of_body"]

JELLY_DENSITY = {2: 100.0, 3: 1000.0}  # kg/m^2 (a slab of 0.1 m) and kg/m^3: water
WOBBLE = 40 * 10.0  # m/s^2: waves run at the root of that times the height
MESH_RATIO = 0.4  # Poisson's, of a filled mesh
FLAT_MESH = 1e-6  # of its longest side: a mesh that is thinner is no body
DEFAULT_BOXES = 16  # along the longest side of a mesh
FILLS = ("voxels", "tetrahedra")
PLANES = ("stress", "strain")
EDGE_SHEAR = {
    2: 0.5,
    3: 0.8,
}  # shear modulus of a lattice of springs with edges of 1 N/m, in parts of that over the spacing
CRUSH = 3.0  # times the shear modulus: the crush modulus of its cells
BALL_SHARE = 0.25  # radius of a filled mesh's balls, of its spacing


@takes_color
def jelly(
    scene: Scene,
    size: Sequence[float] | None = None,
    resolution: Sequence[int] | None = None,
    mesh: str | PathLike[str] | tuple[ArrayLike, ArrayLike] | None = None,
    *,
    mass: float | None = None,
    stiffness: float | None = None,
    density: float | None = None,
    young_modulus: float | None = None,
    poisson_ratio: float | None = None,
    plane: str | None = None,
    fill: str = "voxels",
    spacing: float | None = None,
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
    up: Literal["y", "z"] | None = None,
) -> Shape:
    """A block of jelly from the origin toward the positive axes: a box lattice in 3D, a rectangle in 2D; or a filled mesh.

    With any of density, young_modulus and poisson_ratio it is made of a material and the same at every resolution: its boxes are
    bricks, see Scene.add_bricks, its tetrahedra solids, see Scene.add_solids, and balls weigh what the volume around them does. A
    mesh keeps its coordinates, is always of a material, and shows its own surface.

    Otherwise springs run along the edges and the diagonals of faces and cells, their stiffness in the ratio that makes the
    lattice elastic alike in all directions (see `_lattice`). In 3D the surface has triangles. Ball (i, j, k) has
    index (i * resolution[1] + j) * resolution[2] + k.

    Args:
        size: along each axis [m], 0.4 by default; resolution: balls per axis, at least 2, 8 by default.
        mesh: an OBJ, PLY, STL or GLB file of a closed surface, or (vertices (v, 3) [m], triangles (t, 3)), in place of size and
            resolution.
        mass: of all of it [kg], shared out equally (by volume in a material); as heavy as water by default (in 2D a slab of 0.1
            m).
        stiffness: of an edge [N/m]. By default such that waves run at sqrt(40 g height), which wobbles like jelly, and never
            above what is stable at 1 ms.
        density: in place of mass [kg/m^3, in 2D kg/m^2].
        young_modulus: how stiff it is when pulled [Pa, in 2D N/m]. By default as for stiffness.
        poisson_ratio: how much it narrows when pulled [1], 0 to 0.4999 (in 2D 0.9996); 1/4 (in 2D 1/3) by default, 0.4 for a
            mesh.
        plane: in 2D "stress", a sheet of the material that may change its thickness, which is the default; or "strain", a slice
            of a long body, with ratios to 0.4999.
        fill: "voxels", those boxes of a lattice whose centre is inside, whatever the mesh; or "tetrahedra" that follow it, from
            the package pytetwild, which takes closed meshes alone and, each time, other points.
        damping: of each spring [N s/m]. In a material the viscosity that springs of such damping along all edges would give.
            A tenth of the critical damping of two neighbouring balls by default.
        spacing: of the boxes, or about that of the tetrahedra's corners [m]; a sixteenth of the longest side of the mesh.
        radius: of each ball [m]; 0.45 of the smallest spacing by default, 0.25 in a mesh or with surface_collision. In 2D a
            material without a radius is drawn as its filled area in place of its balls.
        surface_collision: in 3D, nothing goes through the surface, see Scene.add_triangles.
        up: axis of the mesh that points up, "y" or "z"; y by default, with a warning for STL and PLY, which do not tell.
    """
    made_of = {"balls.mass": given_of(mass=mass, density=density, mesh=mesh, size=size, scale=scale)}
    elastic: dict[str, Any] = {"density": density, "young_modulus": young_modulus, "poisson_ratio": poisson_ratio}
    if stiffness is None:
        elastic = with_preset(scene, material, elastic, () if mass is None else ("density",))
        density, young_modulus, poisson_ratio = elastic.values()
    exclusive("jelly", elastic | {"plane": plane}, {"stiffness": stiffness})
    exclusive("jelly", {"density": density}, {"mass": mass})
    factor = validation.number("jelly.scale", scale, positive=True)
    validation.one_of("jelly.fill", fill, FILLS)
    drag = at_least_0("jelly.damping", damping)
    thinner = surface_part("jelly", surface_collision)
    looks: Any = (pinned, material, colour, self_collision, surface_collision)
    placed: dict[str, Any] = {"velocity": velocity, "position": position, "rotation": rotation}
    if surface_collision and scene.dim == 2:
        raise SceneError("jelly.surface_collision", says="needs a scene with dim = 3")
    if mesh is None:
        if spacing is not None:
            raise SceneError("jelly.spacing", says="is for a mesh; a block has a resolution")
        if fill != "voxels":
            raise SceneError("jelly.fill", fill, says="is for a mesh; a block is made of boxes")
        if up is not None:
            raise SceneError("jelly.up", says="is for a mesh; give position and rotation instead")
        block = _block(scene.dim, size, resolution)
        if plane is None and all(value is None for value in elastic.values()):
            points, kinds, soft, triangles, finest, cells = _springs(block, factor, mass)
            total = or_default("jelly.mass", mass, JELLY_DENSITY[scene.dim] * float(np.prod(block[0] * factor)))
            strength = at_least_0("jelly.stiffness", stiffness, soft)
            ball_radius = or_default("jelly.radius", radius, thinner * finest)
            part = Part(total, ball_radius, *looks, **placed | {"scale": factor})
            guarded = strength if stiffness is None else 0.0
            cells = cells._replace(crush_modulus=guarded * cells.crush_modulus)
            return build(scene, "jelly", points, kinds, triangles, part, strength, drag, cells=cells, made_of=made_of)
        body: jelly_material.Simplices | jelly_material.Boxes
        body, extent, default_radius = _solid_block(block, factor)
        volume, skin = float(np.prod(extent)), None
        default_radius *= thinner
    else:
        if scene.dim != 3:
            raise SceneError("jelly.mesh", says="fills closed surfaces, in a scene with dim = 3")
        for name, value in (("size", size), ("resolution", resolution), ("stiffness", stiffness)):
            if value is not None:
                raise SceneError(f"jelly.{name}", says="is for a block; a mesh takes spacing, scale and young_modulus")
        surface = meshes.given_surface("jelly", mesh, up)
        surface = surface._replace(vertices=surface.vertices * factor)
        extent = np.ptp(surface.vertices, axis=0)
        step = or_default("jelly.spacing", spacing, float(extent.max()) / DEFAULT_BOXES)
        enclosed = abs(meshes.volume(surface))
        if extent.min() <= FLAT_MESH * extent.max():
            says = f"is flat, {extent.tolist()} m along the axes; it encloses nothing that could be filled"
            raise SceneError("jelly.mesh", says=says)
        if step > float(extent.max()):
            raise SceneError("jelly.spacing", step, f"at most {float(extent.max()):.4g}, the length of the mesh [m]")
        body, skin = (_voxels if fill == "voxels" else _tetrahedra)(surface, step)
        default_radius = BALL_SHARE * step
        volume = enclosed if not len(meshes.holes(surface.triangles)) else float(body.volume.sum())
    total = mass if mass is not None else volume * or_default("jelly.density", density, JELLY_DENSITY[scene.dim])
    with about("jelly"), following({} if mass is not None else made_of):
        total = validation.number("balls.mass", total, positive=True)
    ratio = MESH_RATIO if poisson_ratio is None and mesh is not None else poisson_ratio
    shape = of_body(
        scene,
        "jelly",
        body,
        total,
        float(extent[1]),
        default_radius,
        young_modulus=young_modulus,
        poisson_ratio=ratio,
        plane=plane,
        damping=damping,
        radius=radius,
        pinned=pinned,
        material=material,
        colour=colour,
        self_collision=self_collision,
        surface_collision=surface_collision,
        bounded=fill != "tetrahedra",
        made_of=made_of,
        **placed,
    )
    if skin is not None:
        corners, weights = shape.balls[skin[0]], skin[1]
        scene.add_embedded_surface(
            corners, weights, surface.triangles, covers=shape.balls, colour=colour, uv=surface.uv
        )
    return shape


def of_body(
    scene: Scene,
    shape: str,
    body: jelly_material.Simplices | jelly_material.Boxes,
    mass: float,
    height: float,
    default_radius: float,
    *,
    young_modulus: float | None = None,
    poisson_ratio: float | None = None,
    plane: str | None = None,
    damping: float | None = None,
    radius: float | None = None,
    pinned: Pins = False,
    material: str = "default",
    colour: Sequence[float] | None = None,
    self_collision: bool = False,
    surface_collision: bool = False,
    bounded: bool = True,
    made_of: Mapping[str, Sequence[str]] = NOTHING_SAID,
    **placed: Any,
) -> Shape:
    """Add a jelly of a material; shape: its name in messages. mass: of all of it [kg]; height: m, for the default of Young's
    modulus; bounded: that default is stable at 1 ms; made_of: as of `build`. The rest as for `jelly`; placed: velocity, position
    and the like. In 2D pictures show its filled area, out to where its balls end, where no radius asks for balls.
    """
    if surface_collision and scene.dim == 2:
        raise SceneError(f"{shape}.surface_collision", says="needs a scene with dim = 3")
    masses = body.volume * (mass / float(body.volume.sum()))
    if plane is not None:
        validation.one_of(f"{shape}.plane", plane, PLANES)
        if scene.dim == 3:
            raise SceneError(f"{shape}.plane", says="needs a scene with dim = 2")
    long = plane == "strain"
    ratio = 1 / (4 if long else scene.dim + 1) if poisson_ratio is None else poisson_ratio
    ratio = validation.number(f"{shape}.poisson_ratio", ratio, low=0, high=MOST_RATIO[3 if long else scene.dim])
    factor, ratio = in_plane_strain(1.0, ratio) if long else (1.0, ratio)
    if young_modulus is None:
        modulus = _wobbly(body, masses, height, ratio, bounded)
    else:
        modulus = factor * validation.number(f"{shape}.young_modulus", young_modulus, positive=True)
    drag = at_least_0(f"{shape}.damping", damping)
    ball_radius = or_default(f"{shape}.radius", radius, default_radius)
    part = Part(masses, ball_radius, pinned, material, colour, self_collision, surface_collision, **placed)
    mu, density = lame(scene.dim, modulus, ratio)[0], float(masses.sum() / body.volume.sum())
    elements = body.elements(modulus, ratio, _viscosity(body.side, mu, density, drag, scene.dim))
    made_of = {**made_of, **dict.fromkeys(("bricks.viscosity", "solids.viscosity"), given_of(damping=damping))}
    made = build(scene, shape, body.points, [], body.triangles, part, 0.0, None, made_of=made_of, **elements)
    if scene.dim == 2 and radius is None:
        corners, weights = filling(body.points, body.area, ball_radius)
        scene.add_embedded_surface(made.balls[corners], weights, body.area, colour=colour)
    return made


def _viscosity(side: float, mu: float, density: float, drag: float | None, dim: int) -> float:
    """Viscosity [Pa s, in 2D N s/m] of a lattice of springs as long as `side`, with the damping `drag` [N s/m] of its edges, see
    `_lattice`; None: a tenth of what is critical for two balls."""
    shear = EDGE_SHEAR[dim]
    if drag is None:
        drag = DAMPING_RATIO * 2 * math.sqrt(mu * side ** (dim - 2) / shear * density * side**dim / 2)
    return shear * drag * side ** (2 - dim)


# Blocks ------------------------------------------------------------------------------------------------------------


def _block(dim: int, size: Any, resolution: Any) -> tuple[NDArray[np.float64], tuple[int, ...]]:
    """Size (dim,) [m] and balls per axis."""
    extent = lengths("jelly.size", (0.4,) * dim if size is None else size, dim)
    number = counts("jelly.resolution", (8,) * dim if resolution is None else resolution, dim, 2)
    balls = math.prod(number)
    affordable("jelly.resolution", resolution, balls, balls * (4 if dim == 2 else 13), cells=balls * 2)
    return extent, number


def _springs(block: tuple, factor: float, mass: float | None) -> tuple:
    """Points, springs, the default stiffness, surface, ball radius and cells of a block of equal balls; the cells' moduli for a
    stiffness of 1 N/m."""
    extent, number = block
    dim = len(number)
    spacing = extent / (np.array(number) - 1)
    points = np.stack(np.meshgrid(*map(np.arange, number), indexing="ij"), axis=-1).reshape(-1, dim) * spacing
    total = or_default("jelly.mass", mass, JELLY_DENSITY[dim] * float(np.prod(extent * factor)))
    kinds, along = _lattice(number)
    cell = float(np.prod(spacing * factor)) ** (2 / dim)  # m^2
    soft = WOBBLE * float(extent[1]) * factor * total / len(points) / (along * cell)  # c^2 = along k a^2 / m
    triangles = np.zeros((0, 3), dtype=np.int64)
    if dim == 3:
        triangles = jelly_material.box_surface(np.ones([n - 1 for n in number], dtype=bool))
    finest = 0.45 * float(spacing.min()) * factor
    corners, volume, share, together = jelly_material.box_cells(
        np.ones([n - 1 for n in number], dtype=bool), spacing * factor
    )
    mu = 0.5 if dim == 2 else 0.8 / cell**0.5  # C44, see `_lattice`
    cells = Cells(corners, 0.0 * volume, np.full(len(corners), CRUSH * share * mu), volume, together)
    return points, kinds, min(soft, stable_stiffness(kinds, len(points), total)), triangles, finest, cells


def _lattice(number: tuple[int, ...]) -> tuple[list[Springs], float]:
    """The springs of a square or cubic lattice that is elastic alike in all directions, and its C11 a^(dim-2) / k.

    With k1 on the edges, k2 on the face diagonals and k3 on the cell diagonals, summing k L^2 n n n n over the
    springs of a cell gives C11 = k1 + 2 k2 + 4/3 k3 and C12 = C44 = k2 + 4/3 k3 (times 1/a) in 3D, C11 = k1 + k2 and
    C12 = k2 in 2D. Isotropy, C11 = C12 + 2 C44, then asks for k1 = k2 + 8/3 k3, or k1 = 2 k2 in 2D.
    """
    if len(number) == 2:
        edges, diagonals = lattice_pairs(number, (1, 0), (0, 1)), lattice_pairs(number, (1, 1), (1, -1))
        return [Springs(edges, 1.0), Springs(diagonals, 0.5)], 1.5
    faces = lattice_pairs(number, (1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1))
    cells = lattice_pairs(number, (1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1))
    edges = lattice_pairs(number, (1, 0, 0), (0, 1, 0), (0, 0, 1))
    return [Springs(edges, 1.0), Springs(faces, 0.6), Springs(cells, 0.15)], 2.4


def _solid_block(block: tuple, factor: float) -> tuple[jelly_material.Boxes, NDArray[np.float64], float]:
    extent, number = block[0] * factor, block[1]
    spacing = extent / (np.array(number) - 1)
    filled = np.ones([n - 1 for n in number], dtype=bool)
    return jelly_material.lattice(filled, spacing), extent, 0.45 * float(spacing.min())


def _wobbly(
    body: jelly_material.Simplices | jelly_material.Boxes, masses: NDArray, height: float, ratio: float, bounded: bool
) -> float:
    """The default of Young's modulus: waves at sqrt(40 g height), and never above what is stable at 1 ms with a margin.

    Of tetrahedra a few small ones would make all of it soft: no bound for them.
    """
    dim, density = body.points.shape[1], float(masses.sum() / body.volume.sum())
    mu, lam = lame(dim, 1.0, ratio)
    soft = WOBBLE * height * density / (2 * mu + lam)
    if not bounded:
        return soft
    return min(soft, 4 / (SAFE_MARGIN * SAFE_STEP**2 * body.rate(masses, ratio)))


# Meshes ------------------------------------------------------------------------------------------------------------


def _voxels(surface: meshes.Surface, step: float) -> tuple[jelly_material.Boxes, tuple[NDArray, NDArray]]:
    extent = np.ptp(surface.vertices, axis=0)
    boxes = float(np.prod(np.maximum(1, np.ceil(extent / step - 1e-9))))
    part = min(1.0, abs(meshes.volume(surface)) / max(1e-300, float(np.prod(extent))))
    balls = boxes * max(part, 0.05)
    affordable("jelly.spacing", step, balls, 0, bricks=balls)
    low, filled = jelly_material.boxes_in(surface, step)
    wrong = meshes.flaws(surface)
    if not filled.any() and wrong:
        raise SceneError("jelly.mesh", says=f"encloses nothing that could be filled: {'; '.join(wrong)}. Mend it")
    if not filled.any():
        raise SceneError("jelly.spacing", step, "less; no box of that size fits into the mesh")
    if wrong:
        part = float(filled.sum()) * step**3
        warn(
            f"jelly.mesh: {'; '.join(wrong)}. What is inside, {part:.4g} m^3, was decided by a majority of rays: look at the"
            " result, or mend the mesh"
        )
    body = jelly_material.lattice(filled, np.full(3, step))
    return body._replace(points=body.points + low), jelly_material.skin_of_boxes(
        filled, (surface.vertices - low) / step
    )


def _tetrahedra(surface: meshes.Surface, step: float) -> tuple[jelly_material.Simplices, tuple[NDArray, NDArray]]:
    wrong = meshes.flaws(surface)
    if wrong:
        says = f'cannot be filled with tetrahedra: {"; ".join(wrong)}. Mend it, or use fill = "voxels", which takes any mesh'
        raise SceneError("jelly.mesh", says=says)
    if meshes.volume(surface) < 0:
        surface = meshes.Surface(surface.vertices, surface.triangles[:, ::-1])
    balls = abs(meshes.volume(surface)) / step / step / step  # the cube of a tiny step would be 0
    affordable("jelly.spacing", step, balls, 0, solids=6 * balls)
    points, cells = jelly_material.tetrahedra("jelly", surface, step)
    return jelly_material.simplices(points, cells), jelly_material.skin_of_tetrahedra(points, cells, surface.vertices)
