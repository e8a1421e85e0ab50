"""Flat pictures: discs, rods, triangles and half planes with analytic edges, one pixel at a time from lists by tile.

A shape is 8 numbers in px: disc (x, y, radius, pin 0 or 1), rod (x, y, x, y, radius, blunt 0 or 1),
triangle (x, y, x, y, x, y).
A body is 8 numbers in px: centre (x, y), direction of its x axis (x, y), half size (x, y), radius around that, hollow.
Lists hold the shapes that touch a tile in drawing order; pixels traverse them from the front until nothing shines through.
Colours are linear.
"""

from taichi_sim.kernels.render.finish import alpha_byte, encode

from taichi_sim.device.engine import ti

vec2 = ti.types.vector(2, ti.f32)
vec3 = ti.types.vector(3, ti.f32)
Look = ti.types.matrix(5, 3, ti.f32)  # rows: background at the top, at the bottom, wall, its hatching, its edge

DISC, ROD, TRIANGLE = 0, 1, 2
PIN_COLOUR = (0.02, 0.022, 0.03)


@ti.func
def unit(a):
    return ti.min(ti.max(a, ti.f32(0.0)), ti.f32(1.0))


@ti.func
def row(look, k):
    return vec3(look[k, 0], look[k, 1], look[k, 2])


@ti.func
def segment_distance(p, a, b, blunt):
    """Distance from p to the segment a b; blunt: nothing lies beyond the ends, so that joined segments do not overlap."""
    d = b - a
    t = (p - a).dot(d) / ti.max(d.dot(d), ti.f32(1e-12))
    result = (p - a - d * unit(t)).norm()
    if blunt > 0 and (t < 0 or t >= 1):
        result = ti.f32(1e9)
    return result


@ti.func
def disc(p, s, colour):
    """Coverage and colour: a darker rim, a soft light from above left, a dark dot when pinned."""
    centre, r = vec2(s[0], s[1]), s[2]
    distance = (p - centre).norm()
    rim = ti.min(r * ti.f32(0.16), ti.f32(2.2))
    inner = unit(r - rim - distance + ti.f32(0.5)) if r > 2 else ti.f32(0.8)
    slope = (centre[0] - p[0] + centre[1] - p[1]) / (r * 2)
    body = colour * (1 + ti.f32(0.10) * slope) + ti.max(slope, ti.f32(0.0)) * ti.f32(0.05)
    c = colour * ti.f32(0.45) * (1 - inner) + body * inner
    if s[3] > 0:
        dot = unit(ti.max(r * ti.f32(0.36), ti.f32(1.2)) - distance + ti.f32(0.5))
        ring = unit(ti.max(r * ti.f32(0.52), ti.f32(1.8)) - distance + ti.f32(0.5))
        c = c * (1 - ring) + vec3(0.9, 0.9, 0.9) * ring
        c = c * (1 - dot) + vec3(PIN_COLOUR) * dot
    return unit(r - distance + ti.f32(0.5)), c


@ti.func
def triangle_coverage(p, s):
    """Half a pixel fat, so that neighbours leave no seam."""
    a, b, c = vec2(s[0], s[1]), vec2(s[2], s[3]), vec2(s[4], s[5])
    area = (b - a).cross(c - a)
    winding = ti.f32(1.0) if area > 0 else ti.f32(-1.0)
    inside = ti.f32(1e9)
    for k in ti.static(range(3)):
        u, v = (a, b, c)[k], (b, c, a)[k]
        e = v - u
        inside = ti.min(inside, winding * e.cross(p - u) / ti.max(e.norm(), ti.f32(1e-9)))
    return unit(inside + ti.f32(0.99)) if ti.abs(area) > ti.f32(1e-6) else ti.f32(0.0)


@ti.func
def body_distance(s, q):
    """Distance [px] from q, in the axes of a collider, to its surface; negative inside."""
    inner = vec2(ti.max(ti.abs(q[0]) - s[4], ti.f32(0.0)), ti.max(ti.abs(q[1]) - s[5], ti.f32(0.0)))
    d = inner.norm() + ti.min(ti.max(ti.abs(q[0]) - s[4], ti.abs(q[1]) - s[5]), ti.f32(0.0)) * ti.f32(s[6] == 0)
    d -= s[6]
    if s[7] > 0:
        d = ti.max(-d, d - s[7])
    return d


