"""Spheres and rods into a buffer of what is seen at each sample (see `visibility`); `triangles` draws the rest.

The same kernels draw the picture and the shadow map. A view is a 4x4 matrix: rows right, up, forward (each with its
offset), then (pixels per unit, centre x, centre y, far), far = 0 for perspective. Pixels count from the top left.
"""

from taichi_sim.kernels.render.visibility import key_of, mark, mark_thin, may_win, put

from taichi_sim.device.engine import ti

vec2 = ti.types.vector(2, ti.f32)
vec3 = ti.types.vector(3, ti.f32)
vec4 = ti.types.vector(4, ti.f32)
View = ti.types.matrix(4, 4, ti.f32)

SPHERE, ROD, TRIANGLE, PLANE = 1, 2, 3, 4  # kind of a primitive: identity = kind << 28 | index
NEAR_PLANE = 1e-3
EXACT_RADIUS = 3.0  # px: a sphere at least this large is intersected exactly, a smaller one is drawn as a bulging disc
SMALLEST_RADIUS = 0.55  # px: no sphere is drawn smaller, or it would flicker between samples
THIN = 5.0  # texels of a shadow map: what is less wide may lie between two taps
SAMPLE_OFFSETS = {
    1: ((0.0, 0.0),),
    4: ((-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125)),
}  # rotated grid


@ti.func
def to_view(view, p):
    """The point p in the axes of the view: right, up, forward."""
    return vec3(
        view[0, 0] * p[0] + view[0, 1] * p[1] + view[0, 2] * p[2] + view[0, 3],
        view[1, 0] * p[0] + view[1, 1] * p[1] + view[1, 2] * p[2] + view[1, 3],
        view[2, 0] * p[0] + view[2, 1] * p[1] + view[2, 2] * p[2] + view[2, 3],
    )


@ti.func
def screen(view, c):
    """(x px, y px, closeness, pixels per unit) of a point in view axes; closeness 0 where it lies behind."""
    w, scale = ti.f32(0.0), view[3, 0]
    if view[3, 3] > 0:
        w = ti.max(view[3, 3] - c[2], ti.f32(0.0))
    elif c[2] > ti.f32(NEAR_PLANE):
        w = ti.f32(1.0) / c[2]
        scale *= w
    return vec4(view[3, 1] + c[0] * scale, view[3, 2] - c[1] * scale, w, scale)


@ti.func
def first(a):
    return ti.cast(ti.max(ti.floor(a), ti.f32(0.0)), ti.i32)


@ti.func
def last(a, size):
    """Index after the last pixel that reaches a."""
    return ti.cast(ti.min(ti.floor(a) + ti.f32(1.0), ti.cast(size, ti.f32)), ti.i32)


@ti.func
def draw_disc(seen: ti.template(), samples: ti.template(), q, r, bulge, identity, width, height):
    """A disc of r px about q whose closeness rises by `bulge` at the middle: a sphere in a parallel view."""
    top = key_of(seen, q[2] + bulge, identity)
    inverse = ti.f32(1.0) / (r * r)
    y0, y1 = first(q[1] - r), last(q[1] + r, height)
    x0, x1 = first(q[0] - r), last(q[0] + r, width)
    mark(seen, x0, x1, y0, y1, width)
    if r < ti.f32(THIN):
        mark_thin(seen, x0, x1, y0, y1, width)
    for y in range(y0, y1):
        for x in range(x0, x1):
            for s in ti.static(range(samples)):
                slot = (y * width + x) * samples + s
                dx = ti.cast(x, ti.f32) + ti.f32(ti.static(0.5 + SAMPLE_OFFSETS[samples][s][0])) - q[0]
                dy = ti.cast(y, ti.f32) + ti.f32(ti.static(0.5 + SAMPLE_OFFSETS[samples][s][1])) - q[1]
                h = ti.f32(1.0) - (dx * dx + dy * dy) * inverse
                if h > 0 and may_win(seen, slot, top):
                    put(seen, slot, q[2] + bulge * ti.sqrt(h), identity)


@ti.func
def tangents(a, z, r):
    """The slopes a/z of the two lines through the eye that touch a circle of radius r at (a, z)."""
    root = r * ti.sqrt(ti.max(a * a + z * z - r * r, ti.f32(0.0)))
    inverse = ti.f32(1.0) / (z * z - r * r)
    return (a * z - root) * inverse, (a * z + root) * inverse


@ti.func
def draw_ball(seen: ti.template(), samples: ti.template(), view, c, r, identity, width, height):
    """A sphere at c (view axes) in perspective, hit by the ray of every sample."""
    f = view[3, 0]
    left, right = tangents(c[0], c[2], r)
    low, high = tangents(c[1], c[2], r)
    top = key_of(seen, ti.f32(1.0) / (c[2] - r), identity)
    y0, y1 = first(view[3, 2] - f * high), last(view[3, 2] - f * low, height)
    x0, x1 = first(view[3, 1] + f * left), last(view[3, 1] + f * right, width)
    mark(seen, x0, x1, y0, y1, width)
    for y in range(y0, y1):
        for x in range(x0, x1):
            for s in ti.static(range(samples)):
                slot = (y * width + x) * samples + s
                if may_win(seen, slot, top):
                    dx = (ti.cast(x, ti.f32) + ti.f32(ti.static(0.5 + SAMPLE_OFFSETS[samples][s][0])) - view[3, 1]) / f
                    dy = (view[3, 2] - ti.cast(y, ti.f32) - ti.f32(ti.static(0.5 + SAMPLE_OFFSETS[samples][s][1]))) / f
                    scale = ti.f32(1.0) / (dx * dx + dy * dy + ti.f32(1.0))
                    t = (dx * c[0] + dy * c[1] + c[2]) * scale
                    miss = c - t * vec3(dx, dy, ti.f32(1.0))  # from the nearest point of the ray: no cancellation
                    h = r * r - miss.dot(miss)
                    if h > 0:
                        put(seen, slot, ti.f32(1.0) / (t - ti.sqrt(h * scale)), identity)


