"""Going on along the change that an iteration made, to the least of what iterations lessen: the kinetic energy less the work of
the target speeds, which along that change is a parabola."""

from taichi_sim.device.engine import ti

FURTHEST_EXTENSION = 1e6  # times the change of an iteration
SMALLEST_CURVATURE = 1e-30  # J: below it nothing has changed
SPENT_CONTACT = 4.0  # times its last change: a contact that holds less is about to let go


@ti.func
def last_change(iterated: ti.template(), c, impulse, longest):
    """Change of the normal impulse of a contact, now `impulse` [N s], by the last iteration, and how many times it may be made
    again, at most `longest`, before the contact pulls. One that is about to let go stays out, lest it stops the others."""
    change = impulse - iterated[c].previous_impulse
    if impulse < -SPENT_CONTACT * change:
        iterated[c].previous_impulse = impulse
        change = 0.0
    if change < 0.0:
        longest = ti.min(longest, impulse / -change)
    return change, longest


@ti.func
def best_extension(slope, curvature, longest):
    """Number of times that the change is made again, at most `longest`."""
    return ti.max(0.0, ti.min(-slope / ti.max(curvature, SMALLEST_CURVATURE), longest))
