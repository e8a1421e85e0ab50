"""Bending: elements of four balls whose weighted sum of places is the curvature, linear, with a damping of its size."""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.forces.corners import Corners
from taichi_sim.kernels.loops import list_entry

__all__ = ["Bending"]


@ti.data_oriented
class Bending(Corners):
    """Forces -w_i (k b + c n n . db/dt), b = sum_j w_j x_j, n = b / |b|; weights sum to 0, so that places count from ball i.

    Damped is the size of b, not its direction, which rotates with the body: a sheet that is folded rotates freely. The torque of
    an element is b x n, which is 0. Where b is 0 nothing rotates, and all of db/dt is damped.

    Undamped elements that stay whole have their forces from `couplings`: most balls have fewer neighbours than elements."""

    name = "bending"
    elastic = may_slice = True
    derivatives = 2

    def __init__(self, model: Model, fields: Fields) -> None:
        scene = model.scene
        bends, weights = scene.bends, scene.bend_weights
        stiffness, damping = scene.held_bending()
        self.damped = bool(np.any(damping > 0))
        rod = bends[:, 0] == bends[:, 1]  # of three balls, the first of which counts twice
        weights = np.where(rod[:, None], np.stack([weights[:, 0] + weights[:, 1], 0 * rod, *weights.T[2:]], 1), weights)
        rest = [[j for j in range(4) if j != k] for k in range(4)]
        kept = np.concatenate([~rod if k == 1 else np.ones(len(rod), dtype=bool) for k in range(4)])
        others = np.concatenate([bends[:, r] for r in rest])
        real = fields.real
        columns = dict.fromkeys(("stiffness", "own", "wa", "wb", "wc"), real)
        data = {"stiffness": np.tile(stiffness, 4), "own": weights.T.ravel()}
        data |= {name: np.concatenate([weights[:, r[k]] for r in rest]) for k, name in enumerate(("wa", "wb", "wc"))}
        if self.damped:
            columns["damping"] = real
            data["damping"] = np.tile(damping, 4)
        data = {name: values[kept] for name, values in data.items()}
        self.gather(model, fields, others[kept], bends.T.ravel()[kept], columns, data)
        self.coupled = not self.damped and not self.tears
        self.reads_p = not self.coupled
        if self.coupled:
            self.couplings = _Couplings(bends, scene.bend_weights, stiffness, model, fields)

    @ti.func
    def force_on(self, ball: ti.template(), i, time):
        """Force on ball i [N], in the precision of places."""
        f = ti.Vector.zero(ball.x.dtype, self.dim)
        if ti.static(self.coupled):
            f += self.couplings.force_on(ball, i, time)
        else:
            f += Corners.force_on(self, ball, i, time)
        return f

    @ti.func
    def add_products(self, p: ti.template(), ball: ti.template(), total: ti.template(), s):
        """total (n) += (s^2 K + s D) p."""
        if ti.static(self.coupled):
            self.couplings.add_products(p, ball, total, s)
        else:
            Corners.add_products(self, p, ball, total, s)

    @ti.func
    def block_at(self, ball: ti.template(), i, s):
        """Block of ball i of s^2 K + s D [kg]."""
        block = ti.Matrix.zero(float, self.dim, self.dim)
        if ti.static(self.coupled):
            block += self.couplings.block_at(ball, i, s)
        else:
            block += Corners.block_at(self, ball, i, s)
        return block

    @ti.func
    def _curve(self, ball: ti.template(), i, row):
        """Weighted sum of places [m]."""
        x = ball[i].x
        return row.wa * (ball[row.a].x - x) + row.wb * (ball[row.b].x - x) + row.wc * (ball[row.c].x - x)

    @ti.func
    def _change(self, ball: ti.template(), i, row):
        """Rate of change of that [m/s]."""
        v = ball[i].v
        return row.wa * (ball[row.a].v - v) + row.wb * (ball[row.b].v - v) + row.wc * (ball[row.c].v - v)

    @ti.func
    def corner_force(self, ball: ti.template(), i, row, time):
        """Force on ball i [N] by the curvature, and by the rate of its size."""
        bent = self._curve(ball, i, row)
        pull = row.stiffness * bent
        if ti.static(self.damped):
            change = self._change(ball, i, row)
            square = bent.dot(bent)
            if square > 0.0:
                change = ti.cast(bent.dot(change) / square * bent, float)
            pull += row.damping * change
        return -row.own * pull

    @ti.func
    def corner_energy(self, ball: ti.template(), i, row, real: ti.template()):
        """Share of ball i of the element's energy [J], in proportion to the sizes of its weights."""
        bent = self._curve(ball, i, row)
        return 0.5 * ti.cast(self._share(row) * row.stiffness, real) * ti.cast(bent.dot(bent), real)

    @ti.func
    def _share(self, row):
        """Part of the element that its corner counts."""
        return abs(row.own) / max(1e-30, abs(row.own) + abs(row.wa) + abs(row.wb) + abs(row.wc))

    @ti.func
    def corner_loss(self, ball: ti.template(), i, row, real: ti.template()):
        """Share of ball i of half the power of damping [W]."""
        loss = ti.cast(0.0, real)
        if ti.static(self.damped):
            p = ball[i].p
            moved = row.wa * (ball[row.a].p - p) + row.wb * (ball[row.b].p - p) + row.wc * (ball[row.c].p - p)
            bent, change = ti.cast(self._curve(ball, i, row), float) - moved, self._change(ball, i, row)
            square = bent.dot(bent)
            rate = change.dot(change)
            if square > 0.0:
                rate = ti.cast(bent.dot(change) ** 2 / square, float)
            loss = 0.5 * ti.cast(self._share(row) * row.damping * rate, real)
        return loss

    @ti.func
    def corner_product(self, ball: ti.template(), i, row, s):
        """The exact derivative by places; of damping that by velocities, n kept, and what turns of n do with its force."""
        p = ball[i].p
        turned = row.wa * (ball[row.a].p - p) + row.wb * (ball[row.b].p - p) + row.wc * (ball[row.c].p - p)
        product = s * (s * row.stiffness) * turned
        if ti.static(self.damped):
            n, along, across = self._resistance(ball, i, row, s)
            product = across * turned + (along - across) * n.dot(turned) * n
        return row.own * product

    @ti.func
    def _resistance(self, ball: ti.template(), i, row, s):
        """Direction n of the curvature b, and s^2 K + s D along it and across it [kg]. Across n it is s^2 (k |b| + c n . db/dt)
        / |b| without what is negative. Above s^2 k + s c n has turned round: the element bends through where it is flat."""
        n, across = ti.cast(self._curve(ball, i, row), float), s * (s * row.stiffness)
        along, square = across + s * row.damping, n.norm_sqr()
        if square > 0.0:
            across += s * (s * row.damping) * n.dot(self._change(ball, i, row)) / square
            n /= ti.sqrt(square)
            across = ti.min(ti.max(0.0 * across, across), along)
        else:
            across = along
        return n, along, across

    @ti.func
    def corner_block(self, ball: ti.template(), i, row, s):
        """The block of the same."""
        one = ti.Matrix.identity(float, self.dim)
        block = s * (s * row.stiffness) * one
        if ti.static(self.damped):
            n, along, across = self._resistance(ball, i, row, s)
            block = across * one + (along - across) * n.outer_product(n)
        return row.own * row.own * block


