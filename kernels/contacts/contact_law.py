"""One law for every contact, and how balls with several contacts share their mass between them.

Impulses are accumulated: `accumulated` [N s] is what a contact got so far in this solve, and from the step before where it
started with that."""

from taichi_sim.kernels.trigonometry import arccosine, cosine
from taichi_sim.kernels.vectors import part_across, tangent, zero_scalar_in_2d

from taichi_sim.device.engine import ti

# A soft contact is a damped spring that is solved implicitly, a quarter of a cycle per step and ten times critically damped
# (Catto, Soft Constraints, 2011): unlike a rigid one it takes energy out of tall piles, and it pushes out what overlaps.
SOFT_DAMPING_RATIO = 10.0
SOFT_ANGLE = 1.5707963267948966  # omega h: pi / 2
SOFT_PUSH = SOFT_ANGLE / (2.0 * SOFT_DAMPING_RATIO + SOFT_ANGLE)  # part of the depth that one step removes
SOFT_STIFFNESS = SOFT_ANGLE * (2.0 * SOFT_DAMPING_RATIO + SOFT_ANGLE)
SOFT_LEAK = 1.0 / (1.0 + SOFT_STIFFNESS)  # part of the accumulated impulse that an iteration lets go
SOFT_MASS = 1.0 - SOFT_LEAK  # of the contact's mass
PUSH_OUT = 0.5  # part of the remaining depth that the position correction of one step removes
FASTEST_PUSH_OUT = 20.0  # of the threshold speed: soft contacts do not push out faster
CALM_PUSH_OUT = 5.0  # the same where solves start from loads, see pair_solve.calm_push_out_speed
DEEP_OVERLAP = 0.2  # of the radius: where it is twice as fast
RESOLVED_SWING = 1.0  # of a ball, see `swing`: beyond it nothing bounces
TOUCH_TOLERANCE = 1e-5  # of the radius: a ball this close that hardly approaches rests
LEAST_SQUARED_SINE = 1e-3  # of over-relaxation: normals that face each other more exactly converge more slowly
CORRECTION_SLOP = 0.01  # of the radius: depth that position correction leaves


@ti.func
def pair_law(model: ti.template(), one, other):
    """Coefficients of the contact between two materials."""
    return model.laws[one * model.surfaces + other]


@ti.func
def swing(model: ti.template(), i, n):
    """h^2 n . K n / m of ball i, with K the stiffness of what holds it: about the square of how far it swings along n in a step
    of an implicit method. 0 where a ball is free, no stage was solved yet, or forces are explicit."""
    result = 0.0 * n[0]
    if ti.static(model.holds_back):
        result = n.dot(model.swing[i] @ n)
    return result


@ti.func
def as_resolved(model: ti.template(), law, swing):
    """The law of a contact, without restitution where a step does not resolve the `swing` of what touches: thrown back against
    its neighbours, a ball would strain what holds it further within the step than the impact had energy for."""
    if ti.static(model.holds_back):
        if swing > RESOLVED_SWING:
            law.restitution = 0.0
    return law


@ti.func
def normal_impulse(u, target, mass, accumulated):
    """New total normal impulse [N s] of a contact: it reaches the target speed but never pulls.

    u: normal part of the relative velocity sum g_i v_i; mass: 1 / sum w_i g_i^2 s_i [kg]. For a lone contact this is the
    exact law j = (target - u) / W whatever it accumulated. A soft one has SOFT_MASS of its mass, and only a part accumulated.
    """
    return ti.max(0.0, accumulated + (target - u) * mass)


@ti.func
def further_impulse(model: ti.template(), table: ti.template(), c, law, n, u, slip, mass, tangential_mass, threshold,
                    time):  # fmt: skip
    """Further impulse [N s] of contact c of a table, a rigid one, a row of the solve; notes what it has accumulated then. n:
    normal; u, slip [m/s]: relative velocity sum g_i v_i, and of the surfaces, which spin; mass, tangential_mass [kg]: what its
    balls oppose to an impulse along n, and along the surfaces. Viscous friction acts for `time` seconds."""
    before = table[c].impulse
    total = normal_impulse(u.dot(n), table[c].target, mass, before)
    p = (total - before) * n
    table[c].impulse = total
    if ti.static(model.has_friction):
        p += friction(model, table, c, law, n, u, slip, total, mass, tangential_mass, threshold, time)
    return p


