"""Impulses that contacts accumulate and keep from step to step: scaled to another step, bounded, and for contacts of several
balls found again.

Before the contacts of sticks are listed anew, what they accumulated goes to `old`, `begin` and `length` of which say where each
stick has its own.
"""

from taichi_sim.kernels.contacts.contact_incidence import each_contact
from taichi_sim.kernels.contacts.contact_law import along_surface
from taichi_sim.kernels.vectors import part_across, zero_scalar_in_2d

from taichi_sim.device.engine import ti

LOAD_GROWTH = 2.0  # times what a contact accumulated before: more than that, after an impact, was the impact's


@ti.func
def scale(table: ti.template(), ratio):
    """Scale what all contacts of a table have accumulated by `ratio`."""
    for e in range(table.shape[0]):
        table[e].impulse = ratio * table[e].impulse
        if ti.static("tangential_impulse" in table.keys):
            table[e].tangential_impulse = ratio * table[e].tangential_impulse
        if ti.static("load" in table.keys):
            table[e].load = ratio * table[e].load


@ti.func
def keep_at_most(table: ti.template(), c, most):
    """Limit what contact c of a table accumulated to `most` [N s], which may be a load: the next solve starts with it, and
    would throw back what was an impact's."""
    accumulated = table[c].impulse
    if accumulated > most:
        table[c].impulse = most
        if ti.static("tangential_impulse" in table.keys):
            table[c].tangential_impulse = most / accumulated * table[c].tangential_impulse


@ti.func
def largest_load(solver: ti.template(), start, i, j):
    """The most [N s] that a contact of balls i and j may keep after an impact that had accumulated `start` before the solve."""
    return LOAD_GROWTH * start + solver.threshold[0] / ti.max(
        solver.model.inverse_mass[i], solver.model.inverse_mass[j]
    )


@ti.func
def start_from_load(table: ti.template(), solver: ti.template(), c, i, j):
    """Limit what contact c of a table, of balls i and j, accumulated in an impact to the largest load and a part of the rest. So
    an impact that takes several steps to stop is braked by what it gave before, and hardly thrown back by it."""
    accumulated = table[c].impulse
    load = accumulated
    if accumulated > LOAD_GROWTH * table[c].load:
        most = largest_load(solver, table[c].load, i, j)
        load = ti.min(accumulated, most)
        keep_at_most(table, c, most + solver.carried_part[0] * (accumulated - most))
    table[c].load = load


@ti.func
def store(sticks: ti.template()):
    """Keep what contacts accumulated while they are listed anew."""
    each_contact(sticks, store_contact, (sticks,))


@ti.func
def store_contact(c, sticks: ti.template()):
    """Keep what contact c accumulated, and its ball, while contacts are listed anew."""
    sticks.old[c].other = sticks.contact[c].ball
    sticks.old[c].impulse = sticks.contact[c].impulse
    if ti.static(sticks.model.has_friction):
        sticks.old[c].tangential_impulse = sticks.contact[c].tangential_impulse


@ti.func
def forget(table: ti.template(), c, dim: ti.template()):
    """Clear what contact c of a table has accumulated."""
    table[c].impulse = 0.0
    if ti.static("load" in table.keys):
        table[c].load = 0.0
    if ti.static("tangential_impulse" in table.keys):
        table[c].tangential_impulse = zero_scalar_in_2d(dim)


@ti.func
def kept_impulse(table: ti.template(), c, n):
    """Impulse [N s] with which contact c of a table starts: what it accumulated along its normal n, which has turned since, and
    along its surface."""
    p = table[c].impulse * n
    if ti.static("tangential_impulse" in table.keys):
        tangential = table[c].tangential_impulse
        if ti.static(n.n == 3):
            tangential = part_across(tangential, n)
            table[c].tangential_impulse = tangential
        p += along_surface(n, tangential)
    return p


@ti.func
def recall(sticks: ti.template(), s, c):
    """Restore to contact c of stick s what it had accumulated under the last list."""
    forget(sticks.contact, c, sticks.model.dim)
    for e in range(sticks.begin[s], sticks.begin[s] + sticks.length[s]):
        if sticks.old[e].other == sticks.contact[c].ball:
            sticks.contact[c].impulse = sticks.old[e].impulse
            if ti.static(sticks.model.has_friction):
                sticks.contact[c].tangential_impulse = sticks.old[e].tangential_impulse


@ti.func
def start(contacts: ti.template(), solver: ti.template(), c, u, n):
    """Contact c, whose speed along the normal is u, starts with what it accumulated; nothing presses any more what leaves
    fast."""
    if ti.static(not contacts.warm_starts) or u > solver.threshold[0]:
        forget(contacts.contact, c, contacts.model.dim)
    if ti.static(contacts.warm_starts):
        contacts.contact[c].starting_impulse = contacts.contact[c].impulse
        contacts.contact[c].gained_speed = ti.max(solver.threshold[0], contacts.contact[c].last_speed - u)
        contacts.applied_impulse[c] = kept_impulse(contacts.contact, c, n)


@ti.func
def limit(sticks: ti.template(), c, inverse_mass, u):
    """Limit what contact c keeps after a solve to twice what it started with, and what forces gave since it was last seen.
    inverse_mass: sum w g^2 [1/kg]; u: its speed."""
    most = LOAD_GROWTH * sticks.contact[c].starting_impulse + sticks.contact[c].gained_speed / inverse_mass
    keep_at_most(sticks.contact, c, most)
    sticks.contact[c].last_speed = u
