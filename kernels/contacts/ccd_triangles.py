"""Contacts of surfaces in a step: the list of all pairs that are near, and how far balls may move before any of them meet."""

from taichi_sim.kernels.contacts.contact_incidence import begin_entries, each_contact, list_entries
from taichi_sim.kernels.contacts.touch_distance import is_upper
from taichi_sim.kernels.contacts.triangle_bvh import DRIFT_ALLOWED, any_left_path, fit, traverse
from taichi_sim.kernels.contacts.triangle_pairs import (
    FIND_CANDIDATES,
    LIMIT_WAYS,
    LOOK_AHEAD,
    hold_apart,
    list_candidate,
    planes,
)
from taichi_sim.kernels.loops import each

from taichi_sim.device.engine import ti

PLANE_CLEARANCE = 0.02  # of what is kept: how far past its plane a ball is led
PLANE_SWEEPS = 2  # times that all planes of a ball are gone through
SAMPLE = 64  # balls of surfaces, of which the common motion is taken
SAFE_DEVIATION = 0.99  # of a radius: what moves no further from where it was expected cannot meet what was not listed


@ti.func
def detect(triangles: ti.template(), solver: ti.template(), ball: ti.template()):
    """Candidates of all leaves where those of the last search hold no more, the contacts among them, then for each ball the list
    of its places in these; `decide` and `begin` come before."""
    fixed = ti.static(triangles.pairs.plan.gathers)
    n, capacity = ti.static(triangles.model.n, triangles.candidate_capacity)
    work = ti.static(triangles.work)  # read in each loop: between them a device would launch a thread for it
    fit(triangles, ball, work[0].searches * work[0].lists, FIND_CANDIDATES)
    each(work[0].searches * work[0].lists * n, n, fixed, traverse, (triangles, solver, ball, False, FIND_CANDIDATES))
    number = ti.static(triangles.candidates)
    each(work[0].lists * ti.min(number[0], capacity), capacity, fixed, list_candidate, (triangles, solver, ball))
    list_entries(triangles)


