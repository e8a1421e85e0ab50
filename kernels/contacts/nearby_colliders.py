"""Search for the colliders that a ball is at, from its present place; each is kept in a slot of the ball."""

from taichi_sim.kernels.contacts import colliders as geometry
from taichi_sim.kernels.contacts import warm_start
from taichi_sim.kernels.contacts.colliders import MESH

from taichi_sim.device.engine import ti

FAR_GAP = 1e30  # m, the gap of an empty slot
EMPTY = -1  # its key
NONE = -1  # in place of the number of a collider
# as far as a ball comes in so many steps at its speed, where implicit stages ask for what they will meet; and so many radii: it
# may have stopped within the step, and what presses it acts on
FORESEEN_STEPS = 2.0
FORESEEN_RADII = 0.25
AHEAD = 2.0  # steps: where a ball would be then tells whether it closes
FELL = 0.1  # of a cell: what falls no further closes no faster than what edges are rounded by explains


@ti.func
def find(walls: ti.template(), x, v, i, crowded, h):
    """Fill the slots of ball i at x with the velocity v, for a step of h seconds, with the colliders in reach: each where it was
    before, those that are new in a free one; where there are too many, the nearest. Returns how many contacts there are to look
    at: none of the slots of a ball that is and was far from all colliders, which are not even cleared."""
    at = walls.collider_contacts
    first = i * at.count
    ready = at.filled[i] > 0
    for e in range(first, ti.select(ready, first + at.count, first)):
        at.slot[e].gap = FAR_GAP
    if walls.model.inverse_mass[i] > 0.0:
        r = walls.model.radius[i]
        exact, seen, seen_d, seen_n = False, NONE, 0.0 * r, 0.0 * x
        if ti.static(walls.colliders.has_mesh):
            exact, seen, seen_d, seen_n = is_at_seam_or_strikes(walls, x, v, i, h)
            at.exact[i] = exact
        for k in range(walls.colliders.count):
            reach = walls.reach_of(i, walls.tolerance(x, i, walls.colliders.distance_from_origin(k)), crowded)
            if ti.static(walls.foresees):
                u = v - geometry.surface_velocity(walls.colliders, k, x, 0.0)
                reach = ti.max(reach, FORESEEN_STEPS * h * u.norm(), FORESEEN_RADII * r)
            if walls.colliders.collides_with(walls.model, i, k) and geometry.near(walls.colliders, k, x, r + reach):
                faces = 1
                if ti.static(walls.colliders.has_faces):
                    faces = walls.colliders.shape[k].faces
                for face in range(faces):
                    d, n, within = seen_d, seen_n, False
                    if k != seen or exact:
                        d, n, within = walls.colliders.distance(k, face, x, 0.0, r, exact)
                    if d - r <= reach and (face == 0 or within):
                        for e in range(first, ti.select(ready, first, first + at.count)):
                            at.slot[e].gap = FAR_GAP
                            at.slot[e].key = EMPTY
                        ready = True
                        fill_slot(walls, i, k, k * walls.colliders.faces + face, d - r, n, x - d * n, h)
    filled = 0
    for e in range(first, ti.select(ready, first + at.count, first)):
        if at.slot[e].gap == FAR_GAP:
            at.slot[e].key = EMPTY
        else:
            filled += 1
    if filled > 0 and filled + walls.planes.count > 1:
        filled -= forget_hidden(walls, x, i)
    at.filled[i] = filled
    return ti.select(ready, walls.count, walls.planes.count)


@ti.func
def is_at_seam_or_strikes(walls: ti.template(), x, v, i, h):
    """True if ball i at x may come within h seconds, at its velocity v from them, so near to two surfaces that what their edges
    are rounded by, where a mesh keeps distances on a grid, decides which of them it is on, or hit a mesh. After that the
    mesh looked at, or NONE, with its distance from x and the direction."""
    number, strikes = 0, False
    seen, seen_d, seen_n = NONE, 0.0 * x[0], 0.0 * x
    r, rounded = walls.model.radius[i], geometry.ROUNDED * walls.colliders.widest_cell
    slowest = slowest_strike(walls, h)
    for k in range(walls.planes.count):
        if walls.planes.gap(x, i, k) < rounded + h * v.norm():
            number += 1
    for k in range(walls.colliders.count):
        u = v - geometry.surface_velocity(walls.colliders, k, x, 0.0)
        way = h * u.norm()
        is_mesh = walls.colliders.shape[k].kind == MESH
        looks = ti.select(is_mesh and way > h * slowest, 2, 1)
        reach = r + rounded + way
        may = looks == 2 or ti.static(walls.collider_contacts.has_seams)
        may = may and walls.colliders.collides_with(walls.model, i, k) and geometry.near(walls.colliders, k, x, reach)
        if may and looks == 2 and geometry.has_exact_cell(walls.colliders, k, x, way):
            looks = 1
            may = ti.static(walls.collider_contacts.has_seams)
        if may:
            here, closes = reach, AHEAD * way > r
            for look in range(looks):
                if look == 0 or (here < reach and not closes):
                    d, n, _ = walls.colliders.distance(k, 0, x + look * AHEAD * h * u, 0.0, r, False)
                    if look == 0:
                        here, closes = d, closes or n.dot(u) < -slowest
                        if is_mesh:
                            seen, seen_d, seen_n = k, d, n
                    else:
                        closes = here - d > h * slowest
            if here < reach:
                number += 1
                strikes = strikes or (looks == 2 and closes)
    return strikes or number > 1, seen, seen_d, seen_n


