"""A program with kernels whose launches are known: prints, as JSON, what is counted of each way to launch and to wait.

Of its two loops the second is as long as a field says, which one thread reads in between.
"""

import json
import sys
from collections.abc import Callable

import numpy as np

from taichi_sim.benchmark.launch_counts import count
from taichi_sim.device import backend
from taichi_sim.device.engine import ti

N = 100


@ti.data_oriented
class Known:
    """The kernels, and each piece of work by its name."""

    def __init__(self):
        self.a, self.n = ti.field(ti.f32, N), ti.field(ti.i32, ())
        self.work: dict[str, Callable[[], object]] = {
            "nothing": lambda: None,
            "launched": self.loops,
            "synced": lambda: (self.loops(), ti.sync(), ti.sync()),
            "returned": lambda: (self.loops(), self.first()),
            "filled": lambda: (self.copied(np.zeros(N, np.float32)), ti.sync()),
            "fetched": lambda: (self.loops(), self.a.to_numpy()),
            "element": lambda: (self.loops(), self.a[3]),
        }

    @ti.kernel
    def loops(self):
        for i in range(N):
            self.a[i] = 1.0
        for i in range(self.n[None]):
            self.a[i] = self.a[i] + 1.0

    @ti.kernel
    def first(self) -> float:
        return self.a[0]

    @ti.kernel
    def copied(self, out: ti.types.ndarray()):  # type: ignore[valid-type]
        for i in range(N):
            out[i] = self.a[i]


if __name__ == "__main__":
    backend.start(sys.argv[1], "f32")
    known = Known()
    for work in known.work.values():  # compiles
        work()
    print(json.dumps({name: count(work) for name, work in known.work.items()}))
