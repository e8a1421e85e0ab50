"""A surface on pages."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.outputs.parts import Surface, few_colours
from taichi_sim.render.colouring import Colouring
from taichi_sim.render.styles import WITHIN, unmirrored
from taichi_sim.scene.looks import Look

__all__ = ["WebSurface", "textured", "to_bytes"]

BANDS = 12  # colours of a surface that is coloured by a quantity
BAND_COLOURS = Colouring.shades(BANDS)

Part = tuple[
    str, NDArray, NDArray[np.bool_], NDArray[np.uint32]
]  # name, sRGB, vertices that it has, triangles of these


class WebSurface:
    """A surface as one mesh for each colour: a mesh of viser has one.

    add: as `add_mesh_simple` of a viser scene; made: called with each mesh that is new.
    """

    def __init__(self, name: str, surface: Surface, add: Callable[..., Any], made: Callable[[Any], None]) -> None:
        self.surface, self._name, self._add, self._made = surface, name, add, made
        self._palette, self._kind = few_colours(surface.colour)
        self._own: tuple[Any, list[Part]] = (None, [])  # triangles, and the parts with the surface's own colours
        self._meshes: dict[str, Any] = {}

    def show(self, points: NDArray[np.float32], faces: NDArray, values: NDArray[np.float64] | None) -> None:
        """Put it to vertices (v, 3) and triangles (t, 3). values (n,): places of the balls on the scale of colours, or None for
        the colours of its own."""
        if values is None and self._own[0] is not faces:
            self._own = faces, list(self._parts("own", self._palette, faces, self._kind[faces[:, 0]]))
        parts = (
            self._own[1]
            if values is None
            else list(self._parts("band", BAND_COLOURS, faces, self._bands(faces, values)))
        )
        for name, colour, used, triangles in parts:
            mesh = self._meshes.get(name)
            if mesh is not None:
                mesh.vertices, mesh.faces = points[used], triangles
                continue
            self._meshes[name] = self._add(
                name,
                points[used],
                triangles,
                color=to_bytes(colour),
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
            self._made(self._meshes[name])
        there = {name for name, *_ in parts}
        for name, mesh in self._meshes.items():
            mesh.visible = name in there

    def _bands(self, faces: NDArray, values: NDArray[np.float64]) -> NDArray[np.int64]:
        """The colour (t,) of each triangle, of the mean of its corners."""
        places = np.einsum("vk,vk->v", self.surface.weights, values[self.surface.corners])[faces].mean(axis=1)
        return np.minimum((BANDS * places).astype(np.int64), BANDS - 1)

    def _parts(self, word: str, palette: NDArray, faces: NDArray, kind: NDArray) -> Iterator[Part]:
        """The triangles of each colour; kind (t,): which of the palette each has."""
        for k in np.flatnonzero(np.bincount(kind)).tolist():
            mine = faces[kind == k]
            used = np.zeros(len(self.surface.corners), dtype=bool)
            used[mine] = True
            yield f"{self._name}_{word}{k}", palette[k], used, (np.cumsum(used) - 1)[mine].astype(np.uint32)


def textured(surface: Surface, look: Look, sheet: NDArray | None) -> Surface:
    """A surface with the colours of its look's texture at its vertices: viser has no images on meshes that move. sheet: its
    triangles (t, 3) where it is a rectangular sheet. Raises SceneError where the image cannot be read."""
    if surface.uv is None:
        return surface
    uv, repeat = surface.uv if sheet is None else unmirrored(surface.uv, sheet), look.repeat or 1.0
    sizes = look.sizes()
    fine = [one for one in sizes if one.shape[0] * one.shape[1] * repeat**2 >= len(uv)]
    image = (fine or sizes[:1])[-1]  # about a pixel for each vertex
    across, up = np.moveaxis(repeat * (0.5 + WITHIN * (uv - 0.5)) % 1.0, 1, 0)
    height, width = image.shape[:2]
    row, column = ((1.0 - up) * height).astype(np.int64), (across * width).astype(np.int64)
    return replace(surface, colour=image[np.minimum(row, height - 1), np.minimum(column, width - 1)] / 255.0)


def to_bytes(colour: NDArray) -> NDArray[np.uint8]:
    """Colours in 0..1 as bytes."""
    return np.rint(255 * np.clip(colour, 0.0, 1.0)).astype(np.uint8)