@ti.func
def slowest_strike(walls: ti.template(), h):
    """Speed [m/s] from which a ball hits a mesh: what bounces, and does not just fall by what edges are rounded by. Below it the
    ball keeps to one surface while it comes to rest."""
    u = walls.threshold[0]
    return ti.sqrt(u * (u + FELL * walls.colliders.widest_cell / h))


@ti.func
def fill_slot(walls: ti.template(), i, k, key, gap, n, point, h):
    """Note a contact of ball i with collider k at a point: in the slot of its key, else in a free one, else in that of the widest
    gap."""
    at = walls.collider_contacts
    first = i * at.count
    place = -1
    for e in range(first, first + at.count):
        if at.slot[e].key == key:
            place = e
    if place < 0:
        widest = gap
        for e in range(first, first + at.count):
            free = at.slot[e].key < 0 and at.slot[e].gap == FAR_GAP
            if at.slot[e].gap > widest or (free and (place < 0 or at.slot[place].key >= 0)):
                place = e
                widest = at.slot[e].gap
        if place >= 0:
            warm_start.forget(walls.contact, i * walls.count + walls.planes.count + place - first, walls.model.dim)
    if place >= 0:
        at.slot[place].key = key
        at.slot[place].gap = gap
        at.slot[place].normal = n
        if ti.static(at.moves):
            # what slides does not follow the matter inward: along n the chord is left to `following`, which knows its way
            velocity = geometry.chord_velocity(walls.colliders, k, point, h)
            velocity += n.dot(geometry.surface_velocity(walls.colliders, k, point, 0.0) - velocity) * n
            at.slot[place].velocity = velocity
            at.slot[place].lost = n.dot(geometry.past_velocity(walls.colliders, k, point) - velocity)


@ti.func
def forget_hidden(walls: ti.template(), x, i):
    """Empty the slots of ball i at x whose contact is hidden by another one of it: at a seam of surfaces in one plane the edge of
    the next one, whose direction would throw up what slides there. Returns how many."""
    at = walls.collider_contacts
    first = i * at.count
    hidden, number = 0, 0
    for s in range(at.count):
        if at.slot[first + s].key >= 0:
            for k in range(walls.count):
                if hidden >> s & 1 == 0 and is_hidden(walls, x, i, s, k):
                    hidden |= 1 << s
                    number += 1
    for s in range(at.count):
        if hidden >> s & 1 == 1:
            at.slot[first + s].gap = FAR_GAP
            at.slot[first + s].key = EMPTY
            warm_start.forget(walls.contact, i * walls.count + walls.planes.count + s, walls.model.dim)
    return number


@ti.func
def is_hidden(walls: ti.template(), x, i, s, k):
    """Tell whether the place where ball i at x meets the collider in its slot s belongs to its surface k too, which is no
    further away, but not the other way around."""
    at, planes = walls.collider_contacts, walls.planes.count
    own = at.slot[i * at.count + s]
    r, gap, n = walls.model.radius[i], FAR_GAP + 0.0 * own.gap, 0.0 * own.normal
    far = walls.colliders.distance_from_origin(own.key // at.faces)
    key = own.key
    if k < planes:
        gap, n = walls.planes.gap(x, i, k), walls.planes.wall[k].normal
    elif k - planes != s:
        other = at.slot[i * at.count + k - planes]
        if other.key >= 0 and other.key // at.faces != own.key // at.faces:
            gap, n, key = other.gap, other.normal, other.key
            far += walls.colliders.distance_from_origin(key // at.faces)
    touch = walls.tolerance(x, i, far)
    yes = gap <= own.gap + touch
    point, back = x - (own.gap + r) * own.normal, x - (gap + r) * n
    if k < planes:
        yes = yes and n.dot(point - back) <= touch
    for turn in range(ti.select(k < planes, 1, 0), ti.select(yes, 2, 0)):
        d, _, _ = walls.colliders.distance(
            ti.select(turn == 0, key, own.key) // at.faces,
            ti.select(turn == 0, key, own.key) % at.faces,
            ti.select(turn == 0, point, back),
            0.0,
            touch,
            True,
        )
        yes = yes and ((d <= touch) == (turn == 0))
    return yes
