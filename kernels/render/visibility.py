"""What lies nearest at every sample, kept by an atomic maximum, so that the order of threads plays no part.

Closeness w is linear on the screen: 1/z in perspective, far - z in a parallel (light) view; its bits sort like it. Where the
device has 64-bit integers, a key is (closeness << 32) | identity. Elsewhere all is drawn twice: first the closeness alone, then,
of the primitives exactly as close as that, the largest identity; so the pictures are the same. The second stage computes each w
by the same instructions as the first, hence to the same bits.
"""

from taichi_sim.device.engine import ti


@ti.func
def bits_of(w):
    return ti.bit_cast(ti.cast(w, ti.f32), ti.i32)


@ti.func
def key_of(seen: ti.template(), w, identity):
    """What a primitive so close enters the maximum with: its key, or the bits of its closeness."""
    if ti.static(seen.wide):
        return (ti.cast(bits_of(w), ti.i64) << 32) | ti.cast(identity, ti.i64)
    else:
        return bits_of(w)


@ti.func
def may_win(seen: ti.template(), slot, key):
    """Whether a primitive with at most this key could be what is seen."""
    if ti.static(seen.wide):
        return key > seen.key[slot]
    else:
        return key > seen.bits[slot] - seen.stage[0]


@ti.func
def put(seen: ti.template(), slot, w, identity):
    key = key_of(seen, w, identity)
    if ti.static(seen.wide):
        if key > seen.key[slot]:
            ti.atomic_max(seen.key[slot], key)
    elif seen.stage[0] == 0:
        if key > seen.bits[slot]:
            ti.atomic_max(seen.bits[slot], key)
    elif key == seen.bits[slot]:
        ti.atomic_max(seen.identity[slot], identity)


@ti.func
def start_with(seen: ti.template(), slot, w, identity):
    """What is seen where nothing else is drawn. To be called before each stage."""
    if ti.static(seen.wide):
        seen.key[slot] = key_of(seen, w, identity)
    else:
        if seen.stage[0] == 0:
            seen.bits[slot] = bits_of(w)
        seen.identity[slot] = ti.select(seen.bits[slot] == bits_of(w), identity, 0)


@ti.func
def found(seen: ti.template(), slot):
    """What is seen at a sample, for `closeness` and `identity`."""
    if ti.static(seen.wide):
        return seen.key[slot]
    else:
        return ti.Vector([seen.bits[slot], seen.identity[slot]])


@ti.func
def closeness(seen: ti.template(), key):
    if ti.static(seen.wide):
        return ti.bit_cast(ti.cast(key >> 32, ti.i32), ti.f32)
    else:
        return ti.bit_cast(key[0], ti.f32)


@ti.func
def identity_of(seen: ti.template(), key):
    if ti.static(seen.wide):
        return ti.cast(key, ti.i32)
    else:
        return key[1]
