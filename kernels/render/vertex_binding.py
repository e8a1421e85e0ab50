"""Vertices that follow balls, each at a weighted mean of them: their places and their colours.

Row k of the sparse weights: entries start[k] to start[k + 1], the balls `entry` and their `weight`.
"""

from taichi_sim.kernels.render.raster import vec3, vec4

from taichi_sim.device.engine import ti


@ti.kernel
def bind(
    ball: ti.template(),
    start: ti.template(),
    entry: ti.template(),
    weight: ti.template(),
    first: ti.i32,
    count: ti.i32,
):
    """Vertices `first` on: weighted means of balls, entries start[k] to start[k + 1] for the k-th; no radius."""
    for k in range(count):
        p = vec3(0, 0, 0)
        for e in range(start[k], start[k + 1]):
            p += weight[e] * ball[entry[e]].xyz
        ball[first + k] = vec4(p[0], p[1], p[2], 0)


@ti.func
def along(table: ti.template(), value):
    """Colour at `value`, from 0 to 1, of a table (k, 3)."""
    last = table.shape[0] - 1
    place = ti.min(ti.max(value, ti.f32(0.0)), ti.f32(1.0)) * last
    k = ti.min(ti.cast(place, ti.i32), last - 1)
    t = place - k
    result = vec3(0, 0, 0)
    for c in ti.static(range(3)):
        result[c] = table[k, c] * (1 - t) + table[k + 1, c] * t
    return result


@ti.kernel
def paint_balls(
    value: ti.types.ndarray(ti.f32, 1), table: ti.types.ndarray(ti.f32, 2), colour: ti.template(), count: ti.i32
):
    """Colours of balls by their values."""
    for i in range(count):
        colour[i] = along(table, value[i])


@ti.kernel
def paint_bound(
    value: ti.types.ndarray(ti.f32, 1),
    table: ti.types.ndarray(ti.f32, 2),
    colour: ti.template(),
    start: ti.template(),
    entry: ti.template(),
    weight: ti.template(),
    first: ti.i32,
    count: ti.i32,
):
    """Colours of the vertices that `bind` places, by the weighted means of their balls' values."""
    for k in range(count):
        mean = ti.f32(0.0)
        for e in range(start[k], start[k + 1]):
            mean += weight[e] * value[entry[e]]
        colour[first + k] = along(table, mean)
