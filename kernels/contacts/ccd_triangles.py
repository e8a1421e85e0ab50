"""Contacts of surfaces in a step: the list of all pairs that are near, and how far balls may move before any of them meet."""

from taichi_sim.kernels.contacts.contact_incidence import list_entries
from taichi_sim.kernels.contacts.triangle_bvh import fit, hasty, walk
from taichi_sim.kernels.contacts.triangle_pairs import DETECT, LIMIT, hold_apart, planes

from taichi_sim.device.engine import ti

CLEAR, SWEEPS = (
    0.02,
    2,
)  # of what is kept: how far past its plane a ball is led; times that all its planes are gone through
SAFE = 0.99  # of a radius: what moves no further from where it was expected cannot meet what was not listed


@ti.func
def detect(facets: ti.template(), solver: ti.template(), ball: ti.template()):
    """Rows of all patches, then for each ball the list of its places in them."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        facets.work[1] = ti.select(facets.grid.work[0] > 0, facets.model.n, 0)  # none where the grid gave up
        facets.used[0] = 0
        facets.work[2] = ti.select(facets.work[1] > 0, facets.leaves, 0)
    for i in range(facets.model.n):
        facets.way[i] = ball[i].v / solver.rate[0]
    fit(facets, ball, DETECT)
    for k in range(facets.work[1]):
        walk(facets, solver, ball, k, False, DETECT)
    list_entries(facets)


@ti.func
def limit(facets: ti.template(), solver: ti.template(), ball: ti.template()):
    """Shorten the ways of the step just made so that no two surfaces, and no surface and ball, have gone through each other.

    Listed pairs have planes in between. The others were at least as far apart as their balls are thick and as they would come
    nearer with the speeds they had: where no ball is further than its radius from where those took it, they cannot have met.
    Balls that are, being hit or cut short, are looked at with all that is around their ways; should that cut short others,
    everything is.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        facets.work[0] = ti.min(facets.used[0], facets.capacity)
        facets.fast[0] = 0
    lead_past(facets, solver, ball)
    for i in range(facets.model.n):
        facets.part[i] = 1.0
        facets.hasty[i] = 0
    for c in range(facets.work[0]):
        hold_apart(facets, ball, balls_of(facets, c), facets.row[c].normal, facets.row[c].kind)
    for everything in ti.static(range(2)):
        cut_short(facets, solver, ball)
        for i in range(facets.model.n):
            off = ball[i].x - facets.grid.origin[i] - facets.way[i]
            if not off.norm() <= SAFE * facets.model.radius[i] and facets.hasty[i] == 0:
                facets.hasty[i] = 1
                facets.fast[0] = 1
        ti.loop_config(serialize=True)
        for _ in range(1):
            facets.work[1] = facets.fast[0] * facets.model.n
            facets.work[2] = facets.fast[0] * facets.leaves
            facets.fast[0] = 0
        fit(facets, ball, LIMIT)
        for k in range(facets.work[1]):
            if ti.static(everything) or k >= facets.patches or hasty(facets, facets.walker[k]):
                walk(facets, solver, ball, k, ti.static(not everything), LIMIT)
    cut_short(facets, solver, ball)


@ti.func
def cut_short(facets: ti.template(), solver: ti.template(), ball: ti.template()):
    """Take back of each way what it may not be."""
    for i in range(facets.model.n):
        if facets.part[i] < 1.0:
            solver.state.shift(i, (1.0 - facets.part[i]) * (facets.grid.origin[i] - ball[i].x))
            facets.part[i] = 1.0


@ti.func
def lead_past(facets: ti.template(), solver: ti.template(), ball: ti.template()):
    """Take from the ways of balls what leads across the planes of listed pairs, so that they may slide along: a way that is cut
    short as a whole lets a ball stick. This need not settle all."""
    for c in range(facets.work[0]):
        up, down, keep = planes(facets, ball, balls_of(facets, c), facets.row[c].normal, facets.row[c].kind)
        facets.row[c].up = up + CLEAR * keep
        facets.row[c].down = down - CLEAR * keep
    for i in range(facets.model.n):
        x = ball[i].x
        change = 0.0 * x
        for _ in range(SWEEPS):
            for e in range(facets.first[i], facets.first[i] + facets.number[i]):
                c, k = facets.entry[e] // 4, facets.entry[e] % 4
                n = facets.row[c].normal
                height = n.dot(x + change - facets.grid.origin[facets.member[4 * c]])
                if k == 0 or (k == 1 and facets.row[c].kind > 0):
                    change += ti.max(0.0, facets.row[c].up - height) * n
                else:
                    change -= ti.max(0.0, height - facets.row[c].down) * n
        if change.dot(change) > 0.0 and facets.model.inverse_mass[i] > 0.0:  # a pin stays where it is
            solver.state.shift(i, change)


@ti.func
def balls_of(facets: ti.template(), c):
    """The four balls of a row."""
    return ti.Vector([facets.member[4 * c + k] for k in ti.static(range(4))])
