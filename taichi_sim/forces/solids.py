"""Solids: tetrahedra, in 2D triangles, of a stable neo-Hookean material, with deformation gradients averaged at the balls."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.forces.neo_hookean import NeoHookean
from taichi_sim.kernels.loops import list_entry
from taichi_sim.scene.neo_hookean import constants
from taichi_sim.scene.solids import averages, shape_gradients

__all__ = ["Pairs", "Solids"]

NOTHING = 1e-30  # m^dim, the volume of no elements, by which their sums of 0 are divided


@ti.data_oriented
class Solids(NeoHookean):
    """Forces of the energy sum_i V_i W(F_i) + sum_i own_i / 2 sum_e w_e |F_e - F_i|^2: w_e = V_e / (dim + 1) the share of element
    e in a ball i, V_i and F_i their sum and the mean of the F_e (Dohrmann et al. 2000). The second term keeps elements from
    what the averages do not see (Puso, Solberg 2006; Gee et al. 2009).

    F_i and forces are sums over pairs of balls that share an element: F_i = sum_j x_j c_ij^T / V_i, c_ij = sum_e w_e g_ej, with
    the gradients g of the elements' linear functions; the second term is sum_i own_i (sum_e w_e |F_e|^2 - V_i |F_i|^2) / 2,
    whose first part is that of springs without length. A row is such a pair, ball i with ball a, also with itself: `slope` c_ia,
    `back` c_ai, `link` sum_e V_e own_e g_ei . g_ea.

    Fields: `law`, of each ball with elements, its number a row's `node`; `gradient` F and `stress` of each. Where springs can
    tear, sums are over the elements that are whole: `part`, those of a pair from first[place] to first[place + 1], and `sides`,
    the pairs of an element.
    """

    name = "solids"
    elastic = may_slice = True

    def __init__(self, model: Model, fields: Fields) -> None:
        scene, dim, real = model.scene, model.dim, fields.real
        self.real = real
        gradient, volume = shape_gradients(scene.solid_rest)
        at = averages(scene.solids, volume, scene.solid_modulus, scene.solid_ratio, scene.solid_viscosity)
        self.count, self.viscous = len(at.balls), bool(np.any(at.viscosity > 0))
        pairs = Pairs(at.places, gradient, volume, at.own)
        m, k, alpha = constants(at.mu, at.lam)
        values = {"m": m, "k": k, "alpha": alpha, "viscosity": at.viscosity, "own": at.own, "volume": pairs.volume}
        types = {"ball": ti.i32, "place": ti.i32, **dict.fromkeys(values, real)}
        alone = np.flatnonzero(pairs.own == pairs.other)
        self.law = fields.table(types, self.count, {"ball": at.balls, "place": alone, **values})
        self.gradient, self.change = fields.matrices(self.count, dim), fields.matrices(self.count, dim)
        self.stress = self.change
        vector = ti.types.vector(dim, real)
        columns = {"node": ti.i32, "slope": vector, "back": vector, "link": real}
        data = {"node": pairs.other, "slope": pairs.slope, "back": pairs.back, "link": pairs.link}
        if np.isfinite(scene.break_strain).any():
            columns["place"], data["place"] = ti.i32, np.arange(len(pairs.own))
        own, other = at.balls[pairs.own], at.balls[pairs.other]
        self.gather(model, fields, other[:, None], own, columns, data)
        self.ties = np.stack([own, _lowest_free(scene.pinned, own, other)[pairs.other]], axis=1)
        free = self.ties[:, 1] >= 0
        self.ties[~free, 1] = own[~free]
        if self.tears:
            kinds = {"element": ti.i32, "slope": vector, "back": vector, "link": real, "volume": real}
            first, parts = pairs.parts()
            self.part = fields.table(kinds, first[-1], parts)
            self.first, self.sides = fields.integers(first), fields.integers(pairs.sides.ravel())
            self.side_count = pairs.sides.shape[1]

    @ti.func
    def _acts(self, element):
        """True if an element is whole."""
        whole = True
        for k in range(self.side_count):
            if self.gone[self.sides[element * self.side_count + k]] != 0:
                whole = False
        return whole

    @ti.func
    def _pair(self, row):
        """Vectors and link of a row, of the elements that are whole."""
        slope, back, link = row.slope, row.back, row.link
        if ti.static(self.tears):
            slope, back, link = 0.0 * slope, 0.0 * back, 0.0 * link
            for k in range(self.first[row.place], self.first[row.place + 1]):
                part = self.part[k]
                if self._acts(part.element):
                    slope += part.slope
                    back += part.back
                    link += part.link
        return slope, back, link

    @ti.func
    def _volume(self, law):
        """Share of a ball in the elements that are whole [m^dim]."""
        volume = law.volume
        if ti.static(self.tears):
            volume = ti.cast(NOTHING, float)
            for k in range(self.first[law.place], self.first[law.place + 1]):
                if self._acts(self.part[k].element):
                    volume += self.part[k].volume
        return volume

    @ti.func
    def _averaged(self, ball: ti.template(), i, member: ti.template(), real: ti.template()):
        """Mean (dim, dim) at ball i of the derivatives of a member of balls, "x" [m], "v" or "w" [m/s] or "p", in the elements;
        without the division by its volume."""
        total = ti.Matrix.zero(real, self.dim, self.dim)
        for t in range(self.start[i + 1] - self.start[i]):
            row = self.row[list_entry(self, i, t)]
            slope, _, _ = self._pair(row)
            d = ti.Vector.zero(real, self.dim)
            if ti.static(member == "x"):
                d = ti.cast(ball[row.a].x - ball[i].x, real)
            elif ti.static(member == "w"):
                d = ti.cast(ball[row.a].w - ball[i].w, real)
            elif ti.static(member == "v"):
                d = ti.cast(ball[row.a].v - ball[i].v, real)
            else:
                d = ti.cast(ball[row.a].p - ball[i].p, real)
            for j in ti.static(range(self.dim)):
                for s in ti.static(range(self.dim)):
                    total[j, s] += d[j] * ti.cast(slope[s], real)
        return total

    @ti.func
    def _rate(self, ball: ti.template(), law, gradient, real: ti.template()):
        """Rate of the strain at the ball of a law [1/s], of which the symmetric part counts."""
        change = self._averaged(ball, law.ball, "v", real) / self._volume(law)
        rate = gradient.transpose() @ change
        if ti.static(self.staged):
            past = self._averaged(ball, law.ball, "w", real) / self._volume(law)
            rate += ti.cast(self.half_step[0], real) * (past.transpose() @ past - change.transpose() @ change)
        return rate

    @ti.func
    def prepare(self, ball: ti.template()):
        """Stresses at each ball."""
        for node in range(self.count):
            law = self.law[node]
            gradient = self._averaged(ball, law.ball, "x", ball.x.dtype) / self._volume(law)
            stress = self.stress_of(gradient, law) - law.own * gradient
            if ti.static(self.viscous):
                rate = self._rate(ball, law, gradient, float)
                stress += law.viscosity * gradient @ (rate + rate.transpose())
            self.gradient[node], self.stress[node] = ti.cast(gradient, float), ti.cast(stress, self.stress.dtype)

    @ti.func
    def corner_force(self, ball: ti.template(), i, row, time):
        """Force of the stress at ball a, and of the elements' own, on ball i [N]."""
        _, back, link = self._pair(row)
        return -self.stress[row.node] @ back - link * (ball[row.a].x - ball[i].x)

    @ti.func
    def corner_energy(self, ball: ti.template(), i, row, real: ti.template()):
        """Energy [J] at ball i, in its row with itself."""
        stored = ti.cast(0.0, real)
        if row.a == i:
            law = self.law[row.node]
            gradient = self._averaged(ball, i, "x", real) / self._volume(law)
            stored = self._volume(law) * (self.doubled_density(gradient, law) - law.own * gradient.norm_sqr())
            for t in range(self.start[i + 1] - self.start[i]):
                other = self.row[list_entry(self, i, t)]
                square = ti.cast(0.0, real)
                _, _, link = self._pair(other)
                for j in ti.static(range(self.dim)):
                    square += ti.cast(ball[other.a].x[j] - ball[i].x[j], real) ** 2
                stored -= 0.5 * link * square
        return 0.5 * stored

    @ti.func
    def corner_loss(self, ball: ti.template(), i, row, real: ti.template()):
        """Half of the power of viscosity [W] at ball i, in its row with itself."""
        loss = ti.cast(0.0, real)
        if ti.static(self.viscous):
            if row.a == i:
                law = self.law[row.node]
                rate = self._rate(ball, law, self._averaged(ball, i, "x", real) / self._volume(law), real)
                loss = 0.25 * self._volume(law) * law.viscosity * (rate + rate.transpose()).norm_sqr()
        return loss

    # The derivatives, for implicit methods

    def allocate_derivatives(self, fields: Fields) -> None:
        """Declare the axes of the balls with elements, and their stresses in the precision of places."""
        self.allocate_axes(self.count, fields)
        if fields.widens:
            self.stress = fields.matrices(self.count, self.dim, wide=True)

    @ti.func
    def prepare_blocks(self, ball: ti.template(), s):
        """Principal axes at each ball."""
        for node in range(self.count):
            law = self.law[node]
            self.find_axes(node, self.gradient[node], law)
            if ti.static(self.viscous):
                self.note_drag(node, law.viscosity, self._rate(ball, law, self.gradient[node], float))

    @ti.func
    def prepare_product(self, ball: ti.template(), s):
        """Changes of the stresses."""
        for node in range(self.count):
            law = self.law[node]
            change = self._averaged(ball, law.ball, "p", float) / self._volume(law)
            stress = s * s * (self.stress_change(node, change) - law.own * change)
            if ti.static(self.viscous):
                gradient = self.gradient[node]
                rate = gradient.transpose() @ change
                stress += s * law.viscosity * gradient @ (rate + rate.transpose()) + s * s * change @ self.drag[node]
            self.change[node] = stress

    @ti.func
    def corner_product(self, ball: ti.template(), i, row, s):
        """Row of ball i of the product."""
        _, back, link = self._pair(row)
        return self.change[row.node] @ back + s * s * link * (ball[row.a].p - ball[i].p)

    @ti.func
    def corner_block(self, ball: ti.template(), i, row, s):
        """Block that joins ball i to itself by the stress at ball a."""
        law = self.law[row.node]
        _, b, link = self._pair(row)
        block = s * s * (self.change_block(row.node, b) - law.own * b.norm_sqr() * ti.Matrix.identity(float, self.dim))
        if ti.static(self.viscous):
            gradient = self.gradient[row.node]
            along = gradient @ b
            wide = b.norm_sqr() * gradient @ gradient.transpose()
            block += s * law.viscosity * (wide + along.outer_product(along))
            block += s * s * b.dot(self.drag[row.node] @ b) * ti.Matrix.identity(float, self.dim)
        block /= self._volume(law)
        if row.a == i:
            block += s * s * link * ti.Matrix.identity(float, self.dim)
        return block


