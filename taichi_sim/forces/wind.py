"""Wind: air that presses on triangles, and drags on what moves through it."""

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.forces.corners import Corners
from taichi_sim.geometry.mesh import sides
from taichi_sim.kernels.trigonometry import cosine, sine

__all__ = ["Wind"]

MOST_TAKEN = 0.5  # of the relative velocity, that a step may take from a triangle
GUST_WAVES = ((1.0, 0.0, 0.0, 0.0), (1.7, 0.9, 0.6, 1.3), (2.9, -1.4, 1.1, 4.1))  # along, across, across, phase
SIDEWAYS_GUSTS = 0.5  # of the gusts, that blows across the wind


@ti.data_oriented
class Wind(Corners):
    """Force of wind on each triangle: density / 2 (drag A |u_n| u_n + skin_friction A |u_t| u_t), u the air's velocity less the
    triangle's, a third of it on each corner.

    A coefficient c of u is never more than MOST_TAKEN / (h D), D = sum over corners w_j t_j / 9 with t_j the triangles at ball
    j: with masses split so, a step can never reverse what it slows, however light the cloth. What resists the wind would then
    feel less than it should: at the advised step, see element_rates, no coefficient is that large.
    """

    name = "wind"
    elastic = False

    def __init__(self, model: Model, fields: Fields) -> None:
        scene = model.scene
        assert scene.wind is not None
        wind, t = scene.wind, scene.triangles
        real = fields.real
        count = np.bincount(t.ravel(), minlength=model.n)
        give = (model.inverse_mass_array * count)[t].sum(axis=1) / 9.0
        most = np.divide(MOST_TAKEN, give, out=np.zeros(len(t)), where=give > 0)
        self.gather(model, fields, sides(t[:, [1, 2, 0]]), t.T.ravel(), {"most": real}, {"most": np.tile(most, 3)})
        speed = float(np.linalg.norm(wind.velocity))
        self.gusty = wind.gust > 0 and speed > 0
        along, one, two = axes(np.array(wind.velocity))
        vector = ti.types.vector(3, real)
        columns = dict.fromkeys(("velocity", "along", "one", "two"), vector)
        columns |= dict.fromkeys(("speed", "gust", "number", "press", "rub"), real)
        first = {
            "velocity": wind.velocity,
            "along": along,
            "one": one,
            "two": two,
            "speed": speed,  # m/s
            "gust": wind.gust,
            "number": 2.0 * np.pi / wind.gust_length,  # 1/m, of the longest wave
            "press": 0.5 * wind.density * wind.drag,  # kg/m^3
            "rub": 0.5 * wind.density * wind.skin_friction,
        }
        self.law = fields.table(columns, 1, {name: np.array([value]) for name, value in first.items()})

    @ti.func
    def air(self, x, time):
        """Velocity of the air at x [m/s], with waves of three lengths that it takes along."""
        law = self.law[0]
        u = law.velocity
        if ti.static(self.gusty):
            s, p, q = law.along.dot(x) - law.speed * time, law.one.dot(x), law.two.dot(x)
            more = aside = ti.cast(0.0, float)
            for a, b, c, phase in ti.static(GUST_WAVES):
                angle = law.number * (a * s + b * p + c * q) + phase
                more += sine(angle) / ti.static(len(GUST_WAVES))
                aside += cosine(1.3 * angle) / ti.static(len(GUST_WAVES))
            u += law.gust * law.speed * (more * law.along + SIDEWAYS_GUSTS * aside * law.one)
        return u

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        """Each ball gathers from its triangles."""
        for i in range(self.n):
            f = ti.Vector.zero(float, 3)
            for e in range(self.start[i], self.start[i + 1]):
                row = self.row[e]
                x, a, b = ball[i].x, ball[row.a].x, ball[row.b].x
                area = 0.5 * (a - x).cross(b - x)
                size = area.norm()
                if size > 0.0 and self.is_whole(e):
                    n = area / size
                    u = self.air((x + a + b) / 3.0, time) - (ball[i].v + ball[row.a].v + ball[row.b].v) / 3.0
                    across = u.dot(n)
                    slip = u - across * n
                    f += ti.min(self.law[0].press * size * ti.abs(across), row.most / h) * across * n
                    f += ti.min(self.law[0].rub * size * slip.norm(), row.most / h) * slip
            impulse[i] = impulse[i] + h * f / 3.0


def axes(velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors along a wind (3,), and two across it, the second as near to upright as can be."""
    speed = np.linalg.norm(velocity)
    along = velocity / speed if speed > 0 else np.array([1.0, 0.0, 0.0])
    up = np.array([0.0, 1.0, 0.0]) if abs(along[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
    one = np.cross(up, along)
    one /= np.linalg.norm(one)
    return along, one, np.cross(along, one)