@ti.data_oriented
class _Couplings(Corners):
    """Bending elements summed over each pair of their balls, as their force is linear: that on ball i is
    sum_j stiffness_ij (x_j - x_i), stiffness_ij = -sum over elements of k w_i w_j, of either sign [N/m].

    bends, weights (b, 4), stiffness (b,) [N/m]: the elements."""

    may_slice = True
    derivatives = 2

    def __init__(self, bends: NDArray, weights: NDArray, stiffness: NDArray, model: Model, fields: Fields) -> None:
        one, other = np.repeat(bends, 4, axis=1).ravel(), np.tile(bends, 4).ravel()
        terms = -(stiffness[:, None, None] * weights[:, :, None] * weights[:, None, :]).ravel()
        pairs, number = np.unique(one.astype(np.int64) * model.n + other, return_inverse=True)
        sums = np.bincount(number.ravel(), terms)
        ball, a = np.divmod(pairs, model.n)
        apart = ball != a
        self.gather(model, fields, a[apart, None], ball[apart], {"stiffness": fields.real}, {"stiffness": sums[apart]})

    @ti.func
    def corner_force(self, ball: ti.template(), i, row, time):
        """Force on ball i by one of its neighbours [N]."""
        return row.stiffness * (ball[row.a].x - ball[i].x)

    @ti.func
    def add_products(self, p: ti.template(), ball: ti.template(), total: ti.template(), s):
        """total (n) += s^2 K p, of padded vectors."""
        for i in range(self.n):
            mine, change = p[i], 0.0 * p[i]
            for t in range(self.start[i + 1] - self.start[i]):
                row = self.row[list_entry(self, i, t)]
                change += row.stiffness * (mine - p[row.a])
            total[i] = total[i] + s * s * change

    @ti.func
    def corner_block(self, ball: ti.template(), i, row, s):
        """Part of a neighbour in the block of ball i."""
        return s * (s * row.stiffness) * ti.Matrix.identity(float, self.dim)
