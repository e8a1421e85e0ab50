"""Walls of balls among others: impacts in turn with those of pairs (kernels.hits), and what kernels.settle asks."""

from taichi_sim.kernels.contacts import contact_law
from taichi_sim.kernels.vectors import cross, lever

from taichi_sim.device.engine import ti

FAR = 1e30  # times: nothing is in the way
SPENT = 4.0  # times its last change: a contact that holds less is about to let go
GROWTH = 2.0  # times what a contact held before: more than that, after an impact, was the impact's


@ti.func
def bound(solver: ti.template(), start, i, j):
    """The most that a contact of balls i and j may keep that held `start` [N s] before the solve."""
    return GROWTH * start + solver.threshold[0] / ti.max(solver.model.inverse_mass[i], solver.model.inverse_mass[j])


@ti.func
def load(walls: ti.template(), solver: ti.template(), i, n):
    """Speed into a wall that forces gave ball i since contacts were last looked for."""
    return ti.max(0.0, kick(walls, solver, i, n))


@ti.func
def kick(walls: ti.template(), solver: ti.template(), i, n):
    """The same, negative where forces pull it away."""
    u = 0.0 * n[0]
    if ti.static(solver.loaded):
        u = -solver.kicked[i].dot(n)
    elif ti.static(walls.model.has_gravity):
        u = -walls.model.gravity[0].dot(n) / solver.rate[0]
    return u


@ti.func
def bounce(walls: ti.template(), ball: ti.template(), solver: ti.template(), i, time):
    """Impacts of ball i, one among others, on the walls that it reaches in this step; whether there were any. See
    kernels.hits. It bounces where it is: left to the move, a ball between a wall and a heavy one would bounce there in each
    step, and the heavy one come through."""
    bounced = 0
    if walls.crowded[i] > 0 and walls.model.inverse_mass[i] > 0.0:
        for k in range(ti.select(walls.touched[i] > 0, walls.count, 0)):
            n = walls.normal(i, k)
            u = walls.relative(ball[i].v, i, k)
            pressed = kick(walls, solver, i, n)
            closing = -(n.dot(u) + ti.max(0.0, pressed))
            reach = ti.max(walls.touch(ball[i].x, i, k), closing / solver.rate[0])
            law = walls.law_with(i, 0)
            near = closing > walls.threshold[0] and walls.gap(ball[i].x, i, k) <= reach
            if near:  # an empty slot has no law
                law = walls.law(i, k)
            if near and law.restitution > 0.0:
                bounced = 1
                mass = 1.0 / walls.model.inverse_mass[i]
                total = -(1.0 + law.restitution) * (n.dot(u) + 0.5 * pressed) * mass
                p = total * n
                if ti.static(walls.model.has_friction):
                    slip = contact_law.viscous_share(walls.model, law, total, mass, walls.threshold[0], u, time)
                    if ti.static(solver.spins):
                        u -= lever(solver.state.spin[i], n)
                        mass *= walls.model.sideways(i)
                    change, _ = contact_law.sliding_impulse(
                        walls.model, u, n, mass, 0.0 * p, law.friction * total, slip
                    )
                    p += change
                if ti.static(walls.told):
                    walls.tell(i, k, p)
                solver.apply(i, p, -cross(n, p))
    return bounced


@ti.func
def limit(walls: ti.template(), solver: ti.template(), i):
    """Of what the walls of ball i hold after an impact, what may be a load; see kernels.hits."""
    if walls.crowded[i] > 0:
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
    and its work at the target speeds [J]. See kernels.settle."""
    p = ti.Vector.zero(float, walls.model.dim)
    far = FAR + 0.0 * walls.model.radius[i]
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
