"""Nodes of a glTF file: meshes with materials, cameras, and the animation that moves them."""

from collections.abc import Sequence
from io import BytesIO
from math import radians
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from taichi_sim.geometry.spheres import icosphere
from taichi_sim.outputs.glb import Glb
from taichi_sim.outputs.morphed import Morphed
from taichi_sim.outputs.parts import Body, few_colours, single
from taichi_sim.outputs.rods import rod
from taichi_sim.render.camera import Camera
from taichi_sim.render.palette import to_linear

__all__ = ["Nodes"]

Floats = NDArray[np.float64]
ROUND_BALL = 2  # how often the triangles of a ball are cut in four
ROUGHNESS = 0.6
NEAR, FAR = 0.01, 100.0  # ends of what a camera shows, in its distance from what it looks at
REPEATED, SMOOTH, SMOOTHER = 10497, 9729, 9987  # numbers of glTF for an image that repeats and is filtered
WHITE = np.ones(3)
KNOWN_IMAGES = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg"}  # by their first bytes


class Nodes:
    """Nodes of a file. names: of objects; held: the number of parts of each; times, shape_times [s]: of the frames, and of those
    at which meshes have a shape.

    An object of one part is a node with its name; of several, each is a node in it with an ending to that name.
    """

    def __init__(self, names: Sequence[str], held: NDArray, times: Floats, shape_times: Floats) -> None:
        self._glb, self._names, self._single = Glb(), names, held < 2
        self._times, self._shape_times = times.astype(np.float32), shape_times.astype(np.float32)
        self._of_object: list[list[int]] = [[] for _ in names]
        self._roots: list[int] = []
        self._channels: list[dict[str, Any]] = []
        self._samplers: list[dict[str, Any]] = []
        self._once: dict[str, int] = {}  # accessors that many items use

    def write(self, file: IO[bytes], fps: float) -> None:
        """Write the file. fps [1/s]: said in its extras."""
        for name, parts in zip(self._names, self._of_object):
            self._roots += parts if len(parts) < 2 else [self._glb.add("nodes", name=name, children=parts)]
        if self._channels:
            self._glb.add("animations", name="run", channels=self._channels, samplers=self._samplers)
        self._glb.write(file, self._roots, {"fps": fps})

    # What there is

    def add_morphed(self, mesh: Morphed, part: str, texture: tuple[Path, float] | None = None) -> None:
        """Add a mesh whose points move freely, with an image that repeats so often along each side."""
        same = bool(np.all(mesh.colour == mesh.colour[:1]))
        plain = mesh.colour[0] if same and texture is None else WHITE
        colour = None if same or texture is not None else _shares(mesh.colour)
        uv = None if mesh.uv is None else mesh.uv * (1.0 if texture is None else texture[1]) * [1, -1] + [0, 1]
        material = self._material(mesh.name, plain, None if texture is None else texture[0])
        node = self._part(mesh.object, part, mesh=mesh.add_to(self._glb, material, colour, uv))
        if len(mesh.points) > 1:
            self._animate(node, "weights", self._shape_weights(len(mesh.points)), self._shape_times)

    def add_balls(self, number: int, radius: Floats, colour: Floats, places: Floats) -> None:
        """Add b balls of an object: radius (b,) [m], colour (b, 3) sRGB, places (f, b, 3) [m] at all frames."""
        tints, kind = few_colours(colour)
        ball, name = icosphere(ROUND_BALL), self._names[number]
        meshes = [
            self._still(name, ball.vertices, ball.triangles, ball.vertices, self._material(f"{name}_ball_{k}", tint))
            for k, tint in enumerate(tints)
        ]
        made = [
            self._glb.add("nodes", name=f"{name}_ball_{k}", mesh=meshes[kind[k]], scale=[float(r)] * 3, **_at(place))
            for k, (r, place) in enumerate(zip(radius, places[0]))
        ]
        self._part(number, "balls", children=made)
        self._move(made, "translation", places)

    def add_rods(self, number: int, colour: Floats, middle: Floats, turn: Floats, scale: Floats) -> None:
        """Add m springs of an object: middle (f, m, 3) [m], turn (f, m, 4) and scale (f, m, 3) of a rod along z."""
        name = self._names[number]
        mesh = self._still(name, *rod(), self._material(f"{name}_rod", colour))
        made = [
            self._glb.add("nodes", name=f"{name}_rod_{k}", mesh=mesh, **_at(*place))
            for k, place in enumerate(zip(middle[0], turn[0], scale[0]))
        ]
        self._part(number, "springs", children=made)
        for path, values in (("translation", middle), ("rotation", turn), ("scale", scale)):
            self._move(made, path, values)

    def add_body(self, body: Body, centre: Floats | None = None, turn: Floats | None = None) -> None:
        """Add a collider: centre (f, 3) [m] and turn (f, 4) at all frames; none where it has no place of its own."""
        mesh = self._still(
            body.name, body.vertices, body.triangles, body.normals, self._material(body.name, body.colour)
        )
        placed = {} if centre is None or turn is None else _at(centre[0], turn[0])
        node = self._glb.add("nodes", name=body.name, mesh=mesh, **placed)
        self._roots.append(node)
        if centre is not None and turn is not None:
            self._move([node], "translation", centre[:, None])
            self._move([node], "rotation", turn[:, None])

    def add_camera(self, cameras: Sequence[Camera], aspect: float) -> None:
        """Add a camera, by where it is at all frames."""
        first = cameras[0]
        away = first.distance
        view = {"yfov": radians(first.fov), "aspectRatio": aspect, "znear": NEAR * away, "zfar": FAR * away}
        eye = np.array([one.eye for one in cameras])
        axes = np.array([one.axes() for one in cameras]) * [[1.0], [1.0], [-1.0]]  # it looks along -z
        turn = Rotation.from_matrix(axes.transpose(0, 2, 1)).as_quat()
        number = self._glb.add("cameras", type="perspective", perspective=view)
        node = self._glb.add("nodes", name="camera", camera=number, **_at(eye[0], turn[0]))
        self._roots.append(node)
        self._move([node], "translation", eye[:, None])
        self._move([node], "rotation", turn[:, None])

    def _part(self, number: int, part: str, **about: Any) -> int:
        name = self._names[number]
        node = self._glb.add("nodes", name=name if self._single[number] else f"{name}_{part}", **about)
        self._of_object[number].append(node)
        return node

    # Motion

    def _move(self, nodes: Sequence[int], path: str, values: Floats) -> None:
        """Let nodes have values (f, nodes, width) of a property at all frames, where these change."""
        moves = np.any(values != values[:1], axis=(0, 2))
        if not moves.any():
            return
        rows = values[:, moves].transpose(1, 0, 2).astype(np.float32)
        for node, output in zip(np.array(nodes)[moves].tolist(), self._glb.arrays(rows)):
            self._animate(node, path, output, self._times)

    def _animate(self, node: int, path: str, output: int, times: NDArray[np.float32]) -> None:
        key = f"times {len(times)}"
        if key not in self._once:
            self._once[key] = self._glb.array(times, bounds=True)
        self._samplers.append({"input": self._once[key], "output": output, "interpolation": "LINEAR"})
        self._channels.append({"sampler": len(self._samplers) - 1, "target": {"node": node, "path": path}})

    def _shape_weights(self, shapes: int) -> int:
        """Weights of all shapes at the time of each: the first is that of the mesh itself."""
        key = f"weights {shapes}"
        if key not in self._once:
            self._once[key] = self._glb.array(np.eye(shapes, dtype=np.float32)[:, 1:].ravel())
        return self._once[key]

    # Looks

    def _still(self, name: str, vertices: Floats, triangles: NDArray, normals: Floats, material: int) -> int:
        mesh = Morphed(name, 0, np.zeros((len(vertices), 3)))
        mesh.points, mesh.normals, mesh.faces = [single(vertices)], [single(normals)], [triangles]
        return mesh.add_to(self._glb, material, None, None)

    def _material(self, name: str, colour: Any, image: Path | None = None) -> int:
        """A material of an sRGB colour, or of an image."""
        about: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": ROUGHNESS}
        about["baseColorFactor"] = [*to_linear(np.asarray(colour)).tolist(), 1.0]
        if image is not None:
            source = self._glb.add("images", **self._image(image))
            sampler = self._glb.add("samplers", magFilter=SMOOTH, minFilter=SMOOTHER, wrapS=REPEATED, wrapT=REPEATED)
            about["baseColorTexture"] = {"index": self._glb.add("textures", source=source, sampler=sampler)}
        return self._glb.add("materials", name=name, pbrMetallicRoughness=about, doubleSided=True)

    def _image(self, file: Path) -> dict[str, Any]:
        """An image as the file holds it: as it is, or what is neither PNG nor JPEG as PNG."""
        data = file.read_bytes()
        kind = next((kind for start, kind in KNOWN_IMAGES.items() if data.startswith(start)), None)
        if kind is None:
            from PIL import Image

            made = BytesIO()
            Image.open(BytesIO(data)).save(made, "PNG")
            data, kind = made.getvalue(), "image/png"
        return {"name": file.stem, "bufferView": self._glb.view(data), "mimeType": kind}


def _at(place: Floats, turn: Floats | None = None, scale: Floats | None = None) -> dict[str, Any]:
    """Keys of a node that place it."""
    found = {"translation": place, "rotation": turn, "scale": scale}
    return {key: single(value).tolist() for key, value in found.items() if value is not None}


def _shares(colour: Floats) -> NDArray[np.uint16]:
    """Linear colours (v, 4) with opacity 1 as whole shares of 65535, from sRGB ones (v, 3)."""
    return np.rint(65535 * np.column_stack([to_linear(colour), np.ones(len(colour))])).astype(np.uint16)
