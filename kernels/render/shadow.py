"""Shadows of the lamp: a filtered map of what lies nearest to it, blurred by the distance of what casts them."""

from taichi_sim.kernels.render.raster import screen, to_view, vec2
from taichi_sim.kernels.render.visibility import TILE, closeness, found

from taichi_sim.device.engine import ti

LAMP_SOFTNESS = 0.10  # tangent of the lamp's half angle: how fast a shadow blurs with the distance of what casts it
WIDEST_BLUR = 13.0  # texels: the largest blur
COARSE_TEXELS = TILE  # texels of the shadow map in a coarse cell, more than WIDEST_BLUR + 1
BLOCKER_TAPS, BLUR_TAPS = 14, 16  # taps that look for blockers, and at most that blur


@ti.func
def shadow_tap(shadow: ti.template(), size, x, y):
    """Closeness to the light at the nearest texel; 0 outside."""
    w = ti.f32(0.0)
    i, j = ti.cast(ti.floor(x), ti.i32), ti.cast(ti.floor(y), ti.i32)
    if i >= 0 and j >= 0 and i < size and j < size:
        w = closeness(shadow, found(shadow, j * size + i))
    return w


@ti.func
def shadow_smooth(shadow: ti.template(), size, x, y, w):
    """Part of the four texels about (x, y) that is nearer to the light than w, weighted bilinearly; nothing outside."""
    fx, fy = ti.floor(x - ti.f32(0.5)), ti.floor(y - ti.f32(0.5))
    i, j = ti.cast(fx, ti.i32), ti.cast(fy, ti.i32)
    total = ti.f32(0.0)
    if i >= 0 and j >= 0 and i < size - 1 and j < size - 1:
        ux, uy = x - ti.f32(0.5) - fx, y - ti.f32(0.5) - fy
        slot = j * size + i
        upper, lower = ti.f32(0.0), ti.f32(0.0)
        if closeness(shadow, found(shadow, slot)) > w:
            upper += 1 - ux
        if closeness(shadow, found(shadow, slot + 1)) > w:
            upper += ux
        if closeness(shadow, found(shadow, slot + size)) > w:
            lower += 1 - ux
        if closeness(shadow, found(shadow, slot + size + 1)) > w:
            lower += ux
        total = upper * (1 - uy) + lower * uy
    return total


