"""Light: from the visible primitive of every sample to the colour of every pixel, linear, in 0..1.

A warm key light with a filtered shadow map, a cool fill and sky, a bounce from the ground, a soft highlight.
Colours are linear.
"""

from taichi_sim.kernels.render.raster import ROD, SPHERE, TRIANGLE, edge, rod_ends, screen, to_view, vec2, vec3
from taichi_sim.kernels.render.visibility import closeness, found

from taichi_sim.device.engine import ti

KEY_LIGHT = (2.35, 2.18, 1.92)  # light from the lamp
FILL_LIGHT = (0.26, 0.30, 0.38)  # cool light from the other side, without shadow
SKY_LIGHT = (0.50, 0.60, 0.76)  # light from above
BOUNCE_LIGHT = (0.34, 0.31, 0.29)  # light from below
LAMP_SOFTNESS = 0.10  # tangent of the lamp's half angle: how fast a shadow blurs with the distance of what casts it
WIDEST_BLUR = 13.0  # texels: the largest blur
COARSE_TEXELS = 16  # texels of the shadow map in a coarse cell, more than WIDEST_BLUR + 1
BLOCKER_TAPS, BLUR_TAPS = 14, 16  # taps that look for blockers, and that blur
STRETCHED_COLOUR, COMPRESSED_COLOUR, STEEL_COLOUR = (0.62, 0.06, 0.05), (0.03, 0.16, 0.60), (0.33, 0.34, 0.36)


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
    """How much of the four texels about (x, y) is nearer to the light than w, weighted bilinearly."""
    fx, fy = x - ti.f32(0.5), y - ti.f32(0.5)
    ux, uy = fx - ti.floor(fx), fy - ti.floor(fy)
    total = ti.f32(0.0)
    for j in ti.static(range(2)):
        for i in ti.static(range(2)):
            weight = (ux if ti.static(i == 1) else 1 - ux) * (uy if ti.static(j == 1) else 1 - uy)
            if shadow_tap(shadow, size, fx + i, fy + j) > w:
                total += weight
    return total


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
    for k in range(BLUR_TAPS):
        reach = radius * ti.sqrt((ti.cast(k, ti.f32) + ti.f32(0.5)) / BLUR_TAPS)
        total += shadow_smooth(shadow, size, q[0] + reach * direction[0], q[1] + reach * direction[1], level)
        direction = rotated(direction)
    return 1 - total / BLUR_TAPS


