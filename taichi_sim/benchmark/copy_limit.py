"""Rate at which the device copies memory: the bound of any kernel that has to go through its data once."""

import functools
from typing import Any

import numpy as np

from taichi_sim.benchmark.contest import Report, elapsed
from taichi_sim.common.memory import available
from taichi_sim.device import backend
from taichi_sim.device.devices import find
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields

FULL, SMALL = 256 << 20, 16 << 20  # bytes of each of the two fields; caches hold less than the first
COPIES, TIMINGS = 20, 5


@ti.data_oriented
class Copy:
    """A Runner (see peers) that copies `size` bytes of single precision numbers from one field to another at each step."""

    def __init__(self, size: int) -> None:
        self.n = size // 4
        self._fields: list[Fields] = []  # a tree each: some devices bind less than both at once
        self.source, self.target = (self._field() for _ in range(2))

    def _field(self) -> Any:
        fields = Fields(ti.f32)
        field = fields.reals(self.n)
        fields.build()
        self._fields.append(fields)
        return field

    @ti.kernel
    def _copy(self):
        for i in range(self.n):
            self.target[i] = self.source[i]

    def step(self, steps: int) -> None:
        for _ in range(steps):
            self._copy()
        ti.sync()

    def close(self) -> None:
        for fields in self._fields:
            fields.free()


def copy_size(arch: str, quick: bool) -> int:
    """Bytes to copy: little where the device is software, or its memory is short."""
    device = find(arch)
    if quick or device is None or device.software:
        return SMALL
    memory = device.memory if arch != "cpu" else available()
    return FULL if not memory or memory > 8 * FULL else SMALL


@functools.cache
def copy_seconds(arch: str, quick: bool) -> tuple[float, ...]:
    """Seconds of a copy, several times."""
    backend.start(arch, "f32")
    copy = Copy(copy_size(arch, quick))
    copy.step(1)
    seconds = tuple(elapsed(copy.step, COPIES) / COPIES for _ in range(TIMINGS))
    copy.close()
    return seconds


def bandwidth(arch: str, quick: bool) -> float:
    """Bytes that the device reads and writes in a second, at best, in a copy."""
    return 2.0 * copy_size(arch, quick) / float(np.min(copy_seconds(arch, quick)))


def copy_report(quick: bool, arch: str = "cpu") -> Report:
    """A field copied to another: the limit of the device."""
    size = copy_size(arch, quick)
    report = Report(f"copy: {size / 2**20:.0f} MiB of f32 from one field to another on {arch}", ratios=False)
    report.rows = [("taichi_sim", list(copy_seconds(arch, quick)), 0.0)]
    report.least_bytes = 2.0 * size
    report.notes.append(
        f"the limit of this device is the best of these, {bandwidth(arch, quick) / 1e9:.4g} GB/s, read and written"
    )
    return report
