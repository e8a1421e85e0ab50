"""From what is seen to pixels: each distinct primitive of a pixel shaded once, ambient occlusion, final colours."""

from taichi_sim.kernels.render.raster import PLANE, TRIANGLE, View, vec2, vec3
from taichi_sim.kernels.render.shade import ground, illuminate, lit, rotated, sky, surface
from taichi_sim.kernels.render.visibility import closeness, found, identity_of

from taichi_sim.device.engine import ti

SAME_SHEET_DEPTH = 0.004  # samples of a mesh whose depths differ by less share their shading
OCCLUSION_TAPS = 12  # of the ambient occlusion


@ti.func
def axis(view, k):
    return vec3(view[k, 0], view[k, 1], view[k, 2])


@ti.func
def pixel_ray(view, px, py):
    """Direction whose forward part is 1."""
    right, up = (px - view[3, 1]) / view[3, 0], (view[3, 2] - py) / view[3, 0]
    return axis(view, 2) + axis(view, 0) * right + axis(view, 1) * up


@ti.func
def alike(seen: ti.template(), a, b):
    """Whether two samples may share one shading: the same primitive, or one sheet of triangles."""
    ia, ib = identity_of(seen, a), identity_of(seen, b)
    result = ia == ib
    if (ia >> 28) == TRIANGLE and (ib >> 28) == TRIANGLE:
        wa = closeness(seen, a)
        result = result or ti.abs(wa - closeness(seen, b)) < wa * ti.f32(SAME_SHEET_DEPTH)
    return result


@ti.func
def tone(c):
    """Soft shoulder: bright parts keep their hue."""
    return ti.min(c / (1 + ti.f32(0.42) * c) * ti.f32(1.12), ti.f32(1.0))


@ti.func
def colour_of(scene: ti.template(), seen: ti.template(), view, light, look, eye, ray, planes, key, px, py, open_share):
    """Linear colour of one sample."""
    lamp = axis(look, 0)
    identity = identity_of(seen, key)
    far = sky(ray[1] / ray.norm(), axis(look, 2), axis(look, 3))
    result = far
    if identity != 0:
        w = closeness(seen, key)
        p, n, colour, gloss = surface(scene, view, eye, ray, identity, w, px, py)
        fog = ti.f32(0.0)
        if (identity >> 28) == PLANE:
            k = identity & 0xFFFFFFF
            n = vec3(planes[k, 0], planes[k, 1], planes[k, 2])
            t = (planes[k, 3] - n.dot(eye)) / ti.min(n.dot(ray), ti.f32(-1e-6))
            distance = ti.min(t, ti.f32(1e4)) * ray.norm()
            p = eye + ray * ti.min(t, ti.f32(1e4))
            footprint = distance / view[3, 0] / ti.max(-n.dot(ray) / ray.norm(), ti.f32(0.02))
            colour, gloss = ground(p, n, footprint, look[0, 3]) * axis(look, 3), ti.f32(0.0)
            reach = distance * ti.f32(0.16)
            fog = 1 - 1 / (1 + reach * reach * reach)
        share = ti.f32(1.0)
        if ti.static(scene.has_shadow):
            cosine = n.dot(lamp)
            if cosine > 0:
                slope = ti.sqrt(ti.max(1 - cosine * cosine, ti.f32(0.0))) / ti.max(cosine, ti.f32(0.1))
                share = lit(scene, light, p, n, slope)
        result = tone(illuminate(colour, gloss, n, ray, lamp, axis(look, 1), share, open_share))
        result += (far - result) * fog
    return result


