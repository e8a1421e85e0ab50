"""Search for the pairs of surfaces to look at: leaves of a tree whose boxes come near each other.

The leaf of a ball is what it owns: the triangles whose first ball it is, and the edges. The shape of the tree is fixed, as what
is one surface stays together: node k has the children 2 k and 2 k + 1, and each node at the bottom the same number of leaves,
by their slots. What is near depends on how leaves move relative to each other, so that a cloth that falls as a whole sees no
more of itself than one at rest.

What is found holds for some steps: a pair becomes a candidate while it is further apart than it is listed by the skin, and
nothing is looked for until some ball has drifted by nearly half of that (ccd_triangles.begin).
"""

from taichi_sim.kernels.contacts.triangle_pairs import (
    BEYOND_ALL,
    FIND_CANDIDATES,
    KEPT_DISTANCE,
    LIMIT_WAYS,
    LOOK_AHEAD,
    ball_triangle,
    edge_edge,
    holds,
    near_boxes,
    stretch,
)
from taichi_sim.kernels.loops import each

from taichi_sim.device.engine import ti

# of the skin, of each ball since a search: two halves of it bring a pair near, the rest is for rounding
DRIFT_ALLOWED = 0.45
SHORTEST_HOLD = 1.0  # steps that a search with a skin must hold; where it would not, there is no skin


@ti.func
def has_leaf(triangles: ti.template(), i):
    """True if ball i owns anything: triangles, whose edges it then owns too, or sticks."""
    return triangles.edge_start[i + 1] > triangles.edge_start[i]


@ti.func
def any_left_path(triangles: ti.template(), p):
    """True if ball p, or any ball of its leaf, is not where it was expected."""
    yes = triangles.left_path[p] == 1
    for e in range(triangles.edge_start[p], triangles.edge_start[p + 1]):
        yes = yes or triangles.left_path[triangles.edge[e].two] == 1
    return yes


@ti.func
def bounds(triangles: ti.template(), ball: ti.template(), i, job: ti.template()):
    """The box around ball i with its leaf, and the distance [m] within which it concerns what approaches it as fast as the ball
    itself: the largest radius, and what its other balls may approach faster."""
    low, high = stretch(triangles, ball, i, job)
    thick, spread = triangles.model.radius[i], 0.0 * triangles.model.radius[i]
    for e in range(triangles.edge_start[i], triangles.edge_start[i + 1]):
        k = triangles.edge[e].two
        if holds(triangles, e):
            bottom, top = stretch(triangles, ball, k, job)
            low, high = ti.min(low, bottom), ti.max(high, top)
            thick = ti.max(thick, triangles.model.radius[k])
            if ti.static(job == FIND_CANDIDATES):
                apart = triangles.expected_displacement[k] - triangles.expected_displacement[i]
                spread = ti.max(spread, LOOK_AHEAD * apart.norm())
    if ti.static(job == LIMIT_WAYS):
        thick *= KEPT_DISTANCE  # what lies in a plane between two ways gets no nearer
    return low, high, 1.001 * (thick + spread)  # for rounding