@ti.kernel
def draw_spheres(
    ball: ti.template(),
    seen: ti.template(),
    samples: ti.template(),
    exact: ti.template(),
    view: View,
    width: ti.i32,
    height: ti.i32,
    count: ti.i32,
):
    """Balls (x, y, z, radius); radius 0: not drawn. One that crosses the near plane is left out. exact: perspective."""
    for i in range(count):
        b = ball[i]
        if b[3] > 0:
            c = to_view(view, vec3(b[0], b[1], b[2]))
            q = screen(view, c)
            r = b[3] * q[3]
            identity = (SPHERE << 28) | i
            inside = q[0] + r > -1 and q[1] + r > -1 and q[0] - r < width + 1 and q[1] - r < height + 1
            if ti.static(exact):
                near = q[2] > 0 and c[2] - b[3] > ti.f32(NEAR_PLANE)
                if near and r >= ti.f32(EXACT_RADIUS):
                    draw_ball(seen, samples, view, c, b[3], identity, width, height)
                elif near and inside:
                    r = ti.max(r, ti.f32(SMALLEST_RADIUS))
                    draw_disc(seen, samples, q, r, b[3] * q[2] * q[2], identity, width, height)
            elif q[2] > 0 and inside:
                draw_disc(seen, samples, q, ti.max(r, ti.f32(SMALLEST_RADIUS)), b[3], identity, width, height)


@ti.func
def rod_ends(view, p, q):
    """Both ends on the screen, the segment clipped at the near plane; closeness 0 where all of it lies behind."""
    a, b = to_view(view, p), to_view(view, q)
    if view[3, 3] == 0:
        near = ti.f32(4 * NEAR_PLANE)
        if a[2] < near and b[2] > near:
            a += (b - a) * ((near - a[2]) / (b[2] - a[2]))
        elif b[2] < near and a[2] > near:
            b += (a - b) * ((near - b[2]) / (a[2] - b[2]))
    return screen(view, a), screen(view, b)


@ti.func
def draw_rod(seen: ti.template(), samples: ti.template(), a, b, r, identity, width, height):
    """A round rod of radius r (units) as a thick line on the screen, at least a thin line wide."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    squared = ti.max(dx * dx + dy * dy, ti.f32(1e-12))
    widest = ti.max(r * ti.max(a[3], b[3]), ti.f32(SMALLEST_RADIUS))
    half = widest * ti.sqrt(squared) / ti.max(ti.abs(dy), ti.f32(1e-6)) + ti.f32(1.0)  # half a row's span
    slope = dx / (dy if ti.abs(dy) > ti.f32(1e-6) else ti.f32(1e-6))
    xlow, xhigh = ti.min(a[0], b[0]) - widest, ti.max(a[0], b[0]) + widest
    for y in range(first(ti.min(a[1], b[1]) - widest), last(ti.max(a[1], b[1]) + widest, height)):
        middle = a[0] + (ti.cast(y, ti.f32) + ti.f32(0.5) - a[1]) * slope
        x0, x1 = first(ti.max(xlow, middle - half)), last(ti.min(xhigh, middle + half), width)
        mark(seen, x0, x1, y, y + 1, width)
        if widest < ti.f32(THIN):
            mark_thin(seen, x0, x1, y, y + 1, width)
        for x in range(x0, x1):
            for s in ti.static(range(samples)):
                ex = ti.cast(x, ti.f32) + ti.f32(ti.static(0.5 + SAMPLE_OFFSETS[samples][s][0])) - a[0]
                ey = ti.cast(y, ti.f32) + ti.f32(ti.static(0.5 + SAMPLE_OFFSETS[samples][s][1])) - a[1]
                u = ti.min(ti.max((ex * dx + ey * dy) / squared, ti.f32(0.0)), ti.f32(1.0))
                rx, ry = ex - u * dx, ey - u * dy
                wide = ti.max(r * (a[3] + u * (b[3] - a[3])), ti.f32(SMALLEST_RADIUS))
                h = ti.f32(1.0) - (rx * rx + ry * ry) / (wide * wide)
                if h > 0:
                    w = a[2] + u * (b[2] - a[2])
                    put(seen, (y * width + x) * samples + s, w, identity)


@ti.kernel
def draw_rods(
    ball: ti.template(),
    ends: ti.template(),
    radius: ti.template(),
    seen: ti.template(),
    samples: ti.template(),
    view: View,
    width: ti.i32,
    height: ti.i32,
    count: ti.i32,
):
    for i in range(count):
        k = ends[i]
        a, b = rod_ends(view, ball[k[0]].xyz, ball[k[1]].xyz)
        if a[2] > 0 and b[2] > 0:
            draw_rod(seen, samples, a, b, radius[i], (ROD << 28) | i, width, height)
