"""One iteration over the pairs: further impulses from the present velocities, in turn (Gauss-Seidel) or all at once."""

from typing import NamedTuple

from taichi_sim.kernels.contacts import contact_law, pair_impacts, warm_start
from taichi_sim.kernels.contacts.pair_lists import pair_entry
from taichi_sim.kernels.contacts.pair_sweeps import add, add_to_other, torque
from taichi_sim.kernels.contacts.pairs import RIGID, law_of
from taichi_sim.kernels.vectors import lever, product, zero_scalar_in_2d

from taichi_sim.device.engine import ti


class Iteration(NamedTuple):
    """Switches of an iteration over pairs, fixed when it is compiled."""

    prepares: bool = False  # masses, target speeds, bias velocities, viscous friction: the first of a solve
    impacts: bool = False  # of these, whether what closes fast is solved too, or left for the next solve
    stops_first: bool = False  # where the energy limiter compares both, what touches is stopped before it bounces
    yields_to_loads_only: bool = False  # soft contacts let go of a part of their load, not of what an impact gave them
    takes_back: bool = False  # the speed with which the solve before the move pushed out overlap
    starts: bool = True  # this solve began with what contacts accumulated before; else that was applied before the move


FIRST = Iteration(prepares=True, impacts=True, stops_first=True)
NEXT = Iteration(stops_first=True)
AFTER_IMPACTS = Iteration(yields_to_loads_only=True)  # see impact_iterations
BOUNCE = Iteration()  # where restitution is a matter of its own, see energy_limiter
LAST = Iteration(prepares=True, takes_back=True)  # of the short solve at the end of a step
RELAX = Iteration(prepares=True, takes_back=True, starts=False)  # the same where a method ends with the move


@ti.func
def ball_in_turn(solver: ti.template(), ball: ti.template(), i, time, how: ti.template()):
    """The pairs that ball i lists, each seeing what those before it changed."""
    solve_in_turn(solver, ball, i, 0, solver.pairs.touching[i], time, how)


@ti.func
def solve_in_turn(solver: ti.template(), ball: ti.template(), i, begin, end, time, how: ti.template()):
    """The pairs of ball i from turn `begin` to `end`: each changes the velocities that the next one sees. Returns the largest
    change of a relative velocity [m/s]."""
    most = ti.cast(0.0, float)
    v = ball[i].v
    w = solver.model.inverse_mass[i]
    spin = zero_scalar_in_2d(solver.model.dim)
    if ti.static(solver.model.spins):
        spin = solver.state.spin[i]
    for t in range(begin, end):
        c = pair_entry(solver.pairs, solver.pairs.first[i], t)
        j = solver.pairs.link[c].other
        p = further_impulse(solver, ball, i, j, c, v, spin, time, how)
        v += w * p
        ball[j].v = ball[j].v - solver.model.inverse_mass[j] * p
        most = ti.max(most, (w + solver.model.inverse_mass[j]) * p.norm())
        if ti.static(solver.model.spins):
            twist = torque(solver, c, p)
            spin += w * (solver.model.spin_response(i) * twist)
            twist = solver.model.spin_response(j) * twist
            solver.state.spin[j] = solver.state.spin[j] + solver.model.inverse_mass[j] * twist
    ball[i].v = v
    if ti.static(solver.model.spins):
        solver.state.spin[i] = spin
    return most


@ti.func
def ball_at_once(solver: ti.template(), ball: ti.template(), i, time, how: ti.template()):
    """All pairs that ball i lists see the old velocities; impulses are summed in `impulse` and `angular_impulse`, to be applied
    at the end."""
    v = ball[i].v
    total = ti.Vector.zero(float, solver.model.dim)
    spin, angular = zero_scalar_in_2d(solver.model.dim), zero_scalar_in_2d(solver.model.dim)
    if ti.static(solver.model.spins):
        spin = solver.state.spin[i]
    begin = solver.pairs.first[i]
    for t in range(solver.pairs.touching[i]):
        c = pair_entry(solver.pairs, begin, t)
        j = solver.pairs.link[c].other
        p = further_impulse(solver, ball, i, j, c, v, spin, time, how)
        total += p
        add_to_other(solver, solver.impulse, j, -p)
        if ti.static(solver.model.spins):
            twist = torque(solver, c, p)
            angular += twist
            add_to_other(solver, solver.angular_impulse, j, twist)
    add(solver, solver.impulse, i, total)
    if ti.static(solver.model.spins):
        add(solver, solver.angular_impulse, i, angular)


