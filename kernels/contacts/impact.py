"""Moving a ball through a step with impacts on walls and colliders at their exact times.

Within a step the path is a parabola from x with start velocity v - a h / 2 and acceleration a: exact for constant forces,
so an elastic bounce loses nothing. A scheme without acceleration inside the step passes a = 0 and moves on a straight line.

A force that changes within the step acts with the mean of its values at both ends, as it does without impacts: what it did before
the impact is thrown back with the ball. So the second half of the kick, h a / 2, of a ball that met a wall after the time t is
h a / 2 - m (m . h a / 2) with m = sqrt((1 + e) t / h) n, its `reflected`. Without m a ball on a spring k that bounces with the
speed u would gain h^2 k u^2 / 6 on average, as the force changes with its way.
"""

from taichi_sim.kernels.contacts import bent_paths, contact_law, surface_ways
from taichi_sim.kernels.contacts.ccd_colliders import NOTHING, UNKNOWN_WAY, first_collider
from taichi_sim.kernels.contacts.colliders import surface_velocity
from taichi_sim.kernels.contacts.kinds import RESTING
from taichi_sim.kernels.contacts.parabola import crossing
from taichi_sim.kernels.vectors import cross, lever, zero_scalar_in_2d

from taichi_sim.device.engine import ti

SHORTEST_FLIGHT = 1.0 / 16.0  # of a step: one that is shorter ends in rest
MOST_IMPACTS = 8  # per ball and step; a wedge that asks for more stops the ball for the rest of the step


@ti.func
def first_wall(walls: ti.template(), i, x, v, a, remaining, rested):
    """Earliest wall hit by ball i within `remaining` seconds: its number or NOTHING, and the time. rested: the wall that it met
    just now and rests on, which rounding must not have it meet again."""
    hit = NOTHING
    time = remaining
    for k in range(walls.planes.count):
        wall = walls.planes.wall[k]
        gap = walls.planes.gap(x, i, k)
        u = wall.normal.dot(v)
        pull = wall.normal.dot(a)
        closest = gap + ti.min(0.0, u) * remaining + 0.5 * ti.min(0.0, pull) * remaining * remaining
        # what rests on it does not meet it, unless another surface has thrown it back there
        resting = walls.touching[i] > 0 and walls.contact[i * walls.count + k].role == RESTING
        resting = resting and u >= -walls.threshold[0]
        resting = resting or k == rested
        if gap >= -walls.tolerance(x, i, 0.0) and closest <= 0.0 and not resting:
            t = crossing(ti.max(gap, 0.0), u, pull, 2.0 * remaining)
            if t < time:
                time = t
                hit = k
    return hit, time


@ti.func
def bounce(walls: ti.template(), i, n, law, v, a, threshold, h, remaining):
    """Velocity, from the surface, and acceleration of ball i after it met a surface with the normal n, and whether it rests:
    reflected above the threshold speed, else resting on it for the `remaining` seconds of the step. Coulomb friction is bounded
    by all of the normal impulse: that of the impact, and that which the acceleration into the surface adds while it rests."""
    u = n.dot(v)
    press = ti.max(0.0, -n.dot(a))
    rests = is_caught(law, u, press, threshold, h)
    j = -u
    if -u > threshold and not rests:
        j = contact_law.rebound(law.restitution, u, 0.0 * u)
    after = v + j * n
    rest = a
    if rests:
        rest = a + press * n
        j += press * remaining
    if ti.static(walls.model.has_friction):
        slip, sideways = v, 0.0 * u + 1.0
        if ti.static(walls.model.spins):
            slip -= lever(walls.state.spin[i], n)
            sideways = walls.model.sideways(i)
        viscous = ti.select(-u > threshold, contact_law.decayed(law.viscous_friction * h), 0.0 * u)
        change, _ = contact_law.tangential_impulse(
            walls.model, slip, n, sideways, zero_scalar_in_2d(v.n), law.friction * j, viscous
        )  # of a unit mass
        after += change
        if ti.static(walls.model.spins):
            walls.state.spin[i] = walls.state.spin[i] - walls.model.spin_response(i) * cross(n, change)
    return after, rest, rests


