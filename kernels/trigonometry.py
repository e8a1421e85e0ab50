"""Sines, cosines and inverse cosines to the last digits of single precision, on every device.

Vulkan lets a device's own sine and cosine be wrong by 2^-11, its inverse cosine by 4096 units in the last place, and some
are: SwiftShader's sine by 1.9e-4. Those of the CPU and of CUDA are right, and are taken.
"""

from taichi_sim.device.engine import has_right_sines, ti

PI = 3.141592653589793
HALF_PI = (1.5703125, 4.837512969970703e-4, 7.549789948768648e-8)  # in parts, the first ones of few digits
# Abramowitz and Stegun 4.4.46: arccos(a) / sqrt(1 - a), to 2e-8
ARCCOSINE = (
    1.5707963050, -0.2145988016, 0.0889789874, -0.0501743046, 0.0308918810, -0.0170881256, 0.0066700901, -0.0012624911,
)  # fmt: skip


@ti.func
def by_polynomials(angle):
    """Sine and cosine of an angle [rad] up to some thousands, of what is left of it within pi / 4 of 0 (Cephes)."""
    quarters = ti.round(angle * (2.0 / PI))
    a = ((angle - quarters * HALF_PI[0]) - quarters * HALF_PI[1]) - quarters * HALF_PI[2]
    z = a * a
    s = a + a * z * (-1.6666654611e-1 + z * (8.3321608736e-3 - z * 1.9515295891e-4))
    c = 1.0 - 0.5 * z + z * z * (4.166664568e-2 + z * (-1.388731625e-3 + z * 2.443315712e-5))
    turn = ti.cast(quarters, ti.i32) & 3
    if turn % 2 == 1:
        s, c = c, -s
    if turn >= 2:
        s, c = -s, -c
    return s, c


@ti.func
def sine_cosine(angle):
    s, c = angle, angle
    if ti.static(has_right_sines()):
        s, c = ti.sin(angle), ti.cos(angle)
    else:
        s, c = by_polynomials(angle)
    return s, c


@ti.func
def sine(angle):
    return ti.sin(angle) if ti.static(has_right_sines()) else by_polynomials(angle)[0]


@ti.func
def cosine(angle):
    return ti.cos(angle) if ti.static(has_right_sines()) else by_polynomials(angle)[1]


@ti.func
def arccosine(a):
    """Angle from 0 to pi whose cosine is a, from -1 to 1."""
    angle = a
    if ti.static(has_right_sines()):
        angle = ti.acos(a)
    else:
        size = ti.abs(a)
        angle = 0.0 * a
        for k in ti.static(range(len(ARCCOSINE) - 1, -1, -1)):
            angle = angle * size + ARCCOSINE[k]
        angle *= ti.sqrt(1.0 - size)
        if a < 0.0:
            angle = PI - angle
    return angle
