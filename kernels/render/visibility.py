"""Search for what lies nearest at every sample, kept by an atomic maximum, so that the order of threads plays no part.

Closeness w is linear on the screen: 1/z in perspective, far - z in a parallel (light) view; its bits sort like it. Where the
device has 64-bit integers, a key is (closeness << 32) | identity. Elsewhere all is drawn twice: first the closeness alone,
then, of the primitives exactly as close as that, the largest identity; so the pictures are the same. The second stage computes
each w by the same instructions as the first, hence to the same bits. Shadow maps need the closeness alone, 32 bits and one
stage.

What is drawn leaves a mark on the tiles that it may touch: all others hold nothing, and are neither read nor cleared.
"""

from taichi_sim.device.engine import ti

TILE = 16  # px


@ti.func
def bits_of(w):
    return ti.bit_cast(ti.cast(w, ti.f32), ti.i32)


@ti.func
def key_of(seen: ti.template(), w, identity):
    """Key of a primitive for the maximum (larger is nearer): closeness in the high bits, identity in the low ones; only the
    bits of its closeness where keys are not wide."""
    if ti.static(seen.wide):
        return (ti.cast(bits_of(w), ti.i64) << 32) | ti.cast(identity, ti.i64)
    else:
        return bits_of(w)


@ti.func
def may_win(seen: ti.template(), slot, key):
    """True if a primitive with at most this key could be what is seen."""
    if ti.static(seen.wide):
        return key > seen.key[slot]
    elif ti.static(seen.depth_only):
        return key > seen.bits[slot]
    else:
        return key > seen.bits[slot] - seen.stage[0]


@ti.func
def put(seen: ti.template(), slot, w, identity):
    key = key_of(seen, w, identity)
    if ti.static(seen.wide):
        if key > seen.key[slot]:
            ti.atomic_max(seen.key[slot], key)
    elif ti.static(seen.depth_only):
        if key > seen.bits[slot]:
            ti.atomic_max(seen.bits[slot], key)
    else:
        if seen.stage[0] == 0:
            if key > seen.bits[slot]:
                ti.atomic_max(seen.bits[slot], key)
        elif key == seen.bits[slot]:
            ti.atomic_max(seen.identity[slot], identity)


@ti.func
def tiles_across(width):
    return (width + ti.static(TILE - 1)) // TILE


@ti.func
def mark(seen: ti.template(), x0, x1, y0, y1, width):
    """Something may be drawn at pixels x0 <= x < x1, y0 <= y < y1."""
    if x0 < x1 and y0 < y1:
        across = tiles_across(width)
        for j in range(y0 // TILE, (y1 - 1) // TILE + 1):
            for i in range(x0 // TILE, (x1 - 1) // TILE + 1):
                seen.marked[j * across + i] = 1


@ti.func
def mark_thin(seen: ti.template(), x0, x1, y0, y1, width):
    """Mark, in a shadow map, that what is drawn at these pixels is too thin to be sure to be met by taps about other places."""
    if ti.static(seen.depth_only):
        if x0 < x1 and y0 < y1:
            across = tiles_across(width)
            for j in range(y0 // TILE, (y1 - 1) // TILE + 1):
                for i in range(x0 // TILE, (x1 - 1) // TILE + 1):
                    seen.thin[j * across + i] = 1


@ti.kernel
def clear(seen: ti.template(), samples: ti.template(), width: ti.i32, height: ti.i32, tiles: ti.i32):
    """Clear the tiles of a picture that bear a mark: nothing is seen there."""
    for k in range(tiles * TILE):  # rows of tiles
        tile = k // TILE
        if seen.marked[tile] > 0:
            across = tiles_across(width)
            x, y = tile % across * TILE, tile // across * TILE + k % TILE
            if y < height:
                first = (y * width + x) * samples
                for slot in range(first, first + ti.min(TILE, width - x) * samples):
                    if ti.static(seen.wide):
                        seen.key[slot] = ti.cast(0, ti.i64)
                    else:
                        seen.bits[slot] = 0
                        if ti.static(not seen.depth_only):
                            seen.identity[slot] = 0
    for tile in range(tiles):
        seen.marked[tile] = 0
        if ti.static(seen.depth_only):
            seen.thin[tile] = 0


@ti.func
def found(seen: ti.template(), slot):
    """Value of the nearest primitive at a sample, for `closeness` and `identity`."""
    if ti.static(seen.wide):
        return seen.key[slot]
    elif ti.static(seen.depth_only):
        return seen.bits[slot]
    else:
        return ti.Vector([seen.bits[slot], seen.identity[slot]])


@ti.func
def closeness(seen: ti.template(), key):
    if ti.static(seen.wide):
        return ti.bit_cast(ti.cast(key >> 32, ti.i32), ti.f32)
    elif ti.static(seen.depth_only):
        return ti.bit_cast(key, ti.f32)
    else:
        return ti.bit_cast(key[0], ti.f32)


@ti.func
def identity_of(seen: ti.template(), key):
    if ti.static(seen.wide):
        return ti.cast(key, ti.i32)
    else:
        return key[1]
