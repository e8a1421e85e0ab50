"""Bricks: hexahedra, in 2D quadrilaterals, of a stable neo-Hookean material, with one point and stabilised bending."""

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.forces.neo_hookean import NeoHookean
from taichi_sim.scene.bricks import WARP, laws
from taichi_sim.scene.neo_hookean import constants, lame

__all__ = ["Bricks"]


@ti.data_oriented
class Bricks(NeoHookean):
    """Forces of the energy V (m (I - 3 - log(I + 1)) / 2 + k (J - alpha)^2 / 2 + E(Q) / 2), I and J those of F at the centre, Q_p
    = F^T q_p for the amplitudes q_p of what is not linear: rotations cancel. See scene.bricks for E.

    Viscosity acts on the rates of the strain (F^T F - 1) / 2 and of Q. Amplitudes are sums over the corners with signs, those of
    the sides that an amplitude's number names by its bits; all are sums and differences of pairs. Each brick computes the forces
    on its corners once, into `force`, and products into `given`; balls gather them.
    """

    name = "bricks"
    elastic = True

    def __init__(self, model: Model, fields: Fields) -> None:
        scene, dim = model.scene, model.dim
        self.real = fields.real
        self.count, self.k = scene.bricks.shape
        self.bits = bits = tuple(
            1 << (dim - 1 - s) for s in range(dim)
        )  # of sides, in numbers of corners and amplitudes
        self.bent = tuple(p for p in range(self.k) if p not in (0, *bits))
        # for each side, along which strains are linear: the others, and the amplitudes that strain them
        others = [[d for d in range(dim) if d != s] for s in range(dim)]
        self.bends = tuple((*rest, *(bits[d] | bits[s] for d in rest)) for s, rest in enumerate(others))
        self.viscous = bool(np.any(scene.brick_viscosity > 0))
        own, law = laws(scene)
        modulus, ratio, size = own[:, 0], own[:, 1], own[:, 2:-1]
        mu, lam = lame(dim, modulus, ratio)
        m, k, alpha = constants(mu, lam)
        values = {
            "m": m,
            "k": k,
            "alpha": alpha,
            "mu": mu,
            "young": modulus,
            "ratio": ratio,
            "volume": size.prod(axis=1),
        }
        values |= {"plate": modulus / (1.0 - ratio**2) if dim == 3 else modulus, "delay": own[:, -1] / mu}
        slope = {"slope": ti.types.vector(dim, fields.real)}  # 1/m
        self.law = fields.table(dict.fromkeys(values, fields.real) | slope, len(own), values | {"slope": 2.0 / size})
        columns = {"balls": ti.types.vector(self.k, ti.i32), "law": ti.i32}
        self.brick = fields.table(columns, self.count, {"balls": scene.bricks, "law": law})
        self.given = self.force = fields.vectors(self.count * self.k, dim)
        self.gather(
            model,
            fields,
            np.concatenate([np.delete(scene.bricks, c, axis=1)[:, None] for c in range(self.k)], axis=1).reshape(
                -1, self.k - 1
            ),
            scene.bricks.ravel(),
            {"place": ti.i32},
            {"place": np.arange(self.count * self.k)},
        )

    @ti.func
    def _amplitudes(self, ball: ti.template(), e, member: ti.template(), real: ti.template()):
        """Amplitudes (2^dim, dim) of brick e in a member of its balls, "x" [m], "v" or "w" [m/s] or "p": sums with signs."""
        corners = self.brick[e].balls
        u = ti.Matrix.zero(real, self.k, self.dim)
        for c in ti.static(range(1, self.k)):
            d = ti.Vector.zero(real, self.dim)
            if ti.static(member == "x"):
                d = ti.cast(ball[corners[c]].x - ball[corners[0]].x, real)
            elif ti.static(member == "w"):
                d = ti.cast(ball[corners[c]].w - ball[corners[0]].w, real)
            elif ti.static(member == "v"):
                d = ti.cast(ball[corners[c]].v - ball[corners[0]].v, real)
            else:
                d = ti.cast(ball[corners[c]].p - ball[corners[0]].p, real)
            for j in ti.static(range(self.dim)):
                u[c, j] = d[j] / self.k
        for bit in ti.static(self.bits):
            for c in ti.static(range(self.k)):
                if ti.static(c & bit == 0):
                    for j in ti.static(range(self.dim)):
                        low, high = u[c, j], u[c | bit, j]
                        u[c, j], u[c | bit, j] = low + high, high - low
        return u

    @ti.func
    def _gradient(self, u, slope, real: ti.template()):
        """Derivative (dim, dim) of the places at the centre [1], or of velocities [1/s]."""
        gradient = ti.Matrix.zero(real, self.dim, self.dim)
        for s in ti.static(range(self.dim)):
            for j in ti.static(range(self.dim)):
                gradient[j, s] = slope[s] * u[self.bits[s], j]
        return gradient

    @ti.func
    def _turned_back(self, gradient, u, real: ti.template()):
        """F^T q of the amplitudes that are not linear, (2^dim, dim)."""
        q = ti.Matrix.zero(real, self.k, self.dim)
        for p in ti.static(self.bent):
            for s in ti.static(range(self.dim)):
                for j in ti.static(range(self.dim)):
                    q[p, s] += gradient[j, s] * u[p, j]
        return q

    @ti.func
    def _bending(self, q, law, real: ti.template()):
        """Derivative of E / 2 by Q, (2^dim, dim): of strains that are linear along a side, see scene.bricks.stabilisation."""
        t = ti.Matrix.zero(real, self.k, self.dim)
        slope, shears = law.slope, ti.cast(0.0, real)
        if ti.static(self.dim == 3):
            for d, e, p, r in ti.static(self.bends):
                shears += slope[d] * q[p, e] + slope[e] * q[r, d]
        for bend in ti.static(self.bends):
            if ti.static(self.dim == 2):
                d, p = ti.static(bend)
                t[p, d] += law.plate / 3.0 * slope[d] * slope[d] * q[p, d]
            else:
                d, e, p, r = ti.static(bend)
                along, across = slope[d] * q[p, d], slope[e] * q[r, e]
                shear = law.mu / 3.0 * ((1.0 - WARP) * (slope[d] * q[p, e] + slope[e] * q[r, d]) + WARP * shears)
                t[p, d] += law.plate / 3.0 * slope[d] * (along + law.ratio * across)
                t[r, e] += law.plate / 3.0 * slope[e] * (across + law.ratio * along)
                t[p, e] += slope[d] * shear
                t[r, d] += slope[e] * shear
        if ti.static(self.dim == 3):
            for d in ti.static(range(3)):
                t[7, d] += law.young / 9.0 * slope[d] * slope[d] * q[7, d]
        return t

    @ti.func
    def _give(self, given: ti.template(), e, law, stress, gradient, u, t):
        """Note for the corners of brick e what each gets, of the stress of the centre and the derivative by Q."""
        f = ti.Matrix.zero(given.dtype, self.k, self.dim)
        share = -law.volume / self.k
        for p in ti.static(self.bent):
            for s in ti.static(range(self.dim)):
                for j in ti.static(range(self.dim)):
                    stress[j, s] += u[p, j] * t[p, s]
                    f[p, j] += share * gradient[j, s] * t[p, s]
        for s in ti.static(range(self.dim)):
            for j in ti.static(range(self.dim)):
                f[self.bits[s], j] = share * law.slope[s] * stress[j, s]
        for bit in ti.static(self.bits):
            for c in ti.static(range(self.k)):
                if ti.static(c & bit == 0):
                    for j in ti.static(range(self.dim)):
                        same, signed = f[c, j], f[c | bit, j]
                        f[c, j], f[c | bit, j] = same - signed, same + signed
        for c in ti.static(range(self.k)):
            for j in ti.static(range(self.dim)):
                given[e * self.k + c][j] = f[c, j]

    @ti.func
    def _rates(self, ball: ti.template(), e, law, gradient, u, real: ti.template()):
        """Rate of the strain [1/s], of which the symmetric part counts, and of Q (2^dim, dim) [m/s]."""
        w = self._amplitudes(ball, e, "v", real)
        change = self._gradient(w, law.slope, real)
        strain = gradient.transpose() @ change
        bent = self._turned_back(change, u, real) + self._turned_back(gradient, w, real)
        if ti.static(self.staged):
            half = ti.cast(self.half_step[0], real)
            before = self._amplitudes(ball, e, "w", real)
            past = self._gradient(before, law.slope, real)
            strain += half * (past.transpose() @ past - change.transpose() @ change)
            bent += 2.0 * half * (self._turned_back(past, before, real) - self._turned_back(change, w, real))
        return strain, bent

    @ti.func
    def prepare(self, ball: ti.template()):
        """Forces on the corners of each brick."""
        for e in range(self.count):
            law = self.law[self.brick[e].law]
            u = self._amplitudes(ball, e, "x", ball.x.dtype)
            gradient = self._gradient(u, law.slope, ball.x.dtype)
            stress, q = self.stress_of(gradient, law), self._turned_back(gradient, u, ball.x.dtype)
            if ti.static(self.viscous):
                strain, bent = self._rates(ball, e, law, gradient, u, ball.x.dtype)
                stress += law.delay * law.mu * gradient @ (strain + strain.transpose())
                q += law.delay * bent
            self._give(self.force, e, law, stress, gradient, u, self._bending(q, law, ball.x.dtype))

    # The derivatives, for implicit methods: those of Q without what is negative

    def allocate_derivatives(self, fields: Fields) -> None:
        """Declare the axes of bricks, blocks of their corners, and forces in the precision of places."""
        self.allocate_axes(self.count, fields)
        if fields.widens:
            self.force = fields.vectors(self.count * self.k, self.dim, wide=True)
        self.block = fields.matrices(self.count * self.k, self.dim)  # kg

    @ti.func
    def _changes(self, e, law, gradient, u, change, moved, s):
        """Change of stress and of the derivative by Q, both times s^2, and with those by viscosity times s, where the gradient
        changes by `change` and the amplitudes by `moved`."""
        stress = s * s * self.stress_change(e, change)
        factor = s * s
        if ti.static(self.viscous):
            strain = gradient.transpose() @ change
            stress += s * law.delay * law.mu * gradient @ (strain + strain.transpose()) + s * s * change @ self.drag[e]
            factor += s * law.delay
        q = factor * (self._turned_back(change, u, float) + self._turned_back(gradient, moved, float))
        return stress, self._bending(q, law, float)

    @ti.func
    def prepare_blocks(self, ball: ti.template(), s):
        """Principal axes of each brick, and the blocks of its corners."""
        for e in range(self.count):
            law = self.law[self.brick[e].law]
            u = self._amplitudes(ball, e, "x", float)
            gradient = self._gradient(u, law.slope, float)
            self.find_axes(e, gradient, law)
            if ti.static(self.viscous):
                strain, _ = self._rates(ball, e, law, gradient, u, float)
                self.note_drag(e, law.delay * law.mu, strain)
            for c in range(self.k):
                for j in range(self.dim):
                    self._block_column(e, law, gradient, u, c, j, s)

    @ti.func
    def _block_column(self, e, law, gradient, u, c, j, s):
        """Write column j of the block of corner c of brick e."""
        moved, change = ti.Matrix.zero(float, self.k, self.dim), ti.Matrix.zero(float, self.dim, self.dim)
        for p in ti.static(range(1, self.k)):
            sign = ti.cast(1.0 / self.k, float)
            for bit in ti.static(self.bits):
                if ti.static(p & bit != 0):
                    if c & bit == 0:
                        sign = -sign
            for i in ti.static(range(self.dim)):
                if i == j:
                    moved[p, i] = sign
        change = self._gradient(moved, law.slope, float)
        stress, t = self._changes(e, law, gradient, u, change, moved, s)
        for p in ti.static(self.bent):
            for a in ti.static(range(self.dim)):
                for i in ti.static(range(self.dim)):
                    stress[i, a] += u[p, i] * t[p, a]
        for i in ti.static(range(self.dim)):
            found = ti.cast(0.0, float)
            for l in ti.static(range(self.dim)):
                if l == j:  # what corner c adds to each amplitude
                    for a in ti.static(range(self.dim)):
                        found += law.slope[a] * stress[i, a] * moved[self.bits[a], l]
                        for p in ti.static(self.bent):
                            found += gradient[i, a] * t[p, a] * moved[p, l]
            self.block[e * self.k + c][i, j] = law.volume * found

    @ti.func
    def prepare_product(self, ball: ti.template(), s):
        """Products of each brick."""
        for e in range(self.count):
            law = self.law[self.brick[e].law]
            u, moved = self._amplitudes(ball, e, "x", float), self._amplitudes(ball, e, "p", float)
            gradient, change = self._gradient(u, law.slope, float), self._gradient(moved, law.slope, float)
            stress, t = self._changes(e, law, gradient, u, change, moved, s)
            self._give(self.given, e, law, stress, gradient, u, t)

    @ti.func
    def corner_product(self, ball: ti.template(), i, row, s):
        """Rows of ball i of the product."""
        return -self.given[row.place]

    @ti.func
    def corner_block(self, ball: ti.template(), i, row, s):
        """Block that joins ball i to itself."""
        return self.block[row.place]

    @ti.func
    def corner_force(self, ball: ti.template(), i, row, time):
        """Force of a brick on ball i [N]."""
        return self.force[row.place]

    @ti.func
    def corner_loss(self, ball: ti.template(), i, row, real: ti.template()):
        """Share of ball i of half the power of viscosity [W]."""
        loss = ti.cast(0.0, real)
        if ti.static(self.viscous):
            e = row.place // self.k
            law = self.law[self.brick[e].law]
            u = self._amplitudes(ball, e, "x", real)
            strain, q = self._rates(ball, e, law, self._gradient(u, law.slope, real), u, real)
            t = self._bending(q, law, real)
            loss += 0.5 * law.mu * (strain + strain.transpose()).norm_sqr()
            for p in ti.static(self.bent):
                for a in ti.static(range(self.dim)):
                    loss += q[p, a] * t[p, a]
            loss *= 0.5 * law.volume / self.k * law.delay
        return loss

    @ti.func
    def corner_energy(self, ball: ti.template(), i, row, real: ti.template()):
        """Share of ball i of a brick's energy [J]: equal for all corners; 0 at rest."""
        e = row.place // self.k
        law = self.law[self.brick[e].law]
        u = self._amplitudes(ball, e, "x", real)
        gradient = self._gradient(u, law.slope, real)
        q = self._turned_back(gradient, u, real)
        t = self._bending(q, law, real)
        stored = self.doubled_density(gradient, law)
        for p in ti.static(self.bent):
            for s in ti.static(range(self.dim)):
                stored += q[p, s] * t[p, s]
        return 0.5 * law.volume / self.k * stored
