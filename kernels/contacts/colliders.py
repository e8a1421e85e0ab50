"""Poses of colliders, and distances from them.

A collider's pose is that at the start of a step; within the step it moves with constant velocity and angular velocity to the
pose at its end. All distances are signed: negative inside the solid.
"""

from taichi_sim.kernels.contacts.triangle_tree import distance_by_list, signed_distance
from taichi_sim.kernels.trigonometry import sine_cosine
from taichi_sim.kernels.vectors import lever

from taichi_sim.device.engine import ti

MESH, CUSTOM = -1, -2  # kinds; those by a formula are numbered from 0 on, see contacts/colliders.py
CUT = -1  # number of a cell that is cut into eight
ROUNDED = 0.5  # of a cell: what lies between corners of a grid is no further from the distance
BEYOND_GRID = 1.4143  # times: what the border of a grid knows of a place beyond it is no more of the distance


@ti.func
def rotated(q, angle):
    """q rotated by an angle (2D) or a rotation vector (3D)."""
    return q + rotation_chord(q, angle)


@ti.func
def rotation_chord(q, angle):
    """The way from q to q rotated by an angle (2D) or a rotation vector (3D), in half angles, which cancel no digits."""
    chord = 0.0 * q
    if ti.static(q.n == 2):
        s, c = sine_cosine(0.5 * angle)
        chord = 2.0 * s * (c * lever(1.0, q) - s * q)
    else:
        size = angle.norm()
        if size > 0.0:
            n = angle / size
            s, c = sine_cosine(0.5 * size)
            m = n.cross(q)
            chord = 2.0 * s * (c * m + s * n.cross(m))
    return chord


@ti.func
def local(colliders: ti.template(), k, x, after):
    """The point x in the frame of collider k, `after` seconds into the step."""
    pose = colliders.pose[k]
    q = x - pose.x
    if ti.static(colliders.moves):
        q -= after * pose.v
    if ti.static(colliders.rotates):
        q = rotated(q, -after * pose.spin)
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
    if ti.static(colliders.rotates):
        d = rotated(d, after * pose.spin)
    return d


@ti.func
def carried_back(colliders: ti.template(), k, x, after):
    """Place at the start of the step of the matter of collider k that is at the point x `after` seconds into it."""
    p = x
    if ti.static(colliders.moves):
        pose = colliders.pose[k]
        p = x - after * pose.v
        if ti.static(colliders.rotates):
            p = pose.x + rotated(p - pose.x, -after * pose.spin)
    return p


@ti.func
def surface_velocity(colliders: ti.template(), k, x, after):
    """Velocity of the matter of collider k at the point x, `after` seconds into the step."""
    v = 0.0 * x
    if ti.static(colliders.moves):
        pose = colliders.pose[k]
        v = pose.v
        if ti.static(colliders.rotates):
            v += lever(pose.spin, x - pose.x - after * pose.v)
    return v


@ti.func
def chord_velocity(colliders: ti.template(), k, x, h):
    """Velocity that takes the matter of collider k at the point x, at the start of a step, to where it is h seconds later: what
    moves with it stays at its distance from the axis, where the velocity at the start would lead outward."""
    v = 0.0 * x
    if ti.static(colliders.moves):
        pose = colliders.pose[k]
        v = pose.v
        if ti.static(colliders.rotates):
            v += rotation_chord(x - pose.x, h * pose.spin) / h
    return v


@ti.func
def past_velocity(colliders: ti.template(), k, x):
    """Velocity of the matter of collider k at the point x at the end of the step before."""
    v = 0.0 * x
    if ti.static(colliders.moves):
        pose = colliders.pose[k]
        v = pose.past_v
        if ti.static(colliders.rotates):
            v += lever(pose.past_spin, x - pose.x)
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
def box_distance(shape, p):
    """Distance of p from the box |x| <= half and the direction away from it."""
    q = ti.abs(p) - shape.half
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
def round_distance(shape, p):
    """Signed distance [m] of p from the solid of all points within `radius` of a stretch of the x axis, and the direction out
    of it."""
    q = p
    q[0] -= ti.max(-shape.half[0], ti.min(shape.half[0], p[0]))
    d = q.norm()
    n = 0.0 * p
    if d > 0.0:
        n = q / d
    else:
        n[1] = 1.0
    return d - shape.radius, n


@ti.func
def mesh_distance(colliders: ti.template(), shape, p, touch, exact):
    """Signed distance from a mesh and its direction: linear in each cell of its grid, by triangles where that is too coarse;
    at distances up to `touch` [m] also beyond the grid, and all over it if `exact`."""
    g = (p - shape.low) * shape.inverse_cell
    top = ti.cast(shape.cells, float) - 1.0
    inner = ti.max(ti.min(g, top), 0.0)
    cell = ti.min(ti.cast(ti.floor(inner), ti.i32), shape.cells - 2)
    first = first_corner(shape, cell)
    row = colliders.exact[first]
    d, n = 0.0 * p[0], 0.0 * p
    if row >= 0:
        begin, number, centre = cell_of(colliders, row, inner - ti.cast(cell, float))
        if number > 0:
            out = (g - ti.cast(cell, float) - centre).norm() / shape.inverse_cell
            d, n = distance_by_list(colliders.triangle, colliders.listed, begin, begin + number, p, out)
        else:
            d, n = distance_by_tree(colliders, shape, begin, p)
    else:
        out = (g - inner) / shape.inverse_cell
        d, n = interpolated(colliders.grid, shape, first, inner - ti.cast(cell, float), out)
        is_beyond = out.dot(out) > 0.0
        reach = ti.select(is_beyond, BEYOND_GRID, 1.0) * (touch + ROUNDED / shape.inverse_cell)
        if (exact or is_beyond) and d < reach:
            d, n = distance_by_tree(colliders, shape, -1 - row, p)
    return d, n