@ti.func
def shadow_depth(shadow: ti.template(), size, x, y):
    """Closeness to the light between the four texels about (x, y), bilinear, times the share of them that show anything, and
    this share."""
    fx, fy = ti.floor(x - ti.f32(0.5)), ti.floor(y - ti.f32(0.5))
    ux, uy = x - ti.f32(0.5) - fx, y - ti.f32(0.5) - fy
    total, share = ti.f32(0.0), ti.f32(0.0)
    for k in ti.static(range(4)):
        w = shadow_tap(shadow, size, fx + ti.f32(k % 2 + 0.5), fy + ti.f32(k // 2 + 0.5))
        if w > 0:
            part = (ux if ti.static(k % 2 == 1) else 1 - ux) * (uy if ti.static(k // 2 == 1) else 1 - uy)
            total += part * w
            share += part
    return total, share


@ti.func
def rotated(d):
    """A direction rotated by the golden angle: successive ones fill a disc evenly."""
    return vec2(
        ti.f32(-0.7373688) * d[0] - ti.f32(0.6754903) * d[1], ti.f32(0.6754903) * d[0] - ti.f32(0.7373688) * d[1]
    )


@ti.func
def blocker_search(shadow: ti.template(), size, q, level, per_px):
    """Share of a wide disc about q that lies nearer to the light, and the mean closeness there."""
    blockers, nearest = 0, ti.f32(0.0)
    direction = vec2(1.0, 0.0)
    for k in range(BLOCKER_TAPS):
        reach = ti.f32(WIDEST_BLUR) * ti.sqrt(ti.cast(k, ti.f32) / (BLOCKER_TAPS - 1))
        w = shadow_tap(shadow, size, q[0] + reach * direction[0], q[1] + reach * direction[1])
        if w > level + per_px * reach:
            blockers += 1
            nearest += w
        direction = rotated(direction)
    return blockers, nearest / ti.cast(ti.max(blockers, 1), ti.f32)


@ti.func
def blurred(shadow: ti.template(), size, q, level, radius):
    """Share of a disc of `radius` texels about q that is not in shadow."""
    total = ti.f32(0.0)
    direction = vec2(1.0, 0.0)
    taps = ti.min(ti.cast(radius * 2, ti.i32) + 5, BLUR_TAPS)
    for k in range(taps):
        reach = radius * ti.sqrt((ti.cast(k, ti.f32) + ti.f32(0.5)) / taps)
        total += shadow_smooth(shadow, size, q[0] + reach * direction[0], q[1] + reach * direction[1], level)
        direction = rotated(direction)
    return 1 - total / taps


@ti.func
def light_place(light, p, n, slope):
    """Place (x, y) texels at which a point is looked up in the shadow map, and the closeness that casts a shadow on it."""
    texel = 1 / light[3, 0]
    q = screen(light, to_view(light, p + n * (texel * (1 + ti.min(slope, ti.f32(2.0))))))
    return q, q[2] + texel * (ti.f32(0.6) + ti.f32(0.6) * ti.min(slope, ti.f32(3.0)))


@ti.func
def slope_of(cosine):
    """Tangent of an angle, bounded."""
    return ti.sqrt(ti.max(1 - cosine * cosine, ti.f32(0.0))) / ti.max(cosine, ti.f32(0.1))


@ti.func
def filtered(scene: ti.template(), light, q, level, slope, pixel):
    """Share of the lamp, and the texels that it is blurred over: blockers searched near by, then a blur as wide as they are far,
    and as a pixel is, so many texels."""
    texel = 1 / light[3, 0]
    per_px = texel * ti.min(slope, ti.f32(3.0))
    result, radius = ti.f32(1.0), ti.f32(WIDEST_BLUR)
    size = scene.shadow_size
    blockers, nearest = blocker_search(scene.shadow, size, q, level, per_px)
    if blockers > 0:
        narrowest = ti.max(ti.f32(1.2), ti.f32(0.5) * pixel)
        radius = ti.min(ti.max((nearest - q[2]) * ti.f32(LAMP_SOFTNESS) / texel, narrowest), ti.f32(WIDEST_BLUR))
        if blockers < BLOCKER_TAPS or radius > ti.f32(WIDEST_BLUR * 0.5):
            result = blurred(scene.shadow, size, q, level + per_px * radius * ti.f32(0.5), radius)
        else:
            result = ti.f32(0.0)
    return result, radius


@ti.func
def coarse_cell(cells, x, y):
    """The coarse cell of a place in the shadow map, -1 outside."""
    i, j = ti.cast(ti.floor(x / COARSE_TEXELS), ti.i32), ti.cast(ti.floor(y / COARSE_TEXELS), ti.i32)
    return j * cells + i if i >= 0 and j >= 0 and i < cells and j < cells else -1


@ti.kernel
def coarsen(shadow: ti.template(), cell: ti.template(), coarse: ti.template(), thin: ti.template(), size: ti.i32):
    """Find for every cell of the shadow map the largest closeness in it and its eight neighbours, above which all is lit, and
    whether there is anything thin."""
    for c in cell:
        across = size // COARSE_TEXELS
        nearest = ti.f32(0.0)
        if shadow.marked[c] > 0:
            for j in range((c // across) * COARSE_TEXELS, (c // across + 1) * COARSE_TEXELS):
                for i in range((c % across) * COARSE_TEXELS, (c % across + 1) * COARSE_TEXELS):
                    nearest = ti.max(nearest, closeness(shadow, found(shadow, j * size + i)))
        cell[c] = nearest
    for c in coarse:
        across = size // COARSE_TEXELS
        w, any_thin = ti.f32(0.0), 0
        for j in range(ti.max(c // across - 1, 0), ti.min(c // across + 2, across)):
            for i in range(ti.max(c % across - 1, 0), ti.min(c % across + 2, across)):
                w = ti.max(w, cell[j * across + i])
                any_thin |= shadow.thin[j * across + i]
        coarse[c] = w
        thin[c] = any_thin
