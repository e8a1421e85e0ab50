"""For each ball, the sorted list of its entries in contacts of several balls: gathered by ball, sums come out the same whatever
the threads did, and nothing is added by atomics. The entries of ball i are first[i] to first[i] + number[i]."""

from taichi_sim.device.engine import ti


@ti.func
def list_entries(contacts: ti.template()):
    """Make all lists."""
    for i in range(contacts.model.n):
        contacts.number[i] = 0
    for c in range(ti.min(contacts.used[0], contacts.capacity)):
        for k in ti.static(range(contacts.balls_per_contact)):
            contacts.number[contacts.ball_of(contacts.balls_per_contact * c + k)] += 1
    ti.loop_config(serialize=True)
    for _ in range(1):
        contacts.entries[0] = 0
    for i in range(contacts.model.n):
        contacts.first[i] = ti.atomic_add(contacts.entries[0], contacts.number[i])
        contacts.number[i] = 0
    for c in range(ti.min(contacts.used[0], contacts.capacity)):
        for k in ti.static(range(contacts.balls_per_contact)):
            i = contacts.ball_of(contacts.balls_per_contact * c + k)
            contacts.entry[contacts.first[i] + ti.atomic_add(contacts.number[i], 1)] = (
                contacts.balls_per_contact * c + k
            )
    for i in range(contacts.model.n):
        sort(contacts, contacts.first[i], contacts.first[i] + contacts.number[i])


@ti.func
def sort(contacts: ti.template(), first, last):
    """Insertion sort: lists are short."""
    for a in range(first + 1, last):
        value = contacts.entry[a]
        b = a - 1
        while b >= first and contacts.comes_after(contacts.entry[b], value):
            contacts.entry[b + 1] = contacts.entry[b]
            b -= 1
        contacts.entry[b + 1] = value