@ti.func
def has_exact_cell(colliders: ti.template(), k, x, reach):
    """True if all within `reach` [m] of x, at the start of a step, lies in one cell of the grid of mesh k whose distances come
    from triangles: there nothing is rounded."""
    shape = colliders.shape[k]
    g = (local(colliders, k, x, 0.0) - shape.low) * shape.inverse_cell
    cell = ti.cast(ti.floor(g), ti.i32)
    part, wide = g - ti.cast(cell, float), reach * shape.inverse_cell
    yes = part.min() >= wide and part.max() <= 1.0 - wide and cell.min() >= 0 and (shape.cells - 2 - cell).min() >= 0
    if yes:
        yes = colliders.exact[first_corner(shape, cell)] >= 0
    return yes


@ti.func
def first_corner(shape, cell):
    """Number of the lowest corner of this cell (3) in the tables of all grids."""
    return shape.first + (cell[2] * shape.cells[1] + cell[1]) * shape.cells[0] + cell[0]


@ti.func
def distance_by_tree(colliders: ti.template(), shape, near, p):
    """Signed distance of p from a mesh and its direction, by its tree; `near` is a triangle that is not far."""
    box, link = ti.static(colliders.box, colliders.link)
    d, n, _ = signed_distance(box, link, colliders.triangle, shape.first_node, shape.last_node, near, p)
    return d, n


@ti.func
def cell_of(colliders: ti.template(), row, part):
    """Begin and number, see DistanceGrid, of the smallest cell at the parts (3) along the axes of the cell of this row, and the
    parts where its centre is."""
    centre, half = 0.0 * part + 0.5, 0.25
    while colliders.cell[2 * row + 1] == CUT:
        upper = ti.cast(part >= centre, ti.i32)
        centre += half * (2.0 * ti.cast(upper, float) - 1.0)
        half *= 0.5
        row = colliders.cell[2 * row] + upper[0] + 2 * upper[1] + 4 * upper[2]
    return colliders.cell[2 * row], colliders.cell[2 * row + 1], centre


@ti.func
def interpolated(grid: ti.template(), shape, first, t, out):
    """Signed distance and its direction in the cell whose values begin at `first`, at the parts t of it along the axes; from a
    point that is `out` [m] away from the grid, that of the nearest point which its border knows."""
    d = 0.0 * t[0]
    n = 0.0 * t
    for c in ti.static(range(8)):
        dx, dy, dz = ti.static(c & 1, (c >> 1) & 1, (c >> 2) & 1)
        value = grid[first + (dz * shape.cells[1] + dy) * shape.cells[0] + dx]
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
    if out.dot(out) > 0.0:
        r = out + d * n
        d = r.norm()
        n = r / ti.max(d, 1e-30)
    return d, n


@ti.func
def custom_distance(distance_from: ti.template(), p, h):
    """Signed distance [m] of p by a user-defined distance function, and the direction out of the solid, from the differences
    between points h [m] away."""
    n = 0.0 * p
    for e in range(2 * p.n):
        sign = 1.0 - 2.0 * (e % 2)
        q = p
        for a in ti.static(range(p.n)):
            if e // 2 == a:
                q[a] += sign * h
        beside = sign * distance_from(q)
        for a in ti.static(range(p.n)):
            if e // 2 == a:
                n[a] += beside
    size = n.norm()
    if size > 0.0:
        n = n / size
    else:
        n[1] = 1.0
    return distance_from(p), n


@ti.func
def distance(colliders: ti.template(), k, p, touch, exact):
    """Distance of p (in its frame) from collider k, the direction away from it, and whether p lies within a hollow one. touch,
    exact: see `mesh_distance`."""
    shape = colliders.shape[k]
    d, n = 0.0 * p[0], 0.0 * p
    within = False
    for number, distance_from in ti.static(colliders.solids):
        if shape.kind == number:
            d, n = distance_from(shape, p)
    if ti.static(colliders.has_mesh):
        if shape.kind == MESH:
            d, n = mesh_distance(colliders, shape, p, touch, exact)
    if ti.static(colliders.has_custom):
        for number, distance_from in ti.static(colliders.custom):
            if k == number:
                d, n = custom_distance(distance_from, p, colliders.difference * shape.extent)
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
        if within and shape.faces > 1:
            for a in ti.static(range(p.n)):
                if face // 2 == a:
                    sign = 1.0 - 2.0 * (face % 2)
                    d = shape.half[a] + sign * p[a]
                    n = 0.0 * n
                    n[a] = sign
    return d, n


@ti.func
def near(colliders: ti.template(), k, x, reach):
    """True if a point lies within `reach` [m] of the sphere about collider k."""
    q = x - colliders.pose[k].x
    far = colliders.shape[k].extent + reach
    return q.dot(q) <= far * far
