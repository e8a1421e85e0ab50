"""A scene in binary glTF, which browsers, Blender and most 3D programs open: what pictures show, over time."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from taichi_sim.analysis.frame import Frame
from taichi_sim.common.atomic_file import replacing
from taichi_sim.common.warn import warn
from taichi_sim.outputs.base import USUAL_FPS
from taichi_sim.outputs.gltf_scene import GltfScene
from taichi_sim.outputs.scene_film import SceneFilm

__all__ = ["Gltf"]

MOST_SHAPES = 128  # of a mesh: browsers on small devices have no room for many more
MOST_BYTES = 1 << 28  # of all shapes together
SHAPE_BYTES = 24  # of a vertex in a shape: place and normal
MOST_MOTION_BYTES = 1 << 30  # of the places of nodes at all frames; a file of 4 GiB has lengths that glTF cannot state


class Gltf(SceneFilm):
    """A node for each object, collider, floor and the camera, with their names; metres, y up, seconds. An object has a mesh whose
    shapes (morph targets) are surfaces at moments of the run, nodes for loose balls and for springs between them, or all of these
    in a node of its own. Colours and images of looks are materials, vertices have normals and, on a texture, places.

    Meshes have at most MOST_SHAPES shapes and MOST_BYTES together: where there are more frames, shapes of some of them, evenly
    spread, with a warning; between two of them points move straight. Places of nodes take at most
    MOST_MOTION_BYTES, likewise. Frames wait in the log beside the file until it is complete.
    resume: go on where a run into the same name was cut off.
    """

    def prepare(self, first: Frame, size: tuple[int, int], style: Mapping[str, Any]) -> None:
        """Be ready. Raises ValueError where two shapes of all that is shown would already be too large."""
        super().prepare(first, size, style)
        self._shapes(GltfScene(first, self.textures, self.path.parent), [0, 1])

    def finish(self) -> None:
        """Write the file from the frames that were kept."""
        first = self.log.first
        if first is not None:
            scene, fps = GltfScene(first, self.textures, self.path.parent), float(self.fps or USUAL_FPS)
            self.fit_camera()
            shown = self._shown(scene)
            shapes = self._shapes(scene, shown)
            for index, frame in self.log.frames():
                camera = self.camera(frame)
                if index in shown:
                    scene.add(frame, camera, index in shapes)
            with replacing(self.path) as file:
                scene.write(file, fps, shown, shapes, self.aspect)
        super().finish()

    def _shown(self, scene: GltfScene) -> list[int]:
        """Numbers of the frames at which nodes have places."""
        count = self.frames
        kept = min(count, max(2, MOST_MOTION_BYTES // max(1, scene.frame_bytes)))
        if kept < count:
            warn(
                f"{self.path}: holds the motion at {kept} of {count} frames, evenly spread; .glb takes at most"
                f" {MOST_MOTION_BYTES >> 20} MB of it; for all of it write x.usdc"
            )
        return _spread(list(range(count)), kept)

    def _shapes(self, scene: GltfScene, shown: Sequence[int]) -> list[int]:
        """Numbers of the frames, of those shown, at which meshes have a shape."""
        count, most = len(shown), MOST_BYTES // max(1, SHAPE_BYTES * scene.vertices)
        if most < 2:
            raise ValueError(
                f"{self.path}: {scene.vertices} moving vertices are too many for .glb; at most"
                f" {MOST_BYTES // SHAPE_BYTES // 2} are allowed; write x.usdc"
            )
        kept = min(count, most, MOST_SHAPES)
        if kept < count and scene.vertices:
            warn(
                f"{self.path}: holds the surfaces at {kept} of {count} frames, evenly spread; .glb takes at most"
                f" {MOST_SHAPES} shapes and {MOST_BYTES >> 20} MB of them"
            )
        return _spread(shown, kept)


def _spread(numbers: Sequence[int], kept: int) -> list[int]:
    """So many of the numbers, evenly spread."""
    return [numbers[k] for k in np.rint(np.linspace(0, len(numbers) - 1, kept)).astype(int).tolist()]