@ti.func
def friction(
    model: ti.template(), table: ti.template(), c, law, n, u, slip, total, mass, tangential_mass, threshold, time
):
    """Impulse [N s] of friction of contact c of a table that has come to press with `total` [N s]; notes its new Coulomb part, a
    scalar along the normal turned by 90 degrees in 2D. For the others see `further_impulse`."""
    viscous, bound = viscous_share(model, law, total, mass, threshold, u, time), law.friction * ti.max(0.0, total)
    accumulated = table[c].tangential_impulse
    p, tangential = tangential_impulse(model, slip, n, tangential_mass, accumulated, bound, viscous)
    table[c].tangential_impulse = tangential
    return p


@ti.func
def push_out(depth, radius, away):
    """Distance [m] by which the position correction of a step separates what overlaps by `depth` [m]: a part of what is beyond
    the slop and does not part by `away` [m] on its own. radius [m]: of the smaller one."""
    return PUSH_OUT * ti.max(0.0, depth - CORRECTION_SLOP * radius - ti.max(0.0, away))


@ti.func
def over_relaxation(cosine):
    """Gain of impulses of two contacts of one ball, by the cosine between their normals, with which sweeps in turn converge
    fastest (Young 1954); below 2, so that none gains energy."""
    return 2.0 / (1.0 + ti.sqrt(ti.max(LEAST_SQUARED_SINE, 1.0 - cosine * cosine)))


@ti.func
def rebound(restitution, u, from_forces):
    """Change of the normal speed u of two things that bounce. from_forces [m/s]: approach speed that forces gave them since
    contacts were last looked for. What an impact throws back is the speed in the middle of that time, which belongs to the
    positions: half of that is in it."""
    return -(1.0 + restitution) * (u + 0.5 * from_forces)


@ti.func
def closing_speed(u, from_forces):
    """Speed of an impact of two things with the normal speed u: what forces gave them in this very step does not count."""
    return -(u + ti.max(0.0, from_forces))


@ti.func
def impact_impulse(model: ti.template(), law, n, u, forced, slip, mass, tangential_mass, threshold, time):
    """Impulse [N s] of an impact, of whose approach speed forces gave `forced` [m/s], see `rebound`: a row that has accumulated
    nothing and comes to the speed that is thrown back. For the others see `further_impulse`."""
    before = u.dot(n)
    total = normal_impulse(before, before + rebound(law.restitution, before, forced), mass, 0.0 * mass)
    p = total * n
    if ti.static(model.has_friction):
        viscous, none = viscous_share(model, law, total, mass, threshold, u, time), zero_scalar_in_2d(u.n)
        change, _ = tangential_impulse(model, slip, n, tangential_mass, none, law.friction * total, viscous)
        p += change
    return p


@ti.func
def tangential_impulse(model: ti.template(), slip, n, mass, accumulated, bound, viscous):
    """Change of the tangential impulse, a vector, and its new Coulomb part, which may not exceed `bound` and is a scalar in 2D,
    see `along_surface`.

    slip: relative velocity of the two surfaces. The share `viscous` = 1 - exp(-f t) of the sliding speed is taken first, then
    Coulomb friction opposes the rest; together they at most stop it.
    """
    stop = -part_across(slip, n) * mass
    wanted = accumulated + stop
    if ti.static(model.has_viscous):
        wanted -= viscous * stop
    if ti.static(n.n == 2):
        wanted = ti.max(-bound, ti.min(bound, wanted))
    else:
        square = wanted.dot(wanted)
        if square > bound * bound:
            wanted *= bound * ti.rsqrt(square)
    change = wanted - accumulated
    if ti.static(model.has_viscous):
        change += viscous * stop
    return along_surface(n, change), wanted