@ti.func
def lit(scene: ti.template(), light, p, n, slope):
    """Share of the lamp that reaches p: blockers searched near by, then a blur as wide as they are far."""
    texel = 1 / light[3, 0]
    q = screen(light, to_view(light, p + n * (texel * (1 + ti.min(slope, ti.f32(2.0))))))
    level = q[2] + texel * (ti.f32(0.6) + ti.f32(0.6) * ti.min(slope, ti.f32(3.0)))
    per_px = texel * ti.min(slope, ti.f32(3.0))
    result = ti.f32(1.0)
    size = scene.shadow_size
    if coarse_tap(scene.coarse, size // COARSE_TEXELS, q[0], q[1]) > level:
        blockers, nearest = blocker_search(scene.shadow, size, q, level, per_px)
        if blockers > 0:
            radius = ti.min(ti.max((nearest - q[2]) * ti.f32(LAMP_SOFTNESS) / texel, ti.f32(1.2)), ti.f32(WIDEST_BLUR))
            if blockers < BLOCKER_TAPS or radius > ti.f32(WIDEST_BLUR * 0.5):
                result = blurred(scene.shadow, size, q, level + per_px * radius * ti.f32(0.5), radius)
            else:
                result = ti.f32(0.0)
    return result


@ti.func
def coarse_tap(coarse: ti.template(), cells, x, y):
    w = ti.f32(0.0)
    i, j = ti.cast(ti.floor(x / COARSE_TEXELS), ti.i32), ti.cast(ti.floor(y / COARSE_TEXELS), ti.i32)
    if i >= 0 and j >= 0 and i < cells and j < cells:
        w = coarse[j * cells + i]
    return w


@ti.kernel
def coarsen(shadow: ti.template(), cell: ti.template(), coarse: ti.template(), size: ti.i32):
    """For every cell of the shadow map the largest closeness in it and its eight neighbours: above it all is lit."""
    for c in cell:
        across = size // COARSE_TEXELS
        nearest = ti.f32(0.0)
        for j in range((c // across) * COARSE_TEXELS, (c // across + 1) * COARSE_TEXELS):
            for i in range((c % across) * COARSE_TEXELS, (c % across + 1) * COARSE_TEXELS):
                nearest = ti.max(nearest, closeness(shadow, found(shadow, j * size + i)))
        cell[c] = nearest
    for c in coarse:
        across = size // COARSE_TEXELS
        w = ti.f32(0.0)
        for j in range(ti.max(c // across - 1, 0), ti.min(c // across + 2, across)):
            for i in range(ti.max(c % across - 1, 0), ti.min(c % across + 2, across)):
                w = ti.max(w, cell[j * across + i])
        coarse[c] = w


@ti.func
def sky(up, top, horizon):
    """Background in a direction whose height is `up` (-1..1)."""
    t = ti.min(ti.max(up * ti.f32(1.6) + ti.f32(0.25), ti.f32(0.0)), ti.f32(1.0))
    return horizon + (top - horizon) * (t * t * (3 - 2 * t))


@ti.func
def grid_line(a, footprint):
    """Coverage of lines of unit spacing, filtered over a footprint."""
    d = ti.abs(a - ti.floor(a + ti.f32(0.5)))
    wide = ti.f32(0.012) + footprint
    return (
        ti.min(ti.max((wide - d) / ti.max(footprint, ti.f32(1e-4)), ti.f32(0.0)), ti.f32(1.0))
        * ti.f32(0.012)
        / wide
        * 2
    )


@ti.func
def ground(p, n, width, spacing):
    """Share of the horizon's colour on a plane: fine lines of `spacing`, a faint checker, filtered over `width`."""
    helper = vec3(1, 0, 0)
    if ti.abs(n[0]) > ti.f32(0.7):
        helper = vec3(0, 0, 1)
    v = helper.cross(n).normalized()
    u = n.cross(v)
    a, b = p.dot(u) / spacing, p.dot(v) / spacing
    footprint = width / spacing
    line = ti.max(grid_line(a, footprint), grid_line(b, footprint))
    sharp = ti.min(ti.max((a - ti.floor(a)) - ti.f32(0.5), -1), 1) * ((b - ti.floor(b)) - ti.f32(0.5))
    checker = ti.f32(0.5) if sharp > 0 else ti.f32(-0.5)
    fade = 1 / (1 + footprint * footprint * 60)
    return vec3(0.775, 0.765, 0.755) * (1 + ti.f32(0.05) * checker * fade - ti.f32(0.30) * line * fade)


@ti.func
def spring_colour(strain):
    """Steel at rest, red stretched, blue compressed; full at a tenth."""
    t = ti.min(ti.abs(strain) * 10, ti.f32(1.0))
    end = vec3(STRETCHED_COLOUR)
    if strain < 0:
        end = vec3(COMPRESSED_COLOUR)
    return vec3(STEEL_COLOUR) * (1 - t) + end * t


@ti.func
def surface(scene: ti.template(), view, eye, ray, identity, w, px, py):
    """Point, normal (towards the eye), colour and gloss of what a pixel sees."""
    kind, i = identity >> 28, identity & 0xFFFFFFF
    p, n, colour, gloss = eye + ray / w, -ray.normalized(), vec3(0.5, 0.5, 0.5), ti.f32(0.2)
    if ti.static(scene.has_spheres):  # without them there is no such field
        if kind == SPHERE:
            b = scene.ball[i]
            c = b.xyz - eye
            scale = 1 / ray.dot(ray)
            t = c.dot(ray) * scale
            miss = c - ray * t
            n = -(miss + ray * ti.sqrt(ti.max(b[3] * b[3] - miss.dot(miss), ti.f32(0.0)) * scale)).normalized()
            p = b.xyz + n * b[3]
            colour, gloss = scene.colour[i], ti.f32(0.35)
    if ti.static(scene.has_rods):  # without them there is no such field
        if kind == ROD:
            k = scene.rod[i]
            a, b = rod_ends(view, scene.ball[k[0]].xyz, scene.ball[k[1]].xyz)
            dx, dy = b[0] - a[0], b[1] - a[1]
            length = ti.sqrt(ti.max(dx * dx + dy * dy, ti.f32(1e-12)))
            u = ti.min(ti.max(((px - a[0]) * dx + (py - a[1]) * dy) / (length * length), ti.f32(0.0)), ti.f32(1.0))
            wide = ti.max(scene.rod_radius[i] * (a[3] + u * (b[3] - a[3])), ti.f32(0.55))
            side = ti.min(ti.max(((px - a[0]) * dy - (py - a[1]) * dx) / (length * wide), ti.f32(-1.0)), ti.f32(1.0))
            right = vec3(view[0, 0], view[0, 1], view[0, 2]) * dy + vec3(view[1, 0], view[1, 1], view[1, 2]) * dx
            n = (right / length * side + n * ti.sqrt(1 - side * side)).normalized()
            colour, gloss = spring_colour(scene.rod_strain[i]), ti.f32(0.5)
    if ti.static(scene.has_triangles):  # without them there is no such field
        if kind == TRIANGLE:
            k = scene.corner[i]
            a, b, c = scene.ball[k[0]].xyz, scene.ball[k[1]].xyz, scene.ball[k[2]].xyz
            qa, qb, qc = screen(view, to_view(view, a)), screen(view, to_view(view, b)), screen(view, to_view(view, c))
            winding = ti.f32(1.0)
            if edge(qb[0] - qa[0], qb[1] - qa[1], qc[0] - qa[0], qc[1] - qa[1]) < 0:
                winding = ti.f32(-1.0)
            wa = ti.max(winding * edge(qb[0] - px, qb[1] - py, qc[0] - px, qc[1] - py), ti.f32(0.0)) * qa[2]
            wb = ti.max(winding * edge(qc[0] - px, qc[1] - py, qa[0] - px, qa[1] - py), ti.f32(0.0)) * qb[2]
            wc = ti.max(winding * edge(qa[0] - px, qa[1] - py, qb[0] - px, qb[1] - py), ti.f32(0.0)) * qc[2]
            flat = (b - a).cross(c - a)
            smooth = scene.normal[k[0]] * wa + scene.normal[k[1]] * wb + scene.normal[k[2]] * wc
            total = ti.max(wa + wb + wc, ti.f32(1e-30))
            if smooth.norm() < ti.f32(0.2) * total or smooth.dot(flat) < 0:
                smooth = flat
            if flat.dot(ray) > 0:
                smooth = -smooth
            n = smooth / ti.max(smooth.norm(), ti.f32(1e-30))
            # w is that of a sample beside the pixel's centre: in its own shadow, where pixels are large
            if total > ti.f32(1e-20):
                p = (a * wa + b * wb + c * wc) / total
            colour = (scene.colour[k[0]] * wa + scene.colour[k[1]] * wb + scene.colour[k[2]] * wc) / total
            if flat.dot(ray) > 0:
                colour *= ti.f32(0.82)
            gloss = ti.f32(0.15)
    return p, n, colour, gloss


@ti.func
def illuminate(colour, gloss, n, ray, lamp, fill, light_share, openness):
    """Colour of a surface under the lamp, the sky and the bounce."""
    to_eye = -ray.normalized()
    cosine = ti.max(n.dot(lamp), ti.f32(0.0)) * light_share
    up = ti.f32(0.5) + ti.f32(0.5) * n[1]
    ambient = (vec3(BOUNCE_LIGHT) * (1 - up) + vec3(SKY_LIGHT) * up) * openness
    half = (lamp + to_eye).normalized()
    shine = ti.max(n.dot(half), ti.f32(0.0))
    shine *= shine  # power 32 by squaring
    shine *= shine
    shine *= shine
    shine *= shine
    shine *= shine
    rim = 1 - ti.max(n.dot(to_eye), ti.f32(0.0))
    rim *= rim
    aside = ti.max(n.dot(fill), ti.f32(0.0)) * openness
    result = colour * (vec3(KEY_LIGHT) * (cosine * ti.f32(0.62)) + vec3(FILL_LIGHT) * aside + ambient)
    return (
        result
        + vec3(KEY_LIGHT) * (shine * gloss * light_share * ti.f32(0.35))
        + vec3(SKY_LIGHT) * (rim * rim * openness * (ti.f32(0.05) + gloss * ti.f32(0.3)))
    )
