"""Walls of balls among others: impacts in turn with those of pairs (kernels.pair_impacts), and what kernels.impact_iterations
asks."""

from taichi_sim.kernels.contacts import contact_law
from taichi_sim.kernels.contacts.kinds import ALONE
from taichi_sim.kernels.vectors import cross, lever

from taichi_sim.device.engine import ti

UNBOUNDED = 1e30  # times: nothing is in the way
SPENT = 4.0  # times its last change: a contact that holds less is about to let go
GROWTH = 2.0  # times what a contact held before: more than that, after an impact, was the impact's


@ti.func
def bound(solver: ti.template(), start, i, j):
    """The most that a contact of balls i and j may keep that held `start` [N s] before the solve."""
    return GROWTH * start + solver.threshold[0] / ti.max(solver.model.inverse_mass[i], solver.model.inverse_mass[j])


@ti.func
def kick(walls: ti.template(), solver: ti.template(), i, n):
    """Speed into a wall that forces gave ball i since contacts were last looked for, negative where they pull it away."""
    u = 0.0 * n[0]
    if ti.static(solver.loaded):
        u = -solver.kicked[i].dot(n)
    elif ti.static(walls.model.has_gravity):
        u = -walls.model.gravity[0].dot(n) / solver.rate[0]
    return u


@ti.func
def bounce(walls: ti.template(), ball: ti.template(), solver: ti.template(), i, time):
    """Impacts of ball i, one among others, on the walls that it reaches in this step; whether there were any. See
    kernels.pair_impacts. It bounces where it is: left to the move, a ball between a wall and a heavy one would bounce there in
    each step, and the heavy one come through."""
    bounced = 0
    if walls.crowded[i] != ALONE and walls.model.inverse_mass[i] > 0.0:
        for k in range(ti.select(walls.touched[i] > 0, walls.count, 0)):
            n = walls.normal(i, k)
            u = walls.relative(ball[i].v, i, k)
            forced = kick(walls, solver, i, n)
            closing = -(n.dot(u) + ti.max(0.0, forced))
            reach = ti.max(walls.touch(ball[i].x, i, k), closing / solver.rate[0])
            if closing > walls.threshold[0] and walls.gap(ball[i].x, i, k) <= reach:
                law = walls.law(i, k)
                if law.restitution > 0.0:
                    bounced = 1
                    mass = 1.0 / walls.model.inverse_mass[i]
                    total = contact_law.rebound(law.restitution, n.dot(u), forced) * mass
                    p = total * n
                    if ti.static(walls.model.has_friction):
                        slip, sideways = u, mass
                        if ti.static(solver.spins):
                            slip -= lever(solver.state.spin[i], n)
                            sideways *= walls.model.sideways(i)
                        change, _ = contact_law.friction_impulse(
                            walls.model, law, n, u, slip, mass, sideways, 0.0 * p, total, walls.threshold[0], time
                        )
                        p += change
                    if ti.static(walls.told):
                        walls.tell(i, k, p)
                    solver.apply(i, p, -cross(n, p))
    return bounced


@ti.func
def limit(walls: ti.template(), solver: ti.template(), i):
    """Of what the walls of ball i hold after an impact, what may be a load; see kernels.pair_impacts."""
    if walls.crowded[i] != ALONE:
        for k in range(ti.select(walls.touched[i] > 0, walls.count, 0)):
            c = i * walls.count + k
            held = walls.contact[c].impulse
            most = bound(solver, walls.contact[c].start, i, i)
            if walls.solved(c) and held > most:
                walls.contact[c].impulse = most
                if ti.static(walls.model.has_friction):
                    walls.contact[c].slide = most / held * walls.contact[c].slide


@ti.func
def note(walls: ti.template(), i):
    """Note what the walls of ball i hold before a pass."""
    for k in range(ti.select(walls.touched[i] > 0, walls.count, 0)):
        walls.contact[i * walls.count + k].noted = walls.contact[i * walls.count + k].impulse


@ti.func
def changed(walls: ti.template(), i):
    """Impulse [N s] that the pass added to ball i along the normals, how many times it may be added again before a wall pulls,
    and its work at the target speeds [J]. See kernels.impact_iterations."""
    p = ti.Vector.zero(float, walls.model.dim)
    far = UNBOUNDED + 0.0 * walls.model.radius[i]
    work = 0.0 * walls.model.radius[i]
    for k in range(ti.select(walls.touched[i] > 0, walls.count, 0)):
        contact = walls.contact[i * walls.count + k]
        if walls.solved(i * walls.count + k):
            change = contact.impulse - contact.noted
            if contact.impulse < -SPENT * change:
                walls.contact[i * walls.count + k].noted = contact.impulse
                change = 0.0
            p += change * walls.normal(i, k)
            work += contact.target * change
            if change < 0.0:
                far = ti.min(far, contact.impulse / -change)
    return p, far, work


@ti.func
def go_on(walls: ti.template(), i, times):
    """Add to what the walls of ball i hold `times` what the pass added."""
    for k in range(ti.select(walls.touched[i] > 0, walls.count, 0)):
        c = i * walls.count + k
        if walls.solved(c):
            held = walls.contact[c].impulse
            if ti.static(walls.told):
                walls.tell(i, k, times * (held - walls.contact[c].noted) * walls.normal(i, k))
            walls.contact[c].impulse = ti.max(0.0, held + times * (held - walls.contact[c].noted))