@ti.func
def is_caught(law, u, press, threshold, h):
    """True if a ball that arrives with the normal speed u < 0 rests: it is slow, does not bounce, or what presses it into the
    surface [m/s^2] would bring it back at once, so that the bounces to come add up to a small part of the step."""
    return -u <= threshold or law.restitution == 0.0 or -2.0 * law.restitution * u < SHORTEST_FLIGHT * h * press


@ti.func
def beside(last, n, v):
    """The vector v, which leads along a surface with the normal n, without what leads back into the one with the normal `last`:
    in a wedge a ball would be thrown from one to the other without end."""
    across = last - last.dot(n) * n
    if last.dot(v) < 0.0 and across.dot(across) > contact_law.LEAST_SQUARED_SINE:
        v -= across.dot(v) / across.dot(across) * across
    return v


@ti.func
def note_reflection(walls: ti.template(), i, n, law, rests, part, body):
    """Note that ball i met a surface with the normal n, of the body that has a probe or -1, after this part of the step; the
    last one in a step counts."""
    if not rests:
        walls.reflected[i] = ti.sqrt((1.0 + law.restitution) * part) * n
        if ti.static(walls.probed):
            walls.reflecting_body[i] = body


@ti.func
def thrown_back(walls: ti.template(), i, kick):
    """The second half of a kick [m/s], of a ball that may have met a wall in this step."""
    m = walls.reflected[i]
    return kick - m.dot(kick) * m


@ti.func
def record_thrown_back(walls: ti.template(), i, kick):
    """Record for probes what the wall that ball i met in this step gave it beside the second half of a kick [m/s]."""
    m = walls.reflected[i]
    if m.dot(m) > 0.0:
        walls.received.add(i, walls.reflecting_body[i], -m.dot(kick) / walls.model.inverse_mass[i] * m)


@ti.func
def surface(walls: ti.template(), i, key, x, after):
    """Direction from a collider, or a face of it, see ccd_colliders.first_collider, to ball i at x that touches it `after`
    seconds into the step, and its velocity there."""
    k = key // walls.colliders.faces
    touch, exact = walls.model.radius[i], walls.collider_contacts.needs_exact(i)
    d, n, _ = walls.colliders.distance(k, key % walls.colliders.faces, x, after, touch, exact)
    return n, surface_velocity(walls.colliders, k, x - d * n, after)


@ti.func
def met_surface(walls: ti.template(), i, hit, key, x, after):
    """Number of the collider of a key that ball i at x meets `after` seconds into the step, or of wall `hit`, beyond those;
    direction from it to the ball, its velocity there, its material, and the number of its probe, or -1."""
    number, n, own, material, body = NOTHING, 0.0 * x, 0.0 * x, 0, -1
    if key == NOTHING:
        number, n, material = hit, walls.planes.wall[hit].normal, walls.planes.wall[hit].material
        if ti.static(walls.has_colliders):
            number += walls.colliders.count
        if ti.static(walls.probed):
            body = walls.received.plane[hit]
    elif ti.static(walls.has_colliders):
        number = key // walls.colliders.faces
        n, own = surface(walls, i, key, x, after)
        material = walls.colliders.shape[number].surface
        if ti.static(walls.probed):
            body = walls.received.solid[number]
    return number, n, own, material, body


@ti.func
def pushed(walls: ti.template(), i, key, x, after, time):
    """Displacement of ball i at x, which a collider touches `after` seconds into the step and pushes before it for `time`."""
    n, own = surface(walls, i, key, x, after)
    return time * ti.max(0.0, n.dot(own)) * n


@ti.func
def pressing_speed(walls: ti.template(), i, k, n, v):
    """Normal speed, 0 or negative, with which ball i at the velocity v presses into its surface k; one that falls away is
    followed, one that is foreseen is reached."""
    least = 0.0 * v[0]
    if ti.static(walls.has_colliders or walls.foresees):
        if k >= walls.planes.count or (ti.static(walls.foresees) and walls.law(i, k).restitution == 0.0):
            least = ti.min(0.0, walls.contact[i * walls.count + k].target)
    return ti.min(0.0, n.dot(walls.relative(v, i, k)) - least)


