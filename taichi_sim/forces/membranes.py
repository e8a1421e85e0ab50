"""Membranes: triangles of an orthotropic St. Venant-Kirchhoff material, with damping by the rate of strain."""

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.forces.incidence import Corners
from taichi_sim.scene.membranes import shape_gradients

__all__ = ["Membranes"]


@ti.data_oriented
class Membranes(Corners):
    """Forces -A F (S + T) g_k on the corners k of triangles of area A at rest, g_k the gradients of their linear functions.

    F = sum_k x_k g_k^T (3 x 2) is the derivative of places, E = (F^T F - 1) / 2 the strain, S = C : E the stress, and T = damping
    C : dE/dt. The matrix has F (C : sym F^T dF) g, positive semidefinite, and dF (S + T) g without the negative eigenvalue of S
    + T, which is what buckles (Teran et al. 2005). Each triangle is worked out once, into three vectors, which its corners
    gather.

    Fields: `triangle`, one row each; `given` (3 t): what each has for its corners; `state`: F by its columns u and v, and S + T.
    """

    name = "membranes"
    elastic = may_slice = True

    def __init__(self, model: Model, fields: Fields) -> None:
        scene, real = model.scene, fields.real
        corners, (gradient, area) = scene.membranes, shape_gradients(scene.membrane_rest)
        self.count = len(corners)
        self.damped = bool(np.any(scene.membrane_damping > 0))
        data = {name: corners[:, k] for k, name in enumerate("abc")}
        types = dict.fromkeys(data, ti.i32)
        values = {"bu": gradient[:, 1, 0], "bv": gradient[:, 1, 1], "cu": gradient[:, 2, 0], "cv": gradient[:, 2, 1]}
        values["area"] = area
        values |= {name: getattr(scene, f"membrane_{name}") for name in ("warp", "weft", "shear", "coupling")}
        if self.damped:
            values["damping"] = scene.membrane_damping
        self.triangle = fields.table({**types, **dict.fromkeys(values, real)}, self.count, {**data, **values})
        vector = ti.types.vector(3, real)
        self.given = fields.vectors(3 * self.count, 3)
        self.state = fields.table({"u": vector, "v": vector, "stress": vector}, self.count)
        place = 3 * np.arange(self.count)[None] + np.arange(3)[:, None]
        others = np.concatenate([corners[:, [1, 2]], corners[:, [2, 0]], corners[:, [0, 1]]])
        self.gather(model, fields, others, corners.T.ravel(), {"place": ti.i32}, {"place": place.ravel()})

    @ti.func
    def _slope(self, a, b, c, of):
        """Columns u and v of sum_k x_k g_k^T for vectors a, b, c at the corners."""
        p, q = b - a, c - a
        return p * of.bu + q * of.cu, p * of.bv + q * of.cv

    @ti.func
    def _stress(self, strain, of):
        """Stress (S_uu, S_vv, S_uv) [N/m] of a strain (E_uu, E_vv, 2 E_uv)."""
        return ti.Vector(
            [
                of.warp * strain[0] + of.coupling * strain[1],
                of.weft * strain[1] + of.coupling * strain[0],
                of.shear * strain[2],
            ]
        )

    @ti.func
    def _give(self, t, u, v, of):
        """Note for the corners of triangle t what the columns u and v of a stress give them."""
        b = -of.area * (u * of.bu + v * of.bv)
        c = -of.area * (u * of.cu + v * of.cv)
        self.given[3 * t] = ti.cast(-(b + c), float)
        self.given[3 * t + 1] = ti.cast(b, float)
        self.given[3 * t + 2] = ti.cast(c, float)

    @ti.func
    def _rate(self, ball: ti.template(), u, v, of):
        """Rate of the strain (E_uu, E_vv, 2 E_uv) [1/s]."""
        du, dv = self._slope(ball[of.a].v, ball[of.b].v, ball[of.c].v, of)
        rate = ti.Vector([u.dot(du), v.dot(dv), u.dot(dv) + v.dot(du)])
        if ti.static(self.staged):
            rate -= self.half_step[0] * ti.Vector([du.dot(du), dv.dot(dv), 2.0 * du.dot(dv)])
            du, dv = self._slope(ball[of.a].w, ball[of.b].w, ball[of.c].w, of)
            rate += self.half_step[0] * ti.Vector([du.dot(du), dv.dot(dv), 2.0 * du.dot(dv)])
        return rate

    @ti.func
    def _strain(self, u, v):
        return ti.Vector([0.5 * (u.dot(u) - 1.0), 0.5 * (v.dot(v) - 1.0), u.dot(v)])

    @ti.func
    def _whole_stress(self, ball: ti.template(), u, v, of):
        """Stress of the strain, and that of its rate."""
        stress = self._stress(self._strain(u, v), of)
        if ti.static(self.damped):
            stress += of.damping * self._stress(self._rate(ball, u, v, of), of)
        return stress

    @ti.func
    def prepare(self, ball: ti.template()):
        """Forces of all triangles."""
        for t in range(self.count):
            of = self.triangle[t]
            u, v = self._slope(ball[of.a].x, ball[of.b].x, ball[of.c].x, of)
            stress = self._whole_stress(ball, u, v, of)
            self._give(t, u * stress[0] + v * stress[2], v * stress[1] + u * stress[2], of)

    @ti.func
    def corner_force(self, ball: ti.template(), i, row, time):
        """Force on a corner [N]."""
        return self.given[row.place]

    @ti.func
    def corner_energy(self, ball: ti.template(), i, row, real: ti.template()):
        """A third of the triangle's energy [J]."""
        of = self.triangle[row.place // 3]
        u, v = self._slope(ball[of.a].x, ball[of.b].x, ball[of.c].x, of)
        strain = self._strain(u, v)
        return ti.cast(of.area / 6.0, real) * ti.cast(strain.dot(self._stress(strain, of)), real)

    @ti.func
    def corner_loss(self, ball: ti.template(), i, row, real: ti.template()):
        """A third of half of the power that damping takes [W]."""
        loss = ti.cast(0.0, real)
        if ti.static(self.damped):
            of = self.triangle[row.place // 3]
            u, v = self._slope(ball[of.a].x, ball[of.b].x, ball[of.c].x, of)
            rate = self._rate(ball, u, v, of)
            loss = ti.cast(of.area / 6.0 * of.damping, real) * ti.cast(rate.dot(self._stress(rate, of)), real)
        return loss

    @ti.func
    def prepare_blocks(self, ball: ti.template(), s):
        """Slopes, and stresses without their negative eigenvalues, of all triangles."""
        for t in range(self.count):
            of = self.triangle[t]
            u, v = self._slope(ball[of.a].x, ball[of.b].x, ball[of.c].x, of)
            self.state[t].u = ti.cast(u, float)
            self.state[t].v = ti.cast(v, float)
            self.state[t].stress = ti.cast(tensile(self._whole_stress(ball, u, v, of)), float)

    @ti.func
    def _factor(self, of, s):
        """Factor of the material's part of s^2 K + s D [s^2]."""
        factor = s * s
        if ti.static(self.damped):
            factor += s * of.damping
        return factor

    @ti.func
    def prepare_product(self, ball: ti.template(), s):
        """Products of all triangles."""
        for t in range(self.count):
            of, state = self.triangle[t], self.state[t]
            du, dv = self._slope(ball[of.a].p, ball[of.b].p, ball[of.c].p, of)
            u, v, now = state.u, state.v, s * s * state.stress
            change = ti.Vector([u.dot(du), v.dot(dv), u.dot(dv) + v.dot(du)])
            stress = self._factor(of, s) * self._stress(change, of)
            one = u * stress[0] + v * stress[2] + du * now[0] + dv * now[2]
            other = v * stress[1] + u * stress[2] + dv * now[1] + du * now[2]
            self._give(t, -one, -other, of)

    @ti.func
    def corner_product(self, ball: ti.template(), i, row, s):
        """Row of the product."""
        return self.given[row.place]

    @ti.func
    def corner_block(self, ball: ti.template(), i, row, s):
        """Block of a corner."""
        of, state = self.triangle[row.place // 3], self.state[row.place // 3]
        u, v, k = state.u, state.v, row.place % 3
        first, second = ti.Vector([of.bu, of.bv]), ti.Vector([of.cu, of.cv])
        g = ti.select(k == 1, first, ti.select(k == 2, second, -(first + second)))
        uu, uv, vv = g[0] * g[0], g[0] * g[1], g[1] * g[1]
        block = (of.warp * uu + of.shear * vv) * u.outer_product(u) + (of.weft * vv + of.shear * uu) * v.outer_product(
            v
        )
        block += (of.coupling + of.shear) * uv * (u.outer_product(v) + v.outer_product(u))
        pull = state.stress[0] * uu + state.stress[1] * vv + 2.0 * state.stress[2] * uv
        return of.area * (self._factor(of, s) * block + s * s * pull * ti.Matrix.identity(float, 3))


@ti.func
def tensile(stress):
    """Stress (S_uu, S_vv, S_uv) without its negative eigenvalues."""
    mean, half = 0.5 * (stress[0] + stress[1]), 0.5 * (stress[0] - stress[1])
    radius = ti.sqrt(half * half + stress[2] * stress[2])
    high, low = ti.max(0.0, mean + radius), ti.max(0.0, mean - radius)
    part = ti.select(radius > 0.0, 0.5 * (high - low) / ti.select(radius > 0.0, radius, 1.0), 0.0 * radius)
    middle = 0.5 * (high + low)
    return ti.Vector([middle + part * half, middle - part * half, part * stress[2]])
