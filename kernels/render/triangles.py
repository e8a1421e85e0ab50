"""Triangles into a buffer of what is seen at each sample (see `visibility`): row by row, only where a row may meet one."""

from taichi_sim.kernels.render.raster import (
    NEAR_PLANE,
    SAMPLE_OFFSETS,
    TRIANGLE,
    View,
    first,
    last,
    screen,
    to_view,
    vec3,
)
from taichi_sim.kernels.render.visibility import mark, put

from taichi_sim.device.engine import ti

CUT_PLANE = 0.02  # where a triangle that reaches behind the eye ends: nearer, its corners would be too many pixels away
# px from the middle of a pixel to a sample, at most, along either side
FARTHEST = {number: max(abs(a) for offset in offsets for a in offset) for number, offsets in SAMPLE_OFFSETS.items()}
NARROW = 4  # px: of a triangle no wider, all pixels of a row are tried
ROUNDING = 1e-5  # share of a vertex by which a row reaches farther than what is computed of it


@ti.func
def edge(ax, ay, bx, by):
    return ax * by - ay * bx


@ti.func
def screen_door(x, y, sample: ti.template(), samples: ti.template()):
    """Threshold of a sample, from 0 to 1: of several in a pixel each its own, or 4 x 4 pixels in an order that looks even."""
    threshold = ti.f32(ti.static((sample + 0.5) / samples))
    if ti.static(samples == 1):
        i, j = x & 3, y & 3
        rank = (((i ^ j) & 1) << 3) | ((j & 1) << 2) | ((i ^ j) & 2) | ((j & 2) >> 1)  # Bayer
        threshold = (ti.cast(rank, ti.f32) + ti.f32(0.5)) / 16
    return threshold


@ti.func
def narrowed(low, high, middle, value, rise):
    """The part of a range of x where value + rise (x - middle) may be at least 0; as good as nothing of it if none."""
    if rise > 0:
        low = ti.min(ti.max(low, middle - value / rise), high + ti.f32(1.0))
    elif rise < 0:
        high = ti.max(ti.min(high, middle - value / rise), low - ti.f32(1.0))
    elif value < 0:
        high = low - ti.f32(1.0)
    return low, high


@ti.func
def draw_triangle(
    seen: ti.template(), samples: ti.template(), see_through: ti.template(), opacity, a, b, c, identity, width, height
):
    """Either winding, by the shares of the vertices; of what is see-through a part of all samples, its opacity."""
    low, high = ti.min(a.xy, b.xy, c.xy), ti.max(a.xy, b.xy, c.xy)
    side, area = high - low, edge(b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1])
    if ti.abs(area) > ti.f32(1e-9):
        # shares of b, c and a: how they rise from one pixel to the next, and from its middle to a sample at most
        inverse = ti.f32(1.0) / area
        across = vec3(c[1] - a[1], a[1] - b[1], b[1] - c[1]) * inverse
        down = vec3(a[0] - c[0], b[0] - a[0], c[0] - b[0]) * inverse
        reach = (ti.abs(across) + ti.abs(down)) * ti.f32(ti.static(FARTHEST[samples]))
        reach += ti.f32(ROUNDING) * (1 + ti.abs(across) * side[0] + ti.abs(down) * side[1])
        y0, y1, x0, x1 = first(low[1]), last(high[1], height), first(low[0]), last(high[0], width)
        mark(seen, x0, x1, y0, y1, width)
        for y in range(y0, y1):
            dy = ti.cast(y, ti.f32) + ti.f32(0.5) - a[1]
            start, end = ti.cast(x0, ti.f32), ti.cast(x1 - 1, ti.f32)
            if x1 - x0 > NARROW:
                for k in ti.static(range(3)):
                    value = ti.f32(ti.static(float(k == 2))) + down[k] * dy + reach[k]
                    start, end = narrowed(start, end, a[0] - ti.f32(0.5), value, across[k])
            for x in range(first(start + ti.f32(0.9)), last(end + ti.f32(0.1), x1)):
                dx = ti.cast(x, ti.f32) + ti.f32(0.5) - a[0]
                u, v = across[0] * dx + down[0] * dy, across[1] * dx + down[1] * dy
                for s in ti.static(range(samples)):
                    offset = ti.static(SAMPLE_OFFSETS[samples][s])
                    us = u + (across[0] * ti.f32(offset[0]) + down[0] * ti.f32(offset[1]))
                    vs = v + (across[1] * ti.f32(offset[0]) + down[1] * ti.f32(offset[1]))
                    covers = ti.min(us, vs, 1 - us - vs) >= 0
                    if ti.static(see_through):
                        covers = covers and screen_door(x, y, ti.static(s), samples) < opacity
                    if covers:
                        w = a[2] + us * (b[2] - a[2]) + vs * (c[2] - a[2])
                        put(seen, (y * width + x) * samples + s, w, identity)


