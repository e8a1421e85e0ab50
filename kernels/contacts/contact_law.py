"""One law for every contact, and how balls with several contacts share their mass between them."""

from taichi_sim.device.engine import ti

# A soft contact is a damped spring that is solved implicitly, a quarter of a cycle per step and ten times critically damped
# (Catto, Soft Constraints, 2011): unlike a rigid one it takes energy out of tall piles, and it pushes out what overlaps.
DAMPING_RATIO = 10.0
ANGLE = 1.5707963267948966  # omega h: pi / 2
PUSH = ANGLE / (2.0 * DAMPING_RATIO + ANGLE)  # part of the depth that one step removes
STIFF = ANGLE * (2.0 * DAMPING_RATIO + ANGLE)
LEAK = 1.0 / (1.0 + STIFF)  # part of the held impulse that a pass lets go
SOFT = 1.0 - LEAK  # of the contact's mass


@ti.func
def normal_impulse(u, target, mass, held):
    """New total normal impulse [N s] of a contact that holds `held` so far: it reaches the target speed but never pulls.

    u: normal part of the relative velocity sum g_i v_i; mass: 1 / sum w_i g_i^2 s_i [kg]. For a lone contact this is the
    exact law j = (target - u) / W whatever `held` was.
    """
    return ti.max(0.0, held + (target - u) * mass)


@ti.func
def soft_impulse(u, target, mass, held):
    """The same for a soft contact; `target` holds the push-out speed as well."""
    return ti.max(0.0, SOFT * held + (target - u) * (SOFT * mass))


@ti.func
def rebound(restitution, u, kick):
    """Change of the normal speed u of two things that bounce. kick [m/s]: approach speed that forces gave them since contacts
    were last looked for. What an impact throws back is the speed in the middle of that time, which belongs to the positions:
    half of the kick is in it."""
    return -(1.0 + restitution) * (u + 0.5 * kick)


@ti.func
def friction_impulse(model: ti.template(), law, n, u, slip, mass, sideways, held, total, threshold, time):
    """Change of the tangential impulse [N s] of a contact that presses with `total` [N s], and its new Coulomb part, of which it
    held `held`. u, slip [m/s]: relative velocity of the bodies, and of their surfaces, which spin; mass, sideways [kg]: what they
    oppose to an impulse along the normal n, and along the surfaces. Viscous friction acts for `time` seconds."""
    share = viscous_share(model, law, total, mass, threshold, u, time)
    return sliding_impulse(model, slip, n, sideways, held, law.friction * total, share)


@ti.func
def sliding_impulse(model: ti.template(), u, n, mass, slide, bound, slip):
    """Change of the tangential impulse and its new Coulomb part (a vector that may not exceed `bound`).

    u: relative velocity of the two surfaces. The viscous share `slip` = 1 - exp(-f t) of the sliding speed is taken first,
    then Coulomb friction opposes the rest; together they at most stop it.
    """
    stop = (u.dot(n) * n - u) * mass
    wanted = slide + stop
    if ti.static(model.has_viscous):
        wanted -= slip * stop
    square = wanted.dot(wanted)
    if square > bound * bound:
        wanted *= bound * ti.rsqrt(square)
    change = wanted - slide
    if ti.static(model.has_viscous):
        change += slip * stop
    return change, wanted


@ti.func
def sliding_impulse_2d(model: ti.template(), u, mass, slide, bound, slip):
    """The same in 2D, where the one direction along the surface makes speed u and impulses scalars."""
    stop = -u * mass
    wanted = slide + stop
    if ti.static(model.has_viscous):
        wanted -= slip * stop
    wanted = ti.max(-bound, ti.min(bound, wanted))
    change = wanted - slide
    if ti.static(model.has_viscous):
        change += slip * stop
    return change, wanted


