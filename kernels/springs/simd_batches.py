"""Springs in turn, eight at a time, for scenes that fit into a processor's cache.

Springs of a batch share no ball, so none waits for another one of it: all loads and arithmetic come before all stores.
"""

from taichi_sim.kernels.springs.padded_blocks import COINCIDENT

from taichi_sim.device.engine import ti

BATCH_WIDTH = 8


@ti.func
def there_and_back(sweep: ti.template(), springs: ti.template(), h):
    """Call sweep.take(i, j, sweep.give(i, j, e, h)) for all springs e from ball i to ball j, in order and then in the reverse
    order, each seeing what those before it changed. give returns the impulse [N s] on ball i and the square of the distance of
    both ends [m^2]; sweep.change(i, j, e, h) is the same for ends that may coincide. For batches see forces.spring_batches."""
    some_batches(sweep, springs, h, 0, 2 * springs.batches)


@ti.func
def some_batches(sweep: ti.template(), springs: ti.template(), h, begin: ti.template(), end: ti.template()):
    """Those of `there_and_back` from number `begin` to `end`, in the order in which it takes them."""
    ti.loop_config(serialize=True)
    for step in range(begin, end):
        e = ti.min(step, 2 * springs.batches - 1 - step) * BATCH_WIDTH
        f = ti.Matrix.zero(float, BATCH_WIDTH, sweep.dim)
        nearest = ti.cast(1.0, float)
        for q in ti.static(range(BATCH_WIDTH)):
            df, square = sweep.give(springs.spring[e + q].one, springs.spring[e + q].other, e + q, h)
            nearest = ti.min(nearest, square)
            for a in ti.static(range(sweep.dim)):
                f[q, a] = df[a]
        if nearest < COINCIDENT:
            for k in range(e, e + BATCH_WIDTH):
                sweep.change(springs.spring[k].one, springs.spring[k].other, k, h)
        else:
            for q in ti.static(range(BATCH_WIDTH)):
                df = ti.Vector([f[q, a] for a in ti.static(range(sweep.dim))])
                sweep.take(springs.spring[e + q].one, springs.spring[e + q].other, df)
