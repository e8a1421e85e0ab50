"""The box around the ways of all triangles and sticks in a step, where triangles collide: a fast ball that stays out of it meets
none of them, however often it bounces off walls. One that may not waits at the first wall, and bounces in the next step.

`walls.of_surface` says which balls hold them, `walls.around_surfaces` has the lowest and the highest corner of the box.
"""

from taichi_sim.kernels.contacts.triangle_bvh import BEYOND_ALL
from taichi_sim.kernels.contacts.triangle_pairs import LOOK_AHEAD

from taichi_sim.device.engine import ti


@ti.func
def length(speed, acceleration, time):
    """Way [m] that a ball makes in a time [s] at most, and as far as it is looked ahead for triangles."""
    return LOOK_AHEAD * time * (speed + acceleration * time)


@ti.func
def bound(walls: ti.template(), ball: ti.template(), motion: ti.template(), h):
    """Find the box for a step of h seconds, before balls move. What undoes overlap moves none by more than its radius."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        walls.around_surfaces[0] = BEYOND_ALL + ti.Vector.zero(float, 3)
        walls.around_surfaces[1] = -BEYOND_ALL + ti.Vector.zero(float, 3)
    for i in range(walls.model.n):
        if walls.of_surface[i] == 1:
            way = length(ball[i].v.norm(), motion.acceleration(i, h).norm(), h) + 2.0 * walls.model.radius[i]
            for a in ti.static(range(3)):
                if ball[i].x[a] - way < walls.around_surfaces[0][a]:
                    ti.atomic_min(walls.around_surfaces[0][a], ball[i].x[a] - way)
                if ball[i].x[a] + way > walls.around_surfaces[1][a]:
                    ti.atomic_max(walls.around_surfaces[1][a], ball[i].x[a] + way)


@ti.func
def may_meet(walls: ti.template(), i, x, way):
    """True if ball i, which begins the step at x and gets no further from there than `way` [m], may touch what is in the box."""
    low, high = walls.around_surfaces[0], walls.around_surfaces[1]
    return ti.max(low - x, x - high).max() < way + 2.0 * walls.model.radius[i]
