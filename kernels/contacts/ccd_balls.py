"""Continuous collision detection: what moves further than its radius in a step stops where it first touches a ball or a stick.

It keeps its velocity, and the next contact solve finds it touching. Paths are straight within a step except where they bounce off
walls (see bent_paths), and positions are the new ones already. A ball that moves less than its radius looks for nothing, for it
cannot pass through anything meanwhile; what is fast meets it on its way, and it stops there as well.
Times of impact are found in rounds, each against the paths that the one before has left, so that what has stopped early is not
run through by a third.
"""

from taichi_sim.kernels.contacts import bent_paths, touch_times
from taichi_sim.kernels.contacts.pairs import may_touch
from taichi_sim.kernels.contacts.parabola import crossing
from taichi_sim.kernels.contacts.spatial_hash import bucket_of, cell_of, run, same_row
from taichi_sim.kernels.contacts.sticks import closest
from taichi_sim.kernels.contacts.sticks import may_touch as may_touch_stick
from taichi_sim.kernels.loops import each
from taichi_sim.kernels.vectors import cross, product, unit

from taichi_sim.device.engine import ti

STICK_ITERATIONS = 48  # of conservative advancement along a stick; then it stops where it is safe
NEARER_DISTANCE = 0.9  # of the distance
TOUCHING_ALREADY = 0.998  # of the distance at touch: what stopped in the step before is nearer
STOP_DISTANCE = 0.995  # of the distance at touch: found touching in the next search, whatever rounding does


@ti.func
def shorten_ways(solver: ti.template(), ball: ti.template()):
    """Shorten the displacements of this step where something is in the way. Does nothing where all moved slowly."""
    fixed = ti.static(solver.plan.gathers)
    ti.loop_config(serialize=True)
    for _ in range(1):
        solver.swept[0].balls = solver.swept[0].moved_fast * solver.n
        if ti.static(solver.plan.sticks):
            solver.swept[0].sticks = solver.swept[0].moved_fast * solver.sticks.m
        solver.swept[0].moved_fast = 0
        if ti.static(solver.plan.bounces):
            solver.swept[0].passes = solver.swept[0].moved
            solver.swept[0].moved = 0
        solver.swept[0].shortened = 0
    if ti.static(not fixed):
        for i in range(solver.swept[0].balls):
            begin_path(solver, i)
    one_round(solver, ball, fixed)
    ti.loop_config(serialize=True)  # few balls have others that stopped in their way: in turn, until nothing changes
    for _ in range(1):
        rounds = solver.swept[0].balls  # each of them settles at least the earliest stop that is left
        while rounds > 0 and solver.swept[0].shortened > 0:
            solver.swept[0].shortened = 0
            one_round(solver, ball, False)
            rounds -= 1
        if solver.swept[0].balls > 0:
            solver.longest_displacement[0] = 0.0
    each(solver.swept[0].balls, solver.n, fixed, cut_short, (solver,))


@ti.func
def one_round(solver: ti.template(), ball: ti.template(), fixed: ti.template()):
    """Shorten each path once, given where the others stopped in the round before. Sets `shortened` if any changed."""
    each(solver.swept[0].balls, solver.n, fixed, find_time_of_impact, (solver, ball))
    if ti.static(solver.plan.sticks):
        each(solver.swept[0].sticks, solver.sticks.m, fixed, sweep_stick, (solver, ball))
    each(solver.swept[0].balls, solver.n, fixed, take_time_of_impact, (solver,))


@ti.func
def begin_path(solver: ti.template(), i):
    """Reset the path of ball i: nothing is known to stop it."""
    solver.time_of_impact[i] = 1.0
    solver.next_time_of_impact[i] = 1.0


@ti.func
def find_time_of_impact(i, solver: ti.template(), ball: ti.template()):
    """Find where the path of ball i stops at another ball, which stops there, too, if ball i is fast and does not just wait."""
    if is_fast(solver, i):
        t, other = first_touch(solver, solver.pairs.grid, ball, i)
        ti.atomic_min(solver.next_time_of_impact[i], t)
        waits = bent_paths.is_unknown(solver, i, t)
        if t < 1.0 and solver.model.inverse_mass[other] > 0.0 and not waits:
            ti.atomic_min(solver.next_time_of_impact[other], t)


@ti.func
def take_time_of_impact(i, solver: ti.template()):
    """Take over the time of impact that a round has found for ball i."""
    if solver.next_time_of_impact[i] < solver.time_of_impact[i]:
        solver.swept[0].shortened = 1
    solver.time_of_impact[i] = solver.next_time_of_impact[i]


