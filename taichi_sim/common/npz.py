"""Reading .npz archives from anywhere: what they would take is known from their headers before anything is allocated."""

import math
import os
import zipfile
from pathlib import Path
from typing import IO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from taichi_sim.common.errors import SceneError
from taichi_sim.common.memory import available

__all__ = ["MOST_PACKED", "read_npz"]

MOST_PACKED = 100  # times the file's own size that its arrays may have; zeros can be packed a thousandfold
ALWAYS = 64 << 20  # bytes that any file may unpack to
CHUNK = 1 << 20  # bytes
KINDS = "biufUS"  # of the dtypes that files of this program hold
VERSIONS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


def read_npz(path: str | os.PathLike[str], prefix: str = "") -> dict[str, NDArray]:
    """The arrays of an .npz whose names begin with `prefix`, by their names without it.

    Only plain numbers, bools and texts are read. Raises FileNotFoundError; SceneError, whose `file` is the path, where it is no
    such archive, and where its arrays would take more than 100 times its size (and 64 MB), or more memory than is free.
    """
    file = Path(path)
    if not file.is_file():
        if file.exists():
            raise SceneError((), says="is no file; it must be an .npz archive", file=file)
        raise FileNotFoundError(f"{file}: there is no such file")
    try:
        with zipfile.ZipFile(file) as archive:
            chosen = [one for one in archive.infolist() if one.filename.startswith(prefix)]
            _affordable(file, sum(one.file_size for one in chosen))
            arrays: dict[str, NDArray] = {}
            for member in chosen:
                name = member.filename.removesuffix(".npy")
                if name == member.filename or name in arrays:
                    raise ValueError(f"{member.filename!r} is no .npy, or there twice")
                with archive.open(member) as stream:
                    arrays[name] = _array(name, stream, member.file_size)
    except SceneError:
        raise
    except Exception as error:  # a damaged archive raises whatever its parts raise
        if isinstance(error, OSError) and error.filename is not None:  # it cannot be opened
            raise
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise SceneError((), says=f"cannot be read as .npz arrays: {reason}", file=file) from None
    return {name[len(prefix) :]: array for name, array in arrays.items()}


def _affordable(file: Path, need: int) -> None:
    packed, free = file.stat().st_size, available()
    most = min(MOST_PACKED * packed + ALWAYS, free)
    if need > most:
        allowed = f"{free / 1e9:.3g} GB are free" if most == free else f"{MOST_PACKED} times its size are allowed"
        says = f"holds arrays of {need / 1e9:.3g} GB in {packed / 1e6:.3g} MB, and {allowed}"
        raise SceneError((), says=says, file=file)


def _array(name: str, stream: IO[bytes], size: int) -> NDArray:
    """One array, whose header agrees with the size that the archive names."""
    version = npy.read_magic(stream)
    if version not in VERSIONS:
        raise ValueError(f"{name!r} has version {version} of the .npy format; 1 and 2 are read")
    shape, by_column, dtype = VERSIONS[version](stream)
    if dtype.kind not in KINDS or not dtype.itemsize:
        raise ValueError(f"{name!r} holds {dtype}; numbers, bools and texts are read")
    need = math.prod(shape) * dtype.itemsize
    if min(shape, default=0) < 0 or need > size:
        raise ValueError(f"{name!r} has shape {shape}, more than its {size} bytes hold")
    data = np.empty(need, dtype=np.uint8)
    for start in range(0, need, CHUNK):
        part = stream.read(min(CHUNK, need - start))
        if len(part) < min(CHUNK, need - start):
            raise ValueError(f"{name!r} ends early")
        data[start : start + len(part)] = np.frombuffer(part, dtype=np.uint8)
    flat = data.view(dtype)
    return flat.reshape(shape[::-1]).T if by_column else flat.reshape(shape)
