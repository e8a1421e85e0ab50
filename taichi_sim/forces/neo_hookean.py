"""NeoHookean: the stable neo-Hookean material of bricks and solids, and its derivatives without what is negative."""

from typing import Any

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.forces.corners import Corners

__all__ = ["NeoHookean"]

SWEEPS = 5  # of Jacobi's method over the entries of a matrix: to rounding in double precision


@ti.data_oriented
class NeoHookean(Corners):
    """Base of forces of elements with the energy density (m (I - 3 - log(I + 1)) + k (J - alpha)^2) / 2, I and J those of a
    deformation gradient F (Smith, de Goes, Kim 2018). `law`: a row with its m, k and alpha; `real`: the type of numbers."""

    real: Any
    viscous: bool

    @ti.func
    def doubled_density(self, gradient, law):
        """Twice the energy per volume at rest [Pa, in 2D N/m]; 0 at rest."""
        shape, change = gradient.norm_sqr() + (3 - self.dim), gradient.determinant()
        # (J - alpha)^2 - (1 - alpha)^2, which rounding would not leave 0 at rest
        pressed = (change - 1.0) * (change + 1.0 - 2.0 * law.alpha)
        return law.m * (shape - 3.0 - ti.log((shape + 1.0) / 4.0)) + law.k * pressed

    @ti.func
    def stress_of(self, gradient, law):
        """First Piola-Kirchhoff stress (dim, dim) [Pa, in 2D N/m] at a deformation gradient."""
        shape = gradient.norm_sqr() + (3 - self.dim)
        pressure = law.k * (gradient.determinant() - law.alpha)
        stress = law.m * (1.0 - 1.0 / (shape + 1.0)) * gradient
        for s in ti.static(range(self.dim)):
            for j in ti.static(range(self.dim)):
                if ti.static(self.dim == 2):
                    stress[j, s] += (1 - 2 * ((j + s) % 2)) * pressure * gradient[1 - j, 1 - s]
                else:
                    a, b, c, d = ti.static((j + 1) % 3, (j + 2) % 3, (s + 1) % 3, (s + 2) % 3)
                    stress[j, s] += pressure * (gradient[a, c] * gradient[b, d] - gradient[a, d] * gradient[b, c])
        return stress

    # For implicit methods the derivative of the stress in the principal axes, U H(U^T dF V) V^T

    def allocate_axes(self, count: int, fields: Fields) -> None:
        """Declare the principal axes of so many deformation gradients, and how the stress changes along and across them."""
        self.left, self.right, self.along = (fields.matrices(count, self.dim) for _ in range(3))
        # of the pair (i, j): of its sum where i < j, of its difference where i > j
        self.across = fields.matrices(count, self.dim)
        if self.viscous:
            self.drag = fields.matrices(count, self.dim)

    @ti.func
    def note_drag(self, e, viscosity, rate):
        """Write `drag` of row e, the stress of viscosity in the frame of the body, without what is negative: it turns with F.
        rate: of strain [1/s], of which the symmetric part counts."""
        self.drag[e] = self._without_negative(viscosity * (rate + rate.transpose()))

    @ti.func
    def find_axes(self, e, gradient, law):
        """Write the principal axes of row e and the stiffness in them (Smith, de Goes, Kim 2019)."""
        u, sigma, v = ti.svd(gradient, self.real)
        shape = gradient.norm_sqr() + (3 - self.dim)
        stretch, product = ti.Vector.zero(float, self.dim), ti.cast(1.0, float)
        for i in ti.static(range(self.dim)):
            stretch[i] = sigma[i, i]
        last = ti.static(self.dim - 1)
        if u.determinant() * v.determinant() < 0.0:
            stretch[last] = -stretch[last]
            for j in ti.static(range(self.dim)):
                u[j, last] = -u[j, last]
        for i in ti.static(range(self.dim)):
            product *= stretch[i]
        base, pressure = law.m * (1.0 - 1.0 / (shape + 1.0)), law.k * (product - law.alpha)
        along, across = ti.Matrix.zero(float, self.dim, self.dim), ti.Matrix.zero(float, self.dim, self.dim)
        for i in ti.static(range(self.dim)):
            for j in ti.static(range(self.dim)):
                third = ti.cast(1.0, float)
                if ti.static(self.dim == 3 and i != j):
                    third = stretch[ti.static(3 - i - j)]
                rises, falls = ti.cast(1.0, float), ti.cast(1.0, float)  # of J with each of both
                for l in ti.static(range(self.dim)):
                    if ti.static(l != i):
                        rises *= stretch[l]
                    if ti.static(l != j):
                        falls *= stretch[l]
                along[i, j] = law.k * rises * falls + law.m * 2.0 / (shape + 1.0) ** 2 * stretch[i] * stretch[j]
                if ti.static(i == j):
                    along[i, j] += base
                else:
                    along[i, j] += pressure * third
                if ti.static(i < j):
                    across[i, j] = max(0.0, base - pressure * third)
                if ti.static(i > j):
                    across[i, j] = max(0.0, base + pressure * third)
        self.left[e], self.right[e], self.along[e], self.across[e] = u, v, self._without_negative(along), across

    @ti.func
    def _without_negative(self, matrix):
        """Symmetric matrix (dim, dim) without its negative eigenvalues, by Jacobi's rotations: equal ones do no harm."""
        d, axes = matrix, ti.Matrix.identity(float, self.dim)
        for _ in range(SWEEPS):
            for i in ti.static(range(self.dim)):
                for j in ti.static(range(i + 1, self.dim)):
                    if abs(d[i, j]) > 0.0:
                        half = 0.5 * (d[j, j] - d[i, i]) / d[i, j]
                        tangent = ti.select(half < 0.0, -1.0, 1.0) / (abs(half) + ti.sqrt(half * half + 1.0))
                        c = 1.0 / ti.sqrt(tangent * tangent + 1.0)
                        sine = tangent * c
                        for k in ti.static(range(self.dim)):
                            one, other = d[k, i], d[k, j]
                            d[k, i], d[k, j] = c * one - sine * other, sine * one + c * other
                            one, other = axes[k, i], axes[k, j]
                            axes[k, i], axes[k, j] = c * one - sine * other, sine * one + c * other
                        for k in ti.static(range(self.dim)):
                            one, other = d[i, k], d[j, k]
                            d[i, k], d[j, k] = c * one - sine * other, sine * one + c * other
        for i in ti.static(range(self.dim)):
            for j in ti.static(range(self.dim)):
                if ti.static(i == j):
                    d[i, j] = max(0.0, d[i, j])
                else:
                    d[i, j] = 0.0
        return axes @ d @ axes.transpose()

    @ti.func
    def stress_change(self, e, change):
        """Change of the stress by one of the deformation gradient (dim, dim)."""
        u, v, along, across = self.left[e], self.right[e], self.along[e], self.across[e]
        d = u.transpose() @ change @ v
        r = ti.Matrix.zero(float, self.dim, self.dim)
        for i in ti.static(range(self.dim)):
            for j in ti.static(range(self.dim)):
                r[i, i] += along[i, j] * d[j, j]
                if ti.static(i < j):
                    same, turned = 0.5 * across[i, j] * (d[i, j] + d[j, i]), 0.5 * across[j, i] * (d[i, j] - d[j, i])
                    r[i, j], r[j, i] = same + turned, same - turned
        return u @ r @ v.transpose()

    @ti.func
    def change_block(self, e, b):
        """Matrix (dim, dim) that takes a vector u to H(u b^T) b, H as in `stress_change`."""
        u, along, across = self.left[e], self.along[e], self.across[e]
        beta = self.right[e].transpose() @ b
        block = ti.Matrix.zero(float, self.dim, self.dim)
        for i in ti.static(range(self.dim)):
            for j in ti.static(range(self.dim)):
                block[i, j] += along[i, j] * beta[i] * beta[j]
                if ti.static(i != j):
                    same, turned = ti.static((i, j) if i < j else (j, i)), ti.static((j, i) if i < j else (i, j))
                    plus, minus = across[same], across[turned]
                    block[i, i] += 0.5 * (plus + minus) * beta[j] * beta[j]
                    block[i, j] += 0.5 * (plus - minus) * beta[i] * beta[j]
        return u @ block @ u.transpose()
