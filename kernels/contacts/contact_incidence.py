"""For each ball, the sorted list of its places in rows of several balls: gathered by ball, sums come out the same whatever the
threads did, and nothing is added by atomics.

`rows` has `used` rows of `places` balls each; `ball_of(entry)`: the ball at entry places * row + place;
`comes_after(entry, other)`: an order of entries that does not depend on where threads put rows. Ball i has the entries
first[i] to first[i] + number[i].
"""

from taichi_sim.device.engine import ti


@ti.func
def list_entries(rows: ti.template()):
    """Make all lists."""
    for i in range(rows.model.n):
        rows.number[i] = 0
    for c in range(ti.min(rows.used[0], rows.capacity)):
        for k in ti.static(range(rows.places)):
            rows.number[rows.ball_of(rows.places * c + k)] += 1
    ti.loop_config(serialize=True)
    for _ in range(1):
        rows.entries[0] = 0
    for i in range(rows.model.n):
        rows.first[i] = ti.atomic_add(rows.entries[0], rows.number[i])
        rows.number[i] = 0
    for c in range(ti.min(rows.used[0], rows.capacity)):
        for k in ti.static(range(rows.places)):
            i = rows.ball_of(rows.places * c + k)
            rows.entry[rows.first[i] + ti.atomic_add(rows.number[i], 1)] = rows.places * c + k
    for i in range(rows.model.n):
        sort(rows, rows.first[i], rows.first[i] + rows.number[i])


@ti.func
def sort(rows: ti.template(), first, last):
    """Insertion sort: lists are short."""
    for a in range(first + 1, last):
        value = rows.entry[a]
        b = a - 1
        while b >= first and rows.comes_after(rows.entry[b], value):
            rows.entry[b + 1] = rows.entry[b]
            b -= 1
        rows.entry[b + 1] = value
