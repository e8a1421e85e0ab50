"""Finding contacts between balls, each pair once, and what they start with.

A pair is listed by that of its balls which comes first in the sorted grid. Iterations take the balls in that order too, in
blocks that are longer than any pair reaches: see pair_sweeps. Where each ball gathers what it gets, both list it.
"""

from taichi_sim.kernels.contacts import contact_law, warm_start
from taichi_sim.kernels.contacts.collision_groups import balls_meet
from taichi_sim.kernels.contacts.pair_lists import pair_entry
from taichi_sim.kernels.contacts.spatial_hash import bucket_of, cell_of, clip, level_of, run, same_row

from taichi_sim.device.engine import ti

ENDLESS = 2**31 - 1  # what `overflow` says where cells hold so many pairs that none were looked for
LIST_BLOCK = 64  # balls whose lists lie one behind the other
COUNT_LIMIT = 1 << 30  # entries: no more are counted, lest the number wraps around


RIGID = -1.0  # as a bias velocity [m/s]: the contact is not soft, and pushes nothing out
BITS_OF_ONE = 0x3F800000  # the bits of 1.0


@ti.func
def may_touch(pairs: ti.template(), i, j):
    """True if two balls collide at all: not both pinned, of one body, joined by a spring or element, or of groups apart."""
    allowed = pairs.model.inverse_mass[i] + pairs.model.inverse_mass[j] > 0.0 and may_meet(pairs, i, j)
    return allowed and not are_joined(pairs, i, j)


@ti.func
def are_joined(pairs: ti.template(), i, j):
    """True if a spring or element joins two balls: at rest they may be nearer than they are thick."""
    yes = False
    if ti.static(pairs.has_joined):
        for e in range(pairs.joined_start[i], pairs.joined_start[i + 1]):
            yes = yes or pairs.joined_other[e] == j
    return yes


@ti.func
def may_meet(pairs: ti.template(), i, j):
    """True if two balls are neither of one body, nor of groups that do not collide."""
    allowed = True
    if ti.static(pairs.has_bodies):
        allowed = pairs.body[i] == 0 or pairs.body[i] != pairs.body[j]
    if ti.static(pairs.model.has_groups):
        allowed = allowed and balls_meet(pairs.model, i, j)
    return allowed


@ti.func
def nearby(pairs: ti.template(), own, at, free):
    """Write the sorted copies within reach of copy `own` that come after it, or all of them, into the list that begins with link
    `at`; returns how many.

    Links beyond `free` are counted; the last place holds any one of them.
    """
    a = pairs.grid.copy[own]
    found = 0
    mine = level_of(a.radius, pairs.grid)
    for level in range(0 if ti.static(pairs.plan.gathers) else mine, pairs.grid.levels):
        if pairs.grid.dense[level] == 0:
            found = scan(pairs, own, a, mine, level, at, found, free, False)
        if pairs.grid.dense[level] == 1:
            found = scan(pairs, own, a, mine, level, at, found, free, True)
    return found


@ti.func
def scan(pairs: ti.template(), own, a, mine, level, at, found, free, dense: ti.template()):
    """`nearby` in one level, for one of the two ways to place rows in its table. Side by side, rows before the own one hold
    none after."""
    span = (a.radius + pairs.grid.largest[level]) * pairs.grid.enlarged * pairs.grid.margin
    low = cell_of(a.x - span, pairs.grid, level)
    high = cell_of(a.x + span, pairs.grid, level)
    here = low
    if level == mine:
        if ti.static(dense and not pairs.plan.gathers):
            here = cell_of(a.x, pairs.grid, level)
    elif ti.static(pairs.grid.levels > 1):
        low, high = clip(pairs.grid, level, low, high)
        here = low
    length = ti.max(0, high[0] - low[0] + 1)
    # listed by the one that comes first in the order of sweeps
    ranked = ti.static(not dense and pairs.grid.levels == 1 and not pairs.plan.gathers)
    rank = 0
    if ti.static(ranked):
        rank = pairs.grid.rank[pairs.grid.sorted[own]]
    for z in range(
        0 if ti.static(pairs.model.dim == 2) else here[2], 1 if ti.static(pairs.model.dim == 2) else high[2] + 1
    ):
        begin = low[1]
        if ti.static(not pairs.plan.gathers):
            if ti.static(pairs.model.dim == 2) or z == here[pairs.model.dim - 1]:
                begin = here[1]
        for y in range(begin, high[1] + 1):
            row = low
            row[1] = y
            if ti.static(pairs.model.dim == 3):
                row[2] = z
            bucket = bucket_of(row, pairs.grid, level)
            for piece in ti.static(range(1 if dense else 2)):
                first, last = run(pairs.grid, level, bucket, length, piece)
                for k in range(first if ti.static(ranked or pairs.plan.gathers) else ti.max(first, own + 1), last):
                    b = pairs.grid.copy[k]
                    r = b.x - a.x
                    reach = (a.radius + b.radius) * pairs.grid.enlarged
                    if r.dot(r) < reach * reach:
                        listed = True
                        if ti.static(not dense):
                            listed = same_row(row, cell_of(b.x, pairs.grid, level))
                        if ti.static(ranked):
                            listed = listed and pairs.grid.rank[pairs.grid.sorted[k]] > rank
                        if ti.static(pairs.plan.gathers):
                            listed = listed and k != own
                        if listed:
                            pairs.link[pair_entry(pairs, at, ti.min(found, free))].other = k
                            found += 1
    return found


