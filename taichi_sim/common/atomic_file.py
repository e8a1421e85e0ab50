"""Files that appear under their final name only when they are complete."""

import glob
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

__all__ = ["PartFile", "replacing"]


class PartFile:
    """A file under construction: a hidden temporary file in the final folder, so that the last move is atomic.

    It is made at once, so a missing parent folder (which is never created), a folder in its place or a lack of rights
    is an OSError with one sentence before any work is done.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.part = self.path.with_name(f".{self.path.name}.{os.getpid()}.part")
        parent = self.path.parent
        if not parent.is_dir():
            raise FileNotFoundError(f"{self.path}: there is no folder {str(parent)!r}; make it first")
        if self.path.is_dir():
            raise IsADirectoryError(f"{self.path}: is a folder; give the name of a file")
        try:
            self.file: IO[bytes] = open(self.part, "w+b")  # noqa: SIM115  # closed by finish or discard
        except OSError as error:
            raise OSError(f"{self.path}: cannot be written: {error.strerror}") from error

    def sweep(self) -> None:
        """Delete what runs into the same name left that were killed."""
        for part in self.path.parent.glob(f".{glob.escape(self.path.name)}.*.part"):
            if part != self.part:
                part.unlink(missing_ok=True)

    def finish(self) -> None:
        """Close the file and move it to its final name."""
        self.file.close()
        os.replace(self.part, self.path)

    def discard(self) -> None:
        """Close and delete it; whatever lies under the final name stays as it was. Does nothing after finish."""
        self.file.close()
        self.part.unlink(missing_ok=True)


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[IO[bytes]]:
    """A binary file to write that takes the place of `path` when the block ends, and vanishes when it raises."""
    part = PartFile(path)
    try:
        yield part.file
        part.finish()
    finally:
        part.discard()
