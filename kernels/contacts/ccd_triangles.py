"""Contacts of surfaces in a step: the list of all pairs that are near, and how far balls may move before any of them meet."""

from taichi_sim.kernels.contacts.contact_incidence import list_entries
from taichi_sim.kernels.contacts.triangle_bvh import any_left_path, fit, traverse
from taichi_sim.kernels.contacts.triangle_pairs import FIND_PAIRS, LIMIT_WAYS, hold_apart, is_upper, planes

from taichi_sim.device.engine import ti

PLANE_CLEARANCE = 0.02  # of what is kept: how far past its plane a ball is led
PLANE_SWEEPS = 2  # times that all planes of a ball are gone through
SAFE_DEVIATION = 0.99  # of a radius: what moves no further from where it was expected cannot meet what was not listed


@ti.func
def detect(triangles: ti.template(), solver: ti.template(), ball: ti.template()):
    """Contacts of all leaves, then for each ball the list of its places in them."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        # none where the grid gave up
        triangles.work[0].balls = ti.select(triangles.grid.work[0].balls > 0, triangles.model.n, 0)
        triangles.used[0] = 0
        triangles.work[0].bottom_nodes = ti.select(triangles.work[0].balls > 0, triangles.bottom_nodes, 0)
    for i in range(triangles.model.n):
        triangles.expected_displacement[i] = ball[i].v / solver.rate[0]
    fit(triangles, ball, FIND_PAIRS)
    for k in range(triangles.work[0].balls):
        traverse(triangles, solver, ball, k, False, FIND_PAIRS)
    list_entries(triangles)


@ti.func
def limit(triangles: ti.template(), solver: ti.template(), ball: ti.template()):
    """Shorten the ways of the step just made so that no two surfaces, and no surface and ball, have gone through each other.

    Listed pairs have planes in between. The others were at least as far apart as their balls are thick and as they would come
    nearer with the speeds they had: where no ball is further than its radius from where those took it, they cannot have met.
    Balls that are, being hit or cut short, are looked at with all that is around their ways; should that cut short others,
    everything is.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        triangles.work[0].contacts = ti.min(triangles.used[0], triangles.capacity)
        triangles.work[0].left_path = 0
    lead_past(triangles, solver, ball)
    for i in range(triangles.model.n):
        triangles.allowed_part[i] = 1.0
        triangles.left_path[i] = 0
    for c in range(triangles.work[0].contacts):
        hold_apart(triangles, ball, balls_of(triangles, c), triangles.contact[c].normal, triangles.contact[c].kind)
    for everything in ti.static(range(2)):
        cut_short(triangles, solver, ball)
        for i in range(triangles.model.n):
            off = ball[i].x - triangles.grid.origin[i] - triangles.expected_displacement[i]
            if not off.norm() <= SAFE_DEVIATION * triangles.model.radius[i] and triangles.left_path[i] == 0:
                triangles.left_path[i] = 1
                triangles.work[0].left_path = 1
        ti.loop_config(serialize=True)
        for _ in range(1):
            triangles.work[0].balls = triangles.work[0].left_path * triangles.model.n
            triangles.work[0].bottom_nodes = triangles.work[0].left_path * triangles.bottom_nodes
            triangles.work[0].left_path = 0
        fit(triangles, ball, LIMIT_WAYS)
        for k in range(triangles.work[0].balls):
            if ti.static(everything) or k >= triangles.leaf_count or any_left_path(triangles, triangles.leaf_ball[k]):
                traverse(triangles, solver, ball, k, ti.static(not everything), LIMIT_WAYS)
    cut_short(triangles, solver, ball)


@ti.func
def cut_short(triangles: ti.template(), solver: ti.template(), ball: ti.template()):
    """Take back of each way what it may not be."""
    for i in range(triangles.model.n):
        if triangles.allowed_part[i] < 1.0:
            solver.state.shift(i, (1.0 - triangles.allowed_part[i]) * (triangles.grid.origin[i] - ball[i].x))
            triangles.allowed_part[i] = 1.0


@ti.func
def lead_past(triangles: ti.template(), solver: ti.template(), ball: ti.template()):
    """Take from the ways of balls what leads across the planes of listed pairs, so that they may slide along: a way that is cut
    short as a whole lets a ball stick. This need not settle all."""
    for c in range(triangles.work[0].contacts):
        contact = triangles.contact[c]
        up, down, keep = planes(triangles, ball, balls_of(triangles, c), contact.normal, contact.kind)
        triangles.contact[c].upper_plane = up + PLANE_CLEARANCE * keep
        triangles.contact[c].lower_plane = down - PLANE_CLEARANCE * keep
    for i in range(triangles.model.n):
        x = ball[i].x
        change = 0.0 * x
        for _ in range(PLANE_SWEEPS):
            for e in range(triangles.first[i], triangles.first[i] + triangles.number[i]):
                c, k = triangles.entry[e] // 4, triangles.entry[e] % 4
                n = triangles.contact[c].normal
                height = n.dot(x + change - triangles.grid.origin[triangles.member[4 * c]])
                if is_upper(k, triangles.contact[c].kind):
                    change += ti.max(0.0, triangles.contact[c].upper_plane - height) * n
                else:
                    change -= ti.max(0.0, height - triangles.contact[c].lower_plane) * n
        if change.dot(change) > 0.0 and triangles.model.inverse_mass[i] > 0.0:  # a pin stays where it is
            solver.state.shift(i, change)


@ti.func
def balls_of(triangles: ti.template(), c):
    """The four balls of a contact."""
    return ti.Vector([triangles.member[4 * c + k] for k in ti.static(range(4))])