@ti.func
def further_impulse(solver: ti.template(), ball: ti.template(), i, j, c, v, spin, time, how: ti.template()):
    """Further impulse [N s] on ball i (at velocity v, spin) from its pair with j in link c; -impulse acts on j."""
    if ti.static(how.prepares and how.impacts and solver.plan.bounces):
        pair_impacts.measure_again(solver, ball, i, j, c)
    if ti.static(how.prepares and not solver.plan.warm_starts):
        warm_start.forget(solver.pairs.link, c, solver.model.dim)
    n = solver.pairs.contact[c].normal
    before = solver.pairs.link[c].impulse
    u = ball[j].v - v
    if ti.static(how.prepares):
        if ti.static(solver.plan.impacts_in_turn):
            prepare_after_impacts(solver, i, j, c, n, before, how)
        else:
            prepare(solver, i, j, c, n, how)
    total = normal_impulse(solver, i, j, c, u.dot(n), before, how)
    solver.pairs.link[c].impulse = ti.max(0.0, total)
    p = (total - before) * n
    if ti.static(solver.model.has_friction):
        mass, tangential = solver.pairs.contact[c].mass, solver.pairs.link[c].tangential_impulse
        # pairs that only come near press with nothing: without this a pile in 3D takes 1.12 to 1.25 times as long
        if total > 0.0 or product(tangential, tangential, solver.model.dim) > 0.0:
            slip, tangential_mass = u, mass
            if ti.static(solver.model.spins):
                slip -= solver.pairs.contact[c].arm * lever(spin + solver.state.spin[j], n)
                tangential_mass *= contact_law.tangential_mass_part(solver, i, j)
            law = law_of(solver.pairs, i, j, n)
            p += contact_law.friction(
                solver.model, solver.pairs.link, c, law, n, u, slip, total, mass, tangential_mass, solver.threshold[0],
                time,
            )  # fmt: skip
    return -p


@ti.func
def push_out_speed(solver: ti.template(), depth):
    """Speed [m/s] with which a soft contact pushes out so much overlap [m]."""
    return ti.min(contact_law.SOFT_PUSH * depth * solver.rate[0], contact_law.FASTEST_PUSH_OUT * solver.threshold[0])


@ti.func
def calm_push_out_speed(solver: ti.template(), i, j, depth, wanted):
    """Speed [m/s], at most the `wanted` one, with which balls i and j are pushed apart where solves start from loads: a slow one,
    since the iteration that ends a step does not take back all of it, unless they lie deep in each other."""
    speed, calm = wanted, contact_law.CALM_PUSH_OUT * solver.threshold[0]
    if wanted > calm:
        part = depth / (contact_law.DEEP_OVERLAP * ti.min(solver.model.radius[i], solver.model.radius[j]))
        speed = ti.min(wanted, calm * (1.0 + part * part))
    return speed


