"""Walls of crowded balls: impacts in turn with those of pairs (pair_impacts), and what impact_iterations asks."""

from taichi_sim.kernels.contacts import contact_law
from taichi_sim.kernels.contacts.kinds import BALL_ALONE
from taichi_sim.kernels.contacts.line_search import last_change
from taichi_sim.kernels.contacts.warm_start import keep_at_most, largest_load
from taichi_sim.kernels.vectors import cross, lever

from taichi_sim.device.engine import ti

UNBOUNDED_EXTENSION = 1e30  # times: nothing is in the way


@ti.func
def approach_from_forces(walls: ti.template(), solver: ti.template(), i, n):
    """Speed into a wall that forces gave ball i since contacts were last looked for, negative where they pull it away."""
    u = 0.0 * n[0]
    if ti.static(solver.plan.loaded):
        u = -solver.from_forces[i].v.dot(n)
    elif ti.static(walls.model.has_gravity):
        u = -walls.model.gravity[0].dot(n) / solver.rate[0]
    return u


@ti.func
def may_shift(walls: ti.template(), ball: ti.template(), i, shift, impacts):
    """True if no wall is where ball i, after so many impacts in this step, comes by `shift` [m]. Gaps to colliders are those
    found before all of these, up to the radius."""
    free = True
    number = walls.planes.count
    if ti.static(walls.has_colliders):
        free = impacts == 0 and shift.dot(shift) <= walls.model.radius[i] ** 2
        number = ti.select(walls.touching[i] > 0, walls.count, number)
    for k in range(number):
        free = free and walls.normal(i, k).dot(shift) >= -ti.max(0.0, walls.gap(ball[i].x, i, k))
    return free


@ti.func
def bounce(walls: ti.template(), ball: ti.template(), solver: ti.template(), i, time):
    """Impacts of ball i, a crowded one, on the walls that it reaches in this step; whether there were any. It bounces where
    it is: left to the move, a ball between a wall and a heavy one would bounce there in each step, and the heavy one come
    through."""
    bounced = 0
    if walls.crowded[i] != BALL_ALONE and walls.model.inverse_mass[i] > 0.0:
        for k in range(walls.looked_at(i)):
            n = walls.normal(i, k)
            u = walls.relative(ball[i].v, i, k)
            forced = approach_from_forces(walls, solver, i, n)
            closing = contact_law.closing_speed(n.dot(u), forced)
            reach = ti.max(walls.touch(ball[i].x, i, k), closing / solver.rate[0])
            if closing > walls.threshold[0] and walls.gap(ball[i].x, i, k) <= reach:
                law = walls.law(i, k)
                if law.restitution > 0.0:
                    bounced = 1
                    mass = 1.0 / walls.model.inverse_mass[i]
                    slip, tangential_mass = u, mass
                    if ti.static(solver.model.spins):
                        slip -= lever(solver.state.spin[i], n)
                        tangential_mass *= walls.model.sideways(i)
                    p = contact_law.impact_impulse(
                        walls.model, law, n, u, forced, slip, mass, tangential_mass, walls.threshold[0], time
                    )
                    if ti.static(walls.probed):
                        walls.record(i, k, p)
                    solver.apply(i, p, -cross(n, p))
                    solver.since_impact[i] = 0.0
    return bounced


@ti.func
def limit(walls: ti.template(), solver: ti.template(), i):
    """Limit what the walls of ball i accumulated in an impact to what may be a load."""
    if walls.crowded[i] != BALL_ALONE:
        for k in range(walls.looked_at(i)):
            c = i * walls.count + k
            if walls.is_solved(c):
                most = largest_load(solver, walls.contact[c].starting_impulse, i, i)
                keep_at_most(walls.contact, c, most)


@ti.func
def note(walls: ti.template(), i):
    """Note what the walls of ball i accumulated before an iteration."""
    for k in range(walls.looked_at(i)):
        walls.contact[i * walls.count + k].previous_impulse = walls.contact[i * walls.count + k].impulse


@ti.func
def changed(walls: ti.template(), i):
    """Impulse [N s] that the iteration added to ball i along the normals, how many times it may be added again before a wall
    pulls, and its work at the target speeds of the walls, which may move [J]."""
    p = ti.Vector.zero(float, walls.model.dim)
    longest = UNBOUNDED_EXTENSION + 0.0 * walls.model.radius[i]
    work = 0.0 * walls.model.radius[i]
    for k in range(walls.looked_at(i)):
        contact = walls.contact[i * walls.count + k]
        if walls.is_solved(i * walls.count + k):
            change, longest = last_change(walls.contact, i * walls.count + k, contact.impulse, longest)
            p += change * walls.normal(i, k)
            still = ti.Vector.zero(float, walls.model.dim)
            work += (contact.target - walls.relative(still, i, k).dot(walls.normal(i, k))) * change
    return p, longest, work


@ti.func
def extend(walls: ti.template(), i, times):
    """Add to what the walls of ball i accumulated `times` what the iteration added."""
    for k in range(walls.looked_at(i)):
        c = i * walls.count + k
        if walls.is_solved(c):
            now = walls.contact[c].impulse
            change = times * (now - walls.contact[c].previous_impulse)
            if ti.static(walls.probed):
                walls.record(i, k, change * walls.normal(i, k))
            walls.contact[c].impulse = ti.max(0.0, now + change)