@ti.func
def cut_short(i, solver: ti.template()):
    """Take back what ball i went beyond where it stops."""
    if solver.time_of_impact[i] < 1.0:
        solver.state.shift(i, bent_paths.way(solver, i, solver.time_of_impact[i]) - solver.displacement[i])
    bent_paths.end(solver, i)


@ti.func
def note_displacement(solver: ti.template(), i, shift):
    """Keep the displacement of ball i, and whether anything must be looked at."""
    solver.displacement[i] = shift
    if ti.static(solver.plan.gathers):
        begin_path(solver, i)
    way = bent_paths.length(solver, i)
    fast = solver.model.radius[i] ** 2
    if ti.static(solver.plan.sticks):  # they are thin: what counts is the ball that one may cross
        fast = ti.min(fast, solver.crossing_squared[0])
    if ti.static(solver.plan.bounces):
        if way > touch_times.PASSING * solver.model.radius[i]:
            solver.swept[0].moved = 1
    if way * way > fast:
        solver.swept[0].moved_fast = 1
        ti.atomic_max(solver.longest_displacement[0], way)


@ti.func
def is_fast(solver: ti.template(), i):
    """True if ball i moved further than its radius in this step."""
    way = solver.displacement[i]
    return way.dot(way) > solver.model.radius[i] ** 2 or bent_paths.is_bent(solver, i)


@ti.func
def start(solver: ti.template(), ball: ti.template(), i):
    """Position of ball i [m] before it moved."""
    return ball[i].x - solver.displacement[i]


@ti.func
def first_touch(solver: ti.template(), grid: ti.template(), ball: ti.template(), i):
    """Part of its way at which ball i first touches another one, or 1, and that one."""
    t = 1.0 + 0.0 * solver.displacement[i][0]
    other = i
    for level in range(grid.levels):
        x = start(solver, ball, i)
        # others lie in the grid where they were when it was made: since then they moved by the skin and this step
        margin = solver.model.radius[i] + (2.0 + grid.enlarged) * grid.largest[level] + solver.longest_displacement[0]
        lowest, highest = bent_paths.box(solver, i, x, ball[i].x)
        low = cell_of(lowest - margin, grid, level)
        high = cell_of(highest + margin, grid, level)
        cells = 1.0 + 0.0 * x[0]
        for a in ti.static(range(solver.model.dim)):
            cells *= 1.0 + high[a] - low[a]
        everywhere = not (cells > 0.0 and cells <= 0.5 * solver.n)  # then looking at all balls is less work
        height = high[1] - low[1] + 1
        rows = height
        if ti.static(solver.model.dim == 3):
            rows *= high[2] - low[2] + 1
        for row in range(ti.select(everywhere, 1, rows)):
            cell = low
            cell[1] += row % height
            if ti.static(solver.model.dim == 3):
                cell[2] += row // height
            begin, end, first, last = 0, solver.n, 0, 0
            if not everywhere:
                bucket = bucket_of(cell, grid, level)
                begin, end = run(grid, level, bucket, high[0] - low[0] + 1, 0)
                first, last = run(grid, level, bucket, high[0] - low[0] + 1, 1)
            for k in range(end - begin + last - first):
                own = ti.select(k < end - begin, begin + k, first + k - (end - begin))
                if everywhere or same_row(cell, cell_of(grid.copy[own].x, grid, level)):
                    touch = time_of_touch(solver, ball, i, grid.sorted[own])
                    if touch < t:
                        t, other = touch, grid.sorted[own]
    return t, other


@ti.func
def time_of_touch(solver: ti.template(), ball: ti.template(), i, j):
    """Part of its way at which ball i first touches ball j, or 1."""
    touch = 1.0 + 0.0 * ball[i].x[0]
    if i != j and may_touch(solver.pairs, i, j):
        r = start(solver, ball, j) - start(solver, ball, i)
        distance = stopping_distance(solver.model.radius[i] + solver.model.radius[j], r.norm())
        t, end = 0.0 * touch, solver.time_of_impact[i]
        while t < end:
            r = path(solver, ball, j, t) - path(solver, ball, i, t)
            if bent_paths.is_unknown(solver, i, t):
                around = bent_paths.beyond(solver, i) + bent_paths.length(solver, j)
                touch = ti.select(r.norm() < distance + around, t, touch)
                end = t
            else:
                until = ti.min(end, bent_paths.next_change(solver, i, t))
                until = ti.min(until, bent_paths.next_change(solver, j, t))
                d = present_motion(solver, j, t) - bent_paths.motion(solver, i, t)
                later = t + meeting(r, d, distance, until - t)
                if later < until:
                    touch, end = later, later
                t = until
    return touch


@ti.func
def stopping_distance(reach, distance):
    """Distance at which a mover stops; what touches or overlaps already may come a little nearer."""
    return ti.select(distance > TOUCHING_ALREADY * reach, STOP_DISTANCE * reach, NEARER_DISTANCE * distance)


