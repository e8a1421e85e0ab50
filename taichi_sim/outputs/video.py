"""MP4 and WebM video through PyAV, whose encoders come with it from pip."""

from collections.abc import Mapping
from contextlib import suppress
from fractions import Fraction
from os import PathLike
from typing import Any, NamedTuple

import numpy as np

from taichi_sim.analysis.frame import Frame
from taichi_sim.common.atomic_file import PartFile, naming
from taichi_sim.common.warn import warn
from taichi_sim.outputs.base import USUAL_FPS, FileOutput, Image

BT709 = 1  # primaries, transfer and matrix of HD video, in the code of ITU-T H.273
LIMITED = 1  # studio range, as players expect
SMALL = 256  # px: up to 160 wide, x264's mbtree reads memory that nobody wrote, and the bytes differ from run to run
FASTSTART = {"movflags": "faststart"}  # the index at the front
SAME_BYTES = {"fflags": "+bitexact"}  # no random identifiers


class Codec(NamedTuple):
    """An encoder, the container it goes into, its quality (crf) and further options of both."""

    encoder: str
    container: str
    crf: int
    options: dict[str, str]
    muxing: dict[str, str]
    tag: str = ""  # by which players know it


CODECS = {
    "h264": Codec("libx264", "mp4", 18, {}, FASTSTART),
    "h265": Codec("libx265", "mp4", 20, {"x265-params": "log-level=error"}, FASTSTART, "hvc1"),
    "vp9": Codec("libvpx-vp9", "webm", 24, {"b": "0", "row-mt": "1", "cpu-used": "4", "deadline": "good"}, SAME_BYTES),
}


class Video(FileOutput):
    """A video: yuv420p, colours marked as BT.709. MP4 with H.264, which plays everywhere and has its index at the front, or
    H.265, which takes half the space; WebM with VP9.

    Args:
        path: the final name. fps: frames per second of the video. codec: "h264", "h265" or "vp9"; crf: of the codec's own
        scale, from 0 (best) on; 18 of H.264, 20 of H.265, 24 of VP9 look like the original. resume: go on where a run into the
        same name was cut off.
    Frame k is shown at k / fps. Odd sizes grow by one repeated row or column, since yuv420p needs even ones.
    """

    needs_arrays = False
    apart = True
    is_film = True

    def __init__(
        self,
        path: str | PathLike[str],
        fps: float | None = None,
        crf: int | None = None,
        codec: str = "h264",
        resume: bool = False,
    ) -> None:
        super().__init__(path, fps, resume)
        self.codec = CODECS[codec]
        self.crf = self.codec.crf if crf is None else crf
        self._part = PartFile(path)
        self._container: Any = None
        self._stream: Any = None

    @property
    def rate(self) -> Fraction:
        """Frames per second."""
        return Fraction(self.fps or USUAL_FPS).limit_denominator(100_000)

    def options(self) -> Mapping[str, Any]:
        return {"codec": self.codec.encoder, "quality": self.crf}

    def prepare(self, first: Frame, size: tuple[int, int], style: Mapping[str, Any]) -> None:
        width, height = (side + side % 2 for side in size)
        if (width, height) != tuple(size):
            warn(
                f"{self.path.name}: a video has even sides, so that of {size[0]} x {size[1]} px is {width} x {height} px: one"
                " row or column is repeated"
            )

    def holds(self, count: int) -> bool:
        import av

        with suppress(OSError, av.FFmpegError, IndexError), av.open(str(self.path)) as file:
            return file.streams.video[0].frames in (count, 0)  # WebM does not say it
        return False

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        """Encode one picture."""
        import av

        assert image is not None
        self.log.open()  # refused where another run writes it
        image = np.pad(image, ((0, image.shape[0] % 2), (0, image.shape[1] % 2), (0, 0)), mode="edge")
        source = av.VideoFrame.from_ndarray(image, format="rgb24")
        picture = source.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
        picture.time_base, picture.pts = 1 / self.rate, index
        with naming(self.path):
            if self._container is None:
                self._open(picture.width, picture.height)
            self._container.mux(self._stream.encode(picture))

    def _open(self, width: int, height: int) -> None:
        """Start the file."""
        import av

        codec = self.codec
        self._container = av.open(
            str(self._part.part),
            "w",
            format=codec.container,
            options=codec.muxing,
        )
        options = {"crf": str(self.crf), **codec.options}
        if codec.encoder == "libx264" and width < SMALL:
            options["x264-params"] = "mbtree=0"
        stream: Any = self._container.add_stream(codec.encoder, rate=self.rate, options=options)
        if codec.tag:
            stream.codec_context.codec_tag = codec.tag
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.time_base = 1 / self.rate
        context = stream.codec_context
        context.colorspace = context.color_primaries = context.color_trc = BT709
        context.color_range = LIMITED
        self._stream = stream

    def finish(self) -> None:
        """Write what the encoder still holds and the index."""
        with naming(self.path):
            if self._container is not None:
                self._container.mux(self._stream.encode())
                self._container.close()
                self._container = None
        self._part.finish()
        super().finish()

    def leave_as_it_is(self) -> None:
        self._part.discard()
        super().leave_as_it_is()

    def discard(self) -> None:
        """Delete the unfinished file; its pictures stay in the log, for resume."""
        self._container = self._stream = None
        self._part.discard()
        super().discard()
