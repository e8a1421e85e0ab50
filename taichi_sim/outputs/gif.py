"""Animated GIF through Pillow."""

import io
from os import PathLike

from taichi_sim.analysis.frame import Frame
from taichi_sim.common.atomic_file import PartFile
from taichi_sim.outputs.base import Image, Output

SHORTEST = 2  # 1/100 s; shorter ones are played at a tenth of the speed


class Gif(Output):
    """A GIF that repeats for ever; 256 colours per frame.

    A GIF counts time in 1/100 s and players show no frame for less than 2/100 s: above 50 frames per second some frames
    are left out, and the others are shown so long that the whole keeps its duration.
    """

    def __init__(self, path: str | PathLike[str], fps: float = 25.0) -> None:
        self.path = path
        self.fps = fps
        self._part = PartFile(path)
        self._pictures: list[bytes] = []  # as PNG with a palette: small enough to wait for the end
        self._starts: list[int] = []  # 1/100 s
        self._end = 0  # 1/100 s, when the last frame, shown or left out, is over

    def wants(self, index: int) -> bool:
        """Whether this frame is not too close to the last one."""
        self._end = self._at(index + 1)
        return not self._starts or self._at(index) - self._starts[-1] >= SHORTEST

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        """Reduce one picture to 256 colours and keep it."""
        from PIL import Image as Pictures

        assert image is not None
        buffer = io.BytesIO()
        Pictures.fromarray(image).quantize(256, dither=Pictures.Dither.NONE).save(buffer, "PNG", compress_level=1)
        self._pictures.append(buffer.getvalue())
        self._starts.append(self._at(index))

    def finish(self) -> None:
        """Write the file: the first picture opens it, the others follow one at a time."""
        from PIL import Image as Pictures

        if self._pictures:
            first, *rest = (Pictures.open(io.BytesIO(picture)) for picture in self._pictures)
            ends = [*self._starts[1:], max(self._end, self._starts[-1] + 1)]
            shown = [10 * (end - start) for start, end in zip(self._starts, ends)]  # ms
            first.save(self._part.file, "GIF", save_all=True, append_images=rest, duration=shown, loop=0)
        self._part.finish()

    def discard(self) -> None:
        self._pictures.clear()
        self._part.discard()

    def _at(self, index: int) -> int:
        return round(100 * index / self.fps)
