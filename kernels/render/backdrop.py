"""Sky and ground behind everything, which stay the same while the camera does.

Planes of a view are rows (a, b, c): closeness a x + b y + c at a place (x, y) px of the picture, where positive.
"""

from taichi_sim.kernels.render.finish import encode
from taichi_sim.kernels.render.raster import SAMPLE_OFFSETS, View, vec3
from taichi_sim.kernels.render.shade import LAMP_SHARE, axis, illuminate, pixel_ray, tone, untoned
from taichi_sim.kernels.render.shadow import COARSE_TEXELS, coarse_cell, light_place, slope_of
from taichi_sim.kernels.render.visibility import TILE, tiles_across

from taichi_sim.device.engine import ti

FAR = 1e30  # closeness beyond all


@ti.func
def sky(scene: ti.template(), ray, look):
    """Background along a ray: from the horizon to the zenith, with a glow of the stage's above the horizon below the lamp."""
    up, top, horizon = ray[1] / ray.norm(), axis(look, 2), axis(look, 3)
    t = ti.min(ti.max(up * ti.f32(1.6) + ti.f32(0.25), ti.f32(0.0)), ti.f32(1.0))
    colour = horizon + (top - horizon) * (t * t * (3 - 2 * t))
    if ti.static(scene.stage.glow != (0.0, 0.0, 0.0)):
        lamp = axis(look, 0)
        level = ti.sqrt((ray[0] * ray[0] + ray[2] * ray[2]) * (lamp[0] * lamp[0] + lamp[2] * lamp[2]))
        near = ti.f32(0.5) + ti.f32(0.5) * (ray[0] * lamp[0] + ray[2] * lamp[2]) / ti.max(level, ti.f32(1e-9))
        near *= near
        colour += vec3(scene.stage.glow) * (look[1, 3] * near * near / (1 + 12 * up * up))
    return colour


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
def ground(scene: ti.template(), p, n, width, spacing, horizon):
    """Colour of a plane: that of the horizon with fine lines of `spacing` and a faint checker, filtered over `width`."""
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
    plain = ti.min(horizon * vec3(scene.stage.floor), ti.f32(1.0)) * (1 + scene.stage.checker * checker * fade)
    if ti.static(scene.stage.line > 0):
        plain += (1 - plain) * (scene.stage.line * line * fade)
    else:
        plain *= 1 + scene.stage.line * line * fade
    return plain


@ti.func
def nearest_plane(on_screen, count, x, y):
    """Closeness and number, from 1 on, of the plane that is seen there; 0 for the sky."""
    nearest, which = ti.f32(0.0), 0
    for k in range(count):
        w = on_screen[k, 0] * x + on_screen[k, 1] * y + on_screen[k, 2]
        if w > nearest:
            nearest, which = w, k + 1
    return nearest, which


@ti.func
def plane_normal(planes, k):
    return vec3(planes[k, 0], planes[k, 1], planes[k, 2])


@ti.func
def plane_place(planes, eye, ray, k):
    """Distance along a ray, at most 1e4, at which plane k is seen."""
    n = plane_normal(planes, k)
    return ti.min((planes[k, 3] - n.dot(eye)) / ti.min(n.dot(ray), ti.f32(-1e-6)), ti.f32(1e4))


@ti.func
def plane_colour(scene: ti.template(), view, planes, look, eye, ray, k, share, open_share):
    """Colour of the ground under a share of the lamp and of the sky."""
    n, t = plane_normal(planes, k), plane_place(planes, eye, ray, k)
    length = ray.norm()
    distance = t * length
    footprint = distance / view[3, 0] / ti.max(-n.dot(ray) / length, ti.f32(0.02))
    colour = ground(scene, eye + ray * t, n, footprint, look[0, 3], axis(look, 3))
    reach = distance * scene.stage.fog
    fog = 1 - 1 / (1 + reach * reach * reach)
    far = sky(scene, ray, look)
    middle = eye + ray * t
    colour /= 1 + scene.stage.pool * middle.dot(middle)
    near = tone(
        illuminate(scene, colour, ti.f32(0.0), ti.f32(0.0), n, ray, axis(look, 0), axis(look, 1), share, open_share)
    )
    return near + (far - near) * fog


