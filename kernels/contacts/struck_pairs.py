"""Pairs that bounce in a step, where forces change within it and are asked for at its end.

Impacts follow the search at once there, before the forces of the new places are known: what comes back into a spring is pressed
by it where it is then. Velocities are those of the middle of the step; what forces did in half a step more, and how that is
thrown back, is told by what they were at its start, a0 (look_back). They act with the mean of both ends, as they do at walls
(impact): for a pair that touched after the time t the second half of a kick, of the relative speed a h / 2, has
(1 + e) t (a - a0) / 2 less along the normal. Without that a ball on a spring k that bounces with the speed u would gain
h^2 k u^2 / 6 on average, and a body of springs or elements with each of its balls.
"""

from taichi_sim.device.engine import ti

NO_PARTNER = -1


@ti.func
def clear(solver: ti.template(), i):
    """Ball i has not bounced yet in this step."""
    if ti.static(solver.plan.throws_back):
        solver.struck[i].other = NO_PARTNER


@ti.func
def look_back(solver: ti.template(), stepped):
    """Take impacts back to the middle of the step: what forces gave in it, half of which is still to come, counts against
    them. stepped: False at a start, which knows of no forces yet."""
    for i in range(solver.n):
        solver.velocity_from_forces[i] = ti.select(stepped, -1.0, 0.0) * solver.velocity_from_forces[i]


@ti.func
def note(solver: ti.template(), i, j, n, restitution, since):
    """Note that balls i and j have bounced, n being the normal from i to j, so many seconds after they touched."""
    if ti.static(solver.plan.throws_back):
        gain = (1.0 + restitution) * (1.0 - since * solver.rate[0])
        from_forces = (kick_of(solver, i) - kick_of(solver, j)).dot(n)
        note_one(solver, i, j, gain, from_forces, n)
        note_one(solver, j, i, gain, from_forces, -n)


@ti.func
def note_one(solver: ti.template(), i, j, gain, from_forces, n):
    """Note for ball i its last impact."""
    solver.struck[i].other = j
    solver.struck[i].gain = gain
    solver.struck[i].from_forces = from_forces
    solver.struck[i].normal = n


@ti.func
def kick_of(solver: ti.template(), i):
    """Velocity [m/s] that forces gave ball i in this step, negative, see look_back; a pin is moved by none."""
    kick = solver.velocity_from_forces[i]
    if solver.model.inverse_mass[i] == 0.0:
        kick *= 0.0
    return kick


@ti.func
def throw_back(solver: ti.template(), h, forces: ti.template()):
    """Take what the second half of a kick by `forces` has less for pairs of which neither ball has bounced again since."""
    if ti.static(solver.plan.throws_back):
        for i in range(solver.n):
            j = partner(solver, i)
            if j != NO_PARTNER:
                now = (forces.change(j, h) - forces.change(i, h)).dot(solver.struck[i].normal)
                change = part_of(solver, i, j, 0.5 * (now - solver.struck[i].from_forces))
                solver.state.kick(i, change)
                solver.velocity_when_found[i] = solver.velocity_when_found[i] + change


@ti.func
def share(solver: ti.template(), i, part, kick: ti.template()):
    """Change [m/s] of ball i by a part of the kicks (n) that forces give in the second half beside what was known of them."""
    change = ti.Vector.zero(float, solver.model.dim)
    if ti.static(solver.plan.throws_back):
        j = partner(solver, i)
        if j != NO_PARTNER:
            change = part_of(solver, i, j, part * (kick[j] - kick[i]).dot(solver.struck[i].normal))
    return change


@ti.func
def partner(solver: ti.template(), i):
    """The ball that ball i, which is not pinned, bounced off last, if that has not bounced off another since, else NO_PARTNER."""
    j = solver.struck[i].other
    if j != NO_PARTNER:
        again = solver.model.inverse_mass[j] > 0.0 and solver.struck[j].other != i
        if again or solver.model.inverse_mass[i] == 0.0:
            j = NO_PARTNER
    return j


@ti.func
def part_of(solver: ti.template(), i, j, change):
    """Part [m/s] of ball i in a change of the speed of its pair with ball j by forces in the step of their touch."""
    w = solver.model.inverse_mass[i]
    return w / (w + solver.model.inverse_mass[j]) * solver.struck[i].gain * change * solver.struck[i].normal