@ti.func
def press(walls: ti.template(), i, v, a, records: ti.template()):
    """Velocity and acceleration of ball i without the parts that press it into walls on which it rests. records: for probes,
    where it met something and does not get back what is taken of its velocity.

    Those parts are the contact solve's to undo, friction with them; the path only must not enter the wall meanwhile.
    """
    for k in range(walls.looked_at(i)):
        if walls.contact[i * walls.count + k].role == RESTING:
            n = walls.normal(i, k)
            change = -pressing_speed(walls, i, k, n, v) * n
            v += change
            a -= ti.min(0.0, n.dot(a)) * n
            if ti.static(records):
                walls.record(i, k, change / walls.model.inverse_mass[i])
    return v, a


@ti.func
def may_meet_surfaces(walls: ti.template(), i, x, start, v, a, other, since, t, remaining):
    """True if ball i, which meets a wall or the collider `other` after t of the `remaining` seconds of a step that began `since`
    seconds ago at x, has some way to go before that, and may come to triangles that collide before that or after. It has moved by
    `start` so far. It comes off with the speed it has at most, and with twice that of a collider."""
    own = 0.0 * t
    if ti.static(walls.has_colliders):
        if other >= 0:
            k = other // walls.colliders.faces
            own = 2.0 * surface_velocity(walls.colliders, k, x + start + t * (v + 0.5 * t * a), since + t).norm()
    way = start.norm() + surface_ways.length(v.norm() + own, a.norm(), remaining)
    return not is_at_surface(walls, i, x, t * v, other) and surface_ways.may_meet(walls, i, x, way)


