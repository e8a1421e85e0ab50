"""Animated GIF and WebP through Pillow."""

import io
from collections.abc import Mapping
from itertools import islice
from os import PathLike
from typing import Any

from taichi_sim.analysis.frame import Frame
from taichi_sim.common.atomic_file import naming, replacing, require_place
from taichi_sim.outputs.base import USUAL_FPS, Image
from taichi_sim.outputs.resumable import Recorded
from taichi_sim.outputs.run_log import Checkpoint

QUALITY = 80  # of WebP, 0 to 100: no loss that one sees in motion


class Gif(Recorded):
    """A GIF that repeats for ever; 256 colours per frame.

    A GIF counts time in 1/100 s and players show no frame for less than 2/100 s: above 50 frames per second some frames
    are left out, and the others are shown so long that the whole keeps its duration. resume: go on where a run into the same name
    was cut off.
    """

    is_film = True
    ticks = 100  # a second
    shortest = 2  # ticks; shorter ones are played at a tenth of the speed

    def __init__(self, path: str | PathLike[str], fps: float | None = None, resume: bool = False) -> None:
        super().__init__(path, "pictures", resume=resume)  # as PNG: small enough to wait for the end
        self.fps = fps
        require_place(path)
        self._starts: list[int] = []  # ticks, of the pictures
        self._end = 0  # ticks, when the last frame, shown or left out, is over

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
        if self._starts and self._at(index) - self._starts[-1] < self.shortest:
            return False
        if len(self._starts) < self._kept:
            self._starts.append(self._at(index))
            self.frames += 1
            return False
        return True

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        """Keep one picture."""
        from PIL import Image as Pictures

        assert image is not None
        self.log.open()
        buffer = io.BytesIO()
        self._reduced(Pictures.fromarray(image)).save(buffer, "PNG", compress_level=1)
        with naming(self.path):
            self._records.append(buffer.getvalue())
        self._starts.append(self._at(index))

    def finish(self) -> None:
        """Write the file: the first picture opens it, the others follow one at a time."""
        from PIL import Image as Pictures

        with replacing(self.path) as file:
            if self._starts:
                first, *rest = (
                    Pictures.open(io.BytesIO(picture), formats=("PNG",))
                    for picture in islice(self._records, len(self._starts))
                )
                ends = [*self._starts[1:], max(self._end, self._starts[-1] + 1)]
                shown = [1000 // self.ticks * (end - start) for start, end in zip(self._starts, ends)]  # ms
                self._save(file, first, rest, shown)
        self._records.close()
        self.log.delete()

    def discard(self) -> None:
        """Give it up; its frames stay beside it, for resume."""
        self._records.close()
        self.leave()

    def _reduced(self, picture: Any) -> Any:
        """To 256 colours."""
        from PIL import Image as Pictures

        return picture.quantize(256, dither=Pictures.Dither.NONE)

    def _save(self, file: Any, first: Any, rest: list[Any], shown: list[int]) -> None:
        """All pictures, each shown for so long [ms]."""
        first.save(file, "GIF", save_all=True, append_images=rest, duration=shown, loop=0)

    def _at(self, index: int) -> int:
        return round(self.ticks * index / (self.fps or USUAL_FPS))


class Webp(Gif):
    """A WebP that repeats for ever, in all colours, a third of the size of a GIF; browsers show it as a picture. Above 100 frames
    per second some are left out."""

    ticks, shortest = 1000, 10

    def _reduced(self, picture: Any) -> Any:
        return picture

    def _save(self, file: Any, first: Any, rest: list[Any], shown: list[int]) -> None:
        first.save(file, "WEBP", save_all=True, append_images=rest, duration=shown, loop=0, quality=QUALITY, method=4)