@ti.func
def prepare(solver: ti.template(), i, j, c, n, how: ti.template()):
    """Mass of a contact where it is split, 0 where an impact is left for the next solve; its target speed from the velocities
    before the solve, and its bias velocity."""
    if ti.static(solver.split):
        alone = 1.0 / (solver.model.inverse_mass[i] + solver.model.inverse_mass[j])
        mass = ti.min(solver.relaxation / (solver.effective_inverse_mass[i] + solver.effective_inverse_mass[j]), alone)
        if ti.static(not how.impacts and not solver.plan.warm_starts):
            # one iteration would part what arrives at several contacts at once, and nothing take it back
            if (solver.velocity_before[j] - solver.velocity_before[i]).dot(n) < -solver.threshold[0]:
                mass = 0.0
        solver.pairs.contact[c].mass = mass
    if ti.static(solver.pairs.has_target):
        speed = (solver.velocity_before[j] - solver.velocity_before[i]).dot(n)
        restitution = 0.0 * speed
        if ti.static(solver.model.has_restitution):
            restitution = law_of(solver.pairs, i, j, n).restitution
        forced = pair_impacts.approach_from_forces(solver, i, j, n)
        target = contact_law.target_speed(
            speed, forced, solver.plan.late_part, restitution, solver.threshold[0], how.impacts
        )
        fast = contact_law.is_impact(speed, forced, solver.threshold[0])  # never soft
        if ti.static(not how.impacts):  # nor for the one iteration that ends a step, which would throw it back
            target = ti.select(fast, speed, target)
        rebound, bias = 0.0 * speed, RIGID + 0.0 * speed
        if ti.static(solver.model.has_restitution):
            rebound = ti.select(fast and target > 0.0, target, rebound)
        if ti.static(solver.plan.soft):
            depth = solver.pairs.contact[c].depth
            if depth <= 0.0:
                bounces = fast and restitution > 0.0
                target = contact_law.target_until_touch(target, speed, -depth, bounces, solver.rate[0])
                rebound = 0.0
            elif not fast:
                bias = push_out_speed(solver, depth)
                if ti.static(solver.plan.keeps_loads and how.impacts):
                    bias = calm_push_out_speed(solver, i, j, depth, bias)
        if ti.static(how.impacts):
            if ti.static(solver.model.has_restitution):
                solver.pairs.link[c].rebound_speed = rebound
                if ti.static(solver.plan.loaded):
                    if rebound > 0.0:
                        solver.impacts[i], solver.impacts[j] = 1, 1
            if ti.static(solver.plan.soft):
                solver.pairs.link[c].bias_velocity = bias
        elif ti.static(solver.plan.soft):  # what pressed stays, what bounced keeps its speed
            bounced = 0.0 * speed
            if ti.static(solver.model.has_restitution):
                bounced = solver.pairs.link[c].rebound_speed
            if bounced > 0.0 or solver.pairs.link[c].bias_velocity >= 0.0:
                target = ti.max(target, ti.max(0.0, ti.min(bounced, speed)))
        solver.pairs.contact[c].target = target


@ti.func
def prepare_after_impacts(solver: ti.template(), i, j, c, n, before, how: ti.template()):
    """Mass and bias velocity of a contact where impacts come first, see pair_impacts. What closes fast is left alone (mass 0) by
    the solve that ends a step, whose one iteration is for what rests; and by the others if it bounces at e = 1, or before it
    touches: they would take its energy."""
    depth = solver.pairs.contact[c].depth
    speed = (solver.velocity_before[j] - solver.velocity_before[i]).dot(n)
    forced = pair_impacts.approach_from_forces(solver, i, j, n)
    fast = contact_law.is_impact(speed, forced, solver.threshold[0])
    mass = 1.0 / (solver.model.inverse_mass[i] + solver.model.inverse_mass[j])
    if ti.static(not how.impacts):
        mass = ti.select(fast, 0.0, mass)
    elif ti.static(solver.model.has_restitution):
        e = law_of(solver.pairs, i, j, n).restitution
        if fast and e > 0.0 and (e >= 1.0 or depth <= 0.0):
            mass = 0.0
    solver.pairs.contact[c].mass = mass
    if ti.static(how.impacts and solver.plan.warm_starts):
        solver.pairs.contact[c].starting_impulse = before
    if ti.static(how.impacts and solver.plan.soft):
        bias = ti.cast(RIGID, float)
        rests = (
            before > 0.0
            or pair_impacts.rests(solver, i, j, speed, depth)
            or not pair_impacts.is_lossless(solver, i, j, n)
        )
        if depth > 0.0 and not fast and rests:
            bias = push_out_speed(solver, depth)
        solver.pairs.link[c].bias_velocity = bias


