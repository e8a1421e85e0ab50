"""Which colliders a ball minds: found where it is now, each held in a slot of the ball."""

from taichi_sim.kernels.contacts import colliders as geometry

from taichi_sim.device.engine import ti

FAR = 1e30  # m, the gap of a slot in which nothing is held


@ti.func
def find(walls: ti.template(), x, i, crowded):
    """Fill the slots of ball i at x with the colliders that it minds: each where it was before, those that are new in a
    free one; where there are too many, the nearest. Returns how many contacts there are to look at: none of the slots of a
    ball that is and was far from all colliders, which are not even cleared."""
    first = i * walls.count + walls.planes
    ready = walls.held[i] > 0
    for c in range(first, ti.select(ready, first + walls.slots, first)):
        walls.contact[c].gap = FAR
    if walls.model.inverse_mass[i] > 0.0:
        r = walls.model.radius[i]
        for k in range(walls.colliders.count):
            reach = walls.reach_of(i, walls.tolerance(x, i, walls.colliders.far(k)), crowded)
            if walls.colliders.minds(walls.model, i, k) and geometry.near(walls.colliders, k, x, r + reach):
                for face in range(walls.faces):
                    d, n, within = walls.colliders.distance(k, face, x, 0.0)
                    several = within and walls.colliders.shape[k].kind == geometry.BOX
                    if d - r <= reach and (face == 0 or several):
                        for c in range(first, ti.select(ready, first, first + walls.slots)):
                            walls.contact[c].gap = FAR
                            walls.contact[c].key = -1
                        ready = True
                        hold(walls, first, k, k * walls.faces + face, d - r, n, x - d * n)
    held = 0
    for c in range(first, ti.select(ready, first + walls.slots, first)):
        if walls.contact[c].gap == FAR:
            walls.contact[c].key = -1
        else:
            held += 1
    walls.held[i] = held
    return ti.select(ready, walls.count, walls.planes)


@ti.func
def hold(walls: ti.template(), first, k, key, gap, n, at):
    """Note a contact at the point `at`: in the slot of its key, else in a free one, else in that of the widest gap."""
    place = -1
    for c in range(first, first + walls.slots):
        if walls.contact[c].key == key:
            place = c
    if place < 0:
        widest = gap
        for c in range(first, first + walls.slots):
            free = walls.contact[c].key < 0 and walls.contact[c].gap == FAR
            if walls.contact[c].gap > widest or (free and (place < 0 or walls.contact[place].key >= 0)):
                place = c
                widest = walls.contact[c].gap
        if place >= 0:
            walls.forget_one(place)
    if place >= 0:
        walls.contact[place].key = key
        walls.contact[place].gap = gap
        walls.contact[place].normal = n
        if ti.static(walls.moves):
            walls.contact[place].velocity = geometry.surface_velocity(walls.colliders, k, at, 0.0)