@ti.func
def meeting(r, d, distance, end):
    """First time before `end` at which |r + t d| falls to `distance`, or `end`. Sums of squares that nearly cancel are avoided:
    what flies by at a million radii a step would seem to hit."""
    t = end
    speed = d.norm()
    if speed > 0.0:
        e = d / speed
        away = cross(r, e)  # from the line of the path
        square = distance * distance - product(away, away, r.n)
        c = r.dot(r) - distance * distance
        if r.dot(e) < 0.0 and c > 0.0 and square > 0.0:
            t = ti.min(end, c / (ti.sqrt(square) - r.dot(e)) / speed)
    return t


@ti.func
def sweep_stick(s, solver: ti.template(), ball: ti.template()):
    """Stop stick s and the balls that would cross each other before they do."""
    one, two = solver.sticks.one[s], solver.sticks.two[s]
    moved = ti.max(bent_paths.length(solver, one), bent_paths.length(solver, two))
    # the box around the stick's way
    low, high = bent_paths.box(solver, one, start(solver, ball, one), ball[one].x)
    low_two, high_two = bent_paths.box(solver, two, start(solver, ball, two), ball[two].x)
    low, high = ti.min(low, low_two), ti.max(high, high_two)
    for i in range(solver.n):
        r = solver.model.radius[i]
        near = moved + bent_paths.length(solver, i) > 0.5 * r
        lowest, highest = bent_paths.box(solver, i, start(solver, ball, i), ball[i].x)
        for a in ti.static(range(solver.model.dim)):
            near = near and highest[a] > low[a] - r and lowest[a] < high[a] + r
        if near and may_touch_stick(solver.sticks, i, one, two):
            t = time_of_stick_touch(solver, ball, i, one, two)
            if t < 1.0:
                ti.atomic_min(solver.next_time_of_impact[i], t)
                ti.atomic_min(solver.next_time_of_impact[one], t)
                ti.atomic_min(solver.next_time_of_impact[two], t)


@ti.func
def path(solver: ti.template(), ball: ti.template(), i, t):
    """Position of ball i [m] at part t of the step."""
    return start(solver, ball, i) + bent_paths.way(solver, i, ti.min(t, solver.time_of_impact[i]))


@ti.func
def time_of_stick_touch(solver: ti.template(), ball: ti.template(), i, one, two):
    """Part of the step at which ball i first touches the stick, or 1: conservative advancement.

    Seen along the direction from the nearest point of the stick to the ball, no point of the stick is nearer than the nearer of
    its ends. Those move evenly, so until the first of them comes too near, or something stops, nothing can touch.
    """
    t = 0.0 * solver.displacement[i][0]
    n, d = from_stick(solver, ball, i, one, two, t)
    distance = stopping_distance(solver.model.radius[i], d)
    near = 1e-3 * distance
    for _ in range(STICK_ITERATIONS):
        known = not (is_lost(solver, i, t) or is_lost(solver, one, t) or is_lost(solver, two, t))
        if d > distance + near and t < 1.0 and known:
            x, u = path(solver, ball, i, t), present_motion(solver, i, t)
            until = bent_paths.next_change(solver, i, t)
            until = ti.min(until, bent_paths.next_change(solver, one, t))
            until = ti.min(until, bent_paths.next_change(solver, two, t))
            for which in ti.static(range(2)):
                end = one if ti.static(which == 0) else two
                gap = n.dot(x - path(solver, ball, end, t)) - distance
                speed = n.dot(u - present_motion(solver, end, t))
                until = ti.min(until, t + crossing(gap, speed, 0.0 * t, 1.0 + 0.0 * t))
            t = until
            n, d = from_stick(solver, ball, i, one, two, t)
    return ti.min(1.0, t)


@ti.func
def present_motion(solver: ti.template(), i, t):
    """Motion of ball i at part t of the step [m per step]."""
    return ti.select(t < solver.time_of_impact[i], 1.0, 0.0) * bent_paths.motion(solver, i, t)


@ti.func
def is_lost(solver: ti.template(), i, t):
    """True if ball i, which has not stopped, may be anywhere around the first bend of its path."""
    return bent_paths.is_unknown(solver, i, t) and t < solver.time_of_impact[i]


@ti.func
def from_stick(solver: ti.template(), ball: ti.template(), i, one, two, t):
    """Direction from the nearest point of the stick to ball i at part t of the step, and the distance."""
    a, b, x = path(solver, ball, one, t), path(solver, ball, two, t), path(solver, ball, i, t)
    along, _ = closest(x, a, b)
    return unit(x - a - ti.max(0.0, ti.min(1.0, along)) * (b - a), one, i)
