"""Shadows at the rate they vary: the share of the lamp at every fourth pixel of every fourth row, from which pixels between four
alike ones take theirs. Those at the edge of a shadow, of a surface, or near anything thin work it out for themselves."""

from taichi_sim.kernels.render.backdrop import plane_normal, plane_place
from taichi_sim.kernels.render.raster import PLANE, TRIANGLE, View, vec3
from taichi_sim.kernels.render.shade import axis, lit_side, pixel_ray, surface
from taichi_sim.kernels.render.shadow import COARSE_TEXELS, WIDEST_BLUR, coarse_cell, filtered, light_place, slope_of
from taichi_sim.kernels.render.visibility import TILE, closeness, found, identity_of, tiles_across

from taichi_sim.device.engine import ti

STEP = 4  # px
UNKNOWN = -1.0  # a share
EVEN = 0.3  # difference between shares that a pixel among them may lie between
SAME_SHEET = 0.01  # difference of depths, as a part of them


@ti.func
def lattice_width(width):
    """Number of points along a side of `width` pixels: those of all tiles, and one more."""
    return tiles_across(width) * ti.static(TILE // STEP) + 1


@ti.func
def map_share(scene: ti.template(), view, light, q, level, slope, cell, eye, p, n):
    """Share of the lamp at p, and whether that of pixels near by may be quite another one: at narrow edges of shadows, and near
    anything thin."""
    away = p - eye
    steep = ti.max(ti.abs(n.dot(away)) / away.norm(), ti.f32(0.2))
    pixel = axis(view, 2).dot(away) / view[3, 0] * light[3, 0] / steep  # texels, along its longer side on the surface
    share, radius = filtered(scene, light, q, level, slope, pixel)
    abrupt = scene.thin[cell] > 0
    if radius < STEP * pixel and share > 0 and share < 1:
        abrupt = True
    return share, abrupt


@ti.func
def ground_share(scene: ti.template(), view, light, look, planes, eye, ray, k, pixel):
    """Share of the lamp at the point of plane k that a pixel sees, and True if that of pixels near by may be quite another
    one."""
    share, abrupt = ti.f32(1.0), False
    cell = scene.backdrop_cell[pixel]
    if cell >= 0:
        if scene.coarse[cell] > scene.backdrop_level[pixel]:
            n = plane_normal(planes, k)
            slope, p = slope_of(n.dot(axis(look, 0))), eye + ray * plane_place(planes, eye, ray, k)
            q, level = light_place(light, p, n, slope)
            share, abrupt = map_share(scene, view, light, q, level, slope, cell, eye, p, n)
    return share, abrupt


@ti.func
def surface_share(scene: ti.template(), view, light, eye, p, n, cosine):
    """Share of the lamp at p on a surface that faces the lamp, and True if that of pixels near by may be quite another one."""
    slope = slope_of(cosine)
    q, level = light_place(light, p, n, slope)
    share, abrupt = ti.f32(1.0), False
    cell = coarse_cell(scene.shadow_size // COARSE_TEXELS, q[0], q[1])
    if cell >= 0:
        if scene.coarse[cell] > level:
            share, abrupt = map_share(scene, view, light, q, level, slope, cell, eye, p, n)
    return share, abrupt


@ti.kernel
def sample(
    scene: ti.template(),
    seen: ti.template(),
    view: View,
    light: View,
    planes: View,
    on_screen: View,
    eye: vec3,
    look: View,
    width: ti.i32,
    height: ti.i32,
):
    """Find what each point sees, its depth, the share of the lamp there and, for the sky, the normal."""
    for k in range(lattice_width(width) * lattice_width(height)):
        x, y = k % lattice_width(width) * STEP, k // lattice_width(width) * STEP
        share, identity, w, abrupt = ti.f32(UNKNOWN), 0, ti.f32(0.0), False
        if x < width and y < height:
            pixel = y * width + x
            px, py = ti.cast(x, ti.f32) + ti.f32(0.5), ti.cast(y, ti.f32) + ti.f32(0.5)
            which = scene.plane[pixel] - 1
            if which >= 0:
                identity = (PLANE << 28) | which
                w = on_screen[which, 0] * px + on_screen[which, 1] * py + on_screen[which, 2]
            if seen.marked[y // TILE * tiles_across(width) + x // TILE] > 0:
                key = found(seen, pixel * scene.samples)
                if closeness(seen, key) > w:
                    identity, w = identity_of(seen, key), closeness(seen, key)
            ray = pixel_ray(view, px, py)
            # beyond, the next one is out of reach of its taps
            near = STEP * light[3, 0] <= ti.f32(WIDEST_BLUR) * view[3, 0] * w
            n = vec3(0, 0, 0)
            if (identity >> 28) == PLANE:
                n = plane_normal(planes, which)
                if ti.static(scene.has_shadow):
                    if near:
                        share, abrupt = ground_share(scene, view, light, look, planes, eye, ray, which, pixel)
            elif identity != 0:
                if ti.static(scene.has_occlusion) or near:
                    p, facing, _, _, through = surface(scene, view, eye, ray, identity, w, px, py)
                    n = facing
                    if ti.static(scene.has_shadow):
                        side, cosine = lit_side(facing, axis(look, 0), through)
                        if near and cosine > 0:
                            share, abrupt = surface_share(scene, view, light, eye, p, side, cosine)
            if ti.static(scene.has_occlusion):
                scene.lattice_normal[k] = vec3(axis(view, 0).dot(n), axis(view, 1).dot(n), axis(view, 2).dot(n))
        if ti.static(scene.has_occlusion):
            scene.open_raw[k], scene.open[k] = ti.f32(1.0), ti.f32(1.0)
        if ti.static(scene.has_shadow):
            scene.lattice_share[k] = ti.f32(UNKNOWN) if abrupt else share
        scene.lattice_identity[k] = identity
        scene.lattice_depth[k] = w


@ti.func
def between(scene: ti.template(), identity, w, x, y, width):
    """The share of a pixel from those about it; UNKNOWN where they are not alike."""
    k, across = y // STEP * lattice_width(width) + x // STEP, lattice_width(width)
    u, v = ti.cast(x % STEP, ti.f32) / STEP, ti.cast(y % STEP, ti.f32) / STEP
    low, high, total = ti.f32(1.0), ti.f32(0.0), ti.f32(0.0)
    for j in ti.static(range(2)):
        for i in ti.static(range(2)):
            corner = k + j * across + i
            other, share = scene.lattice_identity[corner], scene.lattice_share[corner]
            same = other == identity
            if (identity >> 28) == TRIANGLE and (other >> 28) == TRIANGLE:
                same = ti.abs(scene.lattice_depth[corner] - w) < w * ti.f32(SAME_SHEET)
            if not same:
                share = ti.f32(UNKNOWN)
            low, high = ti.min(low, share), ti.max(high, share)
            total += share * (u if ti.static(i == 1) else 1 - u) * (v if ti.static(j == 1) else 1 - v)
    return total if low >= 0 and high - low < ti.f32(EVEN) else ti.f32(UNKNOWN)
