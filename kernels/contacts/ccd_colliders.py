"""The first time at which a moving ball meets a collider.

Within a step a collider moves with constant velocity and angular velocity from its pose, and the ball along a parabola.
"""

from taichi_sim.kernels.contacts.colliders import (
    carried_back,
    distance,
    face_distance,
    local,
    surface_velocity,
    world,
)
from taichi_sim.kernels.contacts.kinds import RESTING
from taichi_sim.kernels.contacts.parabola import crossing

from taichi_sim.device.engine import ti

MISSES, MEETS, UNKNOWN = 0, 1, -1  # what becomes of a ball and one collider
NOTHING, UNKNOWN_WAY = -1, -2  # in place of the number of a wall or the key of a collider
WHOLE = -1  # in place of a face: all of the collider
MOST_LOOKS = 256  # at the distance along one path; what needs more waits at the last safe place
LOOK_STRIDE = 0.2  # of the radius: no look lies further behind a surface, so none is passed over
MARCH_SAFETY = 0.7  # of the way that a distance kept on a grid allows
RESTING_SINK = 0.005  # of the radius: what rests may sink in so far while it moves; the contact solve bears it
ROTATING_SINK = 0.1  # of the radius: the same for what came to rest within the step on a collider that rotates
SAME_FACE = 0.9  # cosine between normals


@ti.func
def meeting(
    walls: ti.template(), colliders: ti.template(), i, k, face, x, v, a, since, limit, begin, settled, floor, place
):
    """First time within `limit` seconds at which ball i, on a parabola from x that begins `since` seconds into the step, meets
    collider k, or that face of a hollow box around it, where it is not WHOLE: MEETS, MISSES or UNKNOWN beyond that time, and the
    time.

    Looks at the distance follow each other by a `stride` that passes nothing over; where one lies behind the surface, the meeting
    lies between it and the last one (`between`).
    """
    r = walls.model.radius[i]
    pose = colliders.pose[k]
    drift = v - pose.v
    start = x - pose.x - since * pose.v
    travel = drift.norm() * limit + 0.5 * a.norm() * limit * limit
    extent = colliders.shape[k].extent
    found, time = MISSES, limit
    if start.norm() <= extent + r + travel:
        finest = 1e-9 * r + walls.rounding * (ti.abs(x).max() + colliders.distance_from_origin(k))
        fastest, curve = approach(colliders, k, start, drift.norm() + a.norm() * limit, travel, extent + r)
        left, right, above, below = 0.0 * r, limit, 0.0 * r, 0.0 * r
        sunk = 0.0 * r
        behind, done = False, False
        t = 0.0 * r
        looks = 0
        while not done and looks < MOST_LOOKS:
            at = x + t * (v + 0.5 * t * a)
            slot = -1
            if looks == 0 and since == 0.0:
                slot = walls.collider_contacts.slot_of_mesh(i, k)
            d, n, within = 0.0 * r, 0.0 * x, False
            if slot >= 0:  # there it was found
                d, n = walls.collider_contacts.slot[slot].gap + r, walls.collider_contacts.slot[slot].normal
            else:
                p = local(colliders, k, at, since + t)
                d, n, within = distance(colliders, k, p, r, walls.collider_contacts.needs_exact(i))
                if ti.static(colliders.has_faces):
                    if face != WHOLE:
                        d, n = face_distance(colliders, k, face, p, d, n, True)
            gap = d - r
            if looks == 0 and MARCH_SAFETY * gap > fastest * limit:
                done = True
            else:
                if slot < 0:
                    n = world(colliders, k, n, since + t)
                if looks == 0:
                    sunk = ti.max(0.0, -gap)
                gap += sunk
                if gap < RESTING_SINK * r:
                    gap += allowance(walls, i, k, n, at - d * n, since + t, begin, settled, floor, place)
                u = n.dot(v + t * a - surface_velocity(colliders, k, at, since + t))
                looks += 1
                if behind:
                    if gap >= 0.0:
                        left, above = t, gap
                    else:
                        right, below = t, gap
                    if above <= finest or looks == MOST_LOOKS or right - left <= 1e-12 * limit:
                        found, time, done = MEETS, left, True
                elif gap < -finest:
                    behind, right, below = True, t, gap
                    if above <= finest:
                        found, time, done = MEETS, left, True
                elif gap <= finest and u < 0.0:
                    found, time, done = MEETS, t, True
                else:
                    left, above = t, gap
                    convex = is_convex(colliders, k, face, within)
                    free, step = stride(gap, u, n.dot(a) - curve, fastest, convex, r, 2.0 * limit)
                    if t + free >= limit or t >= limit:
                        done = True
                    else:
                        t = ti.min(t + step, limit)
            if behind:
                t = between(left, right, above, below)
        if not done:
            found, time = UNKNOWN, left
            if behind:
                found = MEETS
    return found, time


@ti.func
def is_convex(colliders: ti.template(), k, face, within):
    """True if collider k, or a face of it, is convex as seen from outside, so that it lies behind the plane that touches it
    where it is nearest: each such plane is treated as a wall, which is exact for faces and converges like Newton's method for
    the rest."""
    convex = face != WHOLE or not within
    if ti.static(colliders.has_mesh or colliders.has_custom):
        convex = convex and colliders.shape[k].kind >= 0
    return convex