@ti.func
def normal_impulse(solver: ti.template(), i, j, c, u, before, how: ti.template()):
    """New accumulated normal impulse of pair c of balls i and j, which approaches with -u [m/s] and had accumulated `before`."""
    mass = solver.pairs.contact[c].mass
    target = 0.0 * u
    if ti.static(solver.plan.impacts_in_turn):
        if ti.static(solver.plan.soft):  # it may close the gap, but not go on
            target = ti.min(0.0, solver.pairs.contact[c].depth * solver.rate[0])
    elif ti.static(solver.pairs.has_target):
        target = solver.pairs.contact[c].target
        if ti.static(solver.plan.limits_energy and how.stops_first):
            target = ti.select(solver.pairs.contact[c].depth > 0.0, ti.min(0.0, target), target)
    total = contact_law.normal_impulse(u, target, mass, before)
    if ti.static(solver.plan.soft):
        bias = solver.pairs.link[c].bias_velocity
        if ti.static(how.takes_back):
            least = -ti.min(before, mass * ti.max(0.0, bias))
            if ti.static(not how.starts):
                least += before
            total = ti.max(least, before + (target - u) * mass)
        elif bias >= 0.0:
            kept = contact_law.SOFT_MASS * before
            if ti.static(how.yields_to_loads_only):
                kept = before - contact_law.SOFT_LEAK * pair_impacts.load_of(solver, i, j, c, before)
            total = contact_law.normal_impulse(u, target + bias, contact_law.SOFT_MASS * mass, kept)
    return total


@ti.func
def present_target(solver: ti.template(), i, j, c, accumulated):
    """Normal speed [m/s] at which an iteration that yields to loads only changes nothing of what pair c accumulated."""
    target = 0.0 * accumulated
    if ti.static(solver.plan.soft):
        target = ti.min(target, solver.pairs.contact[c].depth * solver.rate[0])
        bias = solver.pairs.link[c].bias_velocity
        if bias >= 0.0:
            yielding = (
                contact_law.SOFT_LEAK / contact_law.SOFT_MASS * pair_impacts.load_of(solver, i, j, c, accumulated)
            )
            target += bias - yielding / solver.pairs.contact[c].mass
    return target


@ti.func
def correct_position(ball: ti.template(), i, j, c, solver: ti.template(), h):
    """Displacement [m] that separates the pair of balls i and j in link c where their own motion does not. Velocities never
    see it.

    In turn a pair that does not bounce keeps its angular momentum: further apart it turns as much more slowly.
    """
    contact = solver.pairs.contact[c]
    u, depth = ball[j].v - ball[i].v, contact.depth
    inverse_mass = solver.model.inverse_mass[i] + solver.model.inverse_mass[j]
    if ti.static(solver.in_turn):
        depth -= contact.normal.dot(solver.position_correction[j] - solver.position_correction[i])
    else:
        inverse_mass = solver.effective_inverse_mass[i] + solver.effective_inverse_mass[j]
    smaller = ti.min(solver.model.radius[i], solver.model.radius[j])
    apart = contact_law.push_out(depth, smaller, h * contact.normal.dot(u))
    if apart > 0.0:
        q = apart / inverse_mass * contact.normal
        if ti.static(solver.in_turn and not solver.model.has_restitution):
            distance = solver.model.radius[i] + solver.model.radius[j] - contact.depth
            slip = u - u.dot(contact.normal) * contact.normal
            solver.exchange(i, j, apart / ((distance + apart) * inverse_mass) * slip)
        add(solver, solver.position_correction, i, -solver.model.inverse_mass[i] * q)
        if ti.static(solver.in_turn):
            add(solver, solver.position_correction, j, solver.model.inverse_mass[j] * q)
        else:
            add_to_other(solver, solver.position_correction, j, solver.model.inverse_mass[j] * q)
