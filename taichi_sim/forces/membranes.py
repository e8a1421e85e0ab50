"""Membranes: triangles of an orthotropic St. Venant-Kirchhoff material, with damping by the rate of strain."""

from typing import Any

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.forces.corners import Corners
from taichi_sim.forces.folding import elastic, folded
from taichi_sim.kernels.springs import padded_blocks
from taichi_sim.kernels.springs.padded_blocks import dot
from taichi_sim.scene.membranes import aspect, shape_gradients

__all__ = ["Membranes"]

NO_LIMIT = -1.0  # N m
MOST_LIMIT = 1e9  # times the stiffer thread: no strain comes to it


@ti.data_oriented
class Membranes(Corners):
    """Forces -A F (S + T) g_k on the corners k of triangles of area A at rest, g_k the gradients of their linear functions.

    F = sum_k x_k g_k^T (3 x 2) is the derivative of places, E = (F^T F - 1) / 2 the strain, S = C : E the stress, and T = damping
    C : dE/dt. The matrix has F (C : sym F^T dF) g, positive semidefinite, and dF (S + T) g without the negative eigenvalue of S
    + T, which is what buckles (Teran et al. 2005). Each triangle is worked out once, into three vectors, which its corners
    gather. On one thread explicit methods add these in the same order to the balls instead, in `sum`, and read copies of places
    and velocities, `padded`, with a fourth number: a register holds them, and the loop takes half of the time.

    Fields: `triangle`, one row each, with moduli times A; `force` (3 t) [N], `given` (3 t): forces and products on the corners of
    each; `state`: F by its columns u and v, and A (S + T).
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
        values |= {name: area * getattr(scene, f"membrane_{name}") for name in ("warp", "weft", "shear", "coupling")}
        if self.damped:
            values["damping"] = scene.membrane_damping
        self.folds = bool(np.isfinite(scene.membrane_compression_limit).any())
        if self.folds:
            most = MOST_LIMIT * np.maximum(scene.membrane_warp, scene.membrane_weft)
            folds = scene.membrane_compression_limit < most
            values["limit"] = np.where(folds, area * scene.membrane_compression_limit, NO_LIMIT)
            values["aspect"] = aspect(
                np.where(folds, scene.membrane_warp, 1.0), np.where(folds, scene.membrane_weft, 1.0)
            )
        self.triangle = fields.table({**types, **dict.fromkeys(values, real)}, self.count, {**data, **values})
        vector = ti.types.vector(3, real)
        self.state = fields.table({"u": vector, "v": vector, "stress": vector}, self.count)
        if self.folds:
            self.give = fields.table({"share": real, "across": vector, "turn": vector}, self.count)
        self.scatters = model.serial and not np.isfinite(scene.break_strain).any()
        if self.scatters:
            self.sum = fields.vectors(model.n, padded_blocks.width(3))
        else:
            self.given = self.force = fields.vectors(3 * self.count, 3)
        # triangle after triangle, so that each ball adds them in the order in which one thread does
        others = corners[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2)
        self.gather(model, fields, others, corners.ravel(), {"place": ti.i32}, {"place": np.arange(3 * self.count)})

    def allocate_places(self, fields: Fields, real: Any) -> None:
        """Declare the copies that one thread reads."""
        if self.scatters:
            kinds = {"x": real, "v": fields.real} if self.damped else {"x": real}
            four = {name: ti.types.vector(padded_blocks.width(3), kind) for name, kind in kinds.items()}
            self.padded = fields.table(four, self.n)

    @ti.func
    def _slope(self, a, b, c, of):
        """Columns u and v of sum_k x_k g_k^T for vectors a, b, c at the corners."""
        p, q = b - a, c - a
        return p * of.bu + q * of.cu, p * of.bv + q * of.cv

    @ti.func
    def _parts(self, u, v, of):
        """Forces on the corners by the columns u and v of a stress times the area [N m]."""
        b = u * of.bu + v * of.bv
        c = u * of.cu + v * of.cv
        return b + c, -b, -c

    @ti.func
    def _corner_forces(self, u, v, stress, of):
        """Forces on the corners [N] by a stress at the slope of columns u and v."""
        return self._parts(u * stress[0] + v * stress[2], v * stress[1] + u * stress[2], of)

    @ti.func
    def _give(self, given: ti.template(), t, parts):
        """Note for the corners of triangle t what each gets."""
        for k in ti.static(range(3)):
            given[3 * t + k] = ti.cast(parts[k], given.dtype)

    @ti.func
    def _rate(self, ball: ti.template(), u, v, of):
        """Rate of the strain (E_uu, E_vv, 2 E_uv) [1/s]."""
        du, dv = self._slope(ball[of.a].v, ball[of.b].v, ball[of.c].v, of)
        rate = ti.Vector([dot(u, du, 3), dot(v, dv, 3), dot(u, dv, 3) + dot(v, du, 3)])
        if ti.static(self.staged):
            rate -= self.half_step[0] * ti.Vector([dot(du, du, 3), dot(dv, dv, 3), 2.0 * dot(du, dv, 3)])
            du, dv = self._slope(ball[of.a].w, ball[of.b].w, ball[of.c].w, of)
            rate += self.half_step[0] * ti.Vector([dot(du, du, 3), dot(dv, dv, 3), 2.0 * dot(du, dv, 3)])
        return rate

    @ti.func
    def _strain(self, u, v):
        return ti.Vector([0.5 * (dot(u, u, 3) - 1.0), 0.5 * (dot(v, v, 3) - 1.0), dot(u, v, 3)])

    @ti.func
    def _whole_stress(self, ball: ti.template(), u, v, of):
        """Stress of the strain and of its rate, times the area."""
        strain = self._strain(u, v)
        stress = elastic(strain, of)
        if ti.static(self.folds):
            stress = folded(strain, of)[0]
        return self._damp(stress, ball, u, v, of)

    @ti.func
    def _damp(self, stress, ball: ti.template(), u, v, of):
        """Stress plus that of damping, times the area."""
        whole = stress
        if ti.static(self.damped):
            whole += of.damping * elastic(self._rate(ball, u, v, of), of)
        return whole

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        """Add h times the forces [N s]."""
        if ti.static(self.scatters):
            for i in range(self.n):
                for k in ti.static(range(3)):
                    self.padded[i].x[k] = ball[i].x[k]
                if ti.static(self.damped):
                    self.padded[i].v = padded_blocks.pad(ball[i].v, 3)
            for t in range(self.count):
                of = self.triangle[t]
                u, v = self._slope(self.padded[of.a].x, self.padded[of.b].x, self.padded[of.c].x, of)
                a, b, c = self._corner_forces(u, v, self._whole_stress(self.padded, u, v, of), of)
                self.sum[of.a] = self.sum[of.a] + ti.cast(a, float)  # a bare += would be atomic
                self.sum[of.b] = self.sum[of.b] + ti.cast(b, float)
                self.sum[of.c] = self.sum[of.c] + ti.cast(c, float)
            for i in range(self.n):
                impulse[i] = impulse[i] + h * padded_blocks.cut(self.sum[i], 3)
                self.sum[i] = ti.Vector.zero(float, 4)  # for the next step
        else:
            Corners.accumulate(self, model, ball, impulse, h, time)

    @ti.func
    def prepare(self, ball: ti.template()):
        """Forces of all triangles."""
        for t in range(self.count):
            of = self.triangle[t]
            u, v = self._slope(ball[of.a].x, ball[of.b].x, ball[of.c].x, of)
            self._give(self.force, t, self._corner_forces(u, v, self._whole_stress(ball, u, v, of), of))

    @ti.func
    def corner_force(self, ball: ti.template(), i, row, time):
        """Force on a corner [N]."""
        return self.force[row.place]

    @ti.func
    def corner_energy(self, ball: ti.template(), i, row, real: ti.template()):
        """A third of the triangle's energy [J]."""
        of = self.triangle[row.place // 3]
        u, v = self._slope(ball[of.a].x, ball[of.b].x, ball[of.c].x, of)
        strain = self._strain(u, v)
        energy = 0.5 * strain.dot(elastic(strain, of))
        if ti.static(self.folds):
            energy = folded(strain, of)[1]
        return ti.cast(energy, real) / 3.0

    @ti.func
    def corner_loss(self, ball: ti.template(), i, row, real: ti.template()):
        """A third of half of the power that damping takes [W]."""
        loss = ti.cast(0.0, real)
        if ti.static(self.damped):
            of = self.triangle[row.place // 3]
            u, v = self._slope(ball[of.a].x, ball[of.b].x, ball[of.c].x, of)
            rate = self._rate(ball, u, v, of)
            loss = ti.cast(of.damping / 6.0, real) * ti.cast(rate.dot(elastic(rate, of)), real)
        return loss

    def allocate_derivatives(self, fields: Fields) -> None:
        """Declare what corners gather on one thread, too, and forces in the precision of places."""
        if self.scatters:
            self.given = self.force = fields.vectors(3 * self.count, 3)
        if fields.widens:
            self.force = fields.vectors(3 * self.count, 3, wide=True)

    @ti.func
    def prepare_blocks(self, ball: ti.template(), s):
        """Slopes, and stresses without their negative eigenvalues, of all triangles."""
        for t in range(self.count):
            of = self.triangle[t]
            u, v = self._slope(ball[of.a].x, ball[of.b].x, ball[of.c].x, of)
            self.state[t].u = ti.cast(u, float)
            self.state[t].v = ti.cast(v, float)
            strain = self._strain(u, v)
            stress = elastic(strain, of)
            if ti.static(self.folds):
                stress, _, share, across, turn = folded(strain, of)
                self.give[t].share = ti.cast(share, float)
                self.give[t].across = ti.cast(across, float)
                self.give[t].turn = ti.cast(turn, float)
            self.state[t].stress = ti.cast(tensile(self._damp(stress, ball, u, v, of)), float)

    @ti.func
    def _factor(self, t, of, s):
        """Factor of C in the material's part of s^2 K + s D [s^2]."""
        factor = s * s
        if ti.static(self.folds):
            factor *= self.give[t].share
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
            stress = self._factor(t, of, s) * elastic(change, of)
            if ti.static(self.folds):
                across, turn = self.give[t].across, self.give[t].turn
                stress -= s * s * (across * across.dot(change) + turn * turn.dot(change))
            one = u * stress[0] + v * stress[2] + du * now[0] + dv * now[2]
            other = v * stress[1] + u * stress[2] + dv * now[1] + du * now[2]
            self._give(self.given, t, self._parts(-one, -other, of))

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
        block = self._factor(row.place // 3, of, s) * block + s * s * pull * ti.Matrix.identity(float, 3)
        if ti.static(self.folds):
            one, other = self.give[row.place // 3].across, self.give[row.place // 3].turn
            for w in ti.static((one, other)):
                along = (w[0] * g[0] + w[2] * g[1]) * u + (w[1] * g[1] + w[2] * g[0]) * v
                block -= s * s * along.outer_product(along)
        return block


@ti.func
def tensile(stress):
    """Stress (S_uu, S_vv, S_uv) without its negative eigenvalues."""
    mean, half = 0.5 * (stress[0] + stress[1]), 0.5 * (stress[0] - stress[1])
    radius = ti.sqrt(half * half + stress[2] * stress[2])
    high, low = ti.max(0.0, mean + radius), ti.max(0.0, mean - radius)
    part = ti.select(radius > 0.0, 0.5 * (high - low) / ti.select(radius > 0.0, radius, 1.0), 0.0 * radius)
    middle = 0.5 * (high + low)
    return ti.Vector([middle + part * half, middle - part * half, part * stress[2]])
