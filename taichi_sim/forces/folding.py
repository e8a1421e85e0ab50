"""Folding of a sheet below the size of its triangles, by which membranes give way to compression.

A flat triangle cannot show a fold smaller than itself. Folds shorten it by a second strain W, positive semidefinite, and bear a
limit l [N/m] of compression: the energy per area at rest is the least of (E + W) : C : (E + W) / 2 + l tr W over all such W. With
l = 0 it is the relaxed energy of a membrane (Pipkin, IMA Journal of Applied Mathematics 36, 1986). It is convex in the strain E.
Its stress S = C : (E + W) has no principal value below -l. A triangle is in one of three states. Flat: C : E bears the limit, W =
0. Crushed: W = -l C^-1 : 1 - E is positive, and S = -l in all directions. Folded, else: W = a n n^T.

With r^4 = warp / weft the axes of a fabric are drawn by r along the warp and by 1 / r along the weft. Then both are as stiff, m
= (warp weft)^1/2, and W is as positive as it was. Of W_uu = (s + d) / r, W_vv = (s - d) r and W_uv = t a fold changes the
energy by m (A s^2 + B d^2 + D t^2 + b_s s + b_d d + b_t t), A = 1 + coupling / m, B = 1 - coupling / m, D = 2 shear / m, and W
is positive where s >= (d^2 + t^2)^1/2. At the least on the border of that cone a multiplier z >= 0 gives s = -b_s / 2 (A - z),
d = -b_d / 2 (B + z) and t = -b_t / 2 (D + z). Let b be scaled so that b_d^2 + b_t^2 = 1. Then z is the only root of z - A = b_s
R(z), R = ((b_d / (B + z))^2 + (b_t / (D + z))^2)^-1/2. R is concave and has the asymptote z + b_d^2 B + b_t^2 D. From where z -
A meets b_s times that, Newton's method comes to the root from one side.
"""

from taichi_sim.device.engine import ti

__all__ = ["elastic", "folded"]

SOFTEST = 1e-12  # of A, B and D: less is taken for so much, where directions of folds are looked for
ROUNDS = 16  # of Newton's method: four are usual, and twelve are enough for D from 1e-6 to 1e6
NEAR = 1e-7  # part by which a round changes a divisor, after which the next round would change nothing


@ti.func
def elastic(strain, of):
    """Stress (S_uu, S_vv, S_uv) times the area [N m] of a strain (E_uu, E_vv, 2 E_uv) of a flat triangle."""
    return ti.Vector(
        [
            of.warp * strain[0] + of.coupling * strain[1],
            of.weft * strain[1] + of.coupling * strain[0],
            of.shear * strain[2],
        ]
    )


@ti.func
def folded(strain, of):
    """Stress and energy of a triangle of row `of` [N m], and its derivative by strain: the share of C, and two vectors whose
    squares are taken off. A limit below 0 is none; the row's `aspect` is r."""
    fold, share, across, turn = 0.0 * strain, 1.0 + 0.0 * strain[0], 0.0 * strain, 0.0 * strain
    stress = elastic(strain, of)
    if of.limit >= 0.0 and ti.min(stress[0], stress[1]) + of.limit < ti.abs(stress[2]):  # else flat for sure
        r = of.aspect
        root = of.warp / (r * r)
        both, limit = of.coupling / root, of.limit / root
        stiff = ti.max(SOFTEST, ti.Vector([1.0 + both, 1.0 - both, 2.0 * of.shear / root]))
        u, v = r * strain[0], strain[1] / r
        b = stiff * ti.Vector([u + v, u - v, strain[2]]) + limit * ti.Vector([1.0 / r + r, 1.0 / r - r, 0.0])
        size = ti.sqrt(b[1] * b[1] + b[2] * b[2])
        if b[0] < size:
            w = -0.5 * b / stiff
            if w[0] >= ti.sqrt(w[1] * w[1] + w[2] * w[2]):
                share = 0.0 * share
            else:
                z = _multiplier(b, size, stiff)
                c, s = _direction(b, z, stiff)
                p = stiff[0] + stiff[1] * c * c + stiff[2] * s * s
                w = ti.max(0.0, -0.5 * (b[0] + b[1] * c + b[2] * s) / p) * ti.Vector([1.0, c, s])
                across = ti.sqrt(0.5 * root / p) * _undrawn(stiff * ti.Vector([1.0, c, s]), r)
                turn = ti.sqrt(0.5 * root) * _turn(ti.Vector([c, s]), p, z, stiff, r)
            fold = ti.Vector([(w[0] + w[1]) / r, (w[0] - w[1]) * r, 2.0 * w[2]])
            stress = elastic(strain + fold, of)
    energy = 0.5 * (strain + fold).dot(stress) + of.limit * (fold[0] + fold[1])
    return stress, energy, share, across, turn


@ti.func
def _undrawn(y, r):
    """Twice a derivative by E_uu, E_vv and 2 E_uv, of one by (r E_uu + E_vv / r) / 2, (r E_uu - E_vv / r) / 2 and E_uv."""
    return ti.Vector([(y[0] + y[1]) * r, (y[0] - y[1]) / r, y[2]])


@ti.func
def _turn(n, p, z, stiff, r):
    """Vector whose square folds take off C by turning, for a root m of 2; n: twice their angle, by cosine and sine."""
    c, s = n[0], n[1]
    one = ti.Vector([c * s * (stiff[1] - stiff[2]), -s * (stiff[0] + stiff[2]), c * (stiff[0] + stiff[1])])
    h = stiff[0] * (stiff[1] * s * s + stiff[2] * c * c) + stiff[1] * stiff[2]
    return _undrawn(stiff * one, r) / (p * ti.sqrt(z + h / p))


@ti.func
def _multiplier(b, size, stiff):
    """Root z of z - A = b_s R(z)."""
    ratio, gap = b[0] / size, (size - b[0]) / size
    d, t = (b[1] / size) ** 2, (b[2] / size) ** 2
    z = ti.max(0.0, (stiff[0] + ratio * (d * stiff[1] + t * stiff[2])) / gap)
    least = ti.min(stiff[1], stiff[2])
    for _ in range(ROUNDS):
        p, q = 1.0 / (stiff[1] + z), 1.0 / (stiff[2] + z)
        one, other = d * p * p, t * q * q
        square = 1.0 / (one + other)
        reach = ti.sqrt(square)
        slope = (one * p + other * q) * square * reach
        change = (z - stiff[0] - ratio * reach) / ti.max(1.0 - ratio * slope, 1e-3 * gap)
        z = ti.max(0.0, z - change)
        if change * ratio <= 0.0 or ti.abs(change) <= NEAR * (least + z):  # beyond the root by rounding, or there
            break
    return z


@ti.func
def _direction(b, z, stiff):
    """Direction of folds in the drawn axes, by cosine and sine of twice its angle."""
    d, t = -b[1] / (stiff[1] + z), -b[2] / (stiff[2] + z)
    one = 1.0 / ti.sqrt(d * d + t * t)
    return d * one, t * one
