"""Shading of the pixels from what is seen: each distinct primitive of a pixel shaded once, before sky and ground."""

from taichi_sim.kernels.render.backdrop import in_less_sky, nearest_plane, plane_colour
from taichi_sim.kernels.render.finish import alpha_byte, encode
from taichi_sim.kernels.render.occlusion import OPEN, open_share
from taichi_sim.kernels.render.raster import PLANE, SAMPLE_OFFSETS, TRIANGLE, View, vec3
from taichi_sim.kernels.render.shade import axis, illuminate, light_inside, lit_side, pixel_ray, surface, tone
from taichi_sim.kernels.render.shadow import COARSE_TEXELS
from taichi_sim.kernels.render.shadow_lattice import between, ground_share, surface_share
from taichi_sim.kernels.render.visibility import TILE, closeness, found, identity_of, tiles_across

from taichi_sim.device.engine import ti

OUTLINE_DEPTH = 0.03  # samples of a surface whose depths differ by more have an outline between them
SAME_SHEET_DEPTH = 0.004  # samples of a mesh whose depths differ by less share their shading


@ti.func
def alike(scene: ti.template(), ia, wa, ib, wb):
    """True if two samples may share one shading: the same primitive, or triangles of one smooth part of a surface."""
    result = ia == ib
    if ti.static(scene.has_triangles):
        if ia != ib and (ia >> 28) == TRIANGLE and (ib >> 28) == TRIANGLE:
            if ti.abs(wa - wb) < wa * ti.f32(SAME_SHEET_DEPTH):
                result = scene.part[ia & 0xFFFFFFF] == scene.part[ib & 0xFFFFFFF]
    return result


@ti.func
def weigh(scene: ti.template(), seen: ti.template(), on_screen, count, which, pixel, x, y):
    """Samples that things are seen at, and for each distinct one how many it stands for, four bits each."""
    samples = ti.static(scene.samples)
    identity, near = ti.Vector.zero(ti.i32, samples), ti.Vector.zero(ti.f32, samples)
    for s in ti.static(range(samples)):
        px = x + ti.f32(ti.static(0.5 + SAMPLE_OFFSETS[samples][s][0]))
        py = y + ti.f32(ti.static(0.5 + SAMPLE_OFFSETS[samples][s][1]))
        key = found(seen, pixel * samples + s)
        w, behind = closeness(seen, key), ti.f32(0.0)
        if which != 0:
            behind, _ = nearest_plane(on_screen, count, px, py)
        if w > behind:
            identity[s], near[s] = identity_of(seen, key), w
    code, covered, number = 0, 0, ti.Vector.one(ti.i32, samples)
    for s in ti.static(range(samples)):
        if identity[s] != 0:
            covered += 1
            for t in ti.static(range(s + 1, samples)):
                if identity[t] != 0 and alike(scene, identity[s], near[s], identity[t], near[t]):
                    number[s] += ti.min(number[s], 1)
                    number[t] = 0
            code |= number[s] << (4 * s)
    return covered, code


@ti.func
def outline(scene: ti.template(), seen: ti.template(), on_screen, count, which, x, y, width, height):
    """Part of a line that a pixel lies on, with an edge among its samples and one of the next pixels to the right and below.
    What lies behind is one thing, a smooth part of a surface another one."""
    samples = ti.static(scene.samples)
    first, depth, same = 0, ti.f32(0.0), 0
    for s in ti.static(range(samples + 2)):
        i, j = ti.min(x + ti.static(int(s == samples)), width - 1), ti.min(y + ti.static(int(s > samples)), height - 1)
        offset = ti.static(SAMPLE_OFFSETS[samples][s if s < samples else 0])
        px, py = ti.cast(i, ti.f32) + ti.f32(0.5 + offset[0]), ti.cast(j, ti.f32) + ti.f32(0.5 + offset[1])
        key, behind = found(seen, (j * width + i) * samples + ti.static(s if s < samples else 0)), ti.f32(0.0)
        if which != 0:
            behind, _ = nearest_plane(on_screen, count, px, py)
        identity, w = identity_of(seen, key), closeness(seen, key)
        if w <= behind:
            identity = 0
        elif ti.static(scene.has_triangles):
            if (identity >> 28) == TRIANGLE:
                identity = (TRIANGLE << 28) | scene.part[identity & 0xFFFFFFF]
        if ti.static(s == 0):
            first, depth = identity, w
        if identity == first and (first == 0 or ti.abs(w - depth) < depth * ti.f32(OUTLINE_DEPTH)):
            same += 1
    part = ti.cast(same, ti.f32) / ti.static(samples + 2)
    return 4 * part * (1 - part)