@ti.kernel
def resolve(
    scene: ti.template(),
    seen: ti.template(),
    image: ti.template(),
    view: View,
    light: View,
    planes: View,
    eye: vec3,
    look: View,
    width: ti.i32,
    height: ti.i32,
):
    """Shade every pixel: each distinct primitive among its samples once, weighted by its samples.

    Rows of look: direction to the lamp and the spacing of the ground's grid, direction of the fill, zenith, horizon.
    Where the scene is transparent, samples of background and ground have neither colour nor share in alpha.
    """
    for pixel in range(width * height):
        px, py = ti.cast(pixel % width, ti.f32) + ti.f32(0.5), ti.cast(pixel // width, ti.f32) + ti.f32(0.5)
        ray = pixel_ray(view, px, py)
        open_share = ti.f32(1.0)
        if ti.static(scene.has_occlusion):
            open_share = scene.openness[pixel]
        total, weights, solid, s = vec3(0, 0, 0), 0, 0, 0
        while weights < scene.samples and s < scene.samples:
            key = found(seen, pixel * scene.samples + s)
            weight = 1
            for t in range(scene.samples):
                if t != s and alike(seen, key, found(seen, pixel * scene.samples + t)):
                    weight = 0 if t < s else weight + ti.min(weight, 1)
            if weight > 0:
                kind = identity_of(seen, key) >> 28
                if ti.static(not scene.transparent) or (kind != 0 and kind != PLANE):
                    total += weight * colour_of(
                        scene, seen, view, light, look, eye, ray, planes, key, px, py, open_share
                    )
                    solid += weight
                weights += weight
            s += 1
        image[pixel] = total / ti.max(solid, 1)
        if ti.static(scene.transparent):
            scene.alpha[pixel] = ti.cast(solid, ti.f32) / weights


@ti.kernel
def occlude(
    scene: ti.template(),
    seen: ti.template(),
    view: View,
    eye: vec3,
    planes: View,
    reach: ti.f32,
    width: ti.i32,
    height: ti.i32,
):
    """Share of the sky that each pixel sees among what lies within `reach`, from the depths about it; then smoothed."""
    for pixel in range(width * height):
        x, y = pixel % width, pixel // width
        key = found(seen, pixel * scene.samples)
        identity = identity_of(seen, key)
        blocked = ti.f32(0.0)
        if identity != 0:
            px, py = ti.cast(x, ti.f32) + ti.f32(0.5), ti.cast(y, ti.f32) + ti.f32(0.5)
            w = closeness(seen, key)
            ray = pixel_ray(view, px, py)
            p, n, _, _ = surface(scene, view, eye, ray, identity, w, px, py)
            if (identity >> 28) == PLANE:
                k = identity & 0xFFFFFFF
                n = vec3(planes[k, 0], planes[k, 1], planes[k, 2])
            radius = ti.min(ti.max(reach * view[3, 0] * w, ti.f32(3.0)), ti.f32(90.0))
            angle = ti.cast((x % 4) * 4 + (y % 4) * 7 % 16, ti.f32) * ti.f32(0.3926991)
            direction = vec2(ti.cos(angle), ti.sin(angle))
            for k in range(OCCLUSION_TAPS):
                r = radius * (ti.cast(k, ti.f32) + ti.f32(0.6)) / OCCLUSION_TAPS
                i, j = ti.cast(px + r * direction[0], ti.i32), ti.cast(py + r * direction[1], ti.i32)
                direction = rotated(direction)
                if i >= 0 and j >= 0 and i < width and j < height:
                    other = found(seen, (j * width + i) * scene.samples)
                    if identity_of(seen, other) != 0:
                        there = pixel_ray(view, ti.cast(i, ti.f32) + ti.f32(0.5), ti.cast(j, ti.f32) + ti.f32(0.5))
                        v = eye + there / closeness(seen, other) - p
                        d = ti.max(v.norm(), ti.f32(1e-9))
                        near = ti.max(1 - d / (2 * reach), ti.f32(0.0))
                        blocked += ti.max(v.dot(n) / d - ti.f32(0.08), ti.f32(0.0)) * near
        scene.open_raw[pixel] = ti.max(1 - blocked * ti.f32(3.0 / OCCLUSION_TAPS), ti.f32(0.12))
    for pixel in range(width * height):
        x, y = pixel % width, pixel // width
        w = closeness(seen, found(seen, pixel * scene.samples))
        total, weights = ti.f32(0.0), ti.f32(0.0)
        for j in range(ti.max(y - 2, 0), ti.min(y + 2, height)):
            for i in range(ti.max(x - 2, 0), ti.min(x + 2, width)):
                other = closeness(seen, found(seen, (j * width + i) * scene.samples))
                weight = 1 / (1 + ti.abs(other - w) * 300 / ti.max(w, ti.f32(1e-9)))
                total += weight * scene.open_raw[j * width + i]
                weights += weight
        scene.openness[pixel] = total / weights


@ti.func
def luma(image: ti.template(), x, y, width, height):
    c = image[ti.min(ti.max(y, 0), height - 1) * width + ti.min(ti.max(x, 0), width - 1)]
    return ti.sqrt(ti.max(c[0] * ti.f32(0.25) + c[1] * ti.f32(0.65) + c[2] * ti.f32(0.1), ti.f32(0.0)))


@ti.func
def bilinear(image: ti.template(), x, y, width, height):
    i, j = ti.cast(ti.floor(x), ti.i32), ti.cast(ti.floor(y), ti.i32)
    u, v = x - ti.floor(x), y - ti.floor(y)
    i0, i1 = ti.min(ti.max(i, 0), width - 1), ti.min(ti.max(i + 1, 0), width - 1)
    j0, j1 = ti.min(ti.max(j, 0), height - 1), ti.min(ti.max(j + 1, 0), height - 1)
    upper = image[j0 * width + i0] * (1 - u) + image[j0 * width + i1] * u
    return upper * (1 - v) + (image[j1 * width + i0] * (1 - u) + image[j1 * width + i1] * u) * v


@ti.func
def smooth_edge(image: ti.template(), x, y, width, height):
    """Blur along the edge that the brightness about a pixel shows (Lottes, FXAA, 2009)."""
    a, b = luma(image, x - 1, y - 1, width, height), luma(image, x + 1, y - 1, width, height)
    c, d = luma(image, x - 1, y + 1, width, height), luma(image, x + 1, y + 1, width, height)
    m = luma(image, x, y, width, height)
    low, high = ti.min(a, b, c, d, m), ti.max(a, b, c, d, m)
    result = image[y * width + x]
    if high - low > ti.max(ti.f32(0.03), high * ti.f32(0.1)):
        dx, dy = (c + d) - (a + b), (a + c) - (b + d)
        scale = 1 / (ti.min(ti.abs(dx), ti.abs(dy)) + ti.f32(0.03) * (a + b + c + d) + ti.f32(1e-4))
        dx, dy = ti.min(ti.max(dx * scale, -6), 6), ti.min(ti.max(dy * scale, -6), 6)
        fx, fy = ti.cast(x, ti.f32), ti.cast(y, ti.f32)
        third = ti.f32(1.0 / 6.0)
        near = bilinear(image, fx - dx * third, fy - dy * third, width, height)
        near = (near + bilinear(image, fx + dx * third, fy + dy * third, width, height)) / 2
        result = near
    return result


@ti.kernel
def finish(
    image: ti.template(),
    alpha: ti.template(),
    transparent: ti.template(),
    edges: ti.template(),
    width: ti.i32,
    height: ti.i32,
    out: ti.types.ndarray(ti.i32, 1),
):
    """Linear colour to packed sRGB bytes (red lowest, alpha highest), with half a step of fixed noise against bands."""
    for pixel in range(width * height):
        x, y = pixel % width, pixel // width
        c = image[pixel]
        if ti.static(edges):
            c = smooth_edge(image, x, y, width, height)
        c = ti.min(ti.max(c, ti.f32(0.0)), ti.f32(1.0))
        noise = ti.cast((x * 5 + y * 11 + (x ^ y) * 7) % 16, ti.f32) / 16 + ti.f32(0.03)
        packed = ti.i32(0)
        for k in ti.static(range(3)):
            r1 = ti.sqrt(c[k])  # sRGB by roots: 0.6620 x^1/2 + 0.6841 x^1/4 - 0.3236 x^1/8 - 0.0225 x
            r2 = ti.sqrt(r1)
            r3 = ti.sqrt(r2)
            encoded = (
                ti.f32(0.66200269) * r1 + ti.f32(0.68412206) * r2 - ti.f32(0.3235836) * r3 - ti.f32(0.02254115) * c[k]
            )
            byte = ti.cast(ti.min(ti.max(encoded * 255 + noise, ti.f32(0.0)), ti.f32(255.0)), ti.i32)
            packed |= byte << (8 * k)
        if ti.static(transparent):
            packed |= ti.cast(alpha[pixel] * 255 + ti.f32(0.5), ti.i32) << 24
        out[pixel] = packed
