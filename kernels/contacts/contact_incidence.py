"""Sorted list, for each ball, of its entries in contacts of several balls.

Sums that are gathered by ball come out the same whatever the threads did, and nothing is added by atomics. The entries of ball
i are first[i] to first[i] + number[i].
"""

from taichi_sim.kernels.loops import each

from taichi_sim.device.engine import ti


@ti.func
def each_contact(contacts: ti.template(), visit: ti.template(), arguments: ti.template()):
    """visit(c, *arguments) for each contact c."""
    each(ti.min(contacts.used[0], contacts.capacity), contacts.capacity, contacts.pairs.plan.gathers, visit, arguments)


@ti.func
def begin_entries(contacts: ti.template(), i):
    """Clear the list of contacts and the entries of ball i; for each ball, in a loop before contacts are found."""
    contacts.number[i] = 0
    if i == 0:
        contacts.used[0] = 0
        contacts.entries[0] = 0


@ti.func
def list_entries(contacts: ti.template()):
    """Make all lists of what count_entries has counted; `entries` is 0."""
    for i in range(contacts.model.n):
        contacts.first[i] = ti.atomic_add(contacts.entries[0], contacts.number[i])
        contacts.number[i] = 0
    each_contact(contacts, enter, (contacts,))
    if ti.static(not contacts.pairs.plan.gathers):
        for i in range(contacts.model.n):
            sort_entries(contacts, i)


@ti.func
def sort_entries(contacts: ti.template(), i):
    """Put the list of ball i in order. Insertion sort: lists are short."""
    first = contacts.first[i]
    for a in range(first + 1, first + contacts.number[i]):
        value = contacts.entry[a]
        b = a - 1
        while b >= first and contacts.comes_after(contacts.entry[b], value):
            contacts.entry[b + 1] = contacts.entry[b]
            b -= 1
        contacts.entry[b + 1] = value


@ti.func
def count_entries(c, contacts: ti.template()):
    """Contact c is an entry of each of its balls. `number` was 0 before the first."""
    for k in ti.static(range(contacts.balls_per_contact)):
        contacts.number[contacts.ball_of(c, k)] += 1


@ti.func
def enter(c, contacts: ti.template()):
    """Put contact c into the list of each of its balls."""
    for k in ti.static(range(contacts.balls_per_contact)):
        i = contacts.ball_of(c, k)
        place = contacts.first[i] + ti.atomic_add(contacts.number[i], 1)
        contacts.entry[place] = contacts.balls_per_contact * c + k
