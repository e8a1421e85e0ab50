"""Canvas: the fields of a 3D picture. It frees its memory on close()."""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device import backend
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.kernels.render import backdrop, finish, raster, shadow_lattice, visibility
from taichi_sim.kernels.render.shadow import COARSE_TEXELS
from taichi_sim.kernels.render.visibility import TILE
from taichi_sim.render.stages import Stage

__all__ = ["Canvas", "Planes", "finished", "matrix_of", "tiles", "vector_of"]

SHADOW_SIDE = {1: 1024, 4: 1536}  # texels, by samples per pixel


@ti.data_oriented
class Visibility:
    """Buffer of what lies nearest at each of some samples of a picture's pixels; see the kernels of this name."""

    def __init__(self, fields: Fields, size: tuple[int, int], samples: int, depth_only: bool = False) -> None:
        n = size[0] * size[1] * samples
        self.depth_only, self.wide = depth_only, fields.has_wide_numbers and not depth_only
        self.samples, self._size = samples, size
        if self.wide:
            self.key = fields.keys(n)  # (closeness << 32) | identity
        else:
            self.bits = fields.integers(n)  # of the closeness
        if not self.wide and not depth_only:
            # identity: kind << 28 | index, 0 for nothing; stage 0: the closeness is looked for, 1: the identity
            self.identity, self.stage = fields.integers(n), fields.integers(1)
        self.marked = fields.integers(tiles(*size))  # 1: anything may be seen there
        if depth_only:
            self.thin = fields.integers(tiles(*size))  # 1: anything there is too thin for the distance of taps

    def stages(self) -> Iterator[None]:
        """Once for each time that all must be drawn."""
        for stage in range(1 if self.wide or self.depth_only else 2):
            if not self.wide and not self.depth_only:
                self.stage.fill(stage)
            yield

    def clear(self, width: int, height: int) -> None:
        """Clear the buffer for a next picture, of this size."""
        visibility.clear(self, self.samples, *self._size, tiles(*self._size))
        self._size = (width, height)


class Planes(NamedTuple):
    """Walls seen from above: rows (4, 4) of unit normals and offsets [units], and of their closeness on the screen."""

    normals: NDArray[np.float32]
    on_screen: NDArray[np.float32]
    number: int