@ti.func
def backdrop(p, scene: ti.template(), walls, bodies, look, height):
    """The background gradient, the half planes and the colliders, hatched near their edge; the hatching rotates with them. Their
    colour, and how much of the pixel walls and colliders cover."""
    top, bottom = row(look, 0), row(look, 1)
    result = top + (bottom - top) * unit(p[1] / height)
    d = ti.f32(1e9)  # px to the nearest wall, positive in the open; negative: depth inside the union
    for k in range(walls):
        d = ti.min(d, scene.wall[k][0] * p[0] + scene.wall[k][1] * p[1] + scene.wall[k][2])
    across, nearest = p[0] + p[1], -1
    for k in range(bodies):
        s = scene.body[k]
        r = p - vec2(s[0], s[1])
        q = vec2(r[0] * s[2] + r[1] * s[3], r[1] * s[2] - r[0] * s[3])
        e = body_distance(s, q)
        if e < d:
            d, across, nearest = e, q[0] + q[1], k
    solid = unit(ti.f32(0.5) - d)
    if solid > 0:
        plain, hatch, edge = row(look, 2), row(look, 3), row(look, 4)
        if nearest >= 0 and scene.tint[nearest][0] >= 0:
            plain = scene.tint[nearest]
            hatch, edge = plain * ti.f32(0.65), plain * ti.f32(0.2)
        stripe = across / ti.f32(11.0)
        line = unit(ti.f32(1.2) - ti.abs(stripe - ti.floor(stripe) - ti.f32(0.5)) * ti.f32(7.8))
        fill = plain + (hatch - plain) * (line * ti.exp(d / 60))
        border = unit(d + ti.f32(2.5))
        if ti.static(scene.transparent):
            rim = solid * border
            cover = rim + solid * (1 - rim)
            result = (edge * rim + fill * (solid * (1 - rim))) / cover
            solid = cover
        else:
            result += (fill - result) * solid
            result += (edge - result) * (solid * border)
    return result, solid


@ti.kernel
def paint(
    scene: ti.template(),
    entry: ti.types.ndarray(ti.i32, 1),
    start: ti.types.ndarray(ti.i32, 1),
    look: Look,
    walls: ti.i32,
    bodies: ti.i32,
    tile: ti.i32,
    width: ti.i32,
    height: ti.i32,
):
    """scene: fields of shapes, walls and bodies and of the picture, see `Canvas` of the 2D renderer. entry: shapes of all tiles,
    one tile after the other, each in drawing order; start: where a tile's begin."""
    for pixel in range(width * height):
        x, y = pixel % width, pixel // width
        p = vec2(ti.cast(x, ti.f32) + ti.f32(0.5), ti.cast(y, ti.f32) + ti.f32(0.5))
        cell = (y // tile) * ((width + tile - 1) // tile) + x // tile
        total, through = vec3(0, 0, 0), ti.f32(1.0)
        e = start[cell + 1] - 1
        while e >= start[cell] and through > ti.f32(0.003):
            i = entry[e]
            s, c, cover = scene.shape[i], vec3(0, 0, 0), ti.f32(0.0)
            if scene.kind[i] == DISC:
                dx, dy, reach = p[0] - s[0], p[1] - s[1], s[2] + ti.f32(0.5)
                if dx * dx + dy * dy < reach * reach:
                    cover, c = disc(p, s, scene.colour[i])
            elif scene.kind[i] == ROD:
                distance = segment_distance(p, vec2(s[0], s[1]), vec2(s[2], s[3]), s[5])
                cover = unit(s[4] - distance + ti.f32(0.5))
                c = scene.colour[i]
                if s[4] > 3:
                    c *= 1 - ti.f32(0.5) * unit(distance - s[4] + ti.f32(2.0))
            else:
                cover = triangle_coverage(p, s)
                c = scene.colour[i]
            total += c * (cover * through)
            through *= 1 - cover
            e -= 1
        if through > ti.f32(0.003):
            far, solid = backdrop(p, scene, walls, bodies, look, ti.cast(height, ti.f32))
            if ti.static(scene.transparent):
                total += far * (solid * through)
                through *= 1 - solid
            else:
                total += far * through
        alpha = 0
        if ti.static(scene.transparent):
            alpha = alpha_byte(1 - through if through > ti.f32(0.003) else ti.f32(1.0))
            total /= ti.max(1 - through, ti.f32(1e-6))
        scene.packed[pixel] = encode(total, x, y) | alpha
