"""Journal: the finished pictures of an unfinished video, kept beside it without loss, so that an interrupted run goes on."""

import json
import zlib
from collections.abc import Iterator
from pathlib import Path
from struct import Struct
from typing import IO, Any

RECORD = Struct("<II")  # length and CRC-32 of what follows
FIRST = b"taichi-sim frames 1\n"
LOSSLESS = {"preset": "ultrafast", "qp": "0", "tune": "zerolatency", "threads": "1"}  # a packet a picture, at once


class Journal:
    """A file of records, one for each picture, complete in the file as soon as `append` returns. A last one that was cut off, by
    a crash or a full disk, is dropped when the file is opened again.

    Args: path: of the video; fps: of it, which must be what it was. resume: go on with the pictures that are there; otherwise
    they are dropped when the first one is appended. Raises ValueError where they belong to another video.
    """

    def __init__(self, path: Path, fps: float, resume: bool) -> None:
        self.path = path.with_name(f".{path.name}.frames")
        self.size: tuple[int, int] | None = None  # (width, height) px of the pictures in it
        self.frames = 0
        self._fps = fps
        self._file: IO[bytes] | None = None
        self._encoder: Any = None
        if resume and self.path.exists():
            self._find(path)

    def _find(self, video: Path) -> None:
        """Count the pictures that are there, and cut off what is not whole."""
        with open(self.path, "r+b") as file:
            if file.read(len(FIRST)) == FIRST and (about := next(_records(file), None)) is not None:
                header = json.loads(about)
                if header["fps"] != self._fps:
                    raise ValueError(
                        f"{video}: the frames kept of it are {header['fps']:g} a second, not {self._fps:g}; resume with the same"
                        " options, or leave --resume out"
                    )
                self.size = (header["size"][0], header["size"][1])
                end = file.tell()
                for _ in _records(file):
                    self.frames += 1
                    end = file.tell()
                file.truncate(end)

    def append(self, picture: Any) -> None:
        """Keep one more picture, a yuv420p frame of PyAV."""
        import av

        if self._encoder is None:
            self._encoder = context = av.CodecContext.create("libx264", "w")
            context.width, context.height, context.pix_fmt = picture.width, picture.height, "yuv420p"
            context.time_base, context.options = picture.time_base, LOSSLESS
            self._file = open(self.path, "ab" if self.frames else "wb")  # noqa: SIM115  # closed by close
            if not self.frames:
                self.size = (picture.width, picture.height)
                self._file.write(FIRST)
                self._put(json.dumps({"fps": self._fps, "size": self.size}).encode())
        self._put(b"".join(bytes(packet) for packet in self._encoder.encode(picture)))
        self.frames += 1

    def _put(self, data: bytes) -> None:
        assert self._file is not None
        self._file.write(RECORD.pack(len(data), zlib.crc32(data)) + data)
        self._file.flush()

    def pictures(self) -> Iterator[Any]:
        """The pictures that are there, in order."""
        import av

        decoder = av.CodecContext.create("h264", "r")
        with open(self.path, "rb") as file:
            file.seek(len(FIRST))
            records = _records(file)
            next(records)
            for data in records:
                yield from decoder.decode(av.Packet(data))
        yield from decoder.decode(None)

    def close(self) -> None:
        """Leave the file for another run; one without pictures was never made."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def delete(self) -> None:
        """The video is complete."""
        self.close()
        self.path.unlink(missing_ok=True)


def _records(file: IO[bytes]) -> Iterator[bytes]:
    """The whole records from here on."""
    while len(head := file.read(RECORD.size)) == RECORD.size:
        length, check = RECORD.unpack(head)
        data = file.read(length)
        if len(data) < length or zlib.crc32(data) != check:
            return
        yield data
