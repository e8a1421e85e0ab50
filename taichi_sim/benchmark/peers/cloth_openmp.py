"""The cloth step as a C + OpenMP loop, built with the system's compiler into a temporary folder, called by ctypes."""

import ctypes
import functools
import shlex
import shutil
import subprocess
import tempfile
from os import environ
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from taichi_sim.benchmark.cases import Cloth, HalfSprings
from taichi_sim.benchmark.peers import PeerMissingError

# -ffast-math lets the compiler vectorise the sum over a ball's springs and made the loop 1.2 times as fast (gcc 12).
# It is given when compiling only: when linking it would switch denormal numbers off for the whole process.
FLAGS = ("-O3", "-march=native", "-fopenmp", "-fPIC")
FAST = ("-ffast-math",)

_HALF_SPRING = np.dtype([("neighbour", np.int32), ("stiffness", np.float32), ("rest_length", np.float32)])


def compiler() -> str:
    """First line of the C compiler's version. PeerMissingError without one."""
    done = subprocess.run([*_cc(), "--version"], capture_output=True, text=True, check=False)
    return (done.stdout.splitlines() or ["unknown"])[0]


def _cc() -> list[str]:
    words = shlex.split(environ.get("CC", "cc"))
    if not words or shutil.which(words[0]) is None:
        raise PeerMissingError(f"no C compiler: {' '.join(words) or 'cc'} was not found (set CC, or install gcc)")
    return words


@functools.cache
def _library(fast_math: bool) -> ctypes.CDLL:
    """Build and load; the folder is removed at once, the loaded library stays."""
    cc = _cc()
    source = Path(__file__).with_name("cloth_openmp.c")
    with tempfile.TemporaryDirectory() as folder:
        objects, library = Path(folder, "cloth.o"), Path(folder, "cloth.so")
        for command in (
            [*cc, *FLAGS, *(FAST if fast_math else ()), "-c", str(source), "-o", str(objects)],
            [*cc, "-shared", "-fopenmp", str(objects), "-o", str(library), "-lm"],
        ):
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode != 0:
                reason = (done.stderr.strip().splitlines() or ["no message"])[0]
                raise PeerMissingError(f"the C compiler {cc[0]} failed: {reason}")
        try:
            loaded = ctypes.CDLL(str(library))
        except OSError as error:
            raise PeerMissingError(f"the C library does not load: {error}") from None
    pointer, number = ctypes.c_void_p, ctypes.c_int
    loaded.cloth_steps.argtypes = [number, *[pointer] * 4, ctypes.c_float, pointer, number, number]
    loaded.cloth_steps.restype = None
    return loaded


class ClothOpenMP:
    """A cloth stepped by the C loop on `threads` threads, f32."""

    def __init__(self, cloth: Cloth, half: HalfSprings, *, threads: int, fast_math: bool) -> None:
        self._function = _library(fast_math).cloth_steps
        self._dt, self._threads, self._done = cloth.dt, threads, 0
        self._gravity = np.array(cloth.gravity, dtype=np.float32)
        self._start = half.start
        self._springs = np.empty(len(half.neighbour), dtype=_HALF_SPRING)
        for name in _HALF_SPRING.names or ():
            self._springs[name] = getattr(half, name)
        state = np.concatenate([cloth.position, cloth.velocity], axis=1).astype(np.float32)
        self._first = state
        self._states = [state.copy(), state.copy()]  # where the state is after an even, an odd number of steps

    def reset(self) -> None:
        self._states[0][:], self._done = self._first, 0

    def step(self, steps: int) -> None:
        now, following = self._states if self._done % 2 == 0 else self._states[::-1]
        arrays = (a.ctypes.data for a in (self._start, self._springs, now, following))
        self._function(len(now), *arrays, self._dt, self._gravity.ctypes.data, steps, self._threads)
        self._done += steps

    def result(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        state = self._states[self._done % 2]
        return state[:, :3].copy(), state[:, 3:].copy()
