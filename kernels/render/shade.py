"""Light: from the visible primitive of a pixel to its colour, linear, in 0..1.

A key light, a fill, sky, a bounce from the ground, a soft highlight; how much of each is the stage's.
"""

from taichi_sim.kernels.render.patterns import hem, pattern, texture_at, woven
from taichi_sim.kernels.render.raster import ROD, SPHERE, TRIANGLE, rod_ends, screen, to_view, vec3
from taichi_sim.kernels.render.shadow import shadow_depth

from taichi_sim.device.engine import ti

BESIDE = 0.01  # part of the distance that the centre of a pixel and its sample may differ in
BEFORE = 1e-6  # the end of a texture, where the next one begins, with the opposite border
LAMP_SHARE = 0.62  # of the lamp's light, in what a surface scatters
INSIDE = 0.6  # of the lamp's light, in what is scattered inside a body
INSIDE_BIAS = 2.0  # texels: a way as short is none, or those of the shadow map would show
INSIDE_TAP = (1.0, 3.0)  # texels, the first of four places, each a quarter turn from the one before
WEAVE, TEXTURE = 3, 4  # numbers of patterns
THREAD_SLOPE = 0.9  # tangent at the side of a thread
STRETCHED_COLOUR, COMPRESSED_COLOUR, STEEL_COLOUR = (0.62, 0.06, 0.05), (0.03, 0.16, 0.60), (0.33, 0.34, 0.36)


@ti.func
def axis(view, k):
    return vec3(view[k, 0], view[k, 1], view[k, 2])


@ti.func
def pixel_ray(view, px, py):
    """Direction whose forward part is 1."""
    right, up = (px - view[3, 1]) / view[3, 0], (view[3, 2] - py) / view[3, 0]
    return axis(view, 2) + axis(view, 0) * right + axis(view, 1) * up


@ti.func
def spring_colour(strain):
    """Steel at rest, red stretched, blue compressed; full at a tenth."""
    t = ti.min(ti.abs(strain) * 10, ti.f32(1.0))
    end = vec3(STRETCHED_COLOUR)
    if strain < 0:
        end = vec3(COMPRESSED_COLOUR)
    return vec3(STEEL_COLOUR) * (1 - t) + end * t


@ti.func
def along(ray, e1, e2, s, q, ab, ac):
    """Place in a pattern, from that of the first corner on, where a ray meets a triangle's plane (see `surface`)."""
    h = ray.cross(e2)
    det = e1.dot(h)
    inverse = 1 / ti.max(ti.abs(det), ti.f32(1e-20)) * (ti.f32(1.0) if det > 0 else ti.f32(-1.0))
    return ab * (s.dot(h) * inverse) + ac * (ray.dot(q) * inverse)


@ti.func
def surface(scene: ti.template(), view, eye, ray, identity, w, px, py):
    """Point, normal (towards the eye), colour and gloss of what a pixel sees, and the share of the light that comes through, or,
    below 0, how soon light fades inside, per size of the scene."""
    kind, i = identity >> 28, identity & 0xFFFFFFF
    p, n, colour, gloss = eye + ray / w, -ray.normalized(), vec3(0.5, 0.5, 0.5), ti.f32(0.2)
    through = ti.f32(0.0)
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
            e1, e2, s = b - a, c - a, eye - a  # T. Moeller, B. Trumbore, Fast ray-triangle intersection, 1997
            h, q = ray.cross(e2), s.cross(e1)
            det = e1.dot(h)
            winding = ti.f32(1.0) if det > 0 else ti.f32(-1.0)
            wb, wc = ti.max(winding * s.dot(h), ti.f32(0.0)), ti.max(winding * ray.dot(q), ti.f32(0.0))
            wa = ti.max(ti.abs(det) - wb - wc, ti.f32(0.0))  # the centre may lie beside the triangle that a sample hits
            flat = e1.cross(e2)
            normals = scene.normal_of[i]
            smooth = scene.normal[normals[0]] * wa + scene.normal[normals[1]] * wb + scene.normal[normals[2]] * wc
            total = ti.max(wa + wb + wc, ti.f32(1e-30))
            if smooth.norm() < ti.f32(0.2) * total or smooth.dot(flat) < 0:
                smooth = flat
            if flat.dot(ray) > 0:
                smooth = -smooth
            n = smooth / ti.max(smooth.norm(), ti.f32(1e-30))
            # w is that of a sample beside the pixel's centre: in its own shadow, where pixels are large
            if total > ti.f32(1e-20):
                p = (a * wa + b * wb + c * wc) / total
                # beside a slim triangle the weights move it along the whole length: rather where the ray meets the plane
                reach = e2.dot(q) * winding
                if ti.abs(reach * w - ti.abs(det)) < ti.f32(BESIDE) * ti.abs(det):
                    p = eye + ray * (reach / ti.abs(det))
            colour = (scene.colour[k[0]] * wa + scene.colour[k[1]] * wb + scene.colour[k[2]] * wc) / total
            style = scene.style[scene.style_of[i]]
            gloss, through = style[0], style[1]
            if ti.static(scene.is_patterned):
                if (style[3] > 0 or style[8] > 0) and total > ti.f32(1e-20):
                    pa, pb, pc = scene.place[3 * i], scene.place[3 * i + 1], scene.place[3 * i + 2]
                    ab, ac, pixel = pb - pa, pc - pa, 1 / view[3, 0]
                    here = along(ray, e1, e2, s, q, ab, ac)  # also beside a thin triangle
                    beside = along(ray + axis(view, 0) * pixel, e1, e2, s, q, ab, ac) - here
                    below = along(ray - axis(view, 1) * pixel, e1, e2, s, q, ab, ac) - here
                    low, last = ti.floor(ti.min(pa, pb, pc)), ti.ceil(ti.max(pa, pb, pc))
                    last = ti.max(last, low + ti.f32(1.0))
                    high = last - ti.f32(BEFORE) * (ti.abs(last) + ti.f32(1.0))
                    raw = ti.min(ti.max(pa + here, low), high)
                    wide = ti.abs(beside) + ti.abs(below)
                    place, beside, below = raw * style[7], beside * style[7], below * style[7]
                    if style[3] == TEXTURE:
                        colour = texture_at(scene, style, place, beside, below, low * style[7], high * style[7])
                    elif style[3] == WEAVE:
                        weft = vec3(style[4], style[5], style[6])
                        if style[4] < 0:
                            weft = colour
                        colour, slope = woven(place, ti.sqrt(beside * beside + below * below), colour, weft)
                        turned = ab[0] * ac[1] - ab[1] * ac[0]
                        tu, tv = (e1 * ac[1] - e2 * ab[1]) / turned, (e2 * ab[0] - e1 * ac[0]) / turned
                        tilt = tu / ti.max(tu.norm(), ti.f32(1e-20)) * slope[0]
                        tilt += tv / ti.max(tv.norm(), ti.f32(1e-20)) * slope[1]
                        n = (n + ti.f32(THREAD_SLOPE) * tilt).normalized()
                    elif style[3] > 0:
                        share = pattern(style[3], place, wide * style[7])
                        colour += (vec3(style[4], style[5], style[6]) - colour) * share
                    if style[8] > 0:
                        darker, thicker = hem(raw, wide, style[8])
                        colour, through = colour * darker, through * thicker
    return p, n, colour, gloss, through