@ti.func
def keep_colliding(pairs: ti.template(), own, at, found):
    """Turn `found` links to sorted copies into links to the balls that may touch; returns how many those are, and how many
    places further on in the order the furthest is."""
    i = pairs.grid.sorted[own]
    kept = 0
    furthest = 0
    for t in range(found):
        k = pairs.link[pair_entry(pairs, at, t)].other
        j = pairs.grid.sorted[k]
        if may_touch(pairs, i, j):
            distance = k - own
            if ti.static(pairs.grid.levels == 1 and not pairs.plan.gathers):
                if pairs.grid.dense[0] == 0:
                    distance = pairs.grid.rank[j] - pairs.grid.rank[i]
            furthest = ti.max(furthest, distance)
            e = pair_entry(pairs, at, kept)
            if ti.static(pairs.plan.warm_starts):
                recall(pairs, i, j, e)
            pairs.link[e].other = j
            kept += 1
    return kept, furthest


@ti.func
def forget(pairs: ti.template(), e):
    """Link e has accumulated nothing."""
    warm_start.forget(pairs.link, e, pairs.model.dim)
    if ti.static(pairs.plan.soft):
        pairs.link[e].bias_velocity = RIGID
    if ti.static(pairs.has_rebounds):
        pairs.link[e].rebound_speed = 0.0


@ti.func
def store(pairs: ti.template()):
    """Keep links of what touches in `contact`, before new lists are made. Its own content only lasts until then."""
    for i in range(pairs.grid.work[0].balls):
        store_links(pairs, i)


@ti.func
def store_links(pairs: ti.template(), i):
    """`store` for ball i."""
    pairs.old_first[i] = pairs.first[i]
    pairs.old_held[i] = pairs.touching[i]
    for t in range(pairs.touching[i]):
        c = pair_entry(pairs, pairs.first[i], t)
        link = pairs.link[c]
        for own, place in ti.static(pairs.kept()):
            place[c] = own[c]
        if ti.static(pairs.single_precision):  # as a normal number: others might be flushed to 0
            pairs.contact[c].mass = ti.bit_cast(link.other + BITS_OF_ONE, ti.f32)
        else:
            pairs.contact[c].mass = ti.cast(link.other, float)
        if ti.static(pairs.model.has_friction):
            if ti.static(pairs.model.dim == 2):
                pairs.contact[c].normal[0] = link.tangential_impulse
            else:
                pairs.contact[c].normal = link.tangential_impulse


@ti.func
def stored_other(pairs: ti.template(), c):
    """The other ball of the link that `store` put into contact c."""
    if ti.static(pairs.single_precision):
        return ti.bit_cast(pairs.contact[c].mass, ti.i32) - BITS_OF_ONE
    else:
        return ti.cast(pairs.contact[c].mass, ti.i32)


