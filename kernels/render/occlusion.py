"""Ambient occlusion: the share of the sky that pixels see, from the depths about them."""

from taichi_sim.kernels.render.backdrop import nearest_plane, plane_normal
from taichi_sim.kernels.render.raster import PLANE, View, vec2, vec3
from taichi_sim.kernels.render.shade import pixel_ray, surface
from taichi_sim.kernels.render.shadow import rotated
from taichi_sim.kernels.render.visibility import TILE, closeness, found, identity_of, tiles_across

from taichi_sim.device.engine import ti

OCCLUSION_TAPS = 12
STEP = 2  # px: it varies slowly


@ti.func
def seen_there(scene: ti.template(), seen: ti.template(), on_screen, count, x, y, width):
    """Identity and closeness of what a pixel shows, planes included."""
    w, which = nearest_plane(on_screen, count, x + ti.f32(0.5), y + ti.f32(0.5))
    identity = ti.select(which > 0, (PLANE << 28) | (which - 1), 0)
    if seen.marked[y // TILE * tiles_across(width) + x // TILE] > 0:
        key = found(seen, (y * width + x) * scene.samples)
        if closeness(seen, key) > w:
            w, identity = closeness(seen, key), identity_of(seen, key)
    return identity, w


@ti.kernel
def occlude(
    scene: ti.template(),
    seen: ti.template(),
    view: View,
    eye: vec3,
    planes: View,
    on_screen: View,
    count: ti.i32,
    reach: ti.f32,
    width: ti.i32,
    height: ti.i32,
):
    """Share of the sky that every second pixel of every second row sees among what lies within `reach`; then smoothed for all."""
    across, down = (width + 1) // STEP, (height + 1) // STEP
    for k in range(across * down):
        i, j = k % across, k // across
        x, y = i * STEP, j * STEP
        identity, w = seen_there(scene, seen, on_screen, count, x, y, width)
        blocked = ti.f32(0.0)
        if identity != 0:
            px, py = ti.cast(x, ti.f32) + ti.f32(0.5), ti.cast(y, ti.f32) + ti.f32(0.5)
            ray = pixel_ray(view, px, py)
            p, n, _, _, _ = surface(scene, view, eye, ray, identity, w, px, py)
            if (identity >> 28) == PLANE:
                n = plane_normal(planes, identity & 0xFFFFFFF)
            radius = ti.min(ti.max(reach * view[3, 0] * w, ti.f32(3.0)), ti.f32(90.0))
            angle = ti.cast((i % 4) * 4 + (j % 4) * 7 % 16, ti.f32) * ti.f32(0.3926991)
            direction = vec2(ti.cos(angle), ti.sin(angle))
            for tap in range(OCCLUSION_TAPS):
                r = radius * (ti.cast(tap, ti.f32) + ti.f32(0.6)) / OCCLUSION_TAPS
                tx, ty = ti.cast(px + r * direction[0], ti.i32), ti.cast(py + r * direction[1], ti.i32)
                direction = rotated(direction)
                if tx >= 0 and ty >= 0 and tx < width and ty < height:
                    other, near_w = seen_there(scene, seen, on_screen, count, tx, ty, width)
                    if other != 0:
                        there = pixel_ray(view, ti.cast(tx, ti.f32) + ti.f32(0.5), ti.cast(ty, ti.f32) + ti.f32(0.5))
                        v = eye + there / near_w - p
                        d = ti.max(v.norm(), ti.f32(1e-9))
                        near = ti.max(1 - d / (2 * reach), ti.f32(0.0))
                        blocked += ti.max(v.dot(n) / d - ti.f32(0.08), ti.f32(0.0)) * near
        scene.open_raw[k] = ti.max(1 - blocked * ti.f32(3.0 / OCCLUSION_TAPS), ti.f32(0.12))
        scene.open_depth[k] = w
    for pixel in range(width * height):
        x, y = pixel % width, pixel // width
        _, w = seen_there(scene, seen, on_screen, count, x, y, width)
        total, weights = ti.f32(0.0), ti.f32(0.0)
        i0, j0 = (x + 1) // STEP, (y + 1) // STEP  # the 4 x 4 about it, in which all angles occur
        for j in range(ti.max(j0 - 2, 0), ti.min(j0 + 2, down)):
            for i in range(ti.max(i0 - 2, 0), ti.min(i0 + 2, across)):
                weight = 1 / (1 + ti.abs(scene.open_depth[j * across + i] - w) * 300 / ti.max(w, ti.f32(1e-9)))
                total += weight * scene.open_raw[j * across + i]
                weights += weight
        scene.openness[pixel] = total / weights
