"""A run that is simulated to its end before it is drawn, so that its camera shows all of it."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from taichi_sim.analysis.frame import Frame
from taichi_sim.common.errors import UnstableError
from taichi_sim.scene.camera_path import CameraPath
from taichi_sim.scene.scene import Scene

__all__ = ["is_drawn_last", "played"]

MOST_KEPT = 4_000_000  # balls of all frames together: some 400 MB


def is_drawn_last(scene: Scene, count: int, style: Mapping[str, Any]) -> bool:
    """True if pictures in this style have a camera that is to show all of a run of `count` frames, and these can be kept."""
    path = style.get("camera") or CameraPath()
    if isinstance(path, Mapping):
        path = CameraPath.of(path, scene.dim, scene.n_balls)
    return isinstance(path, CameraPath) and path.is_open and count > 1 and 0 < count * scene.n_balls <= MOST_KEPT


def played(frames: Sequence[Frame], end: UnstableError | None) -> Iterator[Frame]:
    """The frames, and then what ended them."""
    yield from frames
    if end is not None:
        raise end
