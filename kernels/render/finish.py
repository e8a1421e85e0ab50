"""Linear colours to the bytes of a picture: sRGB with half a step of fixed noise against bands; smoothed edges."""

from taichi_sim.device.engine import ti


@ti.func
def encode(colour, x, y):
    """Packed sRGB bytes of a pixel, red lowest, its highest byte 0."""
    noise = ti.cast((x * 5 + y * 11 + (x ^ y) * 7) % 16, ti.f32) / 16 + ti.f32(0.03)
    packed = ti.i32(0)
    for k in ti.static(range(3)):
        c = ti.min(ti.max(colour[k], ti.f32(0.0)), ti.f32(1.0))
        r1 = ti.sqrt(c)  # sRGB by roots: 0.6620 x^1/2 + 0.6841 x^1/4 - 0.3236 x^1/8 - 0.0225 x
        r2 = ti.sqrt(r1)
        r3 = ti.sqrt(r2)
        encoded = ti.f32(0.66200269) * r1 + ti.f32(0.68412206) * r2 - ti.f32(0.3235836) * r3 - ti.f32(0.02254115) * c
        byte = ti.cast(ti.min(ti.max(encoded * 255 + noise, ti.f32(0.0)), ti.f32(255.0)), ti.i32)
        packed |= byte << (8 * k)
    return packed


@ti.func
def alpha_byte(alpha):
    return ti.cast(alpha * 255 + ti.f32(0.5), ti.i32) << 24


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
def smooth(image: ti.template(), packed: ti.template(), width: ti.i32, height: ti.i32):
    """The packed bytes of a picture of linear colours, its edges smoothed."""
    for pixel in range(width * height):
        x, y = pixel % width, pixel // width
        packed[pixel] = encode(smooth_edge(image, x, y, width, height), x, y)


@ti.kernel
def without_alpha(packed: ti.template(), out: ti.types.ndarray(ti.i32, 1), groups: ti.i32):
    """Four pixels in three integers, for a machine whose lowest byte comes first."""
    for k in range(groups):
        a, b, c, d = packed[4 * k], packed[4 * k + 1], packed[4 * k + 2], packed[4 * k + 3]
        out[3 * k] = (a & 0xFFFFFF) | (b << 24)
        out[3 * k + 1] = ((b >> 8) & 0xFFFF) | (c << 16)
        out[3 * k + 2] = ((c >> 16) & 0xFF) | (d << 8)


@ti.kernel
def with_alpha(packed: ti.template(), out: ti.types.ndarray(ti.i32, 1), pixels: ti.i32):
    for pixel in range(pixels):
        out[pixel] = packed[pixel]