@ti.func
def before_the_eye(a, b, c):
    """The part beyond the cut plane of a triangle (view axes): corners a, b, c, d, and the number of triangles, abc and acd."""
    nearer = [ti.cast(corner[2] < ti.f32(CUT_PLANE), ti.i32) for corner in (a, b, c)]
    number = nearer[0] + nearer[1] + nearer[2]
    odd = ti.cast(number == 1, ti.i32)  # whether the corner that lies alone on its side of the plane is the nearer one
    p, q, r = a, b, c  # p: that corner
    if nearer[1] == odd:
        p, q, r = b, c, a
    elif nearer[2] == odd:
        p, q, r = c, a, b
    to_q, to_r = on_cut_plane(p, q), on_cut_plane(p, r)
    first, second, third, fourth, parts = p, to_q, to_r, to_r, 1
    if number == 1:
        first, second, third, parts = to_q, q, r, 2
    elif number == 3:
        parts = 0
    return first, second, third, fourth, parts


@ti.func
def on_cut_plane(a, b):
    return a + (b - a) * ((ti.f32(CUT_PLANE) - a[2]) / (b[2] - a[2]))


@ti.kernel
def draw_triangles(
    ball: ti.template(),
    corner: ti.template(),
    style_of: ti.template(),
    style: ti.template(),
    see_through: ti.template(),
    seen: ti.template(),
    samples: ti.template(),
    view: View,
    width: ti.i32,
    height: ti.i32,
    count: ti.i32,
):
    """Triangles over balls, of those that reach behind the eye what lies before it. What is see-through casts no shadow."""
    for i in range(count):
        k, opacity = corner[i], ti.f32(1.0)
        if ti.static(see_through):
            opacity = style[style_of[i]][2]
            if ti.static(seen.depth_only):
                opacity = ti.floor(opacity)
        a, b, c = to_view(view, ball[k[0]].xyz), to_view(view, ball[k[1]].xyz), to_view(view, ball[k[2]].xyz)
        d, parts = c, 1
        if view[3, 3] == 0 and ti.min(a[2], b[2], c[2]) <= ti.f32(NEAR_PLANE):
            a, b, c, d, parts = before_the_eye(a, b, c)
        for part in range(parts):
            if part == 1:
                b, c = c, d
            p, q, r = screen(view, a), screen(view, b), screen(view, c)
            if p[2] > 0 and q[2] > 0 and r[2] > 0:
                draw_triangle(seen, samples, see_through, opacity, p, q, r, (TRIANGLE << 28) | i, width, height)


@ti.kernel
def find_normals(
    ball: ti.template(),
    corner: ti.template(),
    start: ti.template(),
    incident: ti.template(),
    normal: ti.template(),
    count: ti.i32,
):
    """Area-weighted normals of triangles that share one, gathered in a fixed order (the same bits every time)."""
    for v in range(count):
        total = vec3(0, 0, 0)
        for e in range(start[v], start[v + 1]):
            k = corner[incident[e]]
            p = ball[k[0]].xyz
            total += (ball[k[1]].xyz - p).cross(ball[k[2]].xyz - p)
        normal[v] = total / ti.max(total.norm(), ti.f32(1e-20))


@ti.kernel
def even_normals(
    normal_of: ti.template(),
    start: ti.template(),
    incident: ti.template(),
    normal: ti.template(),
    evened: ti.template(),
):
    """Mean, for each of some normals, of those at the corners of its triangles: a third of it is its own. evened: their numbers,
    -1 where there is none, and room for the means."""
    for i in range(evened.shape[0]):
        v = evened[i].of
        if v >= 0:
            total = vec3(0, 0, 0)
            for e in range(start[v], start[v + 1]):
                k = normal_of[incident[e]]
                total += normal[k[0]] + normal[k[1]] + normal[k[2]]
            evened[i].mean = total / ti.max(total.norm(), ti.f32(1e-20))
    for i in range(evened.shape[0]):
        if evened[i].of >= 0:
            normal[evened[i].of] = evened[i].mean
