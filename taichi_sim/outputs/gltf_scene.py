"""A glTF scene under construction: what its nodes show from the first frame on, and how they move."""

from collections.abc import Sequence
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from taichi_sim.analysis.frame import Frame
from taichi_sim.geometry.spheres import icosphere
from taichi_sim.outputs.gltf_nodes import Nodes
from taichi_sim.outputs.morphed import Morphed, among
from taichi_sim.outputs.parts import Parts, Textures, in_3d, placed
from taichi_sim.outputs.rods import ROD, from_z
from taichi_sim.outputs.wall_squares import wall_squares
from taichi_sim.render.camera import Camera

__all__ = ["GltfScene"]

MOST_NODES = 2000  # loose balls and springs between them that are nodes of their own
MANY_BALL = 0  # how often the triangles of a ball are cut in four, where it is one of many


class GltfScene:
    """Scene as nodes, from the first of its frames. folder: from which textures are named.

    Loose balls and springs are nodes that move. Where there are more than MOST_NODES, the balls of each object are one mesh, and
    its springs lines."""

    def __init__(self, first: Frame, textures: Textures, folder: Path) -> None:
        self._parts = parts = Parts(first, textures)
        self._first, self._textures, self._folder = first, textures, folder
        self._pairs, self._owner = parts.springs(first)
        self._surfaces = [Morphed(one.name, one.object, one.colour, one.uv) for one in parts.surfaces]
        self._are_nodes = len(parts.loose) + len(self._pairs) <= MOST_NODES
        self._heaps, self._nets = list[tuple[NDArray, Morphed]](), list[tuple[NDArray, Morphed]]()
        if not self._are_nodes:
            loose = parts.number[parts.loose]
            self._heaps = [self._heap(k, parts.loose[loose == k]) for k in np.unique(loose).tolist()]
            self._nets = [
                self._net(k, np.unique(self._pairs[self._owner == k])) for k in np.unique(self._owner).tolist()
            ]
        self._balls: list[NDArray] = []  # of each frame: places (b, 3) of loose balls
        self._rods: list[tuple[NDArray, NDArray, NDArray]] = []  # middles, quaternions and scales of springs
        self._bodies: list[tuple[NDArray, NDArray]] = []  # middles and quaternions of colliders
        self._eyes: list[Camera] = []

    @property
    def vertices(self) -> int:
        """Vertices of all meshes whose points move freely."""
        return sum(len(one.colour) for one in self._morphed())

    @property
    def frame_bytes(self) -> int:
        """Bytes of the places of all nodes in a frame: three f4 of a ball, ten of a rod, seven of a collider."""
        nodes = 12 * len(self._parts.loose) + 40 * len(self._pairs) if self._are_nodes else 0
        return nodes + 28 * (1 + len(self._parts.bodies))

    def _morphed(self) -> list[Morphed]:
        return [*self._surfaces, *(heap for _, heap in self._heaps), *(net for _, net in self._nets)]

    def _heap(self, k: int, balls: NDArray) -> tuple[NDArray, Morphed]:
        ball = icosphere(MANY_BALL)
        m, first = len(ball.vertices), np.arange(len(balls))
        made = Morphed(self._parts.names[k], k, np.repeat(self._parts.colour[balls], m, axis=0))
        made.normals = [np.tile(ball.vertices, (len(balls), 1)).astype(np.float32)]
        made.faces = [(ball.triangles + m * first[:, None, None]).reshape(-1, 3)]
        return balls, made

    def _net(self, k: int, balls: NDArray) -> tuple[NDArray, Morphed]:
        return balls, Morphed(self._parts.names[k], k, self._parts.colour[balls])

    # Frames

    def add(self, frame: Frame, camera: Camera | None, has_shape: bool) -> None:
        """Take a frame. has_shape: it is one of those at which meshes have a shape."""
        x = in_3d(frame.position)
        if has_shape:
            self._add_shapes(frame, x)
        if self._are_nodes:
            self._balls.append(x[self._parts.loose])
            self._rods.append(self._spanned(frame, x))
        if frame.colliders:
            centre, rotation = zip(*placed(frame))
            self._bodies.append((np.array(centre), Rotation.from_matrix(np.array(rotation)).as_quat()))
        if camera is not None:
            self._eyes.append(camera)

    def _add_shapes(self, frame: Frame, x: NDArray) -> None:
        for one, mesh, faces in zip(self._parts.surfaces, self._surfaces, self._parts.triangles(frame)):
            points = one.points(x)
            mesh.points.append(points.astype(np.float32))
            mesh.normals.append(one.normals(points, faces).astype(np.float32))
            mesh.faces.append(faces)
        ball = icosphere(MANY_BALL).vertices
        for balls, mesh in self._heaps:
            around = x[balls, None] + self._parts.radius[balls, None, None] * ball
            mesh.points.append(around.reshape(-1, 3).astype(np.float32))
        pairs, owner = self._parts.springs(frame) if self._nets else (self._pairs, self._owner)
        for balls, mesh in self._nets:
            mesh.points.append(x[balls].astype(np.float32))
            mesh.faces.append(np.searchsorted(balls, pairs[owner == mesh.object]).astype(np.int32))

    def _spanned(self, frame: Frame, x: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Middles, turns and sizes of the rods of the first frame's springs; those that have torn have no size."""
        pairs = self._parts.springs(frame)[0]
        ends = x[self._pairs]
        along = ends[:, 1] - ends[:, 0]
        length = np.linalg.norm(along, axis=1)
        thick = ROD * self._parts.radius[self._pairs].min(axis=1)
        there = np.ones(len(length)) if len(pairs) == len(self._pairs) else among(self._pairs, pairs)
        scale = there[:, None] * np.stack([thick, thick, length], axis=1)
        return ends.mean(axis=1), from_z(along, length), scale

    # The file

    def write(self, file: IO[bytes], fps: float, shown: Sequence[int], shapes: Sequence[int], aspect: float) -> None:
        """Write it. fps [1/s]: of the frames; shown: their numbers; shapes: those at which meshes have a shape."""
        parts, nodes = (
            self._parts,
            Nodes(self._parts.names, self._parts.held(), np.array(shown) / fps, np.array(shapes) / fps),
        )
        for mesh in self._surfaces:
            mesh.come_apart()
            texture = self._textures.get(mesh.name) if mesh.uv is not None else None
            nodes.add_morphed(mesh, "surface", None if texture is None else (self._folder / texture[0], texture[1]))
        for part, heaps in (("balls", self._heaps), ("springs", self._nets)):
            for _, mesh in heaps:
                mesh.come_apart()
                nodes.add_morphed(mesh, part)
        if self._are_nodes:
            loose = parts.number[parts.loose]
            for k in np.unique(loose).tolist():
                balls, places = parts.loose[loose == k], np.stack(self._balls)[:, loose == k]
                nodes.add_balls(k, parts.radius[balls], parts.colour[balls], places)
            for k in np.unique(self._owner).tolist():
                mine = self._owner == k
                spans = [np.stack([rods[a] for rods in self._rods])[:, mine] for a in range(3)]
                nodes.add_rods(k, parts.colour[self._pairs[mine][0, 0]], *spans)
        for k, body in enumerate(parts.bodies):
            nodes.add_body(body, *(np.stack([bodies[a][k] for bodies in self._bodies]) for a in range(2)))
        for one in wall_squares(self._first):
            if one.is_floor:
                nodes.add_body(one.body)
        if self._eyes:
            nodes.add_camera(self._eyes, aspect)
        nodes.write(file, fps)