class Canvas:
    """Buffers of a picture: what is seen in it and in the shadow map, what lies behind all, colours, and the sky that each
    pixel sees."""

    def __init__(
        self,
        size: tuple[int, int],
        samples: int,
        stage: Stage,
        shadow: bool,
        occlusion: bool,
        transparent: bool = False,
        shadow_catcher: bool = False,
    ) -> None:
        pixels = size[0] * size[1]
        self.catches_shadow = shadow_catcher
        self.stage = stage
        self.samples, self.transparent, self.shadow_size = samples, transparent, SHADOW_SIDE[samples]
        self._fields = fields = Fields(ti.f32, backend.has_wide_numbers())
        self.seen = Visibility(fields, size, samples)
        self.has_wide_runs = backend.start().arch == "cpu"  # a device has threads for single pixels
        self.busy = fields.integers(tiles(*size))  # 0: a tile shows sky and ground in all light, nothing else
        self.packed = fields.integers(pixels + 3)  # bytes of the picture
        self.image = fields.vectors(pixels if samples == 1 else 1, 3)  # linear colours
        # plane: the one that lies behind, from 1 on, negative where samples differ, 0 for the sky; backdrop: colour of sky and
        # ground in all light
        self.plane, self.backdrop, self.backdrop_packed = (
            fields.integers(pixels),
            fields.vectors(pixels, 3),
            fields.integers(pixels),
        )
        self.shadow: Any = None
        self.has_shadow, self.has_occlusion = shadow, occlusion
        points = math.prod(-(-side // TILE) * (TILE // shadow_lattice.STEP) + 1 for side in size)
        # lattice of every fourth pixel of every fourth row: what is seen, its closeness
        self.lattice_identity, self.lattice_depth = fields.integers(points), fields.reals(points)
        if shadow:
            self.lattice_share = fields.reals(points)  # of the lamp, negative where not known
            cells = (self.shadow_size // COARSE_TEXELS) ** 2
            self.shadow = Visibility(fields, (self.shadow_size,) * 2, 1, depth_only=True)
            # closeness to the lamp, the largest in each cell, and near it; thin: 1, anything near is too thin for taps
            self.cell, self.coarse, self.thin = fields.reals(cells), fields.reals(cells), fields.integers(cells)
            # coarse cell that the plane lies in, -1 for none; closeness to the lamp of what casts a shadow there
            self.backdrop_cell, self.backdrop_level = fields.integers(pixels), fields.reals(pixels)
            # of each tile: the range of its coarse cells, first to last along both axes; the least of these closenesses
            self.tile_cells, self.tile_level = fields.cells(tiles(*size), 4), fields.reals(tiles(*size))
        if occlusion:
            # normal in the axes of the view; share of the sky that is seen, smoothed and not yet; tiles that see less than all
            self.lattice_normal, self.occluded = fields.vectors(points, 3), fields.integers(tiles(*size))
            self.dim = fields.integers(tiles(*size))  # 1: a tile, or one beside it, sees less than all of the sky
            self.open, self.open_raw = fields.reals(points), fields.reals(points)
        fields.build()
        self.image.fill(0.0)  # see Buffers
        self._scene: tuple[Any, _Scene] | None = None
        self._painted: Any = None  # what the backdrop was made from
        self._placed: Any = None

    def scene(self, buffers: Any) -> Any:
        """Buffers and canvas in one object for the kernels. It stays one object for the same buffers, or kernels would
        compile again."""
        if self._scene is None or self._scene[0] is not buffers:
            self._scene = (buffers, _Scene(buffers, self))
        return self._scene[1]

    def fit_backdrop(
        self,
        scene: Any,
        size: tuple[int, int],
        view: NDArray,
        light: NDArray | None,
        planes: Planes,
        eye: NDArray,
        look: NDArray,
    ) -> None:
        """Paint what lies behind everything, where it is not as in the picture before."""
        known = (size, *(matrix.tobytes() for matrix in (view, *planes[:2], eye, look)))
        given = (matrix_of(view), matrix_of(planes.normals), matrix_of(planes.on_screen), planes.number)
        if known != self._painted:
            backdrop.paint(scene, *given, vector_of(eye), matrix_of(look), *size)
        placed = None if light is None else (known, light.tobytes())
        if light is not None and placed != self._placed:
            place = (matrix_of(light), given[1], vector_of(eye), matrix_of(look), size[0], size[0] * size[1])
            backdrop.place(scene, given[0], *place)
        self._painted, self._placed = known, placed

    def finish(self, width: int, height: int) -> NDArray[np.uint8]:
        if self.samples == 1:
            finish.smooth(self.image, self.packed, width, height)
        return finished(self.packed, self.transparent, width, height)

    def close(self) -> None:
        self._fields.free()
        self._scene = None


def tiles(width: int, height: int) -> int:
    """Number of tiles that cover a picture."""
    return -(-width // TILE) * -(-height // TILE)


def finished(packed: Any, transparent: bool, width: int, height: int) -> NDArray[np.uint8]:
    """The picture (height, width, 3), or with alpha (height, width, 4), from a field of packed bytes, of three pixels more."""
    pixels = width * height
    if transparent:
        out = np.empty(pixels, dtype=np.int32)
        finish.with_alpha(packed, out, pixels)
        return out.view(np.uint8).reshape(height, width, 4)
    groups = -(-pixels // 4)
    out = np.empty(3 * groups, dtype=np.int32)
    finish.without_alpha(packed, out, groups)
    return out.view(np.uint8)[: 3 * pixels].reshape(height, width, 3)


class _Scene:
    """Members of Buffers and Canvas that the shading kernels see."""

    def __init__(self, buffers: Any, canvas: "Canvas") -> None:
        for owner in (buffers, canvas):
            self.__dict__.update({k: v for k, v in vars(owner).items() if not k.startswith("_")})


def matrix_of(matrix: NDArray) -> Any:
    """A matrix (4, 4) for kernels."""
    return raster.View(matrix.tolist())


def vector_of(vector: Any) -> Any:
    """A vector (3,) for kernels."""
    return ti.Vector([float(a) for a in vector], dt=ti.f32)
