"""When two balls touched, which are found up to a step later: they overlap then, or have passed each other."""

from taichi_sim.device.engine import ti

PASSING = 0.02  # of the radius in a step: what moves less takes at most as large a part of a speed from what it grazes
STRAIGHT = 0.01  # of the radius, by which a way may differ from that of an even motion


@ti.func
def since_touch(solver: ti.template(), ball: ti.template(), i, j, u):
    """Time [s] since balls i and j first touched, which overlap now and close with u, the relative velocity; at most a step, and
    no longer ago than the last impact of either."""
    r = ball[j].x - ball[i].x
    reach, d = solver.model.radius[i] + solver.model.radius[j], r.norm()
    within = (reach - d) * (reach + d)
    time = 0.0 * d
    if within > 0.0:
        closing = -r.dot(u)
        time = within / (closing + ti.sqrt(closing * closing + within * u.dot(u)))
        time = ti.min(time, ti.min(solver.since_impact[i], solver.since_impact[j]))
    return time


@ti.func
def since_passing(solver: ti.template(), ball: ti.template(), i, j, r, reach):
    """Time [s] since balls i and j, r apart, which part, came to touch within the step that brought them here; 0 if they did not,
    or one of them stopped or bounced on its way, where it looked for others by itself (ccd_balls)."""
    u = ball[j].v - ball[i].v
    parting, time = r.dot(u), 0.0 * reach
    if parting > 0.0:
        square = u.dot(u)
        root = parting * parting + (reach * reach - r.dot(r)) * square
        if root > 0.0:
            since = (parting + ti.sqrt(root)) / square
            if since * solver.rate[0] < 1.0 and came_straight(solver, ball, i) and came_straight(solver, ball, j):
                time = since
    return time


@ti.func
def came_straight(solver: ti.template(), ball: ti.template(), i):
    """True if ball i has moved evenly with its present velocity in this step."""
    off = solver.displacement[i] - ball[i].v / solver.rate[0]
    return off.dot(off) < (STRAIGHT * solver.model.radius[i]) ** 2


@ti.func
def forced_since(solver: ti.template(), forced, since):
    """Approach speed of which half is what forces gave a pair from its touch, `since` seconds ago, to the time to which its
    velocities belong. `forced`: of a step, see approach_from_forces."""
    ago = 2.0 * since * solver.rate[0]
    if ti.static(solver.plan.at_search):  # these of the middle of the step that brought it here
        ago = -ago
    return (1.0 + ago) * forced
