"""Time that a process has spent on its kernels, and an estimate of what a scene like this one will take.

Compiled once, kernels are kept on disk, and a later process that needs the same ones only loads them: so what a scene took last
is remembered by what it is compiled from. What is kept is no machine code yet: that is made when a kernel is launched for the
first time in a process, which takes most of the time of loading, so all of a first launch counts. Private names are touched, so
time is counted for one version of Taichi only; in any other it is 0.
"""

import functools
import hashlib
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from taichi_sim.common.remembered import recall, remember
from taichi_sim.device.engine import ENGINE, IS_KNOWN, VERSION

__all__ = ["Expected", "count_time", "loaded", "seconds", "watched"]

TABLE, MOST_REMEMBERED = "compile_times", 500  # scenes
# Seconds that kernels take to compile at first, up to their first launch; each machine takes its own multiple. Scenes of unlike
# kinds took 0.8 to 1.25 times their sums, but for one multiple. "": what all scenes have; pictures: of 3D scenes, those of 2D
# take a tenth; more pictures: of another scene of the process, which needs the larger ones anew; parallel pairs: what pairs take
# more on many threads.
AT_FIRST = {
    "": 1.0,
    "pictures": 2.0,
    "more pictures": 1.3,
    "pairs": 2.6,
    "parallel pairs": 1.8,
    "triangles": 3.0,
    "sticks": 2.0,
    "colliders": 1.5,
    "cells": 0.4,
    "bricks": 0.7,
    "solids": 2.4,
    "springs.motors": 0.3,
    "springs.damping": 0.8,
}
AT_FIRST |= dict.fromkeys(("integrator.implicit_euler", "integrator.tr_bdf2"), 1.9)

PACE = "pace"  # entry of the table: how many times AT_FIRST this machine takes, a mean of what it took lately
LOADED_PART = 0.3  # of the time spent on kernels: where the compiler took less, most of them were in the cache
QUIET = 5.0  # s without work on a kernel, after which an expected time that has passed was spent on something else
LOADING = 0.4  # of the time that compiling took, what loading takes in the next process

_spent = _in_compiler = 0.0
_inside, _ended = False, -math.inf
_hear: Callable[[], None] | None = None  # what `watched` was given
_met: set[str] = set()  # scenes of this process: a second one like it compiles and loads nothing
_drawn = False  # pictures of a 3D scene in this process


def seconds() -> float:
    """Seconds that this process has spent on compiling and loading kernels, tracing and the first launch of each included."""
    return _spent


def loaded() -> bool:
    """True if most kernels of this process were compiled by an earlier one, and only loaded."""
    return _in_compiler < LOADED_PART * _spent


def word(from_cache: bool | None = None) -> str:
    """Name of the time spent on kernels: from a cache, or by the compiler; None: as it was so far."""
    return "loading kernels" if (loaded() if from_cache is None else from_cache) else "compiling"


@functools.cache
def count_time() -> None:
    """Count from now on."""
    if not IS_KNOWN:
        return
    from taichi._lib import core
    from taichi.lang.kernel_impl import Kernel

    Kernel.materialize, Kernel.launch_kernel = _until_launched(_timed(Kernel.materialize), Kernel.launch_kernel)
    core.Program.compile_kernel = _timed(_compiler(core.Program.compile_kernel))


def _compiler(compile_kernel: Callable) -> Callable:
    """The engine's compiler, which finds in no time what the cache holds, with its own time counted."""

    def call(*args: Any) -> Any:
        global _in_compiler
        start = time.perf_counter()
        found = compile_kernel(*args)
        _in_compiler += time.perf_counter() - start
        return found

    return call


def _until_launched(materialize: Callable, launch: Callable) -> tuple[Callable, Callable]:
    """Both, with the first launch of each kernel timed."""
    fresh: set[int] = set()  # identities of kernels that were never launched; they live until then
    timed = _timed(launch)

    def prepare(kernel: Any, *args: Any, **kwargs: Any) -> Any:
        known = len(kernel.compiled_kernels)
        found = materialize(kernel, *args, **kwargs)
        if len(kernel.compiled_kernels) > known:
            fresh.add(id(next(reversed(kernel.compiled_kernels.values()))))
        return found

    def launched(kernel: Any, compiled: Any, *args: Any) -> Any:
        if id(compiled) not in fresh:
            return launch(kernel, compiled, *args)
        fresh.discard(id(compiled))
        found = timed(kernel, compiled, *args)
        if _hear is not None:
            _hear()
        return found

    return prepare, launched