@ti.func
def stride(gap, u, pull, fastest, convex, r, never):
    """Times [s] for which a ball of radius r surely meets nothing, and after which to look again: to the plane of what is convex,
    with the normal speed u [m/s] and acceleration `pull` [m/s^2]; to anything else no longer than its distance. Looks that hardly
    get on are a part of the radius apart."""
    free = never
    if convex:
        free = crossing(ti.max(gap, 0.0), u, pull, never)
    elif fastest > 0.0:
        free = MARCH_SAFETY * gap / fastest
    step = free
    if fastest > 0.0:
        if not convex or step * fastest < 1e-3 * r:
            step = ti.max(step, LOOK_STRIDE * r / fastest)
    return free, step


@ti.func
def between(left, right, above, below):
    """Next time to try for the meeting, between the times left and right at which the gap is `above` and `below` zero: where a
    line between the two crosses zero, but not too near to either (regula falsi, bounded)."""
    part = above / ti.max(above - below, 1e-30)
    return left + (right - left) * ti.max(0.05, ti.min(0.95, part))


@ti.func
def approach(colliders: ti.template(), k, start, fastest, travel, reach):
    """The largest speed [m/s] at which a ball that comes from `start`, seen from the centre, as fast as `fastest` and by `travel`
    at most approaches points of collider k, `reach` [m] around it; and how rotation bends its path as the collider sees it
    [m/s^2]."""
    curve = 0.0 * reach
    if ti.static(colliders.rotates):
        spin = angular_speed(colliders.pose[k].spin, colliders.dim)
        far = ti.min(start.norm() + travel, reach)
        curve = spin * spin * far + 2.0 * spin * fastest
        fastest += spin * far
    return fastest, curve


@ti.func
def angular_speed(spin, dim: ti.template()):
    """1/s, of an angular velocity, which is a scalar in 2D."""
    if ti.static(dim == 2):
        return ti.abs(spin)
    else:
        return spin.norm()


@ti.func
def allowance(walls: ti.template(), i, k, n, point, after, begin, settled, floor, place):
    """Depth [m] to which ball i may sink into collider k, whose normal is n, before the move stops it. It is 0 unless the ball
    rests on the collider, or something else that it rests on bears it at `point`, the place at which it would meet the collider
    `after` seconds into the step. begin: the ball's place at the start of the step. settled, floor, place: the collider on which
    it came to rest within this step, its normal there, and where; other faces of it are met as any."""
    r = walls.model.radius[i]
    sink, depth = RESTING_SINK * r, 0.0 * r
    at, planes = walls.collider_contacts, walls.planes.count
    far = walls.colliders.distance_from_origin(k)
    rests = settled != NOTHING and floor.dot(point - place) + r <= walls.tolerance(point, i, far)
    if settled == k and n.dot(floor) > SAME_FACE:
        rests = True
        if ti.static(walls.colliders.rotates):  # what rotates takes a ball around a bend within the step
            sink = ROTATING_SINK * r
    for s in range(walls.looked_at(i)):
        if walls.contact[i * walls.count + s].role == RESTING:
            m, base, beyond = walls.normal(i, s), point, far
            if s >= planes:
                own = at.collider(i, s - planes)
                rests = rests or (own == k and n.dot(m) > SAME_FACE)
                base = carried_back(walls.colliders, own, point, after)
                beyond += walls.colliders.distance_from_origin(own)
            gap = walls.gap(begin, i, s)
            if m.dot(base - begin) + r + gap <= walls.tolerance(point, i, beyond):
                rests, depth = True, ti.max(depth, -gap)
    return ti.select(rests, sink + depth, 0.0)


@ti.func
def first_collider(walls: ti.template(), i, x, v, a, since, limit, begin, settled, floor, place):
    """Earliest of all colliders that ball i meets: its key (number times `faces`, and the face of a hollow box around the ball),
    NOTHING, or UNKNOWN_WAY less the key; and the time. Each face for itself: that on which a ball rolls is the nearest one
    all the way, and hides the next."""
    hit = NOTHING
    time = limit
    if walls.model.inverse_mass[i] > 0.0:
        for k in range(walls.colliders.count):
            if walls.colliders.collides_with(walls.model, i, k):
                several = 0
                if ti.static(walls.colliders.has_faces):
                    if walls.colliders.shape[k].faces > 1:
                        _far, _away, inside = distance(
                            walls.colliders, k, local(walls.colliders, k, x, since), 0.0, False
                        )
                        if inside:
                            several = 1
                for face in range(ti.select(several == 1, walls.colliders.faces, 1)):
                    which = ti.select(several == 1, face, WHOLE)
                    found, t = meeting(
                        walls, walls.colliders, i, k, which, x, v, a, since, time, begin, settled, floor, place
                    )
                    if found != MISSES and t < time:
                        time = t
                        key = k * walls.colliders.faces + face
                        hit = ti.select(found == MEETS, key, UNKNOWN_WAY - key)
    return hit, time
