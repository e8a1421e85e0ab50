"""Time at which a parabola comes down to zero."""

from taichi_sim.device.engine import ti


@ti.func
def crossing(gap, v, a, never):
    """First time at which gap + v t + a t^2 / 2 falls to 0, or `never`. gap >= 0."""
    t = never
    square = v * v - 2.0 * a * gap
    if v < 0.0 and square >= 0.0:
        t = 2.0 * gap / (ti.sqrt(square) - v)  # no cancellation for a slow fall
    elif v >= 0.0 and a < 0.0:
        t = (v + ti.sqrt(square)) / -a
    return t
