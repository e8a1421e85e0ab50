"""Loads, told from impacts where contacts are solved by iterations alone: only a load may start the next solve.

A solve starts from the impulses of the step before. In what rests these balance what forces add in a step. Of an impact that few
iterations have not stopped, they are what it took to brake so far: given once again, and once more what that gives, they throw
back what they should stop. So a load grows by little in a step, and beyond it a contact keeps what one iteration would add
against the speed that is left. From cold impulses iterations with split masses add no energy: an impact that takes several steps
to stop loses energy in each.
"""

from taichi_sim.kernels.contacts import pair_colours, pair_solve, warm_start

from taichi_sim.device.engine import ti


@ti.func
def keep(solver: ti.template(), ball: ti.template(), i):
    """Keep of the impulses of all contacts of ball i, after a solve, what the next solve may start from."""
    for t in range(solver.pairs.touching[i]):
        c, _ = pair_colours.turn(solver.pairs, i, t, pair_colours.EVERY_COLOUR)
        keep_of_pair(solver, ball, i, solver.pairs.link[c].other, c)
    if ti.static(solver.plan.walls):
        for k in range(ti.select(solver.walls.touching[i] > 0, solver.walls.count, 0)):
            keep_of_wall(solver, solver.walls, ball, i, k)


@ti.func
def keep_of_pair(solver: ti.template(), ball: ti.template(), i, j, c):
    """The same for pair c of balls i and j."""
    lighter = ti.max(solver.model.inverse_mass[i], solver.model.inverse_mass[j])
    load, impulse = solver.pairs.link[c].load + solver.threshold[0] / lighter, solver.pairs.link[c].impulse
    if impulse > load:
        contact = solver.pairs.contact[c]
        left = remaining_approach((ball[j].v - ball[i].v).dot(contact.normal), contact.target)
        warm_start.keep_at_most(solver.pairs.link, c, load + contact.mass * left, solver.model.has_friction)
        if ti.static(solver.plan.by_colours):
            pair_colours.mirror(solver.pairs, c, pair_solve.NEXT)
    solver.pairs.link[c].load = ti.min(load, impulse)


@ti.func
def keep_of_wall(solver: ti.template(), walls: ti.template(), ball: ti.template(), i, k):
    """The same for contact k of ball i with a wall or a collider."""
    c = i * walls.count + k
    if walls.is_solved(c) and walls.model.inverse_mass[i] > 0.0:
        load, impulse = (
            walls.contact[c].load + walls.threshold[0] / walls.model.inverse_mass[i],
            walls.contact[c].impulse,
        )
        if impulse > load:
            u = walls.relative(ball[i].v, i, k).dot(walls.normal(i, k))
            left = remaining_approach(u, walls.contact[c].target)
            warm_start.keep_at_most(walls.contact, c, load + walls.mass(solver, i) * left, walls.model.has_friction)
        walls.contact[c].load = ti.min(load, impulse)


@ti.func
def remaining_approach(u, target):
    """Speed [m/s] with which a contact with the normal speed u approaches more than it may."""
    return ti.max(0.0, ti.min(0.0, target) - u)
