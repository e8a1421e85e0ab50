"""Folding of a sheet below the size of its triangles, by which membranes give way to compression.

A flat triangle cannot show a fold smaller than itself. Folds shorten it by a second strain W, positive semidefinite, and bear a
limit l [N/m] of compression: the energy per area at rest is the least of (E + W) : C : (E + W) / 2 + l tr W over all such W. With
l = 0 it is the relaxed energy of a membrane (Pipkin, IMA Journal of Applied Mathematics 36, 1986). It is convex in the strain E.
Its stress S = C : (E + W) has no principal value below -l. A triangle is in one of three states. Flat: C : E bears the limit, W =
0. Crushed: W = -l C^-1 : 1 - E is positive, and S = -l in all directions. Folded, else: W = a n n^T, where the direction n takes
the most energy off, (l + n . C : E n)^2 / (2 n n : C : n n).
"""

from taichi_sim.device.engine import ti

__all__ = ["elastic", "folded"]

# twice the angles of eight directions, by cosine and sine
DIRECTIONS = [(1.0, 0.0), (0.5**0.5, 0.5**0.5), (0.0, 1.0), (-(0.5**0.5), 0.5**0.5)]
DIRECTIONS += [(-c, -s) for c, s in DIRECTIONS]
ROUNDS = 6  # of Newton's method, from 11 degrees off to what double precision tells
TURN = 0.25  # tangent of half of the most that twice the angle changes in one of them
NEAR = 1e-7  # the same, after which the next round would change nothing


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
    squares are taken off."""
    stress = elastic(strain, of)
    energy, share, across, turn = 0.5 * strain.dot(stress), 1.0 + 0.0 * strain[0], 0.0 * strain, 0.0 * strain
    half = 0.5 * (stress[0] - stress[1])
    radius = ti.sqrt(half * half + stress[2] * stress[2])
    if 0.5 * (stress[0] + stress[1]) - radius < -of.limit:
        det = of.warp * of.weft - of.coupling * of.coupling
        u, v = of.limit * (of.weft - of.coupling), of.limit * (of.warp - of.coupling)  # -det C^-1 : -1
        wu, wv, wuv = -(u + det * strain[0]), -(v + det * strain[1]), -0.5 * det * strain[2]
        if wu > 0.0 and wv > 0.0 and wu * wv > wuv * wuv:
            energy = -of.limit * (strain[0] + strain[1] + 0.5 * (u + v) / det)
            stress, share = ti.Vector([-of.limit, -of.limit, 0.0 * half]), 0.0 * half
        else:
            c, s = _direction(stress, half, radius, of)
            along, beside = _square(c, s), _square_turned(c, s)
            stiff, turned = elastic(along, of), elastic(beside, of)
            p, q = along.dot(stiff), of.limit + along.dot(stress)
            size = -q / p
            energy -= 0.5 * q * q / p
            stress += size * stiff
            across = stiff / ti.sqrt(p)
            kappa = beside.dot(stiff) / p
            turn = turned - kappa * stiff
            bend = ti.max(0.0, _square_bent(c, s).dot(stress))
            turn /= ti.sqrt(ti.max(beside.dot(turned) - kappa * kappa * p, 1e-12 * p) + bend / size)
    return stress, energy, share, across, turn


@ti.func
def _square(c, s):
    """Strain n n^T of a direction by cosine and sine of twice its angle."""
    return ti.Vector([0.5 * (1.0 + c), 0.5 * (1.0 - c), s])


@ti.func
def _square_turned(c, s):
    """Derivative of `_square` by twice the angle."""
    return ti.Vector([-0.5 * s, 0.5 * s, c])


@ti.func
def _square_bent(c, s):
    """Second derivative of `_square` by twice the angle."""
    return ti.Vector([-0.5 * c, 0.5 * c, -s])


@ti.func
def _direction(stress, half, radius, of):
    """Direction that folds take the most energy off along, by cosine and sine of twice its angle."""
    c, s = -half / radius, -stress[2] / radius  # of the least principal stress
    best = _gain(c, s, stress, of)
    for k in ti.static(range(len(DIRECTIONS))):
        gain = _gain(DIRECTIONS[k][0], DIRECTIONS[k][1], stress, of)
        if gain > best:
            best, c, s = gain, DIRECTIONS[k][0] + 0.0 * c, DIRECTIONS[k][1] + 0.0 * s
    change = 1.0 + 0.0 * c
    for _ in range(ROUNDS):
        if ti.abs(change) > NEAR:
            along, beside, bent = _square(c, s), _square_turned(c, s), _square_bent(c, s)
            stiff = elastic(along, of)
            p, q, dq = along.dot(stiff), of.limit + along.dot(stress), beside.dot(stress)
            kappa = beside.dot(stiff)
            slope = dq * p - q * kappa
            rise = bent.dot(stress) * p + dq * kappa - q * (beside.dot(elastic(beside, of)) + bent.dot(stiff))
            change = -0.5 * slope / ti.max(ti.abs(rise), 1e-30)
            change = ti.max(-TURN, ti.min(TURN, change))
            one = 1.0 / (1.0 + change * change)
            dc, ds = (1.0 - change * change) * one, 2.0 * change * one
            c, s = c * dc - s * ds, s * dc + c * ds
    return c, s


@ti.func
def _gain(c, s, stress, of):
    """Twice the energy that folds along a direction take off, 0 where it bears the limit [N m]."""
    along = _square(c, s)
    q, p = of.limit + along.dot(stress), along.dot(elastic(along, of))
    return ti.select(q < 0.0, q * q / ti.max(p, 1e-30), 0.0 * q)
