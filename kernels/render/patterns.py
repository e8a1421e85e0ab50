"""Patterns and textures: colours at a place on a surface, as their mean over a pixel."""

from taichi_sim.kernels.render.raster import vec2, vec3, vec4

from taichi_sim.device.engine import ti

# of a thread: how it darkens with the square of the way from its middle to its sides, and to where it goes under another one
SIDES, ENDS = 1.6, 1.2
WOVEN_MEAN = (1 - SIDES / 12) * (1 - ENDS / 12)  # mean brightness
MOST_TAPS = 8.0  # places of a texture in one pixel
ALMOST_SQUARE = 0.25  # part by which one side of a pixel may be longer than the other for one place to do


@ti.func
def rise(a):
    """Integral of a wave of 1 and -1 in turn, each for half of a unit."""
    d = a - ti.floor(a) - ti.f32(0.5)
    return d if ti.abs(d) < ti.f32(0.25) else (ti.f32(0.5) if d > 0 else ti.f32(-0.5)) - d


@ti.func
def wave(a, width):
    """Mean over a width about a of 1 and -1 in turn, each for half of a unit."""
    wide = ti.max(width, ti.f32(0.002))
    return (rise(a + wide / 2) - rise(a - wide / 2)) / wide


@ti.func
def pattern(kind, place, width):
    """Share of the other colour at a place in a pattern, smoothed over a width along each axis: stripes, or checks."""
    sign = wave(place[0], width[0])
    if kind > 1:
        sign *= wave(place[1], width[1]) * wave(place[2], width[2])
    return ti.f32(0.5) - ti.f32(0.5) * sign


@ti.func
def thread_sums(a):
    """Second integrals, of period 2 without jumps, of four functions of a place a across threads 1 apart, t from the middle of
    its thread, sign 1 on one thread and -1 on the next: 1/12 - t^2, sign, sign t^2 and t."""
    t, sign = a - ti.floor(a) - ti.f32(0.5), ti.f32(1 - 2 * (ti.cast(ti.floor(a), ti.i32) & 1))
    square = t * t
    return vec4(
        square * (1 - 2 * square) / 24,
        sign * (square / 2 - ti.f32(0.125)),
        sign * (square * square - ti.f32(0.0625)) / 12,
        t * (square / 6 - ti.f32(1 / 24)),
    )


@ti.func
def thread_means(a, width):
    """Means of these functions about a, weighted by a tent that is three widths wide: beyond half a thread in a width, where
    pixels would show rings in place of threads, at most a tenth is left."""
    reach = ti.max(ti.f32(1.5) * width, ti.f32(0.05))
    a -= 2 * ti.floor(a / 2)
    return (thread_sums(a - reach) - 2 * thread_sums(a) + thread_sums(a + reach)) / (reach * reach)


@ti.func
def darker(means, part: ti.template()):
    """Means of 1 - part t^2, and of its product with the sign (see `thread_sums`)."""
    return vec2(ti.static(1 - part / 12) + ti.f32(part) * means[0], means[1] - ti.f32(part) * means[2])


@ti.func
def woven(place, width, colour, weft):
    """Colour of a plain weave of threads, 1 apart, about a place, and the slopes of the threads along both axes; their means
    where a width holds more than half a thread."""
    x, y = thread_means(place[0], width[0]), thread_means(place[1], width[1])
    side_x, end_x, side_y, end_y = darker(x, SIDES), darker(x, ENDS), darker(y, SIDES), darker(y, ENDS)
    warp = side_x[0] * end_y[0] - side_x[1] * end_y[1]  # on top where the signs along both axes differ
    over = side_y[0] * end_x[0] + side_y[1] * end_x[1]
    return (colour * warp + weft * over) * ti.f32(ti.static(0.5 / WOVEN_MEAN)), vec2(x[3], y[3])


@ti.func
def hem(place, width, wide):
    """Factors of the colour and of the light that comes through at the border of a sheet, folded over once and stitched."""
    x, y = ti.min(place[0], 1 - place[0]), ti.min(place[1], 1 - place[1])
    inner, run, wider = x, place[1], ti.max(width[0], width[1])
    if y < x:
        inner, run = y, place[0]
    fold = ti.min(ti.max((wide - inner) / ti.max(wider, ti.f32(1e-6)) + ti.f32(0.5), ti.f32(0.0)), ti.f32(1.0))
    stitch = ti.max(1 - ti.abs(inner - ti.f32(0.8) * wide) / ti.max(ti.f32(0.1) * wide, wider), ti.f32(0.0))
    stitch *= ti.min(ti.f32(0.1) * wide / ti.max(wider, ti.f32(1e-6)), ti.f32(1.0))
    dash = ti.f32(0.5) + ti.f32(0.5) * wave(run / (ti.f32(0.8) * wide), wider / (ti.f32(0.8) * wide))
    return 1 - fold * ti.f32(0.12) - ti.f32(0.5) * stitch * dash, 1 - fold * ti.f32(0.5)


@ti.func
def texels(scene: ti.template(), first, across, down, place):
    """Colour between four texels of one size of a texture, whose texels begin at `first`."""
    x = (place[0] - ti.floor(place[0])) * across - ti.f32(0.5)
    y = (1 - place[1] + ti.floor(place[1])) * down - ti.f32(0.5)
    i, j = ti.cast(ti.floor(x), ti.i32), ti.cast(ti.floor(y), ti.i32)
    u, v = x - ti.floor(x), y - ti.floor(y)
    i0, i1 = ti.max(i, 0), ti.min(i + 1, across - 1)
    j0, j1 = ti.max(j, 0), ti.min(j + 1, down - 1)
    upper = scene.texel[first + j0 * across + i0] * (1 - u) + scene.texel[first + j0 * across + i1] * u
    lower = scene.texel[first + j1 * across + i0] * (1 - u) + scene.texel[first + j1 * across + i1] * u
    return upper * (1 - v) + lower * v


@ti.func
def texture_at(scene: ti.template(), style, place, beside, below, low, high):
    """Colour of a texture over a pixel, whose sides are `beside` and `below` long there: a mean along the longer one of places
    within low and high, each between two sizes of the texture, each half the last one, that fit the shorter one."""
    first, across, down = ti.cast(style[4], ti.i32), ti.cast(style[5], ti.i32), ti.cast(style[6], ti.i32)
    sides = vec3(style[5], style[6], 0)
    long, short = (beside * sides).norm(), (below * sides).norm()
    way = beside
    if short > long:
        long, short, way = short, long, below
    taps = ti.cast(
        ti.min(ti.ceil(long / ti.max(short, ti.f32(1.0)) - ti.f32(ALMOST_SQUARE)), ti.f32(MOST_TAPS)), ti.i32
    )
    taps = ti.max(taps, 1)
    wide = ti.max(short, long / taps)
    while wide > 2 and ti.max(across, down) > 1:
        first += across * down
        across, down = (across + 1) // 2, (down + 1) // 2
        wide *= ti.f32(0.5)
    blend = ti.min(ti.max(wide - 1, ti.f32(0.0)), ti.f32(1.0))
    if ti.max(across, down) == 1:
        blend = ti.f32(0.0)
    total = vec3(0, 0, 0)
    for k in range(taps):
        at = place + way * ((ti.cast(k, ti.f32) + ti.f32(0.5)) / taps - ti.f32(0.5))
        at = ti.min(ti.max(at, low), high)
        colour = texels(scene, first, across, down, at)
        if blend > 0:
            coarser = texels(scene, first + across * down, (across + 1) // 2, (down + 1) // 2, at)
            colour += (coarser - colour) * blend
        total += colour
    return total / taps
