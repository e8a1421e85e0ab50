"""MP4 video, H.264 through PyAV, whose encoder comes with it from pip."""

from fractions import Fraction
from os import PathLike
from typing import Any

import numpy as np

from taichi_sim.files import PartFile
from taichi_sim.frame import Frame
from taichi_sim.outputs.base import Image, Output

__all__ = ["Video"]

BT709 = 1  # primaries, transfer and matrix of HD video, in the code of ITU-T H.273
LIMITED = 1  # studio range, as players expect


class Video(Output):
    """An MP4 file that plays everywhere: H.264, yuv420p, colours marked as BT.709, index at the front.

    Args:
        path: the final name. fps: frames per second of the video. crf: 0 (lossless) to 51; 18 looks like the original.
    Frame k is shown at k / fps. Odd sizes grow by one repeated row or column, since yuv420p needs even ones.
    """

    def __init__(self, path: str | PathLike[str], fps: float = 60.0, crf: int = 18) -> None:
        self.path = path
        self.rate = Fraction(fps).limit_denominator(100_000)
        self.crf = crf
        self._part = PartFile(path)
        self._container: Any = None
        self._stream: Any = None

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        """Encode one picture."""
        import av

        assert image is not None
        height, width = image.shape[:2]
        picture = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
        if self._container is None:
            self._open(picture.shape[1], picture.shape[0])
        source = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        encoded = source.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
        encoded.pts = index
        encoded.time_base = 1 / self.rate
        self._container.mux(self._stream.encode(encoded))

    def _open(self, width: int, height: int) -> None:
        import av

        self._container = av.open(str(self._part.part), "w", format="mp4", options={"movflags": "faststart"})
        stream: Any = self._container.add_stream("libx264", rate=self.rate, options={"crf": str(self.crf)})
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.time_base = 1 / self.rate
        context = stream.codec_context
        context.colorspace = context.color_primaries = context.color_trc = BT709
        context.color_range = LIMITED
        self._stream = stream

    def finish(self) -> None:
        """Write what the encoder still holds and the index."""
        if self._container is not None:
            self._container.mux(self._stream.encode())
            self._container.close()
            self._container = None
        self._part.finish()

    def discard(self) -> None:
        """Delete the unfinished file."""
        self._container = self._stream = None
        self._part.discard()
