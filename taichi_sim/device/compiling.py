"""How long a process has spent on its kernels, and how long a scene like this one will take.

Compiled once, kernels are kept on disk, and a later process that needs the same ones only loads them: so what a scene took last
is remembered by what it is compiled from. Private names are touched, so time is counted for one version of Taichi only; in any
other it is 0.
"""

import functools
import hashlib
import time
from collections.abc import Callable, Iterable
from typing import Any

from taichi_sim.common.remembered import recall, remember
from taichi_sim.device.engine import ENGINE, IS_KNOWN, VERSION

__all__ = ["Expected", "count_time", "seconds"]

TABLE, MOST_REMEMBERED = "compile_times", 500  # scenes
# Seconds that kernels take to compile at first, measured with the demos on one core of an AMD EPYC; a slower machine
# takes twice as long. "": what all scenes have.
AT_FIRST = {"": 3.0, "pictures": 2.0, "pairs": 4.0}
AT_FIRST |= dict.fromkeys(("sticks", "colliders", "triangles", "integrator.implicit_euler", "integrator.tr_bdf2"), 2.0)

_spent = 0.0
_inside = False


def seconds() -> float:
    """What this process has spent on compiling and loading kernels, tracing included."""
    return _spent


@functools.cache
def count_time() -> None:
    """Count from now on."""
    if not IS_KNOWN:
        return
    from taichi._lib import core
    from taichi.lang.kernel_impl import Kernel

    Kernel.materialize = _timed(Kernel.materialize)
    core.Program.compile_kernel = _timed(core.Program.compile_kernel)  # or finds what is compiled


def _timed(function: Callable) -> Callable:
    def call(*args: Any, **kwargs: Any) -> Any:
        global _spent, _inside
        if _inside:  # a kernel that another one needs first
            return function(*args, **kwargs)
        _inside, start = True, time.perf_counter()
        try:
            return function(*args, **kwargs)
        finally:
            _spent += time.perf_counter() - start
            _inside = False

    return call


class Expected:
    """How long the kernels of a scene will take, from what they took before.

    Args: names: the parts that they are compiled from. settings: what else they depend on. pictures: whether it is drawn, too.
    """

    def __init__(self, names: Iterable[str], settings: object, pictures: bool) -> None:
        self._names = sorted({*names, *(["pictures"] if pictures else [])})
        self._key = hashlib.sha256(repr((self._names, settings, ENGINE, VERSION)).encode()).hexdigest()[:16]
        before = recall(TABLE).get(self._key)
        self._before = float(before) if isinstance(before, (int, float)) else None

    @classmethod
    def of(cls, simulation: Any, pictures: bool) -> "Expected":
        """Of a Simulation."""
        return cls(simulation.kernels(), (simulation.scene.dim, str(simulation.backend)), pictures)

    @property
    def words(self) -> str:
        """For those who wait."""
        if self._before is None:
            about = sum(AT_FIRST.get(name, 0.0) for name in ["", *self._names])
            return f"compiling (first run, about {about:.0f} s)"
        return "starting" if self._before < 1.0 else f"loading kernels (about {self._before:.0f} s)"

    def remember(self, spent: float) -> None:
        """What they took."""
        known = recall(TABLE)
        known.pop(self._key, None)
        known[self._key] = round(spent, 1)
        for key in list(known)[:-MOST_REMEMBERED]:
            del known[key]
        remember(TABLE, known)
