"""Sums of a column in parts, and on devices in groups of these: nothing is left out or counted twice, whatever the number."""

import numpy as np
import pytest
import taichi as ti
from physics_support import F64, PRECISION
from taichi_sim.kernels import reductions

from taichi_sim.device import backend

REAL = ti.f64 if F64 else ti.f32


@ti.data_oriented
class Column:
    """`number` values, their sums by parts and groups, and the whole."""

    def __init__(self, values):
        self.number, self.parts = len(values), reductions.parts_of(len(values))
        self.value, self.whole = ti.field(REAL, self.number), ti.field(REAL, 1)
        self.sum = ti.field(REAL, self.parts + reductions.groups_of(self.parts))
        self.value.from_numpy(values)

    @ti.func
    def add(self, c):
        found = ti.cast(0.0, REAL)
        for k in range(reductions.members(c, self.parts, self.number)):
            found += self.value[reductions.member(c, k, self.parts)]
        self.sum[c] = found

    @ti.kernel
    def run(self):
        reductions.each_part(self.parts, self.add, ())
        reductions.join((self.sum,), self.parts)
        ti.loop_config(serialize=True)
        for _ in range(1):
            self.whole[0] = reductions.total(self.sum, self.parts)


@pytest.mark.parametrize("device", [False, True])
@pytest.mark.parametrize("number", [1, 64, 65, 4096, 4097, 10_000])
def test_everything_is_summed_once(number, device, monkeypatch):
    """Whole numbers, whose sums are exact."""
    backend.start("cpu", PRECISION)
    monkeypatch.setattr(reductions, "on_device", lambda: device)
    values = np.random.default_rng(number).integers(-100, 100, number)
    column = Column(values.astype(np.float64 if F64 else np.float32))
    column.run()
    assert column.whole[0] == values.sum()
    assert reductions.parts_of(number) == (-(-number // 64) if device else -(-number // 1024))