@ti.func
def fit(triangles: ti.template(), ball: ti.template(), all: ti.template(), job: ti.template()):
    """The boxes of all leaves and nodes: those at the bottom, then above each `subtree_nodes` of them, then the rest; on a device
    a few levels at a time. all: 1, or 0: none."""
    fixed = ti.static(triangles.pairs.plan.gathers)
    each(all * triangles.bottom_nodes, triangles.bottom_nodes, fixed, fit_bottom, (triangles, ball, job))
    if ti.static(fixed):
        for stage in ti.static(triangles.stages):
            for subtree in range(stage[0]):
                if all == 1:
                    join_subtree(triangles, (stage[0] + subtree) << stage[1], 1 << stage[1])
    else:
        for subtree in range(all * triangles.bottom_nodes // triangles.subtree_nodes):
            join_subtree(
                triangles,
                triangles.bottom_nodes + subtree * triangles.subtree_nodes,
                ti.static(triangles.subtree_nodes),
            )
        ti.loop_config(serialize=True)
        for step in range(1, all * triangles.bottom_nodes // triangles.subtree_nodes):
            join(triangles, triangles.bottom_nodes // triangles.subtree_nodes - step)


@ti.func
def fit_bottom(place, triangles: ti.template(), ball: ti.template(), job: ti.template()):
    """The boxes of the leaves of one node at the bottom, and its own."""
    none = BEYOND_ALL + ti.Vector.zero(float, 3)
    low, high, lowest, highest, near = none, -none, none, -none, ti.cast(0.0, float)
    if ti.static(job == FIND_CANDIDATES):
        if place == 0:
            triangles.candidates[0] = 0
            holds = DRIFT_ALLOWED * triangles.widest_skin[0] > SHORTEST_HOLD * triangles.fastest[0]
            triangles.skin[0] = ti.select(holds, triangles.widest_skin[0], 0.0)
    first = place * triangles.leaves_per_node
    for slot in range(first, ti.min(first + triangles.leaves_per_node, triangles.leaf_count)):
        i = triangles.leaf_ball[slot]
        bottom, top, around = bounds(triangles, ball, i, job)
        triangles.leaf[slot].low, triangles.leaf[slot].high, triangles.leaf[slot].reach = bottom, top, around
        way = triangles.expected_displacement[i]
        triangles.leaf[slot].displacement = way
        low, high = ti.min(low, bottom), ti.max(high, top)
        lowest, highest = ti.min(lowest, way), ti.max(highest, way)
        near = ti.max(near, around)
    k = triangles.bottom_nodes + place
    triangles.node[k].low, triangles.node[k].high, triangles.node[k].reach = low, high, near
    triangles.node[k].lowest_displacement, triangles.node[k].highest_displacement = lowest, highest


@ti.func
def join_subtree(triangles: ti.template(), begin, below):
    """All nodes above those from `begin` on, which are `below` in number."""
    first, width = begin, below
    while width > 1:
        first //= 2
        width //= 2
        for k in range(first, first + width):
            join(triangles, k)


@ti.func
def join(triangles: ti.template(), k):
    """Node k around its two children."""
    a, b = triangles.node[2 * k], triangles.node[2 * k + 1]
    triangles.node[k].low, triangles.node[k].high = ti.min(a.low, b.low), ti.max(a.high, b.high)
    triangles.node[k].lowest_displacement = ti.min(a.lowest_displacement, b.lowest_displacement)
    triangles.node[k].highest_displacement = ti.max(a.highest_displacement, b.highest_displacement)
    triangles.node[k].reach = ti.max(a.reach, b.reach)


@ti.func
def traverse(own_slot, triangles: ti.template(), solver: ti.template(), ball: ti.template(), some: ti.template(),
             job: ti.template()):  # fmt: skip
    """Look at all leaves near that of one ball. own_slot: from the number of leaves on that of a ball without one, which is not
    in the tree and so looks for itself. Of two leaves the first one lists their pairs and starts at its own node. some: only
    pairs that have left their path; a leaf that has then looks at all others, as they may not."""
    p = triangles.leaf_ball[own_slot]
    low, high, near = bounds(triangles, ball, p, job)
    way = triangles.expected_displacement[p]
    if ti.static(job == FIND_CANDIDATES):
        near += triangles.skin[0]
        triangles.searched_position[p] = ball[p].x
        triangles.searched_displacement[p] = way
        if own_slot == 0:
            triangles.work[0].expired = 0
            if ti.static(not triangles.pairs.plan.neighbours):  # else the grid counts its own
                triangles.grid.searches[0] = triangles.grid.searches[0] + 1
    found = 0
    own = False
    if ti.static(some):
        own = any_left_path(triangles, p)
    k = 1
    if own_slot < triangles.leaf_count and not own:
        k = triangles.bottom_nodes + own_slot // triangles.leaves_per_node
    while k > 0:
        node = triangles.node[k]
        reach = near + node.reach
        if ti.static(job == FIND_CANDIDATES):
            reach += LOOK_AHEAD * ti.max(way - node.lowest_displacement, node.highest_displacement - way, 0.0).norm()
        meets = near_boxes(low, high, node.low, node.high, reach)
        if meets and k < triangles.bottom_nodes:
            k *= 2
        else:
            if meets:
                first = (k - triangles.bottom_nodes) * triangles.leaves_per_node
                for slot in range(first, ti.min(first + triangles.leaves_per_node, triangles.leaf_count)):
                    if slot > own_slot or (slot != own_slot and (own or own_slot >= triangles.leaf_count)):
                        leaf = triangles.leaf[slot]
                        around = near + leaf.reach
                        if ti.static(job == FIND_CANDIDATES):
                            around += LOOK_AHEAD * (way - leaf.displacement).norm()
                        looks = near_boxes(low, high, leaf.low, leaf.high, around)
                        if ti.static(some):
                            looks = looks and (own or any_left_path(triangles, triangles.leaf_ball[slot]))
                        if looks:
                            found = meet(triangles, solver, ball, p, low, high, slot, around, found, job)
            k += 1
            while k % 2 == 0:
                k //= 2
            if k == 1:
                k = 0


@ti.func
def meet(triangles: ti.template(), solver: ti.template(), ball: ti.template(), p, low, high, slot, near, found,
         job: ti.template()):  # fmt: skip
    """Balls of two leaves against triangles of the other, edges against edges, where they are nearer than `near`: the leaf of
    ball p, which lies between low and high, and the one in a slot. found: how many pairs it has listed; returned with these."""
    number = found
    j, bottom, top = triangles.leaf_ball[slot], triangles.leaf[slot].low, triangles.leaf[slot].high
    for which in ti.static(range(2)):
        i, o = p, j
        if ti.static(which == 1):
            i, o = j, p
        least, most = stretch(triangles, ball, i, job)
        around_low, around_high = bottom, top
        if ti.static(which == 1):
            around_low, around_high = low, high
        if near_boxes(least, most, around_low, around_high, near):
            for t in range(triangles.triangle_start[o], triangles.triangle_start[o + 1]):
                number += ball_triangle(triangles, solver, ball, p, i, t, near, number, job)
    if has_leaf(triangles, p):
        for f in range(triangles.edge_start[j], triangles.edge_start[j + 1]):
            least, most = stretch(triangles, ball, triangles.edge[f].one, job)
            other_least, other_most = stretch(triangles, ball, triangles.edge[f].two, job)
            least, most = ti.min(least, other_least), ti.max(most, other_most)
            if near_boxes(least, most, low, high, near):
                for e in range(triangles.edge_start[p], triangles.edge_start[p + 1]):
                    number += edge_edge(triangles, solver, ball, p, e, f, least, most, near, number, job)
    return number
