"""Animated GIF and WebP through Pillow."""

from collections.abc import Iterator
from os import PathLike
from typing import Any

from taichi_sim.analysis.frame import Frame
from taichi_sim.common.atomic_file import replacing
from taichi_sim.outputs.base import USUAL_FPS, Deferred, Image

QUALITY = 80  # of WebP, 0 to 100: no loss that one sees in motion


class Gif(Deferred):
    """A GIF that repeats for ever; 256 colours per frame.

    A GIF counts time in 1/100 s and players show no frame for less than 2/100 s: above 50 frames per second some frames
    are left out, and the others are shown so long that the whole keeps its duration. resume: go on where a run into the same name
    was cut off.
    """

    needs_arrays = False
    apart = True
    is_film = True
    ticks = 100  # a second
    shortest = 2  # ticks; shorter ones are played at a tenth of the speed

    def __init__(self, path: str | PathLike[str], fps: float | None = None, resume: bool = False) -> None:
        super().__init__(path, fps, resume)
        self._shown: list[int] = []  # numbers of frames
        self._count = 0  # of frames that were asked for, shown or left out

    def wants(self, index: int) -> bool:
        """True if this frame is not too close to the last one that is shown."""
        if index >= self._count:
            self._count = index + 1
        if not self._shown or index > self._shown[-1]:
            if self._shown and self._at(index) - self._at(self._shown[-1]) < self.shortest:
                return False
            self._shown.append(index)
            return True
        return index in self._shown

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        if self.wants(index):
            super().write(index, frame, image)

    def finish(self) -> None:
        """Write the file: the first picture opens it, the others follow one at a time."""
        from PIL import Image as Pictures

        with replacing(self.path) as file:
            if self._shown:
                shown = set(self._shown)
                found = (image for index, image in self.log.all_pictures() if index in shown)
                pictures = (self._reduced(Pictures.fromarray(image)) for image in found)
                starts = [self._at(index) for index in self._shown]
                ends = [*starts[1:], max(self._at(self._count), starts[-1] + 1)]
                duration = [1000 // self.ticks * (end - start) for start, end in zip(starts, ends)]  # ms
                self._save(file, next(pictures), pictures, duration)
        super().finish()

    def _reduced(self, picture: Any) -> Any:
        """Picture with 256 colours."""
        from PIL import Image as Pictures

        return picture.quantize(256, dither=Pictures.Dither.NONE)

    def _save(self, file: Any, first: Any, rest: Iterator[Any], duration: list[int]) -> None:
        """All pictures, each shown for so long [ms]."""
        first.save(file, "GIF", save_all=True, append_images=rest, duration=duration, loop=0)

    def _at(self, index: int) -> int:
        return round(self.ticks * index / (self.fps or USUAL_FPS))


class Webp(Gif):
    """A WebP that repeats for ever, in all colours, a third of the size of a GIF; browsers show it as a picture. Above 100 frames
    per second some are left out."""

    ticks, shortest = 1000, 10

    def _reduced(self, picture: Any) -> Any:
        return picture

    def _save(self, file: Any, first: Any, rest: Iterator[Any], duration: list[int]) -> None:
        first.save(
            file, "WEBP", save_all=True, append_images=rest, duration=duration, loop=0, quality=QUALITY, method=4
        )
