"""What contacts hold from step to step: scaled to another step, and for rows of several balls found again and bounded.

`rows` has the table `row` with the impulse [N s] that each holds along its normal, with friction `slide` along the surface, what
it held before the solve (`start`), and the speed [m/s] along the normal that it was last seen with. Before rows are listed anew
what they hold goes to `old`, `begin` and `length` of which say where each owner has its own.
"""

from taichi_sim.kernels.contacts.wall_impacts import GROWTH

from taichi_sim.device.engine import ti


@ti.func
def scale(table: ti.template(), count, ratio, friction: ti.template()):
    """The first `count` contacts of a table hold as much less or more."""
    for e in range(count):
        table[e].impulse = ratio * table[e].impulse
        if ti.static(friction):
            table[e].slide = ratio * table[e].slide


@ti.func
def store(rows: ti.template()):
    """Keep what rows hold while they are listed anew."""
    for c in range(ti.min(rows.used[0], rows.capacity)):
        rows.old[c].other = rows.row[c].ball
        rows.old[c].impulse = rows.row[c].impulse
        if ti.static(rows.model.has_friction):
            rows.old[c].slide = rows.row[c].slide


@ti.func
def recall(rows: ti.template(), owner, c, n):
    """Row c of an owner, along the normal n, holds what it held under the last list."""
    rows.row[c].impulse = 0.0
    if ti.static(rows.model.has_friction):
        rows.row[c].slide = 0.0 * n
    for e in range(rows.begin[owner], rows.begin[owner] + rows.length[owner]):
        if rows.old[e].other == rows.row[c].ball:
            rows.row[c].impulse = rows.old[e].impulse
            if ti.static(rows.model.has_friction):
                slide = rows.old[e].slide
                rows.row[c].slide = slide - slide.dot(n) * n


@ti.func
def start(rows: ti.template(), solver: ti.template(), c, u, n):
    """Row c, whose speed along the normal is u, starts with what it holds; what leaves fast has nothing that presses it any
    more."""
    if ti.static(not rows.warm) or u > solver.threshold[0]:
        rows.row[c].impulse = 0.0
        if ti.static(rows.model.has_friction):
            rows.row[c].slide = 0.0 * n
    if ti.static(rows.warm):
        rows.row[c].start = rows.row[c].impulse
        rows.row[c].gained = ti.max(solver.threshold[0], rows.row[c].speed - u)
        rows.push[c] = rows.row[c].impulse * n
        if ti.static(rows.model.has_friction):
            rows.push[c] += rows.row[c].slide


@ti.func
def limit(rows: ti.template(), c, inverse, u):
    """Of what row c holds after a solve, what may be a load: more than twice what it held before, and more than forces gave
    since it was last seen, is an impact's, and the next solve would throw it back. inverse: sum w g^2 [1/kg]; u: its speed."""
    held = rows.row[c].impulse
    most = GROWTH * rows.row[c].start + rows.row[c].gained / inverse
    if held > most:
        rows.row[c].impulse = most
        if ti.static(rows.model.has_friction):
            rows.row[c].slide = most / held * rows.row[c].slide
    rows.row[c].speed = u