@ti.func
def colour_of(scene: ti.template(), seen: ti.template(), view, light, look, eye, ray, key, x, y, width):
    """Linear colour of what one sample shows."""
    lamp = axis(look, 0)
    px, py = ti.cast(x, ti.f32) + ti.f32(0.5), ti.cast(y, ti.f32) + ti.f32(0.5)
    w = closeness(seen, key)
    p, n, colour, gloss, through = surface(scene, view, eye, ray, identity_of(seen, key), w, px, py)
    share, openness = ti.f32(1.0), ti.f32(1.0)
    if ti.static(scene.has_occlusion):
        if scene.dim[y // TILE * tiles_across(width) + x // TILE] > 0:
            openness = open_share(scene, identity_of(seen, key), w, x, y, width)
    if ti.static(scene.has_shadow):
        side, cosine = lit_side(n, lamp, through)
        if cosine > 0:
            share = between(scene, identity_of(seen, key), w, x, y, width)
            if share < 0:
                share, _ = surface_share(scene, view, light, eye, p, side, cosine)
    colour += (axis(look, 3) + ti.f32(0.15) - colour) * scene.stage.wash
    result = illuminate(scene, colour, gloss, through, n, ray, lamp, axis(look, 1), share, openness)
    if ti.static(scene.has_shadow and scene.has_light_inside):
        if through < 0:
            result += light_inside(scene, light, lamp, ray, p, colour, -through)
    return tone(result)


@ti.func
def behind_shares(scene: ti.template(), view, light, look, planes, eye, ray, k, x, y, width):
    """Shares of the lamp and of the sky on a plane."""
    share, openness = ti.f32(1.0), ti.f32(1.0)
    if ti.static(scene.has_occlusion):
        if scene.dim[y // TILE * tiles_across(width) + x // TILE] > 0:
            openness = open_share(scene, (PLANE << 28) | k, ti.f32(1.0), x, y, width)
    if ti.static(scene.has_shadow):
        pixel = y * width + x
        cell = scene.backdrop_cell[pixel]
        if cell >= 0:
            if scene.coarse[cell] > scene.backdrop_level[pixel]:
                share = between(scene, (PLANE << 28) | k, ti.f32(0.0), x, y, width)
                if share < 0:
                    share, _ = ground_share(scene, view, light, look, planes, eye, ray, k, pixel)
    return share, openness


@ti.func
def darkening(shaded, plain):
    """Opacity of black that makes a plain colour as dark as a shaded one."""
    return ti.max(1 - shaded.sum() / ti.max(plain.sum(), ti.f32(1e-6)), ti.f32(0.0))


@ti.func
def shade(
    scene: ti.template(), seen: ti.template(), view, light, planes, on_screen, count, eye, look, width, height, x, y
):
    """Shade a pixel of a busy tile, see `resolve`."""
    pixel = y * width + x
    tile = y // TILE * tiles_across(width) + x // TILE
    which = scene.plane[pixel]
    ray = pixel_ray(view, ti.cast(x, ti.f32) + ti.f32(0.5), ti.cast(y, ti.f32) + ti.f32(0.5))
    covered, code = 0, 0
    if seen.marked[tile] > 0:
        covered, code = weigh(scene, seen, on_screen, count, which, pixel, ti.cast(x, ti.f32), ti.cast(y, ti.f32))
    total, slot, weights = vec3(0, 0, 0), pixel * scene.samples, 0
    while code != 0:
        weight = code & 15
        if weight > 0:
            weights += weight
            total += weight * colour_of(scene, seen, view, light, look, eye, ray, found(seen, slot), x, y, width)
        slot += 1
        code >>= 4
    if weights != covered:  # of three samples the outer ones may be alike to the middle one only
        total *= ti.cast(covered, ti.f32) / weights
    if ti.static(scene.stage.outline > 0):
        if covered > 0:
            line = outline(scene, seen, on_screen, count, which, x, y, width, height)
            total += (covered - total) * (scene.stage.outline * line)
    packed = 0
    if ti.static(scene.transparent):
        solid = ti.cast(covered, ti.f32)
        if ti.static(scene.catches_shadow):
            k = ti.abs(which) - 1
            if covered < scene.samples and k >= 0:
                shares = behind_shares(scene, view, light, look, planes, eye, ray, k, x, y, width)
                behind = plane_colour(scene, view, planes, look, eye, ray, k, *shares)
                solid += (scene.samples - covered) * darkening(behind, scene.backdrop[pixel])
        packed = encode(total / ti.max(solid, ti.f32(1e-6)), x, y) | alpha_byte(solid / scene.samples)
    else:
        plain = covered == 0
        if covered < scene.samples:
            behind = scene.backdrop[pixel]
            k = ti.abs(which) - 1
            if k >= 0:
                shares = behind_shares(scene, view, light, look, planes, eye, ray, k, x, y, width)
                if shares[0] < 1:
                    behind, plain = plane_colour(scene, view, planes, look, eye, ray, k, *shares), False
                elif shares[1] < ti.f32(OPEN):
                    behind, plain = in_less_sky(scene, planes, look, k, behind, shares[1]), False
            total += (scene.samples - covered) * behind
        if ti.static(scene.samples > 1):
            packed = scene.backdrop_packed[pixel] if plain else encode(total / scene.samples, x, y)
        else:
            scene.image[pixel] = total
    if ti.static(scene.samples > 1):
        scene.packed[pixel] = packed


@ti.kernel
def find_busy(scene: ti.template(), seen: ti.template(), width: ti.i32, height: ti.i32):
    """Find the tiles that show anything else than sky and ground in all light."""
    for tile in range(tiles_across(width) * tiles_across(height)):
        busy = seen.marked[tile]
        if ti.static(scene.has_occlusion):
            busy |= scene.dim[tile]
        if ti.static(scene.has_shadow):
            box, cells = scene.tile_cells[tile], scene.shadow_size // COARSE_TEXELS
            for j in range(box[1], box[3] + 1):
                for i in range(box[0], box[2] + 1):
                    if scene.coarse[j * cells + i] > scene.tile_level[tile]:
                        busy = 1
        scene.busy[tile] = busy


@ti.kernel
def resolve(
    scene: ti.template(),
    seen: ti.template(),
    view: View,
    light: View,
    planes: View,
    on_screen: View,
    count: ti.i32,
    eye: vec3,
    look: View,
    width: ti.i32,
    height: ti.i32,
):
    """Shade every pixel: each distinct primitive among its samples once, weighted by its samples, and what
    lies behind.

    Rows of look: direction to the lamp and the spacing of the ground's grid, direction of the fill, zenith, horizon.
    Where the scene is transparent, samples of background and ground have neither colour nor share in alpha; where it catches
    shadows, the ground is black with the alpha that darkens it by as much as they do.
    """
    run = ti.static(TILE if scene.has_wide_runs else 1)  # pixels of a row that one turn shades
    for k in range(tiles_across(width) * tiles_across(height) * ti.static(TILE * TILE // run)):
        tile, part = k // ti.static(TILE * TILE // run), k % ti.static(TILE * TILE // run) * run
        y, x0 = tile // tiles_across(width) * TILE + part // TILE, tile % tiles_across(width) * TILE + part % TILE
        for x in range(x0, ti.min(x0 + run, width) if y < height else x0):
            pixel = y * width + x
            if scene.busy[tile] > 0:
                shade(scene, seen, view, light, planes, on_screen, count, eye, look, width, height, x, y)
            elif ti.static(scene.transparent):
                scene.packed[pixel] = 0
            elif ti.static(scene.samples > 1):
                scene.packed[pixel] = scene.backdrop_packed[pixel]
            else:
                scene.image[pixel] = scene.backdrop[pixel]
