"""Moving a ball through a step with impacts on walls at their exact times.

Within a step the path is a parabola from x with start velocity v - a h / 2 and acceleration a: exact for constant forces,
so an elastic bounce loses nothing. A scheme without acceleration inside the step passes a = 0 and moves on a straight line.
"""

import taichi as ti

from .contact_law import decayed
from .direction import cross, lever

IMPACTS = 8  # per ball and step; a wedge that asks for more stops the ball for the rest of the step


@ti.func
def crossing(gap, v, a, never):
    """First time at which gap + v t + a t^2 / 2 falls to 0, or `never`. gap >= 0."""
    t = never
    square = v * v - 2.0 * a * gap
    if v < 0.0 and square >= 0.0:
        t = 2.0 * gap / (ti.sqrt(square) - v)  # no cancellation for a slow fall
    elif v >= 0.0 and a < 0.0:
        t = (v + ti.sqrt(square)) / -a
    return t


@ti.func
def first_wall(walls: ti.template(), i, x, v, a, remaining):
    """Earliest wall hit by ball i within `remaining` seconds: its number or -1, and the time."""
    hit = -1
    time = remaining
    for k in range(walls.count):
        wall = walls.wall[k]
        gap = walls.gap(x, i, k)
        u = wall.normal.dot(v)
        pull = wall.normal.dot(a)
        closest = gap + ti.min(0.0, u) * remaining + 0.5 * ti.min(0.0, pull) * remaining * remaining
        resting = walls.touched[i] > 0 and walls.contact[i * walls.count + k].active == 1
        if gap >= -walls.tolerance(x, i) and closest <= 0.0 and not resting:
            t = crossing(ti.max(gap, 0.0), u, pull, 2.0 * remaining)
            if t < time:
                time = t
                hit = k
    return hit, time


@ti.func
def bounce(walls: ti.template(), i, k, v, a, threshold, h):
    """Velocity and acceleration of ball i after wall k: reflected above the threshold speed, else resting on it."""
    wall = walls.wall[k]
    law = walls.law(i, k)
    u = wall.normal.dot(v)
    j = -u
    if -u > threshold:
        j = -(1.0 + law.restitution) * u
    after = v + j * wall.normal
    if ti.static(walls.model.has_friction):
        t = v - u * wall.normal
        share = 0.0 * u + 1.0
        if ti.static(walls.model.spins):
            t -= lever(walls.state.turn[i], wall.normal)
            share = 1.0 / (1.0 + walls.model.turning)
        speed = t.norm()
        if speed > 0.0:
            slip = ti.select(-u > threshold, decayed(law.viscous_friction * h), 0.0 * u)
            change = ti.min(share * speed, slip * share * speed + law.friction * j) / speed * t
            after -= change
            if ti.static(walls.model.spins):
                walls.state.turn[i] = walls.state.turn[i] + walls.model.turning * cross(wall.normal, change)
    rest = a
    if -u <= threshold or law.restitution == 0.0:
        rest = a - ti.min(0.0, wall.normal.dot(a)) * wall.normal
    return after, rest


@ti.func
def press(walls: ti.template(), i, v, a):
    """Velocity and acceleration of ball i without the parts that press it into walls on which it rests.

    Those are the contact solve's to undo, friction with them; the path only must not enter the wall meanwhile.
    """
    for k in range(ti.select(walls.touched[i] > 0, walls.count, 0)):
        if walls.contact[i * walls.count + k].active == 1:
            n = walls.wall[k].normal
            v -= ti.min(0.0, n.dot(v)) * n
            a -= ti.min(0.0, n.dot(a)) * n
    return v, a


@ti.func
def move(walls: ti.template(), i, x, v, a, h, threshold):
    """Displacement over h and drift velocity of ball i, given drift velocity v (at half the step) and acceleration a."""
    along, pull = press(walls, i, v, a)
    remaining = h
    speed = along - 0.5 * h * pull
    shift = h * along
    touched = False
    for _ in range(IMPACTS):
        if remaining > 0.0:
            start = ti.select(touched, shift, 0.0 * shift)
            hit, t = first_wall(walls, i, x + start, speed, pull, remaining)
            if hit >= 0:
                shift = start + t * (speed + 0.5 * t * pull)
                speed, pull = bounce(walls, i, hit, speed + t * pull, pull, threshold, h)
                remaining -= t
                touched = True
            elif touched:
                shift += remaining * (speed + 0.5 * remaining * pull)
                speed += remaining * pull
                remaining = 0.0
            else:
                remaining = 0.0
    drift = v
    if touched:
        drift = speed - 0.5 * h * a
    return shift, drift
