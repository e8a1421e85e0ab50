"""Gas: closed surfaces that press outward, the more the smaller they are."""

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.forces.corners import Corners
from taichi_sim.geometry.mesh import sides
from taichi_sim.kernels.reductions import LONG_PART, each_part

__all__ = ["Gases"]

LEAST_VOLUME = 1e-3  # of the first: a gas that is pressed together further presses no harder


@ti.data_oriented
class Gases(Corners):
    """Forces p dV/dx with (p + outside) V = (pressure + outside) V0, for all gases of a scene.

    Volumes are summed in parts of fixed length: the same bits for any number of threads. A triangle's volume is counted from the
    gas's first ball: small numbers, whatever the place.
    """

    name = "gas"
    elastic = False  # its energy may be negative, so the energy monitor does not count it

    def __init__(self, model: Model, fields: Fields) -> None:
        gases = model.scene.gases
        self.count = len(gases)
        real = fields.real
        t = np.concatenate([gas.triangles for gas in gases])
        gas = np.repeat(np.arange(self.count), [len(g.triangles) for g in gases])
        self.gather(model, fields, sides(t[:, [1, 2, 0]]), t.T.ravel(), {"gas": ti.i32}, {"gas": np.tile(gas, 3)})
        self.triangle = fields.table(dict.fromkeys("abc", ti.i32), len(t), {n: t[:, k] for k, n in enumerate("abc")})
        ends = np.cumsum([len(g.triangles) for g in gases])
        parts = [
            (k, f, min(f + LONG_PART, e))
            for k, e in enumerate(ends)
            for f in range(e - len(gases[k].triangles), e, LONG_PART)
        ]
        table = np.array(parts)
        self.parts = len(parts)
        columns = {"gas": ti.i32, "first": ti.i32, "last": ti.i32}
        self.part = fields.table(columns, self.parts, {name: table[:, k] for k, name in enumerate(columns)})
        self.volume, self.pressure = fields.reals(self.parts), fields.reals(self.count)
        self.rate = fields.reals(self.count)  # -dp/dV [Pa/m^3]
        self.law = fields.table(
            {"home": ti.i32, "inside": real, "outside": real, "least": real},
            self.count,
            {
                "home": np.array([g.triangles[0, 0] for g in gases]),
                "inside": np.array([(g.pressure + g.outside) * g.volume for g in gases]),
                "outside": np.array([g.outside for g in gases]),
                "least": np.array([LEAST_VOLUME * g.volume for g in gases]),
            },
        )

    @ti.func
    def _measure(self, c, ball: ti.template()):
        """Volume of part c."""
        part = self.part[c]
        home = ball[self.law[part.gas].home].x
        volume = ti.cast(0.0, float)
        for k in range(part.first, part.last):
            t = self.triangle[k]
            volume += (ball[t.a].x - home).dot((ball[t.b].x - home).cross(ball[t.c].x - home))
        self.volume[c] = volume / 6.0

    @ti.func
    def press(self, ball: ti.template()):
        """Volumes and pressures of all gases at the places ball.x (n)."""
        each_part(self.parts, self._measure, (ball,))
        ti.loop_config(serialize=True)
        for _ in range(1):
            for g in range(self.count):
                self.pressure[g] = 0.0
            for c in range(self.parts):
                self.pressure[self.part[c].gas] = self.pressure[self.part[c].gas] + self.volume[c]
            for g in range(self.count):
                law, volume = self.law[g], self.pressure[g]
                full = ti.max(volume, law.least)
                self.pressure[g] = law.inside / full - law.outside
                self.rate[g] = ti.select(volume > law.least, law.inside / (full * full), 0.0 * full)

    @ti.func
    def force(self, ball: ti.template(), i):
        """Force on ball i [N], at the pressures that `press` found: a sixth of (b - x) x (c - x) from each of its triangles."""
        f = ti.Vector.zero(float, 3)
        for e in range(self.start[i], self.start[i + 1]):
            row = self.row[e]
            x = ball[i].x
            f += self.pressure[row.gas] / 6.0 * (ball[row.a].x - x).cross(ball[row.b].x - x)
        return f

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        """Volumes, pressures, then each ball gathers from its triangles."""
        self.press(ball)
        for i in range(self.n):
            impulse[i] = impulse[i] + h * self.force(ball, i)
