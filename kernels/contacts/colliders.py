"""Distances from colliders, and the first time at which a moving ball meets one.

A collider's pose is that at the start of a step; within the step it moves with constant velocity and angular velocity to the
pose at its end. All distances are signed: negative inside the solid.
"""

from taichi_sim.kernels.contacts.parabola import crossing
from taichi_sim.kernels.vectors import lever

from taichi_sim.device.engine import ti

ROUND, BOX, MESH = range(3)
MOST = 256  # looks at the distance along one path; what needs more waits at the last safe place
STRIDE = 0.2  # of the radius: no look lies further behind a surface, so none is passed over
CAREFUL = 0.7  # of the way that a distance kept on a grid allows
SINK = 0.005  # of the radius: what rests may sink in so far while it moves; the contact solve holds it
BEND = 0.1  # of the radius: the same for what came to rest within the step on a collider that turns


@ti.func
def turned(q, angle):
    """q turned by an angle (2D) or a rotation vector (3D)."""
    result = q
    if ti.static(q.n == 2):
        c, s = ti.cos(angle), ti.sin(angle)
        result = ti.Vector([c * q[0] - s * q[1], s * q[0] + c * q[1]])
    else:
        size = angle.norm()
        if size > 0.0:
            n = angle / size
            c, s = ti.cos(size), ti.sin(size)
            result = c * q + s * n.cross(q) + (1.0 - c) * n.dot(q) * n
    return result


@ti.func
def size_of(turn, dim: ti.template()):
    """Angular speed."""
    if ti.static(dim == 2):
        return ti.abs(turn)
    else:
        return turn.norm()


@ti.func
def local(colliders: ti.template(), k, x, after):
    """The point x in the frame of collider k, `after` seconds into the step."""
    pose = colliders.pose[k]
    q = x - pose.x
    if ti.static(colliders.moves):
        q -= after * pose.v
    if ti.static(colliders.turns):
        q = turned(q, -after * pose.turn)
    p = q
    if ti.static(q.n == 2):
        p = ti.Vector([q.dot(pose.along), q[1] * pose.along[0] - q[0] * pose.along[1]])
    else:
        p = ti.Vector([q.dot(pose.along), q.dot(pose.across), q.dot(pose.along.cross(pose.across))])
    return p


@ti.func
def world(colliders: ti.template(), k, n, after):
    """A direction of the frame of collider k as one of the world."""
    pose = colliders.pose[k]
    d = n
    if ti.static(n.n == 2):
        d = ti.Vector([n[0] * pose.along[0] - n[1] * pose.along[1], n[0] * pose.along[1] + n[1] * pose.along[0]])
    else:
        d = n[0] * pose.along + n[1] * pose.across + n[2] * pose.along.cross(pose.across)
    if ti.static(colliders.turns):
        d = turned(d, after * pose.turn)
    return d


@ti.func
def surface_velocity(colliders: ti.template(), k, x, after):
    """Velocity of the matter of collider k at the point x, `after` seconds into the step."""
    v = 0.0 * x
    if ti.static(colliders.moves):
        pose = colliders.pose[k]
        v = pose.v
        if ti.static(colliders.turns):
            v += lever(pose.turn, x - pose.x - after * pose.v)
    return v


@ti.func
def largest(q):
    """Index of the largest component."""
    at = 0
    for a in ti.static(range(1, q.n)):
        best = q[0]
        for b in ti.static(range(a)):
            best = ti.max(best, q[b])
        if q[a] > best:
            at = a
    return at


@ti.func
def box_distance(p, half):
    """Distance of p from a solid box and the direction away from it."""
    q = ti.abs(p) - half
    n = ti.max(q, 0.0)
    d = n.norm()
    if d > 0.0:
        n = n / d
    else:
        axis = largest(q)
        d = q.max()
        for a in ti.static(range(p.n)):
            n[a] = ti.select(a == axis, 1.0, 0.0)
    for a in ti.static(range(p.n)):
        n[a] = ti.select(p[a] < 0.0, -n[a], n[a])
    return d, n


@ti.func
def round_distance(p, half, radius):
    """The same for all points within `radius` of a stretch of the x axis."""
    q = p
    q[0] -= ti.max(-half[0], ti.min(half[0], p[0]))
    d = q.norm()
    n = 0.0 * p
    if d > 0.0:
        n = q / d
    else:
        n[1] = 1.0
    return d - radius, n


@ti.func
def cell_value(grid: ti.template(), shape, i, j, k):
    """Distance kept at a corner of the grid of a mesh."""
    return grid[shape.first + (k * shape.cells[1] + j) * shape.cells[0] + i]


