"""Recording: what a live window shows, as a video."""

from pathlib import Path

from taichi_sim.analysis.frame import Frame
from taichi_sim.outputs.background_writer import Behind
from taichi_sim.outputs.base import Image
from taichi_sim.outputs.video import Video


def free_name(stem: str, suffix: str) -> Path:
    """stem_000.suffix, stem_001.suffix, ... in the working folder: the first that is not there."""
    number = 0
    while (path := Path(f"{stem}_{number:03d}{suffix}")).exists():
        number += 1
    return path


class Recording:
    """An MP4 that is encoded by a thread of its own while the window goes on. Raises OSError where it cannot be written."""

    def __init__(self, path: Path, fps: float) -> None:
        self.path, self._fps = path, fps
        self._video = Video(path, fps)
        self._behind = Behind(self._video.write)
        self._behind.__enter__()
        self._clock, self._next = 0.0, 0

    def add(self, frame: Frame, image: Image, seconds: float) -> None:
        """A picture that is to be seen `seconds` of video after the last one; left out where that is less than a frame."""
        self._clock += seconds
        index = int(self._clock * self._fps * (1 + 1e-9))
        if index >= self._next:
            self._behind.write(index, frame, image)
            self._next = index + 1

    def finish(self) -> None:
        """Write what is left, or, where that fails, nothing."""
        try:
            self._behind.__exit__(None, None, None)
            self._video.finish()
        except BaseException:
            self._video.discard()
            raise
