"""Bouncing never adds kinetic energy.

Where a crowd bounces, a solve that has not converged can add energy: a pair is pushed to its target speed although others,
still to come, already part it; so does Newton's restitution together with friction. So pairs of balls that touch are stopped
first, from velocities v0 to v1, and bounce then, by changes d of v1 (walls and sticks have their target speeds in both).
Where the energy of v1 + d is more than that of v0, all d are scaled down to where it is not, which keeps momentum and angular
momentum; what only rests stays at rest all the same. Velocities of balls that bounce off others are taken without what forces
added late, which no bounce throws back (contact_law.target_speed): their energy is that of the time to which places belong.
"""

from taichi_sim.kernels.reductions import each_part, join, member, members, total
from taichi_sim.kernels.vectors import product

from taichi_sim.device.engine import ti


@ti.func
def note_stopped(solver: ti.template(), ball: ti.template()):
    """Note the velocities where the pairs that touched have stopped."""
    for i in range(solver.n):
        solver.stopped_velocity[i] = ball[i].v
        if ti.static(solver.plan.walls):
            if ti.static(solver.walls.probed):
                solver.walls.received.note(i)
        if ti.static(solver.model.spins):
            solver.stopped_spin[i] = solver.state.spin[i]


@ti.func
def compare_with_before(solver: ti.template()):
    """Take the velocities before the solve as those that `limit` scales back to."""
    for i in range(solver.n):
        solver.stopped_velocity[i] = solver.velocity_before[i]
        if ti.static(solver.model.spins):
            solver.stopped_spin[i] = solver.spin_before[i]


@ti.func
def limit(solver: ti.template(), ball: ti.template()):
    """Scale the changes of velocity since `note_stopped` so that no energy has been added since `velocity_before`."""
    each_part(solver.energy_parts, sum_part, (solver, ball))
    columns = ti.static((solver.energy.lost, solver.energy.linear, solver.energy.square))
    join(columns, solver.energy_parts)
    ti.loop_config(serialize=True)
    for _ in range(1):
        lost, linear, square = [total(column, solver.energy_parts) for column in columns]
        lost = ti.max(0.0, lost)
        less = ti.cast(0.0, solver.energy_type)
        if linear + 0.5 * square > lost:  # the positive root of s linear + s^2 square / 2 = lost
            root = ti.sqrt(linear * linear + 2.0 * square * lost)
            s = (root - linear) / square
            if linear > 0.0:
                s = 2.0 * lost / (root + linear)
            less = ti.min(0.0, s - 1.0)
        solver.energy_scaling[0] = less
    for i in range(solver.n):
        less = ti.cast(solver.energy_scaling[0], float)
        if less < 0.0:
            solver.state.kick(i, less * (ball[i].v - solver.stopped_velocity[i]))
            if ti.static(solver.plan.walls):
                if ti.static(solver.walls.probed):
                    solver.walls.received.scale(i, less)
            if ti.static(solver.model.spins):
                solver.state.spin[i] = solver.state.spin[i] + less * (solver.state.spin[i] - solver.stopped_spin[i])


@ti.func
def sum_part(c, solver: ti.template(), ball: ti.template()):
    """Sum over part c of the balls of the energies that `limit` compares."""
    lost, linear, square = (
        ti.cast(0.0, solver.energy_type),
        ti.cast(0.0, solver.energy_type),
        ti.cast(0.0, solver.energy_type),
    )
    for k in range(members(c, solver.energy_parts, solver.n)):
        i = member(c, k, solver.energy_parts)
        w = solver.model.inverse_mass[i]
        if w > 0.0:
            v0 = ti.cast(solver.velocity_before[i], solver.energy_type)
            v1 = ti.cast(solver.stopped_velocity[i], solver.energy_type)
            d = ti.cast(ball[i].v, solver.energy_type) - v1
            if ti.static(solver.plan.loaded and not solver.plan.impacts_in_turn):
                if solver.impacts[i] > 0:
                    late = ti.cast(solver.plan.late_part * solver.from_forces[i].v, solver.energy_type)
                    v0, v1 = v0 - late, v1 - late
            lost += 0.5 * (v0 - v1).dot(v0 + v1) / w
            linear += v1.dot(d) / w
            square += d.dot(d) / w
            if ti.static(solver.model.spins):  # I omega^2 = m spin^2 / spin_inertia_ratio
                t0 = ti.cast(solver.spin_before[i], solver.energy_type)
                t1 = ti.cast(solver.stopped_spin[i], solver.energy_type)
                t = ti.cast(solver.state.spin[i], solver.energy_type) - t1
                lost += 0.5 * product(t0 - t1, t0 + t1, solver.model.dim) / (w * solver.model.spin_inertia_ratio)
                linear += product(t1, t, solver.model.dim) / (w * solver.model.spin_inertia_ratio)
                square += product(t, t, solver.model.dim) / (w * solver.model.spin_inertia_ratio)
    solver.energy[c].lost = lost
    solver.energy[c].linear = linear
    solver.energy[c].square = square