@ti.func
def is_at_surface(walls: ti.template(), i, x, shift, other):
    """True if ball i at x is at the wall or the collider `other` that it meets after `shift` [m], but for rounding."""
    far = 0.0 * x[0]
    if ti.static(walls.has_colliders):
        if other >= 0:
            far = walls.colliders.distance_from_origin(other // walls.colliders.faces)
    return shift.norm() <= 2.0 * walls.tolerance(x, i, far)


@ti.func
def move(walls: ti.template(), i, x, v, a, h, threshold):
    """Displacement over h and drift velocity of ball i, given drift velocity v (at half the step) and acceleration a."""
    shift = h * v
    drift = v
    if ti.static(walls.plan.reflects):
        walls.reflected[i] = 0.0 * v
    way = ti.abs(shift).sum() + 0.5 * h * h * ti.abs(a).sum()  # at most
    near = True
    if ti.static(not walls.has_colliders):
        near = way >= walls.clearance[i]
    if near:
        shift, drift = move_with_impacts(walls, i, x, v, a, h, threshold)
    return shift, drift


@ti.func
def move_with_impacts(walls: ti.template(), i, x, v, a, h, threshold):
    """`move` of a ball that may meet something."""
    along, pressed = press(walls, i, v, a, False)
    pull = pressed
    remaining = h
    speed = along - 0.5 * h * pull
    shift = h * along
    touched = False
    settled = NOTHING  # the collider on which it came to rest within this step (walls: beyond these), the normal there, and where
    floor, place = 0.0 * v, x
    fast = False  # it may have to stop on its way at another ball, see ccd_balls
    if ti.static(walls.plan.pairs):
        fast = shift.dot(shift) > walls.model.radius[i] ** 2
    rested, last = NOTHING, 0.0 * v  # the wall on which it came to rest just now; the normal of such a surface
    beyond, number = 0.0 * h, 0  # m, length of the path beyond the first bend; bends
    body = -1  # number of the probe of what it met last, or -1
    begun = v  # the drift velocity with which the path begins, after what it bounces off where it starts
    spin = zero_scalar_in_2d(walls.model.dim)
    if ti.static(walls.plan.bends):
        if ti.static(walls.model.spins):
            spin = walls.state.spin[i]
        if ti.static(walls.probed):
            walls.received.note(i)
    for _ in range(MOST_IMPACTS):
        if remaining > 0.0:
            start = ti.select(touched, shift, 0.0 * shift)
            hit, t = first_wall(walls, i, x + start, speed, pull, remaining, rested)
            other = NOTHING
            if ti.static(walls.has_colliders):
                other, t = first_collider(walls, i, x + start, speed, pull, h - remaining, t, x, settled, floor, place)
            meets = other != NOTHING or hit >= 0
            waits = False  # at the wall, where the way may lead through a surface
            if ti.static(walls.plan.triangles):
                if fast and meets:
                    waits = may_meet_surfaces(walls, i, x, start, speed, pull, other, h - remaining, t, remaining)
            if waits:
                shift = start + t * (speed + 0.5 * t * pull)  # the next step bounces
                if ti.static(walls.moves):
                    if other >= 0:
                        shift += pushed(walls, i, other, x + shift, h - remaining + t, remaining - t)
                speed += remaining * pull
                remaining = 0.0
            elif meets:
                since = h - remaining + t
                shift = start + t * (speed + 0.5 * t * pull)
                at_once = False
                if ti.static(walls.plan.bends):
                    at_once = number == 0 and is_at_surface(walls, i, x, shift, other)
                    if not at_once:
                        beyond += ti.select(number > 0, (shift - start).norm(), 0.0 * h)
                        number += 1
                        if fast and number == 1:
                            walls.path[i].rest = ti.max((remaining - t) / h, bent_paths.LEAST_REST)
                            walls.path[i].way = shift
                came, load = speed + t * pull, pull
                speed = came
                remaining -= t
                rests, normal = False, 0.0 * v
                waits = other <= UNKNOWN_WAY  # where it is; the collider bears what forces do meanwhile
                if waits:
                    pull *= 0.0
                    if ti.static(walls.has_colliders and walls.probed):
                        body = walls.received.solid[(UNKNOWN_WAY - other) // walls.colliders.faces]
                else:
                    surface_met, normal, own, material, body = met_surface(walls, i, hit, other, x + shift, since)
                    law = walls.law_of_material(i, material, normal)
                    rests = True  # on a collider that it does not approach
                    if other == NOTHING or normal.dot(came - own) < 0.0:
                        speed, pull, rests = bounce(walls, i, normal, law, came - own, pull, threshold, h, remaining)
                        speed += own
                    if ti.static(walls.plan.reflects):
                        note_reflection(walls, i, normal, law, rests, since / h, body)
                    if rests:
                        settled, floor, place = surface_met, normal, x + shift
                rested = ti.select(rests and other == NOTHING, hit, NOTHING)
                if ti.static(not (walls.moves or walls.model.has_friction)):
                    if rests:
                        speed, pull = beside(last, normal, speed), beside(last, normal, pull)
                        last = normal
                if ti.static(walls.probed):
                    change = speed - came + remaining * (pull - load)
                    walls.received.add(i, body, change / walls.model.inverse_mass[i])
                if ti.static(walls.plan.bends):
                    if at_once:
                        begun = speed + remaining * pull - 0.5 * h * pressed
                        if ti.static(walls.model.spins):
                            spin = walls.state.spin[i]
                        if ti.static(walls.probed):
                            walls.received.note(i)
                touched = True
                remaining = ti.select(waits, 0.0 * h, remaining)
            elif touched:
                shift += remaining * (speed + 0.5 * remaining * pull)
                beyond += ti.select(number > 0, (shift - start).norm(), 0.0 * h)
                speed += remaining * pull
                remaining = 0.0
            else:
                remaining = 0.0
    drift = v
    if touched:
        if ti.static(walls.probed):
            press(walls, i, v, a, True)
            # what it met last bears what forces do once it has met as much as it may
            walls.received.add(i, body, -remaining / walls.model.inverse_mass[i] * pull)
        kick = 0.5 * h * pressed  # the second half
        if ti.static(walls.plan.reflects):
            if ti.static(walls.probed):
                record_thrown_back(walls, i, -kick)  # the end of the step gives what is so
            kick = thrown_back(walls, i, kick)
        drift = speed - kick  # the next solve still has to bear the load on what it rested on
        if ti.static(walls.plan.bends):
            if fast:
                walls.path[i].length = ti.select(number > 1, beyond, 0.0 * h)
                walls.path[i].change = drift - begun
                if ti.static(walls.model.spins):
                    walls.path[i].spin_change = walls.state.spin[i] - spin
    return shift, drift