@ti.func
def recall(pairs: ti.template(), i, j, at):
    """Copy into link `at` what the contact of i and j accumulated when the lists were last made; either of them may have listed
    it.

    Starting from these impulses, iterations need not build up the load of a pile from nothing in every step.
    """
    forget(pairs, at)
    for which in ti.static(range(1 if pairs.plan.gathers else 2)):
        one, two = i, j
        if ti.static(which == 1):
            one, two = j, i
        begin = pairs.old_first[one]
        for t in range(pairs.old_held[one]):
            c = pair_entry(pairs, begin, t)
            if stored_other(pairs, c) == two:
                for own, place in ti.static(pairs.kept()):
                    own[at] = place[c]
                if ti.static(pairs.model.has_friction):
                    normal = pairs.contact[c].normal
                    # a scalar along the normal turned by 90 degrees is the same seen from the other ball
                    if ti.static(pairs.model.dim == 2):
                        pairs.link[at].tangential_impulse = normal[0]
                    else:
                        pairs.link[at].tangential_impulse = normal if ti.static(which == 0) else -normal


@ti.func
def search(pairs: ti.template()):
    """List for each ball the later balls within reach, in an order that the grid fixes; nothing is done while the last lists
    hold.

    The lists of a block of balls lie one behind the other in the entries of that block; what they cannot take goes to a pool at
    the end, where its place depends on the threads, but not what it lists. What does not fit there is counted and not kept; the
    host then makes a larger list and repeats the steps.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        if pairs.grid.crowded_pairs[0] > pairs.grid.pair_limit[0]:
            pairs.overflow[0] = ENDLESS
            pairs.grid.most_crowded_pairs[0] = ti.max(pairs.grid.most_crowded_pairs[0], pairs.grid.crowded_pairs[0])
            pairs.grid.work[0].balls = 0
        if pairs.grid.work[0].balls > 0:
            pairs.used[0] = 0
            pairs.longest_reach[0] = 0
    if ti.static(pairs.plan.warm_starts):
        store(pairs)
    for block in range((pairs.grid.work[0].balls + LIST_BLOCK - 1) // LIST_BLOCK):
        at = block * pairs.block_capacity
        end = at + pairs.block_capacity
        furthest = 0
        for k in range(block * LIST_BLOCK, ti.min((block + 1) * LIST_BLOCK, pairs.grid.n)):
            first, found, far = list_neighbours(pairs, k, at, end - at)
            if first == at:
                at += found
            furthest = ti.max(furthest, far)
            i = pairs.grid.sorted[k]
            pairs.first[i] = first
            pairs.number[i] = found
            pairs.touching[i] = found
        ti.atomic_max(pairs.longest_reach[0], furthest)
    ti.loop_config(serialize=True)
    for _ in range(1):
        if pairs.grid.work[0].balls > 0:
            pairs.block_length[0] = ti.max(LIST_BLOCK, pairs.longest_reach[0])
            pairs.blocks[0] = (pairs.model.n + pairs.block_length[0] - 1) // pairs.block_length[0]


@ti.func
def list_neighbours(pairs: ti.template(), own, at, room):
    """The list of sorted copy `own`, in the `room` entries from `at` on or in the pool. Returns its first entry, its length, and
    how many places further on in the order the furthest of them is."""
    first = at
    far = 0
    found = nearby(pairs, own, at, room - 1)
    if found < room:
        found, far = keep_colliding(pairs, own, at, found)
    else:
        used = COUNT_LIMIT
        if pairs.used[0] < COUNT_LIMIT - pairs.pool_start:
            used = pairs.pool_start + ti.atomic_add(pairs.used[0], found + 1)
        if used + found < pairs.capacity:
            first = used
            nearby(pairs, own, first, found)
            found, far = keep_colliding(pairs, own, first, found)
        else:
            ti.atomic_max(pairs.overflow[0], used + found + 1)
            found = 0
    return first, found, far


@ti.func
def law_of(pairs: ti.template(), i, j, n):
    """Pair law of two balls, along n."""
    which = pairs.only_law + 0 * i
    if ti.static(pairs.only_law < 0):
        which = pairs.model.surface[i] * pairs.model.surfaces + pairs.model.surface[j]
    law = pairs.model.laws[which]
    if ti.static(pairs.model.holds_back):  # each counts by its share of the change of their relative velocity
        w, other = pairs.model.inverse_mass[i], pairs.model.inverse_mass[j]
        own, others = contact_law.swing(pairs.model, i, n), contact_law.swing(pairs.model, j, n)
        law = contact_law.as_resolved(pairs.model, law, (w * own + other * others) / (w + other))
    return law