class Pairs:
    """Pairs (p,) of balls, by their numbers, that share an element, each with itself and in both orders, by the first.

    Attributes: `own`, `other` (p,); `slope`, `back` (p, dim) [m^(dim - 1)] and `link` (p,) [N/m], see Solids; `volume` of each
    ball; `sides` (e, sides), the pairs of an element."""

    def __init__(self, places: NDArray, gradient: NDArray, volume: NDArray, own: NDArray) -> None:
        e, k = places.shape
        count = len(own)
        first, second = np.repeat(places, k, axis=1).ravel().astype(np.int64), np.tile(places, k).ravel()
        code, pair = np.unique(first * count + second, return_inverse=True)
        self.own, self.other = np.divmod(code, count)
        self.pair, self.corners, self.share = pair.ravel(), k, volume / k
        self.area = self.share[:, None, None] * gradient
        strength = volume * own[places].mean(axis=1)
        self.links = (strength[:, None, None] * np.einsum("eia,eja->eij", gradient, gradient)).ravel()
        self.slope = np.stack([self._sum(np.tile(one, k).ravel()) for one in np.moveaxis(self.area, 2, 0)], axis=1)
        self.back = self.slope[np.searchsorted(code, self.other * count + self.own)]
        self.link = self._sum(self.links)
        self.volume = np.bincount(places.ravel(), np.repeat(self.share, k), count)
        upper = np.ravel_multi_index(np.triu_indices(k, 1), (k, k))
        self.sides = self.pair.reshape(e, k * k)[:, upper]

    def _sum(self, values: NDArray) -> NDArray[np.float64]:
        """Sums (p,) over the corners' pairs in elements (e k k,)."""
        return np.asarray(np.bincount(self.pair, values, len(self.own)), dtype=np.float64)

    def parts(self) -> tuple[NDArray, dict[str, NDArray]]:
        """List what each element adds, those of pair k from first[k] to first[k + 1]: first, and columns."""
        order = np.argsort(self.pair, kind="stable")
        element, corner = np.divmod(order, self.corners**2)
        own, other = np.divmod(corner, self.corners)
        columns = {"slope": self.area[element, other], "back": self.area[element, own], "link": self.links[order]}
        columns |= {"element": element, "volume": self.share[element]}
        return np.append(0, np.cumsum(np.bincount(self.pair))), columns


def _lowest_free(pinned: Any, own: NDArray, other: NDArray) -> NDArray[np.int64]:
    """Lowest ball that is not pinned of all that share an element with a ball, by its number; -1 where there is none."""
    names, number = np.unique(other, return_inverse=True)
    lowest = np.full(len(names), len(pinned))
    free = ~pinned[own]
    np.minimum.at(lowest, number.ravel()[free], own[free])
    return np.where(lowest < len(pinned), lowest, -1)
