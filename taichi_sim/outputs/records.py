"""Records: a file that grows by one checksummed piece at a time and can be cut off anywhere."""

import zlib
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from struct import Struct
from typing import IO

from taichi_sim.common.atomic_file import synced

RECORD = Struct("<II")  # length and CRC-32 of what follows
FIRST = b"taichi-sim records 1\n"


class Records:
    """Each is complete in the file as soon as `append` returns; a last one that was cut off, by a crash or a full disk, is
    dropped when the file is opened again.

    number: how many there are. resume: go on with those that are there; otherwise the first that is appended replaces them.
    """

    def __init__(self, path: Path, resume: bool) -> None:
        self.path, self.number = path, 0
        self._file: IO[bytes] | None = None
        if resume and path.exists():
            self.cut(None)

    def cut(self, number: int | None) -> None:
        """Drop all but so many at the beginning, or, None, what is not whole at the end."""
        end, self.number = 0, 0
        with open(self.path, "r+b") as file:
            if file.read(len(FIRST)) == FIRST:
                for _ in islice(_whole(file), number):
                    end, self.number = file.tell(), self.number + 1
            file.truncate(end)

    def append(self, data: bytes) -> None:
        """Add one."""
        if self._file is None:
            self._file = open(self.path, "ab" if self.number else "wb")  # noqa: SIM115  # closed by close
            if not self.number:
                self._file.write(FIRST)
        self._file.write(RECORD.pack(len(data), zlib.crc32(data)))
        self._file.write(data)
        self._file.flush()
        self.number += 1

    def hold(self) -> None:
        """Have all of them on the disk."""
        if self._file is not None:
            synced(self._file)

    def __len__(self) -> int:
        return self.number

    def __iter__(self) -> Iterator[bytes]:
        """Yield the records that there are when it begins."""
        if number := self.number:
            with open(self.path, "rb") as file:
                file.seek(len(FIRST))
                yield from islice(_whole(file), number)

    def close(self) -> None:
        """Leave the file as it is."""
        if self._file is not None:
            with suppress(OSError):  # what a full disk did not take is cut off when the file is opened again
                self._file.close()
            self._file = None


def _whole(file: IO[bytes]) -> Iterator[bytes]:
    """The whole records from here on."""
    while len(head := file.read(RECORD.size)) == RECORD.size:
        length, check = RECORD.unpack(head)
        data = file.read(length)
        if len(data) < length or zlib.crc32(data) != check:
            return
        yield data
