"""Files that appear under their final name only when they are complete, and arrays from those that are there."""

import glob
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.errors import SceneError

__all__ = ["PartFile", "arrays_in", "replacing"]


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


def arrays_in(path: Path, prefix: str) -> dict[str, NDArray]:
    """The arrays of an .npz whose names begin with `prefix`, without it."""
    if not path.is_file():
        raise SceneError("table.file", path, says="is not there; it must be an existing .npz file")
    try:
        with np.load(path, allow_pickle=False) as data:
            found = {key[len(prefix) :]: data[key] for key in data.files if key.startswith(prefix)}
    except Exception as error:  # a damaged archive raises whatever its parts raise
        raise SceneError("table.file", path, says=f"cannot be read as .npz arrays: {error}") from None
    if not found:
        raise SceneError("table.file", path, says=f"holds no array whose name begins with {prefix!r}")
    return found
