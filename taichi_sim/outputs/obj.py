"""OBJ: objects with names, materials in a library beside the frames, and spheres for loose balls."""

from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.atomic_file import replacing
from taichi_sim.geometry.spheres import icosphere
from taichi_sim.outputs.parts import Texture, Textures, Together, few_colours
from taichi_sim.render.palette import to_linear

__all__ = ["Obj"]

BALL_TRIANGLES, MOST_CUTS = 50_000, 2  # of the balls of a frame together, and cuts of the triangles of each


class Obj:
    """The common part of all frames of an OBJ: names, materials, and spheres for loose balls, which its readers pass over."""

    def __init__(self, parts: Together, library: Path, textures: Textures) -> None:
        self._library, self._is_written = library, False
        self.materials: list[tuple[str, NDArray, Texture | None]] = []
        names = self._names = ["_".join(name.split()) for name in parts.names]
        loose = parts.loose
        cuts = max((k for k in range(MOST_CUTS + 1) if len(loose) * 20 * 4**k <= BALL_TRIANGLES), default=0)
        self._ball = icosphere(cuts)
        self._of_surface: dict[int, str] = {}
        self._pictured: list[int] = []  # with an image, which readers multiply by the colours of material and vertices
        self._of_ball = np.zeros(len(loose), dtype=np.int64)  # which material
        for k, name in enumerate(names):
            whole = parts.triangles[parts.number[parts.triangles[:, 0]] == k]
            if len(whole):
                mapped = textures.get(parts.names[k]) if np.isfinite(parts.uv[whole]).all() else None
                self._of_surface[k] = name
                colour = parts.colour[np.unique(whole)].mean(axis=0)
                if mapped is not None:
                    self._pictured.append(k)
                    colour = np.ones(3)
                self.materials.append((name, colour, mapped))
            mine = np.flatnonzero(parts.number[loose] == k)
            if len(mine):
                colours, kind = few_colours(parts.colour[loose[mine]])
                self._of_ball[mine] = len(self.materials) + kind
                plain = len(colours) == 1 and k not in self._of_surface
                self.materials += [
                    (name if plain else f"{name}_ball_{m}", colour, None) for m, colour in enumerate(colours)
                ]

    def write_materials(self, file: IO[bytes]) -> None:
        """Write the library of materials; colours are linear, as Blender reads them."""
        for name, colour, texture in self.materials:
            red, green, blue = to_linear(colour)
            file.write(f"newmtl {name}\nKd {red:.4f} {green:.4f} {blue:.4f}\nNs 60\nillum 2\n".encode())
            if texture is not None:
                image, repeat = texture
                often = "" if repeat == 1.0 else f"-s {repeat:g} {repeat:g} 1 "
                file.write(f"map_Kd {often}{image}\n".encode())

    def write(self, file: IO[bytes], parts: Together) -> None:
        """Write a frame, before the first one the library."""
        if not self._is_written:
            with replacing(self._library) as materials:
                self.write_materials(materials)
            self._is_written = True
        loose, ball = parts.loose, self._ball
        n, m = len(parts.points), len(ball.vertices)
        around = parts.points[loose, None] + parts.radius[loose, None, None] * ball.vertices
        points = np.concatenate([parts.points, around.reshape(-1, 3)])
        shown = np.where(np.isin(parts.number, self._pictured)[:, None], 1.0, parts.colour)
        colour = np.concatenate([shown, np.repeat(parts.colour[loose], m, axis=0)])
        file.write(f"mtllib {self._library.name}\n".encode())
        np.savetxt(file, np.column_stack([points, colour]), fmt="v %.9g %.9g %.9g %.4g %.4g %.4g")
        np.savetxt(file, np.concatenate([parts.normals, ball.vertices]), fmt="vn %.6g %.6g %.6g")
        mapped = bool(np.isfinite(parts.uv).any())
        if mapped:
            np.savetxt(file, np.nan_to_num(parts.uv), fmt="vt %.6g %.6g")
        whole = np.isfinite(parts.uv[:, 0])
        faces = ball.triangles[None] + m * np.arange(len(loose))[:, None, None]  # (b, t, 3)
        for k, name in enumerate(self._names):
            file.write(f"o {name}\n".encode())
            own = parts.triangles[parts.number[parts.triangles[:, 0]] == k]
            if len(own):
                file.write(f"usemtl {self._of_surface[k]}\n".encode())
                corner, times = (" %d/%d/%d", 3) if mapped and whole[own].all() else (" %d//%d", 2)
                np.savetxt(file, np.repeat(own, times, axis=1) + 1, fmt="f" + 3 * corner)
            mine = np.flatnonzero(parts.number[loose] == k)
            for material in np.unique(self._of_ball[mine]).tolist():
                file.write(f"usemtl {self.materials[material][0]}\n".encode())
                of_these = faces[mine[self._of_ball[mine] == material]]
                with_normals = np.stack([of_these + n, np.broadcast_to(ball.triangles + n, of_these.shape)], axis=-1)
                np.savetxt(file, with_normals.reshape(-1, 6) + 1, fmt="f %d//%d %d//%d %d//%d")
            np.savetxt(file, parts.springs[parts.number[parts.springs[:, 0]] == k] + 1, fmt="l %d %d")