@ti.func
def along_surface(n, tangential):
    """A tangential impulse as a vector: in 2D it is kept as a scalar along the normal turned by 90 degrees."""
    if ti.static(n.n == 2):
        return tangential * tangent(n)
    else:
        return tangential


@ti.func
def tangential_mass_part(solver: ti.template(), i, j):
    """Mass that balls i and j oppose to an impulse along their surfaces, as a part of that along the normal."""
    part = solver.model.sideways(i)
    if ti.static(solver.model.some_spin):  # else both are alike
        a, b = solver.model.inverse_mass[i], solver.model.inverse_mass[j]
        if ti.static(solver.split):
            a, b = solver.effective_inverse_mass[i], solver.effective_inverse_mass[j]
        part = (a + b) / (a * (1.0 + solver.model.spin_response(i)) + b * (1.0 + solver.model.spin_response(j)))
    return part


@ti.func
def decayed(a):
    """1 - exp(-a), by its series for small a, where the difference would lose its digits."""
    return ti.select(a < 0.02, a * (1.0 - a * (0.5 - a * (1.0 / 6.0 - a * (1.0 / 24.0 - a / 120.0)))), 1.0 - ti.exp(-a))


@ti.func
def viscous_share(model: ti.template(), law, total, mass, threshold, u, time):
    """Part of the sliding speed that viscous friction takes in `time` seconds from a contact that presses with `total` [N s].

    Unlike Coulomb friction it does not fade with the normal impulse, so that a rounded zero would switch it on or off: none where
    `total` is no more than rounding leaves where two bodies just part.
    """
    share = 0.0 * mass
    if ti.static(model.has_viscous):
        if time > 0.0 and total > ti.max(1e-4 * threshold, 1e-6 * u.norm()) * mass:
            share = decayed(law.viscous_friction * time)
    return share


@ti.func
def target_speed(before, forced, late_part, restitution, threshold, impacts: ti.template()):
    """Normal speed that a contact should have after the solve: -e times the speed before (Moreau), 0 for slow impacts.

    Contacts that separate have this target too, however slowly: the set as a whole changes the kinetic energy by the sum of
    lambda (target + before) / 2, which with the target 0 is a gain for each that separates.

    forced [m/s]: approach speed that forces gave them in this step. It is a load and no impact; the late part of it, which they
    had not yet where they are, is not thrown back.

    Where the solve is not for impacts (the short one that ends a step), fast contacts are left for the next as they are.
    """
    fast = -restitution * before
    if ti.static(not impacts):
        fast = ti.select(restitution > 0.0, ti.min(before, 0.0), 0.0 * before)
    result = ti.select(before > 0.0, fast, 0.0 * before)
    closes = is_impact(before, forced, threshold)
    if closes:
        result = fast
    if ti.static(impacts):
        if restitution > 0.0:
            bounced = before + rebound(restitution, before, 2.0 * late_part * forced)
            if closes:
                result = ti.max(0.0, bounced)
            elif before > threshold:  # the reverse of what a surface on the other side asks for
                result = ti.min(0.0, bounced)
    return result


@ti.func
def target_until_touch(target, u, gap, bounces, rate):
    """Target speed of a contact that is still `gap` [m] apart: within the step, of 1 / rate seconds, it may close the gap, but
    not go on. What bounces keeps its speed u until it touches."""
    return ti.min(target, ti.select(bounces, u, -gap * rate))


@ti.func
def is_impact(u, forced, threshold):
    """True if two things with the normal speed u close fast, whatever forces gave them in this very step."""
    return closing_speed(u, forced) > threshold


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
            result = q + 2.0 * p * cosine(arccosine(r) / 3.0)
    return result


@ti.func
def share(T, count, by_tensor: ti.template()):
    """s of a ball: into how many parts its mass is split. 1 with at most one contact.

    By tensor T = sum n n^T, the sharpest split for which one iteration of normal impulses cannot add energy; by count where
    friction pushes sideways as well.
    """
    s = ti.max(1.0, 1.0 * count)
    if ti.static(by_tensor):
        if count > 1:
            s = ti.max(1.0, largest_eigenvalue(T))
    return s
