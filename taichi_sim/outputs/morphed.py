"""Morphed: meshes of a glTF file whose points move freely, as shapes between which a player goes on."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from taichi_sim.outputs.glb import CORNERS, VERTICES, Glb

__all__ = ["Morphed", "among"]

Floats = NDArray[np.float64]
LINES, TRIANGLES = 1, 4  # modes of primitives
UP = np.array([0.0, 1.0, 0.0], dtype=np.float32)  # in place of a normal that is not known


@dataclass(slots=True, eq=False)
class Morphed:
    """Mesh of v vertices whose points, and normals, are known at some frames. A shape of it is its difference from the first.

    normals: of each frame; one alone: of all of them; none: of lines. faces: triangles (t, 3), or lines (m, 2), of each frame.
    """

    name: str
    object: int
    colour: Floats  # (v, 3) sRGB
    uv: Floats | None = None  # (v, 2), from the lower left corner of an image
    points: list[NDArray[np.float32]] = field(default_factory=list)  # (v, 3) m
    normals: list[NDArray[np.float32]] = field(default_factory=list)
    faces: list[NDArray[np.int32]] = field(default_factory=list)

    def come_apart(self) -> None:
        """Give those faces that tear vertices of their own, which meet in a point where they are no more: a file has one list of
        faces."""
        first, last = self.faces[0], self.faces[-1]
        if first is last or len(first) == len(last):
            return
        lasting = among(first, last)
        torn = first[~lasting]
        own = len(self.colour) + np.arange(torn.size, dtype=np.int32).reshape(torn.shape)
        for k, faces in enumerate(self.faces):
            corners = np.where(among(torn, faces)[:, None], torn, torn[:, :1])
            self.points[k] = np.concatenate([self.points[k], self.points[k][corners.ravel()]])
        self.normals = [np.concatenate([one, one[torn.ravel()]]) for one in self.normals]
        self.colour = np.concatenate([self.colour, self.colour[torn.ravel()]])
        if self.uv is not None:
            self.uv = np.concatenate([self.uv, self.uv[torn.ravel()]])
        self.faces = [np.concatenate([first[lasting], own])]

    def add_to(self, glb: Glb, material: int, colour: NDArray[np.uint16] | None, uv: Floats | None) -> int:
        """Append the mesh to a file, its first frame as it is and the others as shapes, and return its number. colour: (v, 4)
        linear shares, where it is not the material's; uv: places on the image, from its upper left corner."""
        attributes = {"POSITION": glb.array(self.points[0], VERTICES, bounds=True)}
        units = [_unit(one) for one in self.normals]
        if units:
            attributes["NORMAL"] = glb.array(units[0], VERTICES)
        if uv is not None:
            attributes["TEXCOORD_0"] = glb.array(uv.astype(np.float32), VERTICES)
        if colour is not None:
            attributes["COLOR_0"] = glb.array(colour, VERTICES, share=True)
        shapes = []
        for k in range(1, len(self.points)):
            shape = {"POSITION": glb.array(self.points[k] - self.points[0], VERTICES, bounds=True)}
            if len(units) > 1:
                shape["NORMAL"] = glb.array(units[k] - units[0], VERTICES)
            shapes.append(shape)
        faces = self.faces[0].astype(np.uint32)
        part = {
            "attributes": attributes,
            "indices": glb.array(faces.ravel(), CORNERS),
            "mode": TRIANGLES if faces.shape[1] == 3 else LINES,
            "material": material,
        }
        return glb.add("meshes", name=self.name, primitives=[part | ({"targets": shapes} if shapes else {})])


def among(rows: NDArray, others: NDArray) -> NDArray[np.bool_]:
    """Mask (k,) of the rows (k, width) that are rows of others, too."""
    _, number = np.unique(np.concatenate([rows, others]), axis=0, return_inverse=True)
    number = number.reshape(-1)
    return np.isin(number[: len(rows)], number[len(rows) :])


def _unit(normals: NDArray[np.float32]) -> NDArray[np.float32]:
    """The normals as vectors of length 1."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=np.tile(UP, (len(normals), 1)), where=length > 0)
