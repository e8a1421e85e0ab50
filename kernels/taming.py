"""No contact solve adds kinetic energy.

Where each pair changes the velocities that the next one sees, a solve that has not converged can add energy: a pair that bounces
is pushed to its target speed although others, still to come, already part it; so does Newton's restitution together with
friction. The solve changes velocities from v to v + d and the kinetic energy by sum m v.d + sum m d.d / 2. Where that is more
than 0 all d are scaled down to where it is 0, which keeps momentum and angular momentum.
"""

import taichi as ti

PART = 1024  # balls that one thread sums; parts are added in order: the same bits for any number of threads


@ti.func
def tame(solver: ti.template(), ball: ti.template()):
    """Scale the changes of velocity since `before` so that they add no energy."""
    for c in range(solver.parts_of_energy):
        linear, square = ti.cast(0.0, solver.wide), ti.cast(0.0, solver.wide)
        for i in range(c * PART, ti.min((c + 1) * PART, solver.n)):
            w = solver.model.inverse_mass[i]
            if w > 0.0:
                v = ti.cast(solver.before[i], solver.wide)
                d = ti.cast(ball[i].v, solver.wide) - v
                linear += v.dot(d) / w
                square += d.dot(d) / w
                if ti.static(solver.spins):  # I omega^2 = m turn^2 / turning
                    s = ti.cast(solver.before_turn[i], solver.wide)
                    t = ti.cast(solver.state.turn[i], solver.wide) - s
                    linear += product(solver, s, t) / (w * solver.turning)
                    square += product(solver, t, t) / (w * solver.turning)
        solver.energy[c].linear = linear
        solver.energy[c].square = square
    ti.loop_config(serialize=True)
    for _ in range(1):
        linear, square = ti.cast(0.0, solver.wide), ti.cast(0.0, solver.wide)
        for c in range(solver.parts_of_energy):
            linear += solver.energy[c].linear
            square += solver.energy[c].square
        less = ti.cast(0.0, solver.wide)
        if linear + 0.5 * square > 0.0:
            less = ti.min(0.0, ti.max(0.0, -2.0 * linear / square) - 1.0)
        solver.energy[solver.parts_of_energy].linear = less
    for i in range(solver.n):
        less = ti.cast(solver.energy[solver.parts_of_energy].linear, float)
        if less < 0.0:
            solver.state.kick(i, less * (ball[i].v - solver.before[i]))
            if ti.static(solver.spins):
                solver.state.turn[i] = solver.state.turn[i] + less * (solver.state.turn[i] - solver.before_turn[i])


@ti.func
def product(solver: ti.template(), a, b):
    """a . b of two turns, which are scalars in 2D."""
    if ti.static(solver.model.dim == 3):
        return a.dot(b)
    else:
        return a * b
