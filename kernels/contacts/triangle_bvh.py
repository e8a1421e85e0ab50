"""Which pairs of surfaces are looked at: patches whose boxes come near each other.

The patch of a ball is what it owns: the triangles whose first ball it is, and the edges. Patches lie in a tree of boxes whose
shape is fixed, as what is one surface stays together: node k has the children 2 k and 2 k + 1, and each leaf the same number of
patches. What is near depends on how patches move relative to each other, so that a cloth that falls as a whole sees no more of
itself than one at rest.
"""

from taichi_sim.kernels.contacts.triangle_pairs import (
    DETECT,
    KEEP,
    LIMIT,
    LOOK,
    ball_triangle,
    edge_edge,
    near_boxes,
    stretch,
)

from taichi_sim.device.engine import ti

FAR = 1e30  # m, beyond all that there is


@ti.func
def has_patch(facets: ti.template(), i):
    """Whether ball i owns anything: triangles, whose edges it then owns too, or sticks."""
    return facets.edge_start[i + 1] > facets.edge_start[i]


@ti.func
def hasty(facets: ti.template(), p):
    """Whether some ball of patch p is not where it was expected."""
    yes = facets.hasty[p] == 1
    for e in range(facets.edge_start[p], facets.edge_start[p + 1]):
        yes = yes or facets.hasty[facets.edge[e].two] == 1
    return yes


@ti.func
def bounds(facets: ti.template(), ball: ti.template(), i, job: ti.template()):
    """The box around ball i with its patch, and the distance [m] within which it concerns what approaches it as fast as the ball
    itself: the largest radius, and what its other balls may approach faster."""
    low, high = stretch(facets, ball, i, job)
    thick, spread = facets.model.radius[i], 0.0 * facets.model.radius[i]
    for e in range(facets.edge_start[i], facets.edge_start[i + 1]):
        k = facets.edge[e].two
        bottom, top = stretch(facets, ball, k, job)
        low, high = ti.min(low, bottom), ti.max(high, top)
        thick = ti.max(thick, facets.model.radius[k])
        if ti.static(job == DETECT):
            spread = ti.max(spread, LOOK * (facets.way[k] - facets.way[i]).norm())
    if ti.static(job == LIMIT):
        thick *= KEEP  # what lies in a plane between two ways gets no nearer
    return low, high, 1.001 * (thick + spread)  # for rounding