@ti.func
def in_less_sky(scene: ti.template(), planes, look, k, colour, openness):
    """Colour of the ground in all of the lamp and a share of the sky, from its colour in all light."""
    n = plane_normal(planes, k)
    lamp = vec3(scene.stage.key) * (ti.max(n.dot(axis(look, 0)), ti.f32(0.0)) * ti.f32(LAMP_SHARE))
    up = ti.f32(0.5) + ti.f32(0.5) * n[1]
    sky_light = vec3(scene.stage.bounce) * (1 - up) + vec3(scene.stage.sky) * up
    sky_light += vec3(scene.stage.fill) * ti.max(n.dot(axis(look, 1)), ti.f32(0.0))
    return tone(untoned(colour) * (lamp + sky_light * openness) / (lamp + sky_light))


@ti.kernel
def paint(
    scene: ti.template(),
    view: View,
    planes: View,
    on_screen: View,
    count: ti.i32,
    eye: vec3,
    look: View,
    width: ti.i32,
    height: ti.i32,
):
    """Sky and ground where nothing is and all of the lamp and the sky is seen."""
    for pixel in range(width * height):
        x, y = pixel % width, pixel // width
        fx, fy = ti.cast(x, ti.f32), ti.cast(y, ti.f32)
        ray = pixel_ray(view, fx + ti.f32(0.5), fy + ti.f32(0.5))
        total, first, mixed, one = vec3(0, 0, 0), 0, 0, 0
        for s in ti.static(range(scene.samples)):
            offset = ti.static(SAMPLE_OFFSETS[scene.samples][s])
            _, which = nearest_plane(on_screen, count, fx + ti.f32(0.5 + offset[0]), fy + ti.f32(0.5 + offset[1]))
            if ti.static(s == 0):
                one = which
            elif which != one:
                mixed = 1
            if first == 0:
                first = which
        samples = 0
        while samples < scene.samples:
            which, weight = one, scene.samples
            if mixed > 0:
                weight = 1
                for s in ti.static(range(scene.samples)):
                    if s == samples:
                        offset = ti.static(SAMPLE_OFFSETS[scene.samples][s])
                        place = (fx + ti.f32(0.5 + offset[0]), fy + ti.f32(0.5 + offset[1]))
                        _, which = nearest_plane(on_screen, count, place[0], place[1])
            colour = sky(scene, ray, look)
            if which > 0:
                colour = plane_colour(scene, view, planes, look, eye, ray, which - 1, ti.f32(1.0), ti.f32(1.0))
            total += colour * (ti.cast(weight, ti.f32) / scene.samples)
            samples += weight
        scene.plane[pixel] = -first if mixed > 0 else first
        scene.backdrop[pixel] = total
        scene.backdrop_packed[pixel] = encode(total, x, y)


@ti.kernel
def place(scene: ti.template(), view: View, light: View, planes: View, eye: vec3, look: View, width: ti.i32, n: ti.i32):
    """Find the ground that n pixels see in the light's view: the coarse cell of the shadow map, -1 for none, and the closeness
    of what casts a shadow there. Of each tile, the range of cells and the least closeness."""
    cells = scene.shadow_size // COARSE_TEXELS
    for pixel in range(n):
        cell, closest = -1, ti.f32(0.0)
        k = ti.abs(scene.plane[pixel]) - 1
        if k >= 0:
            cosine = plane_normal(planes, k).dot(axis(look, 0))
            if cosine > 0:
                ray = pixel_ray(view, pixel % width + ti.f32(0.5), pixel // width + ti.f32(0.5))
                p = eye + ray * plane_place(planes, eye, ray, k)
                q, closest = light_place(light, p, plane_normal(planes, k), slope_of(cosine))
                cell = coarse_cell(scene.shadow_size // COARSE_TEXELS, q[0], q[1])
        scene.backdrop_cell[pixel] = cell
        scene.backdrop_level[pixel] = closest
    across, down = tiles_across(width), (n // width + ti.static(TILE - 1)) // TILE
    for tile in range(across * down):
        x0, y0 = tile % across * TILE, tile // across * TILE
        first, last, least = ti.Vector([cells, cells]), ti.Vector([-1, -1]), ti.f32(FAR)
        for y in range(y0, ti.min(y0 + TILE, n // width)):
            for x in range(x0, ti.min(x0 + TILE, width)):
                cell = scene.backdrop_cell[y * width + x]
                if cell >= 0:
                    at = ti.Vector([cell % cells, cell // cells])
                    first, last = ti.min(first, at), ti.max(last, at)
                    least = ti.min(least, scene.backdrop_level[y * width + x])
        scene.tile_cells[tile] = ti.Vector([first[0], first[1], last[0], last[1]])
        scene.tile_level[tile] = least
