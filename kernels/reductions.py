"""Energy and speed of balls, summed in double precision in parts of a fixed length: the same bits for any number of threads."""

from taichi_sim.kernels.vectors import unit

from taichi_sim.device.engine import ti

BAD, SPEED, KINETIC, ELASTIC, GRAVITY, WEIGHT, SIZE = range(7)  # members of a row


@ti.func
def good(ball, far):
    """Whether x and v are numbers below `far`. One by one: a comparison with nan is false, and a maximum may drop it."""
    fine = True
    for a in ti.static(range(ball.x.n)):
        fine = fine and ti.abs(ball.x[a]) < far and ti.abs(ball.v[a]) < far
    return fine


@ti.func
def stored(ball: ti.template(), springs: ti.template(), i, real: ti.template()):
    """Elastic energy [J] of the springs that ball i lists."""
    energy = ti.cast(0.0, real)
    for e in range(springs.start[i], springs.start[i + 1]):
        place = e
        if ti.static(springs.order == "waves"):
            place = springs.place[e]
        spring = springs.spring[place]
        _, d = unit(ball[spring.other].x - ball[i].x, i, spring.other)
        stretch = ti.cast(d - spring.rest_length, real)
        energy += 0.5 * ti.cast(spring.stiffness, real) * stretch * stretch
    return energy