@ti.func
def sideways(solver: ti.template(), i, j):
    """Mass that balls i and j oppose to an impulse along their surfaces, as a part of that along the normal."""
    part = solver.model.sideways(i)
    if ti.static(solver.model.some_spin):  # else both are alike
        a, b = solver.model.inverse_mass[i], solver.model.inverse_mass[j]
        if ti.static(solver.split):
            a, b = solver.lightness[i], solver.lightness[j]
        part = (a + b) / (a * (1.0 + solver.model.spin_response(i)) + b * (1.0 + solver.model.spin_response(j)))
    return part


@ti.func
def presses(total, mass, threshold, u):
    """Whether a contact that holds `total` [N s] has friction: more than rounding leaves where two bodies just part. u: relative
    velocity.

    Viscous friction does not fade with the normal impulse, so without this a rounded zero would switch it on or off.
    """
    return total > ti.max(1e-4 * threshold, 1e-6 * u.norm()) * mass


@ti.func
def decayed(a):
    """1 - exp(-a), by its series for small a, where the difference would lose its digits."""
    return ti.select(a < 0.02, a * (1.0 - a * (0.5 - a * (1.0 / 6.0 - a * (1.0 / 24.0 - a / 120.0)))), 1.0 - ti.exp(-a))


@ti.func
def viscous_share(model: ti.template(), law, total, mass, threshold, u, time):
    """Part of the sliding speed that viscous friction takes in `time` seconds from a contact that holds `total` [N s]."""
    share = 0.0 * mass
    if ti.static(model.has_viscous):
        if presses(total, mass, threshold, u):
            share = decayed(law.viscous_friction * time)
    return share


@ti.func
def target_speed(before, restitution, threshold, impacts: ti.template()):
    """Normal speed that a contact should have after the solve: -e times the speed before (Moreau), 0 for slow impacts.

    Contacts that separate have this target too, however slowly: the set as a whole changes the kinetic energy by the sum of
    lambda (target + before) / 2, which with the target 0 is a gain for each that separates.

    Where the solve is not for impacts (the short one that ends a step), fast contacts are left for the next as they are.
    """
    fast = -restitution * before
    if ti.static(not impacts):
        fast = ti.select(restitution > 0.0, ti.min(before, 0.0), 0.0 * before)
    return ti.select(before < -threshold or before > 0.0, fast, 0.0 * before)


@ti.func
def largest_eigenvalue(T):
    """Largest eigenvalue of a symmetric, positive semi-definite 2x2 or 3x3 matrix."""
    q = T.trace() / ti.static(T.n)
    result = q
    if ti.static(T.n == 2):
        d = 0.5 * (T[0, 0] - T[1, 1])
        result = q + ti.sqrt(d * d + T[0, 1] * T[0, 1])
    else:
        # Smith 1961: T = q + p B with det(B) = 2 cos(3 phi); the largest root is q + 2 p cos(phi), phi in [0, pi/3]
        a, b, c = T[0, 0] - q, T[1, 1] - q, T[2, 2] - q
        x, y, z = T[0, 1], T[0, 2], T[1, 2]
        p2 = (a * a + b * b + c * c + 2.0 * (x * x + y * y + z * z)) / 6.0
        if p2 > 0.0:
            p = ti.sqrt(p2)
            det = a * (b * c - z * z) - x * (x * c - z * y) + y * (x * z - b * y)
            r = ti.max(-1.0, ti.min(1.0, 0.5 * det / (p2 * p)))
            result = q + 2.0 * p * ti.cos(ti.acos(r) / 3.0)
    return result


@ti.func
def share(T, count, by_tensor: ti.template()):
    """s of a ball: into how many parts its mass is split. 1 with at most one contact.

    By tensor T = sum n n^T, the sharpest split for which one pass of normal impulses cannot add energy; by count where
    friction pushes sideways as well.
    """
    s = ti.max(1.0, 1.0 * count)
    if ti.static(by_tensor):
        if count > 1:
            s = ti.max(1.0, largest_eigenvalue(T))
    return s
