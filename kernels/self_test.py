"""Small loops with known results, for what the simulation relies on. A device that gets one wrong has a broken driver."""

from taichi_sim.device.engine import ti


@ti.kernel
def ragged(count: ti.template(), slots: ti.template(), n: ti.i32):
    """Loops of unlike lengths that all draw numbers from one counter: 0 to n (n - 1) / 2 - 1, each once."""
    for i in range(n):
        for _ in range(i):
            slots[ti.atomic_add(count[0], 1)] += 1


@ti.kernel
def in_order(a: ti.template(), b: ti.template(), n: ti.i32):
    """The second loop sees all that the first has written, and the third all of the second: b[i] = 3 i."""
    for i in range(n):
        a[i] = i
    for i in range(n):
        b[n - 1 - i] = 2 * a[n - 1 - i] + a[i] - (n - 1 - i)
    for i in range(n):
        b[i] += 2 * a[i] - a[n - 1 - i]


@ti.kernel
def reduced(whole: ti.template(), real: ti.template(), n: ti.i32):
    """Sum, least and largest of 0 to n - 1, and the sum of 0.5 n times: exact in single precision for n up to 2^24."""
    whole[1] = n
    for i in range(n):
        whole[0] += i
        ti.atomic_min(whole[1], i)
        ti.atomic_max(whole[2], i)
        real[0] += 0.5


@ti.kernel
def hashed(mixed: ti.template(), n: ti.i32):
    """Products of unsigned numbers that wrap around, and bits of floats."""
    for i in range(n):
        key = ti.cast(i, ti.u32) * ti.u32(2654435761)
        key ^= key >> 15
        mixed[i] = ti.cast(key & ti.u32(0x7FFFFFFF), ti.i32) ^ ti.bit_cast(ti.cast(i, ti.f32), ti.i32)


@ti.kernel
def rounded(real: ti.template(), n: ti.i32):
    """Rounding down of negative numbers, and comparisons with what is no number, which are false."""
    nothing = real[n] / real[n]
    for i in range(n):
        down = ti.floor(-0.25 * i)
        real[i] = ti.select(nothing < 1.0 or nothing >= 1.0, -1.0, down)
