"""A drag that brings what hangs to rest."""

from taichi_sim.device.engine import ti


@ti.data_oriented
class Drag:
    """Force -rate m v on each ball [N]; rate [1/s]. It changes no state of rest."""

    def __init__(self, rate):
        self.rate = rate

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):  # type: ignore[valid-type]
        for i in range(model.n):
            w = model.inverse_mass[i]
            if w > 0.0:
                impulse[i] += -h * self.rate / w * ball[i].v

    def damping_rate(self, scene):
        return self.rate