@ti.func
def lit_side(n, lamp, through):
    """The normal of the side that light falls on, and its cosine with the lamp: of a sheet the other one, too."""
    side, cosine = n, n.dot(lamp)
    if through > 0 and cosine < 0:
        side, cosine = -n, -cosine
    return side, cosine


@ti.func
def illuminate(scene: ti.template(), colour, gloss, through, n, ray, lamp, fill, light_share, openness):
    """Colour of a surface under the lamp, the sky and the bounce, and the share of their light that comes through."""
    to_eye = -ray.normalized()
    thin = ti.max(through, ti.f32(0.0))
    cosine = ti.max(n.dot(lamp), -thin * n.dot(lamp), ti.f32(0.0)) * light_share
    up = ti.f32(0.5) + (ti.f32(0.5) - thin) * n[1]
    ambient = (vec3(scene.stage.bounce) * (1 - up) + vec3(scene.stage.sky) * up) * openness
    half = (lamp + to_eye).normalized()
    shine = ti.max(n.dot(half), ti.f32(0.0))
    shine *= shine  # power 32 by squaring
    shine *= shine
    shine *= shine
    shine *= shine
    shine *= shine
    gloss *= scene.stage.gloss
    rim = 1 - ti.max(n.dot(to_eye), ti.f32(0.0))
    rim *= rim
    aside = ti.max(n.dot(fill), ti.f32(0.0)) * openness
    result = colour * (vec3(scene.stage.key) * (cosine * ti.f32(LAMP_SHARE)) + vec3(scene.stage.fill) * aside + ambient)
    return (
        result
        + vec3(scene.stage.key) * (shine * gloss * light_share * ti.f32(0.35))
        + vec3(scene.stage.sky) * (rim * rim * openness * (ti.f32(0.05) + gloss * ti.f32(0.3)))
    )


@ti.func
def light_inside(scene: ti.template(), light, lamp, ray, p, colour, rate):
    """Light from the lamp that has come through a body to a place on its surface, by the way that the shadow map shows; what the
    body does not scatter fades sooner."""
    q = screen(light, to_view(light, p))
    entry, share = ti.f32(0.0), ti.f32(0.0)
    dx, dy = ti.f32(INSIDE_TAP[0]), ti.f32(INSIDE_TAP[1])
    for _ in range(4):  # unrolled, the sixteen texels take a software driver of Vulkan 20 GB to compile
        w, seen = shadow_depth(scene.shadow, scene.shadow_size, q[0] + dx, q[1] + dy)
        entry += w - seen * q[2]
        share += seen
        dx, dy = -dy, dx
    way = ti.max(entry / ti.max(share, ti.f32(1e-6)) - ti.f32(INSIDE_BIAS) / light[3, 0], ti.f32(0.0))
    forward = ti.f32(0.55) + ti.f32(0.45) * ray.normalized().dot(lamp)
    left = ti.exp(-rate * way * (ti.f32(1.25) - colour))
    return colour * vec3(scene.stage.key) * left * (forward * ti.f32(INSIDE))


@ti.func
def tone(c):
    """Soft shoulder: bright parts keep their hue."""
    return ti.min(c / (1 + ti.f32(0.42) * c) * ti.f32(1.12), ti.f32(1.0))


@ti.func
def untoned(c):
    """The colour that `tone` makes this of."""
    return c / (ti.f32(1.12) - ti.f32(0.42) * ti.min(c, ti.f32(1.0)))