@ti.func
def mesh_distance(grid: ti.template(), shape, p):
    """The same for a mesh: linear in each cell of its grid. Outside the grid from the nearest point that its border knows."""
    g = (p - shape.low) * shape.inverse_cell
    top = ti.cast(shape.cells, float) - 1.0
    inner = ti.max(ti.min(g, top), 0.0)
    cell = ti.min(ti.cast(ti.floor(inner), ti.i32), shape.cells - 2)
    t = inner - ti.cast(cell, float)
    i, j, k = cell[0], cell[1], cell[2]
    d = 0.0 * p[0]
    n = 0.0 * p
    for c in ti.static(range(8)):
        dx, dy, dz = ti.static(c & 1, (c >> 1) & 1, (c >> 2) & 1)
        value = cell_value(grid, shape, i + dx, j + dy, k + dz)
        wx = t[0] if ti.static(dx == 1) else 1.0 - t[0]
        wy = t[1] if ti.static(dy == 1) else 1.0 - t[1]
        wz = t[2] if ti.static(dz == 1) else 1.0 - t[2]
        d += wx * wy * wz * value
        n += value * ti.Vector([(2 * dx - 1) * wy * wz, (2 * dy - 1) * wx * wz, (2 * dz - 1) * wx * wy])
    size = n.norm()
    if size > 0.0:
        n = n / size
    else:
        n[1] = 1.0
    out = (g - inner) / shape.inverse_cell
    if out.dot(out) > 0.0:
        r = out + d * n
        d = r.norm()
        n = r / ti.max(d, 1e-30)
    return d, n


@ti.func
def distance(colliders: ti.template(), k, p):
    """Distance of p (in its frame) from collider k, the direction away from it, and whether p lies within a hollow one."""
    shape = colliders.shape[k]
    d, n = 0.0 * p[0], 0.0 * p
    within = False
    if ti.static(colliders.has_round):
        if shape.kind == ROUND:
            d, n = round_distance(p, shape.half, shape.radius)
    if ti.static(colliders.has_box):
        if shape.kind == BOX:
            d, n = box_distance(p, shape.half)
    if ti.static(colliders.has_mesh):
        if shape.kind == MESH:
            d, n = mesh_distance(colliders.grid, shape, p)
    if ti.static(colliders.has_hollow):
        if shape.hollow > 0.0:
            within = d < 0.5 * shape.hollow
            d = ti.select(within, -d, d - shape.hollow)
            n = ti.select(within, -n, n)
    return d, n, within


@ti.func
def face_distance(colliders: ti.template(), k, face, p, d, n, within):
    """Distance and direction of one face of a hollow box from within; of anything else the one given."""
    if ti.static(colliders.has_faces):
        shape = colliders.shape[k]
        if within and shape.kind == BOX:
            for a in ti.static(range(p.n)):
                if face // 2 == a:
                    sign = 1.0 - 2.0 * (face % 2)
                    d = shape.half[a] + sign * p[a]
                    n = 0.0 * n
                    n[a] = sign
    return d, n


@ti.func
def near(colliders: ti.template(), k, x, reach):
    """Whether a point lies within `reach` of the sphere about collider k."""
    q = x - colliders.pose[k].x
    far = colliders.shape[k].extent + reach
    return q.dot(q) <= far * far


