"""Pairs that bounce in a step, where forces change within it and are asked for at its end.

Impacts follow the search at once there, before the forces of the new places are known: what comes back into a spring is pressed
by it where it is then. Velocities are those of the middle of the step; what forces did in half a step more, and how that is
thrown back, is told by what they were at its start, a0 (look_back). They act with the mean of both ends, as they do at walls
(impact): each ball has a late kick, h (a - a0) / 2, that was not yet known when it bounced. A pair that touched after the time t
had t / h of it by then, so the second half of its kick has (1 + e) t (a - a0) / 2 less along the normal. Without that a ball on a
spring k that bounces with the speed u would gain h^2 k u^2 / 6 on average, and a body of springs or elements with each of its
balls.

A ball may bounce several times in a step, and each impact throws back what those before it changed as well. So all are noted, and
gone through once more in their order.
"""

from taichi_sim.kernels.contacts import impact

from taichi_sim.device.engine import ti

IMPACTS_PER_BALL = 4  # in a step, on average, are noted; further ones throw nothing back
FEW_IMPACTS = 64  # are noted at least


@ti.func
def clear(solver: ti.template()):
    """Nothing has bounced yet in this step."""
    if ti.static(solver.plan.throws_back):
        solver.struck_number[0] = 0


@ti.func
def look_back(solver: ti.template(), stepped):
    """Take impacts back to the middle of the step: what forces gave in it, half of which is still to come, counts against
    them. stepped: False at a start, which knows of no forces yet."""
    for i in range(solver.n):
        solver.from_forces[i].v = ti.select(stepped, -1.0, 0.0) * solver.from_forces[i].v


@ti.func
def note(solver: ti.template(), i, j, n, restitution, since):
    """Note that balls i and j have bounced, n being the normal from i to j, so many seconds after they touched."""
    if ti.static(solver.plan.throws_back):
        k = ti.atomic_add(solver.struck_number[0], 1)
        if k < solver.struck.shape[0]:
            solver.struck[k].one, solver.struck[k].other = i, j
            solver.struck[k].gain = 1.0 + restitution
            solver.struck[k].part = 1.0 - since * solver.rate[0]
            solver.struck[k].normal = n


@ti.func
def bounced(solver: ti.template(), i):
    """True if ball i has bounced in this step, after its move."""
    return solver.impacts[i] > 0


@ti.func
def late_kick(solver: ti.template(), i, kick):
    """Velocity [m/s] that a kick by forces at the end of the step gives ball i beside half of what was known when it bounced."""
    return 0.5 * (kick + solver.from_forces[i].v)


@ti.func
def note_late_kick(solver: ti.template(), i, late):
    """Note the late kick [m/s] of ball i, if it bounced, and what walls that it met before have thrown back of it."""
    if bounced(solver, i):
        if solver.model.inverse_mass[i] == 0.0:
            late *= 0.0
        solver.late_kick[i] = late
        solver.thrown[i] = thrown_by_walls(solver, i)


@ti.func
def thrown_by_walls(solver: ti.template(), i):
    """Change [m/s] of ball i by the walls that it met in this step, of its late kick."""
    change = ti.Vector.zero(float, solver.model.dim)
    if ti.static(solver.plan.reflects):
        change = impact.thrown_back(solver.walls, i, solver.late_kick[i]) - solver.late_kick[i]
    return change


@ti.func
def throw_back(solver: ti.template()):
    """Change all balls by what impacts throw back of the late kicks noted."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for k in range(ti.min(solver.struck_number[0], solver.struck.shape[0])):
            throw_back_one(solver, solver.struck[k])
    for i in range(solver.n):
        if bounced(solver, i):
            change = solver.thrown[i] - thrown_by_walls(solver, i)
            solver.state.kick(i, change)
            solver.velocity_when_found[i] = solver.velocity_when_found[i] + change


@ti.func
def throw_back_one(solver: ti.template(), pair):
    """Add what one impact throws back: of the part of the late kicks that its balls had by then, and of what impacts before it
    threw back."""
    i, j = pair.one, pair.other
    late = solver.thrown[j] - solver.thrown[i] + pair.part * (solver.late_kick[j] - solver.late_kick[i])
    w, other = solver.model.inverse_mass[i], solver.model.inverse_mass[j]
    change = pair.gain * late.dot(pair.normal) / (w + other) * pair.normal
    solver.thrown[i] = solver.thrown[i] + w * change
    solver.thrown[j] = solver.thrown[j] - other * change
