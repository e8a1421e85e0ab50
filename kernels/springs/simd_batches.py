"""Springs in turn, eight at a time, for scenes that fit into a processor's cache.

Springs of a group share no ball, so none waits for another one of it: all loads and arithmetic come before all stores.
"""

from taichi_sim.kernels.springs.padded_blocks import NEAR

from taichi_sim.device.engine import ti

WIDTH = 8


@ti.func
def in_turn(part: ti.template(), table: ti.template(), h):
    """For all springs e from ball i to ball j part.take(i, j, part.give(i, j, e, h)), each seeing what those before it changed;
    part.change(i, j, e, h) is the same for ends that may coincide. Springs of a group share no ball, see forces.waves."""
    ti.loop_config(serialize=True)
    for group in range(table.groups):
        e = group * WIDTH
        f = ti.Matrix.zero(float, WIDTH, part.dim)
        nearest = ti.cast(1.0, float)
        for q in ti.static(range(WIDTH)):
            df, square = part.give(table.spring[e + q].one, table.spring[e + q].other, e + q, h)
            nearest = ti.min(nearest, square)
            for a in ti.static(range(part.dim)):
                f[q, a] = df[a]
        if nearest < NEAR:
            for k in range(e, e + WIDTH):
                part.change(table.spring[k].one, table.spring[k].other, k, h)
        else:
            for q in ti.static(range(WIDTH)):
                df = ti.Vector([f[q, a] for a in ti.static(range(part.dim))])
                part.take(table.spring[e + q].one, table.spring[e + q].other, df)
