"""Filling the cache of compiled kernels before anybody waits for them: for images, class rooms and clusters."""

import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from taichi_sim.common.own_modules import own_command
from taichi_sim.device.backend import kernel_folder

__all__ = ["Kept", "Warmed", "kept", "warm"]

SHORTEST = {"fps": "1000", "duration": "0.001"}  # a run of two frames


class Kept(NamedTuple):
    """Contents of the cache of kernels; folder: None where nothing can be kept."""

    folder: Path | None
    kernels: int
    bytes: int


class Warmed(NamedTuple):
    """A scene, the seconds that its process took, the kernels that it compiled, and what it said where it failed."""

    name: str
    seconds: float
    kernels: int
    failure: str


def kept() -> Kept:
    """Return what the cache holds at present."""
    folder = kernel_folder()
    files = [] if folder is None else [file.stat().st_size for file in folder.glob("*.tic")]
    return Kept(folder, len(files), sum(files))


def warm(names: Sequence[str], options: Mapping[str, str]) -> Iterator[Warmed]:
    """Run each scene for two frames and draw them, in a process of its own, as `taichi-sim run` would with these options: kernels
    are known by the fields that were made before them in their process."""
    for name in names:
        before, start = kept().kernels, time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            given = [f"--{key}={value}" for key, value in {**SHORTEST, **options}.items()]
            command = own_command("run", name, "-o", f"{folder}/frames/", "--quiet", *given)
            ended = subprocess.run(command, capture_output=True, text=True, check=False)
        said = ended.stderr.strip() if ended.returncode else ""
        yield Warmed(name, time.perf_counter() - start, kept().kernels - before, said)