def _timed(function: Callable) -> Callable:
    def call(*args: Any, **kwargs: Any) -> Any:
        global _spent, _inside, _ended
        if _inside:  # a kernel that another one needs first
            return function(*args, **kwargs)
        _inside, start = True, time.perf_counter()
        try:
            return function(*args, **kwargs)
        finally:
            _ended = time.perf_counter()
            _spent += _ended - start
            _inside = False

    return call


@contextmanager
def watched(hear: Callable[[], None]) -> Iterator[None]:
    """Call this meanwhile whenever a kernel was compiled or loaded; what it raises ends the work."""
    global _hear
    before, _hear = _hear, hear
    try:
        yield
    finally:
        _hear = before


def _is_quiet() -> bool:
    """True if no kernel is compiled or loaded, and none was lately: a step of a large scene takes long, too."""
    return not _inside and time.perf_counter() - _ended > QUIET


def _pace(known: Mapping[str, Any]) -> float:
    """Factor by which kernels take longer here than AT_FIRST, as far as that is known."""
    pace = known.get(PACE)
    return float(pace) if isinstance(pace, (int, float)) and 0.1 < pace < 100.0 else 1.0


class Expected:
    """Time that the kernels of a scene will take, from what they took before.

    Args: names: the parts that they are compiled from. settings: what else they depend on. pictures: whether it is drawn, too.
    """

    def __init__(self, names: Iterable[str], settings: object, pictures: bool) -> None:
        self._names = sorted({*names, *(["pictures"] if pictures else [])})
        self._key = hashlib.sha256(repr((self._names, settings, ENGINE, VERSION)).encode()).hexdigest()[:16]
        before = recall(TABLE).get(self._key)
        self._before = float(before) if isinstance(before, (int, float)) else None
        self._since, self._compiler_since, self._again = seconds(), _in_compiler, False
        self._has_pictures = _drawn

    @classmethod
    def of(cls, simulation: Any, pictures: bool) -> "Expected":
        """Expected of a Simulation, from now on."""
        parts = simulation.parts
        dim = simulation.scene.dim
        settings = (dim, str(simulation.backend), parts.fields.layout)  # lengths are compiled in
        flat = ["pictures.flat"] if pictures and dim == 2 else []
        one = cls([*simulation.kernels(), *flat], settings, pictures and dim == 3)
        one._again = one._key in _met and bool(parts.kernels)
        return one

    def words(self, waited: float = 0.0) -> str:
        """Message for those who have waited so many seconds."""
        about = self._about() * _pace(recall(TABLE)) if self._before is None else self._before
        if waited > max(QUIET, 0.0 if self._again else about) and _is_quiet():
            return "no estimate yet"
        if self._again or (self._before is not None and self._before < 1.0):
            return "starting"
        if self._before is None:
            if waited > about:
                return f"compiling kernels (longer than the {about:.0f} s expected, and goes on; no new estimate)"
            return f"compiling kernels (about {about:.0f} s, less where they are cached)"
        if waited > about:
            return f"loading kernels (longer than the {about:.0f} s of last time, and goes on; no new estimate)"
        return f"loading kernels (about {about:.0f} s)"

    def _about(self) -> float:
        """Seconds that it takes at first on the machine that AT_FIRST is of."""
        parts = {"", *self._names}
        if self._has_pictures and "pictures" in parts:
            parts ^= {"pictures", "more pictures"}
        if {"pairs", "driver.parallel"} <= parts:
            parts.add("parallel pairs")
        return sum(AT_FIRST.get(part, 0.0) for part in sorted(parts))

    @contextmanager
    def told(self, say: Callable[[str], None]) -> Iterator[None]:
        """Say how long it takes, at once and after each kernel of the block, and remember it."""
        begin = time.perf_counter()

        def hear() -> None:
            say(self.words(time.perf_counter() - begin))

        hear()
        with watched(hear):
            yield
        self.spent()

    def spent(self) -> None:
        """Remember what the kernels took, when they are all there."""
        global _drawn
        _drawn = _drawn or "pictures" in self._names
        spent = seconds() - self._since
        if not self._again:
            self.remember(spent, _in_compiler - self._compiler_since < LOADED_PART * spent)
        _met.add(self._key)

    def remember(self, spent: float, loaded: bool) -> None:
        """Record the seconds that the kernels took to compile, or to load where an earlier process had compiled them."""
        known = recall(TABLE)
        known.pop(self._key, None)
        if not loaded:
            pace = spent / self._about()
            known[PACE] = round((pace * _pace(known)) ** 0.5 if PACE in known else pace, 2)
        known[self._key] = round(spent if loaded else LOADING * spent, 1)
        for key in [key for key in known if key != PACE][:-MOST_REMEMBERED]:
            del known[key]
        remember(TABLE, known)