@ti.func
def meeting(walls: ti.template(), colliders: ti.template(), i, k, face, x, v, a, since, limit, settled, floor):
    """First time within `limit` seconds at which ball i, on a parabola from x that begins `since` seconds into the step, meets
    collider k, or that face of a hollow box around it, where it is not -1: the time, and whether it meets it (1), does not (0),
    or is not known beyond that time (-1).

    A solid that is convex cannot be reached before the plane that touches it where it is nearest: each such plane is treated
    as a wall, which is exact for faces and converges like Newton's method for the rest. A mesh, and what is hollow seen from
    within, is approached by steps no longer than its distance, at least a fifth of the radius; where a look lies behind the
    surface, the meeting lies between it and the last one.
    """
    r = walls.model.radius[i]
    pose = colliders.pose[k]
    drift = v - pose.v
    start = x - pose.x - since * pose.v
    travel = drift.norm() * limit + 0.5 * a.norm() * limit * limit
    extent = colliders.shape[k].extent
    found, time = 0, limit
    if start.norm() <= extent + r + travel:
        finest = 1e-9 * r + walls.rounding * (ti.abs(x).max() + colliders.far(k))
        fastest = drift.norm() + a.norm() * limit
        curve = 0.0 * r  # how fast turning bends the path as the collider sees it
        if ti.static(colliders.turns):
            spin = size_of(pose.turn, colliders.dim)
            far = ti.min(start.norm() + travel, extent + r)
            curve = spin * spin * far + 2.0 * spin * fastest
            fastest += spin * far
        left, right, above, below = 0.0 * r, limit, 0.0 * r, 0.0 * r
        sunk = 0.0 * r
        behind, done = False, False
        t = 0.0 * r
        looks = 0
        while not done and looks < MOST:
            at = x + t * (v + 0.5 * t * a)
            p = local(colliders, k, at, since + t)
            d, n, within = distance(colliders, k, p)
            if ti.static(colliders.has_faces):
                if face >= 0:
                    d, n = face_distance(colliders, k, face, p, d, n, face >= 0)
            gap = d - r
            if looks == 0 and CAREFUL * gap > fastest * limit:
                done = True
            else:
                n = world(colliders, k, n, since + t)
                if looks == 0:
                    sunk = ti.max(0.0, -gap)
                gap += sunk
                if gap < SINK * r:
                    gap += allowance(walls, i, k, n, settled, floor)
                u = n.dot(v + t * a - surface_velocity(colliders, k, at, since + t))
                looks += 1
                if behind:
                    if gap >= 0.0:
                        left, above = t, gap
                    else:
                        right, below = t, gap
                    if above <= finest or looks == MOST or right - left <= 1e-12 * limit:
                        found, time, done = 1, left, True
                elif gap < -finest:
                    behind, right, below = True, t, gap
                    if above <= finest:
                        found, time, done = 1, left, True
                elif gap <= finest and u < 0.0:
                    found, time, done = 1, t, True
                else:
                    left, above = t, gap
                    step = 2.0 * limit
                    solid = face >= 0 or not within
                    if ti.static(colliders.has_mesh):
                        solid = solid and colliders.shape[k].kind != MESH
                    if solid:
                        step = crossing(ti.max(gap, 0.0), u, n.dot(a) - curve, step)
                    elif fastest > 0.0:
                        step = CAREFUL * gap / fastest
                    if t + step >= limit or t >= limit:
                        done = True
                    else:
                        if fastest > 0.0:
                            step = (
                                ti.max(step, STRIDE * r / fastest) if not solid or step * fastest < 1e-3 * r else step
                            )
                        t = ti.min(t + step, limit)
            if behind:
                part = above / ti.max(above - below, 1e-30)
                t = left + (right - left) * ti.max(0.05, ti.min(0.95, part))
        if not done:
            found, time = -1, left
            if behind:
                found = 1
    return found, time


@ti.func
def allowance(walls: ti.template(), i, k, n, settled, floor):
    """How far [m] ball i may sink into collider k along n while it moves: a little where it rests on it. settled, floor: the
    collider on which it came to rest within this step, and its normal there: other faces of it are met as any."""
    sink = SINK * walls.model.radius[i]
    rests = settled == k and n.dot(floor) > 0.9
    if ti.static(walls.colliders.turns):
        if rests:  # what turns carries a ball around a bend within the step
            sink = BEND * walls.model.radius[i]
    if walls.touched[i] > 0:
        for c in range(i * walls.count + walls.planes, (i + 1) * walls.count):
            if walls.contact[c].active == 1 and walls.contact[c].key // walls.faces == k:
                rests = rests or n.dot(walls.contact[c].normal) > 0.9
    return ti.select(rests, sink, 0.0)


@ti.func
def first_collider(walls: ti.template(), i, x, v, a, since, limit, settled, floor):
    """Earliest of all colliders that ball i meets: its key (number times `faces`, and the face of a hollow box around the ball),
    -1 for none, -2 where the way is not known; and the time. Each face for itself: that on which a ball rolls is the nearest one
    all the way, and hides the next."""
    hit = -1
    time = limit
    if walls.model.inverse_mass[i] > 0.0:
        for k in range(walls.colliders.count):
            if walls.colliders.minds(walls.model, i, k):
                several = 0
                if ti.static(walls.colliders.has_faces):
                    if walls.colliders.shape[k].kind == BOX:
                        _far, _away, inside = distance(walls.colliders, k, local(walls.colliders, k, x, since))
                        if inside:
                            several = 1
                for face in range(ti.select(several == 1, walls.faces, 1)):
                    which = ti.select(several == 1, face, -1)
                    found, t = meeting(walls, walls.colliders, i, k, which, x, v, a, since, time, settled, floor)
                    if found != 0 and t < time:
                        time = t
                        hit = ti.select(found == 1, k * walls.faces + face, -2)
    return hit, time
