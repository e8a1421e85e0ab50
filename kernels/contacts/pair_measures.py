"""Measures of pairs at the present places, after a search: which pairs touch, their normals and depths, and the impulses they
start with."""

from taichi_sim.kernels.contacts import pair_impacts, touch_times, warm_start
from taichi_sim.kernels.contacts.pair_lists import pair_entry
from taichi_sim.kernels.contacts.pair_sweeps import add, add_to_other, torque
from taichi_sim.kernels.contacts.pairs import forget
from taichi_sim.kernels.vectors import unit, zero_scalar_in_2d

from taichi_sim.device.engine import ti


@ti.func
def measure_block(solver: ti.template(), ball: ti.template(), b, begin, end, time, how: ti.template()):
    """Measure the pairs of a block; where impacts are resolved in turn, mark one in which anything closes fast."""
    fast = 0
    for k in range(begin, end):
        fast |= measure(solver, solver.pairs, ball, solver.pairs.grid.order[k])
    if ti.static(solver.plan.impacts_in_turn):
        solver.block_is_active[b] = fast
        solver.block_was_struck[b] = fast


@ti.func
def measure(solver: ti.template(), pairs: ti.template(), ball: ti.template(), i):
    """Normals and depths of the listed pairs of ball i that touch, or nearly; moves these to the front of its list.

    So the iterations need not ask which touch: what touches changes little from step to step, but not from entry to entry.
    Sums the changes of velocity that accumulated impulses start with, and how many pairs touch each ball. Returns whether any
    closes fast.
    """
    fast = 0
    x, radius, w = ball[i].x, solver.model.radius[i], solver.model.inverse_mass[i]
    begin, touching, held = pairs.first[i], 0, pairs.touching[i]  # held: may hold anything
    passes = False
    if ti.static(solver.plan.bounces):
        passes = solver.swept[0].passes > 0
    total, angular = ti.Vector.zero(float, solver.model.dim), zero_scalar_in_2d(solver.model.dim)
    for t in range(pairs.number[i]):
        e = pair_entry(pairs, begin, t)
        j = pairs.link[e].other
        r = ball[j].x - x
        sum = radius + solver.model.radius[j]
        reach = sum * (1.0 + pairs.gap)
        if ti.static(solver.plan.foresees):
            # as far as either comes in a step, should the other be stopped, too: overlap would push back
            here, there = ball[i].v.dot(r), -ball[j].v.dot(r)
            reach += ti.max(0.0, ti.max(here + there, ti.max(here, there))) / (sum * solver.rate[0])
        passed = 0.0 * sum
        if ti.static(solver.plan.bounces):
            if passes:
                passed = touch_times.since_passing(solver, ball, i, j, r, sum)
        if r.dot(r) < reach * reach or passed > 0.0:
            n, d = unit(r, i, j)
            at = pair_entry(pairs, begin, touching)
            pairs.contact[at].normal = n
            pairs.contact[at].depth = sum - d
            if ti.static(solver.plan.impacts_in_turn):
                u = ball[j].v - ball[i].v
                closing = -u.dot(n)
                if ti.static(solver.plan.bounces):
                    pairs.contact[at].passed = passed
                    if passed > 0.0:
                        closing = -u.dot(r - passed * u) / sum
                if closing > pair_impacts.FAST_APPROACH * solver.threshold[0]:
                    fast = 1
                    solver.disturbed[i] = 0
                pairs.contact[at].lister = i
                pairs.contact[at].next_from_others = pairs.first_from_others[j]
                pairs.first_from_others[j] = at
            if ti.static(not solver.split):
                pairs.contact[at].mass = 1.0 / (w + solver.model.inverse_mass[j])
            if ti.static(solver.model.spins):
                pairs.contact[at].arm = d / sum
            if t > touching:
                link = pairs.link[e]
                pairs.link[e] = pairs.link[at]
                pairs.link[at] = link
            if ti.static(solver.plan.warm_starts):
                p = starting_impulse(solver, ball, i, j, at, n)
                total += p
                add_to_other(solver, solver.warm_velocity, j, -solver.model.inverse_mass[j] * p)
                if ti.static(solver.model.spins):
                    twist = torque(solver, at, p)
                    angular += twist
                    response = solver.model.spin_response(j) * solver.model.inverse_mass[j]
                    add_to_other(solver, solver.warm_spin, j, response * twist)
            if ti.static(solver.counts_pairs):
                add_to_other(solver, solver.pair_count, j, 1)
            if ti.static(solver.splits_by_direction):
                T = n.outer_product(n)
                add(solver, solver.normal_tensor, i, T)
                add_to_other(solver, solver.normal_tensor, j, T)
            touching += 1
        elif ti.static(solver.plan.warm_starts):
            if t < held:
                forget(pairs, e)
    pairs.touching[i] = touching
    if ti.static(solver.plan.warm_starts):
        add(solver, solver.warm_velocity, i, w * total)
        if ti.static(solver.model.spins):
            add(solver, solver.warm_spin, i, (solver.model.spin_response(i) * w) * angular)
    if ti.static(solver.counts_pairs):
        add(solver, solver.pair_count, i, touching)
    return fast


@ti.func
def starting_impulse(solver: ti.template(), ball: ti.template(), i, j, e, n):
    """Impulse [N s] on ball i with which its contact with j in link e starts, along the present normal."""
    if ti.static(solver.plan.keeps_loads):
        warm_start.start_from_load(solver.pairs.link, solver, e, i, j)
    if ti.static(solver.pairs.has_rebounds and (solver.split or solver.plan.limits_energy)):
        if solver.pairs.link[e].rebound_speed > 0.0:
            # it bounced, nothing presses it together: a split mass could not take the impulse back
            if (ball[j].v - ball[i].v).dot(n) > 0.0:
                warm_start.forget(solver.pairs.link, e, solver.model.dim)
    return -warm_start.kept_impulse(solver.pairs.link, e, n)
