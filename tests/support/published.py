"""Published tests: what each measures, as rows, and a drag that brings what hangs to rest."""

from typing import NamedTuple

from taichi_sim.device.engine import ti


class Row(NamedTuple):
    """One quantity at one resolution, beside its reference; `allowed`: the largest relative error that the test takes."""

    what: str
    resolution: str
    found: float
    reference: float
    allowed: float

    @property
    def error(self) -> float:
        """Relative to the reference."""
        return self.found / self.reference - 1.0


def hold(rows):
    """Fail with all rows that are off by more than they may."""
    off = [f"{row.what}, {row.resolution}: {row.error:+.2%}" for row in rows if not abs(row.error) <= row.allowed]
    assert not off, "; ".join(off)


@ti.data_oriented
class Drag:
    """Force -rate m v on each ball [N]; rate [1/s]. It changes no state of rest."""

    def __init__(self, rate):
        self.rate = rate

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        for i in range(model.n):
            w = model.inverse_mass[i]
            if w > 0.0:
                impulse[i] += -h * self.rate / w * ball[i].v

    def damping_rate(self, scene):
        return self.rate