@ti.func
def fit(facets: ti.template(), ball: ti.template(), job: ti.template()):
    """The boxes of all patches and nodes: leaves, then the nodes above each `facets.bunch` of them, then the rest."""
    for leaf in range(facets.work[2]):
        none = FAR + ti.Vector.zero(float, 3)
        low, high, slow, fast, near = none, -none, none, -none, ti.cast(0.0, float)
        for slot in range(leaf * facets.leaf, ti.min((leaf + 1) * facets.leaf, facets.patches)):
            i = facets.walker[slot]
            bottom, top, around = bounds(facets, ball, i, job)
            facets.patch[slot].low, facets.patch[slot].high, facets.patch[slot].near = bottom, top, around
            facets.patch[slot].way = facets.way[i]
            low, high = ti.min(low, bottom), ti.max(high, top)
            slow, fast = ti.min(slow, facets.way[i]), ti.max(fast, facets.way[i])
            near = ti.max(near, around)
        k = facets.leaves + leaf
        facets.node[k].low, facets.node[k].high, facets.node[k].near = low, high, near
        facets.node[k].slow, facets.node[k].fast = slow, fast
    for bunch in range(facets.work[2] // facets.bunch):
        first, width = facets.leaves + bunch * facets.bunch, facets.bunch
        while width > 1:
            first //= 2
            width //= 2
            for k in range(first, first + width):
                join(facets, k)
    ti.loop_config(serialize=True)
    for step in range(1, facets.work[2] // facets.bunch):
        join(facets, facets.work[2] // facets.bunch - step)


@ti.func
def join(facets: ti.template(), k):
    """Node k around its two children."""
    a, b = facets.node[2 * k], facets.node[2 * k + 1]
    facets.node[k].low, facets.node[k].high = ti.min(a.low, b.low), ti.max(a.high, b.high)
    facets.node[k].slow, facets.node[k].fast = ti.min(a.slow, b.slow), ti.max(a.fast, b.fast)
    facets.node[k].near = ti.max(a.near, b.near)


@ti.func
def walk(
    facets: ti.template(), solver: ti.template(), ball: ti.template(), walker, some: ti.template(), job: ti.template()
):
    """Look at all patches near that of one ball. walker: a slot; from the number of patches on, a ball without one, which is not
    in the tree and so looks for itself. Of two patches the first one lists their pairs and starts at its own leaf. some: only
    pairs with something hasty; a hasty patch then looks at all others, as they may not."""
    p = facets.walker[walker]
    low, high, near = bounds(facets, ball, p, job)
    way = facets.way[p]
    found = 0
    own = False
    if ti.static(some):
        own = hasty(facets, p)
    k = 1
    if walker < facets.patches and not own:
        k = facets.leaves + walker // facets.leaf
    while k > 0:
        node = facets.node[k]
        reach = near + node.near
        if ti.static(job == DETECT):
            reach += LOOK * ti.max(way - node.slow, node.fast - way, 0.0).norm()
        meets = near_boxes(low, high, node.low, node.high, reach)
        if meets and k < facets.leaves:
            k *= 2
        else:
            if meets:
                first = (k - facets.leaves) * facets.leaf
                for slot in range(first, ti.min(first + facets.leaf, facets.patches)):
                    if slot > walker or (slot != walker and (own or walker >= facets.patches)):
                        patch = facets.patch[slot]
                        around = near + patch.near
                        if ti.static(job == DETECT):
                            around += LOOK * (way - patch.way).norm()
                        looks = near_boxes(low, high, patch.low, patch.high, around)
                        if ti.static(some):
                            looks = looks and (own or hasty(facets, facets.walker[slot]))
                        if looks:
                            found = meet(facets, solver, ball, p, low, high, slot, around, found, job)
            k += 1
            while k % 2 == 0:
                k //= 2
            if k == 1:
                k = 0


@ti.func
def meet(
    facets: ti.template(),
    solver: ti.template(),
    ball: ti.template(),
    p,
    low,
    high,
    slot,
    near,
    found,
    job: ti.template(),
):
    """Balls of two patches against triangles of the other, edges against edges, where they are nearer than `near`: patch p, which
    lies between low and high, and the one in a slot. found: how many pairs patch p has listed; returned with these."""
    number = found
    j, bottom, top = facets.walker[slot], facets.patch[slot].low, facets.patch[slot].high
    for which in ti.static(range(2)):
        i, o = p, j
        if ti.static(which == 1):
            i, o = j, p
        least, most = stretch(facets, ball, i, job)
        around_low, around_high = bottom, top
        if ti.static(which == 1):
            around_low, around_high = low, high
        if near_boxes(least, most, around_low, around_high, near):
            for t in range(facets.triangle_start[o], facets.triangle_start[o + 1]):
                number += ball_triangle(facets, solver, ball, p, i, t, near, number, job)
    if has_patch(facets, p):
        for f in range(facets.edge_start[j], facets.edge_start[j + 1]):
            least, most = stretch(facets, ball, facets.edge[f].one, job)
            other_least, other_most = stretch(facets, ball, facets.edge[f].two, job)
            least, most = ti.min(least, other_least), ti.max(most, other_most)
            if near_boxes(least, most, low, high, near):
                for e in range(facets.edge_start[p], facets.edge_start[p + 1]):
                    number += edge_edge(facets, solver, ball, p, e, f, least, most, near, number, job)
    return number