@ti.func
def expire(triangles: ti.template()):
    """Ask for a new search, whatever has moved."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        triangles.work[0].expired = 1


@ti.func
def decide(triangles: ti.template(), solver: ti.template(), ball: ti.template()):
    """Decide whether to search at all, and find what balls have moved in common since the last search, from a sample of them.
    Only how balls move relative to each other brings them together: whatever is taken as common, drifts are apart as before."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        triangles.work[0].lists = 1
        if ti.static(triangles.pairs.plan.neighbours):  # the grid is made, and may have given up
            if triangles.grid.crowded_pairs[0] > triangles.grid.pair_limit[0]:
                triangles.work[0].lists = 0
        triangles.work[0].searches = triangles.work[0].expired
        way, change, step = ti.Vector.zero(float, 3), ti.Vector.zero(float, 3), ti.Vector.zero(float, 3)
        number = ti.min(triangles.leaf_count, SAMPLE)
        for k in range(number):
            i = triangles.leaf_ball[k * triangles.leaf_count // number]
            way += ball[i].x - triangles.searched_position[i]
            step += ball[i].v / solver.rate[0]
            change += ball[i].v / solver.rate[0] - triangles.searched_displacement[i]
        triangles.fastest[0] = 0.0
        triangles.common_way[0] = way / number
        triangles.common_change[0] = change / number
        triangles.common_step[0] = step / number


@ti.func
def begin(triangles: ti.template(), solver: ti.template(), ball: ti.template(), i):
    """Begin the search for ball i: clear its list, note where it goes, and find out whether it has drifted so far that a pair
    might be near that is no candidate: two balls that drift by half of the skin each."""
    expected = ball[i].v / solver.rate[0]
    triangles.expected_displacement[i] = expected
    begin_entries(triangles, i)
    relative = (expected - triangles.common_step[0]).norm()
    if relative > triangles.fastest[0]:
        ti.atomic_max(triangles.fastest[0], relative)
    drift = (ball[i].x - triangles.searched_position[i] - triangles.common_way[0]).norm()
    drift += LOOK_AHEAD * (expected - triangles.searched_displacement[i] - triangles.common_change[0]).norm()
    if not drift < DRIFT_ALLOWED * triangles.skin[0]:
        triangles.work[0].searches = 1


@ti.func
def limit(triangles: ti.template(), solver: ti.template(), ball: ti.template()):
    """Shorten the ways of the step just made so that no two surfaces, and no surface and ball, have gone through each other.

    Listed pairs have planes in between. The others were at least as far apart as their balls are thick and as they would come
    nearer with the speeds they had: where no ball is further than its radius from where those took it, they cannot have met.
    Balls that are, being hit or cut short, are looked at with all that is around their ways; should that cut short others,
    everything is. What this finds `cut_short` has still to do.
    """
    n, fixed = ti.static(triangles.model.n, triangles.pairs.plan.gathers)
    each_contact(triangles, place_planes, (triangles, ball))
    for i in range(n):
        lead_past(triangles, solver, ball, i)
        triangles.allowed_part[i] = 1.0
        triangles.left_path[i] = 0
        if i == 0:
            triangles.work[0].left_path = 0
            triangles.work[0].left_path_later = 0
    each_contact(triangles, hold_contact_apart, (triangles, ball))
    for i in range(n):
        if leaves_path(triangles, solver, ball, i):
            triangles.work[0].left_path = 1
    fit(triangles, ball, triangles.work[0].left_path, LIMIT_WAYS)
    each(triangles.work[0].left_path * n, n, fixed, look, (triangles, solver, ball, False))
    for i in range(n):
        if leaves_path(triangles, solver, ball, i):
            triangles.work[0].left_path_later = 1
    # ways have only become shorter since: their boxes hold
    each(triangles.work[0].left_path_later * n, n, fixed, look, (triangles, solver, ball, True))


@ti.func
def leaves_path(triangles: ti.template(), solver: ti.template(), ball: ti.template(), i):
    """Cut the way of ball i short; whether it now, and only now, is not where it was expected."""
    cut_short(triangles, solver, ball, i)
    off = ball[i].x - triangles.grid.origin[i] - triangles.expected_displacement[i]
    leaves = not off.norm() <= SAFE_DEVIATION * triangles.model.radius[i] and triangles.left_path[i] == 0
    if leaves:
        triangles.left_path[i] = 1
    return leaves


@ti.func
def look(k, triangles: ti.template(), solver: ti.template(), ball: ti.template(), everything: ti.template()):
    """Limit the way of the leaf in slot k and of all that are near it; or, unless everything is looked at, of those of which one
    has left its path."""
    if ti.static(everything) or k >= triangles.leaf_count or any_left_path(triangles, triangles.leaf_ball[k]):
        traverse(k, triangles, solver, ball, ti.static(not everything), LIMIT_WAYS)


@ti.func
def cut_short(triangles: ti.template(), solver: ti.template(), ball: ti.template(), i):
    """Take back of the way of ball i what it may not be."""
    if triangles.allowed_part[i] < 1.0:
        solver.state.shift(i, (1.0 - triangles.allowed_part[i]) * (triangles.grid.origin[i] - ball[i].x))
        triangles.allowed_part[i] = 1.0


@ti.func
def place_planes(c, triangles: ti.template(), ball: ti.template()):
    """The planes that neither side of contact c may cross."""
    contact = triangles.contact[c]
    up, down, keep = planes(
        triangles, ball, balls_of(triangles, c), contact.normal, contact.kind, ti.abs(contact.thickness)
    )
    triangles.contact[c].upper_plane = up + PLANE_CLEARANCE * keep
    triangles.contact[c].lower_plane = down - PLANE_CLEARANCE * keep


@ti.func
def hold_contact_apart(c, triangles: ti.template(), ball: ti.template()):
    """Cut short the ways of the balls of contact c that cross its planes all the same."""
    contact = triangles.contact[c]
    hold_apart(triangles, ball, balls_of(triangles, c), contact.normal, contact.kind, ti.abs(contact.thickness))


@ti.func
def lead_past(triangles: ti.template(), solver: ti.template(), ball: ti.template(), i):
    """Take from the way of ball i what leads across the planes of listed pairs, so that it may slide along: a way that is cut
    short as a whole lets a ball stick. This need not settle all."""
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
