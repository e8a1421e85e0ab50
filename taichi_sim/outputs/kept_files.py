"""Files that an unfinished output keeps beside itself: they are whole or not there, and know when they were changed since."""

import json
import shutil
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from taichi_sim.common.atomic_file import replacing
from taichi_sim.common.errors import SceneError

__all__ = ["checksum", "copied", "is_kept", "judged", "read_kept", "write_kept"]

CHUNK = 1 << 20  # bytes
# what parsing and taking apart of something else than was written may raise
ODD = (ValueError, TypeError, KeyError, IndexError, AttributeError, RecursionError, OverflowError)


def write_kept(path: Path, value: Any) -> None:
    """Plain values as JSON with their checksum, whole on the disk before they take the place of what is there."""
    text = json.dumps(value, default=np.generic.item)
    with replacing(path) as file:
        file.write(f'{{"crc32": {zlib.crc32(text.encode())},\n"kept": {text}}}\n'.encode())


def read_kept(path: Path) -> dict[str, Any]:
    """Read the values that `write_kept` wrote. Raises SceneError, see `judged`, where the file is damaged or was edited."""
    with judged(path):
        try:
            found = json.loads(path.read_bytes())
        except (ValueError, RecursionError):
            raise ValueError("it ends too early, or something else was written into it") from None
        kept = found["kept"]
        if not isinstance(kept, dict) or zlib.crc32(json.dumps(kept).encode()) != found["crc32"]:
            raise ValueError("its checksum does not fit")
    return kept  # type: ignore[no-any-return]


def is_kept(path: Path) -> bool:
    """True where a file is there as `write_kept` wrote it."""
    try:
        read_kept(path)
    except (SceneError, OSError):
        return False
    return True


def checksum(path: Path) -> int:
    """CRC-32 of a file."""
    found = 0
    with open(path, "rb") as file:
        while data := file.read(CHUNK):
            found = zlib.crc32(data, found)
    return found


def copied(source: Path, path: Path) -> None:
    """Copy a file, whole on the disk before it appears."""
    with open(source, "rb") as old, replacing(path) as new:
        shutil.copyfileobj(old, new, CHUNK)


@contextmanager
def judged(path: Path) -> Iterator[None]:
    """Turn an error of the block about a file of an unfinished output into one SceneError, which says what to do."""
    try:
        yield
    except ODD as error:
        reason = "it holds something else than was written"
        if isinstance(error, KeyError):
            reason = f"it has no {error}"
        elif isinstance(error, SceneError) and error.file is not None:
            reason = f"it {error.says}"
        elif isinstance(error, ValueError):
            reason = str(error).partition("\n")[0]
        says = f"is damaged ({reason}); delete {path.parent}, or leave --resume out, to begin anew"
        raise SceneError((), says=says, file=path) from None
