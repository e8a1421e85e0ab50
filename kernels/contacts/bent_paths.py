"""Paths of balls that move further than their radius in a step and bounce off walls or colliders meanwhile.

`walls.path` keeps the first bend of each such path: straight ways lead there, and from there to the end. A path with further
bends lies within its remaining length around the first one. Where another ball comes so near, the ball waits at the first bend
and bounces in the next step.
"""

from taichi_sim.device.engine import ti

LEAST_REST = 1e-6  # part of the step: an impact at its very end is a bend as well


@ti.func
def is_bent(solver: ti.template(), i):
    """True if ball i has met a wall in this step."""
    bent = False
    if ti.static(solver.plan.bends):
        bent = solver.walls.path[i].rest > 0.0
    return bent


@ti.func
def is_unknown(solver: ti.template(), i, t):
    """True if the place of ball i at part t of the step is known only by its distance from the first bend."""
    unknown = False
    if ti.static(solver.plan.bends):
        path = solver.walls.path[i]
        unknown = path.rest > 0.0 and t >= 1.0 - path.rest and path.length > 0.0
    return unknown


@ti.func
def beyond(solver: ti.template(), i):
    """Length [m] of the path of ball i beyond its first bend, 0 where that is its only one."""
    result = 0.0 * solver.displacement[i][0]
    if ti.static(solver.plan.bends):
        result = solver.walls.path[i].length
    return result


@ti.func
def way(solver: ti.template(), i, t):
    """Displacement of ball i [m] until part t of the step."""
    whole = solver.displacement[i]
    result = t * whole
    if ti.static(solver.plan.bends):
        path = solver.walls.path[i]
        if path.rest > 0.0:
            if t < 1.0 - path.rest:
                result = t / (1.0 - path.rest) * path.way
            else:
                result = path.way + (t - (1.0 - path.rest)) / path.rest * (whole - path.way)
    return result


@ti.func
def motion(solver: ti.template(), i, t):
    """Motion of ball i at part t of the step [m per step]."""
    result = solver.displacement[i]
    if ti.static(solver.plan.bends):
        path = solver.walls.path[i]
        if path.rest > 0.0:
            result = path.way / (1.0 - path.rest) if t < 1.0 - path.rest else (result - path.way) / path.rest
    return result


@ti.func
def next_change(solver: ti.template(), i, t):
    """Part of the step, after t, at which the motion of ball i changes next; 1 if it does not."""
    end = solver.time_of_impact[i]
    if ti.static(solver.plan.bends):
        if solver.walls.path[i].rest > 0.0 and t < 1.0 - solver.walls.path[i].rest:
            end = ti.min(end, 1.0 - solver.walls.path[i].rest)
    return ti.select(t < end, end, 1.0 + 0.0 * t)


@ti.func
def length(solver: ti.template(), i):
    """Length of the path of ball i [m], at most."""
    displacement = solver.displacement[i]
    result = displacement.norm()
    if ti.static(solver.plan.bends):
        path = solver.walls.path[i]
        if path.rest > 0.0:
            result = path.way.norm() + ti.max(path.length, (displacement - path.way).norm())
    return result


@ti.func
def box(solver: ti.template(), i, start, end):
    """Corners of the box around the path of the centre of ball i from `start` to `end`."""
    low, high = ti.min(start, end), ti.max(start, end)
    if ti.static(solver.plan.bends):
        path = solver.walls.path[i]
        if path.rest > 0.0:
            low, high = ti.min(low, start + path.way - path.length), ti.max(high, start + path.way + path.length)
    return low, high


@ti.func
def end(solver: ti.template(), i):
    """Take back what walls did to ball i if it stops before it meets them; its next path is straight until it does."""
    if ti.static(solver.plan.bends):
        rest = solver.walls.path[i].rest
        solver.walls.path[i].rest = 0.0
        if rest > 0.0 and solver.time_of_impact[i] <= 1.0 - rest:
            solver.state.kick(i, -solver.walls.path[i].change)
            if ti.static(solver.model.spins):
                solver.state.spin[i] = solver.state.spin[i] - solver.walls.path[i].spin_change
            if ti.static(solver.plan.reflects):
                solver.walls.reflected[i] = ti.Vector.zero(float, solver.model.dim)
            if ti.static(solver.walls.probed):
                solver.walls.received.scale(i, -1.0)
