"""Animated GIF through Pillow."""

import io
from collections.abc import Mapping
from itertools import islice
from os import PathLike
from typing import Any

from taichi_sim.analysis.frame import Frame
from taichi_sim.common.atomic_file import naming, replacing, require_place
from taichi_sim.outputs.base import Image
from taichi_sim.outputs.resumable import Recorded
from taichi_sim.outputs.run_log import Checkpoint

SHORTEST = 2  # 1/100 s; shorter ones are played at a tenth of the speed


class Gif(Recorded):
    """A GIF that repeats for ever; 256 colours per frame.

    A GIF counts time in 1/100 s and players show no frame for less than 2/100 s: above 50 frames per second some frames
    are left out, and the others are shown so long that the whole keeps its duration. resume: go on where a run into the same name
    was cut off.
    """

    def __init__(self, path: str | PathLike[str], fps: float = 25.0, resume: bool = False) -> None:
        super().__init__(path, "pictures", resume=resume)  # as PNG with a palette: small enough to wait for the end
        self.fps = fps
        require_place(path)
        self._starts: list[int] = []  # 1/100 s, of the pictures
        self._end = 0  # 1/100 s, when the last frame, shown or left out, is over

    def has(self, checkpoint: Checkpoint) -> bool:
        return self._kept >= checkpoint.own["output"]["pictures"]

    def go_on(self, checkpoint: Checkpoint) -> None:
        for index in range(checkpoint.frame):
            self.wants(index)

    def hold(self) -> Mapping[str, Any]:
        super().hold()
        return {"pictures": self._records.number}

    def wants(self, index: int) -> bool:
        """Whether this frame is not too close to the last one, nor kept already."""
        self._end = self._at(index + 1)
        if self._starts and self._at(index) - self._starts[-1] < SHORTEST:
            return False
        if len(self._starts) < self._kept:
            self._starts.append(self._at(index))
            self.frames += 1
            return False
        return True

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        """Reduce one picture to 256 colours and keep it."""
        from PIL import Image as Pictures

        assert image is not None
        self.log.open()
        buffer = io.BytesIO()
        Pictures.fromarray(image).quantize(256, dither=Pictures.Dither.NONE).save(buffer, "PNG", compress_level=1)
        with naming(self.path):
            self._records.append(buffer.getvalue())
        self._starts.append(self._at(index))

    def finish(self) -> None:
        """Write the file: the first picture opens it, the others follow one at a time."""
        from PIL import Image as Pictures

        with replacing(self.path) as file:
            if self._starts:
                first, *rest = (
                    Pictures.open(io.BytesIO(picture)) for picture in islice(self._records, len(self._starts))
                )
                ends = [*self._starts[1:], max(self._end, self._starts[-1] + 1)]
                shown = [10 * (end - start) for start, end in zip(self._starts, ends)]  # ms
                first.save(file, "GIF", save_all=True, append_images=rest, duration=shown, loop=0)
        self._records.close()
        self.log.delete()

    def discard(self) -> None:
        """Give it up; its frames stay beside it, for resume."""
        self._records.close()
        self.leave()

    def _at(self, index: int) -> int:
        return round(100 * index / self.fps)
