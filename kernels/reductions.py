"""Work in parts of a fixed size, in an order that does not depend on threads, so that sums have the same bits for any number of
them; and sums over balls so, in double precision where the device has it."""

from taichi_sim.device.engine import on_device, ti

GRAIN = 32  # Taichi hands loop indices to CPU threads in runs of at least this many: one run holds one part
BAD, SPEED, KINETIC, ELASTIC, GRAVITY, WEIGHT, LIFT, SIZE = range(8)  # members of a row


LONG_PART = 1024  # terms that one thread sums, where one thread then adds up all parts


def part_size() -> int:
    """Number of terms that one thread sums, where parts are joined in groups first: fewer on a device, which has thousands of
    threads."""
    return 64 if on_device() else LONG_PART


def parts_of(number: int) -> int:
    """Number of parts in which `number` balls are summed."""
    return -(-number // part_size())


def groups_of(parts: int) -> int:
    """Number of groups in which a device sums the sums of so many parts before one thread adds up the rest; 0 on a CPU."""
    return parts_of(parts) if on_device() else 0


@ti.func
def each_part(count: ti.template(), visit: ti.template(), arguments: ti.template()):
    """visit(part, *arguments) for each part below `count`, on any thread."""
    grain = ti.static(1 if on_device() else GRAIN)
    for k in range(count * grain):
        if k % grain == 0:
            visit(k // grain, *arguments)


@ti.func
def members(c, parts: ti.template(), n):
    """Number of n balls that part c of `parts` has. On a CPU `parts` is parts_of(n)."""
    number = ti.min(LONG_PART, n - c * LONG_PART)
    if ti.static(on_device()):
        number = (n - c + parts - 1) // parts
    return number


@ti.func
def member(c, k, parts: ti.template()):
    """Ball k of part c of `parts`. On a CPU those of a part lie one behind the other. On a device those of one k do, for
    neighbouring threads to read neighbouring memory at the same time."""
    i = c * LONG_PART + k
    if ti.static(on_device()):
        i = c + k * parts
    return i


@ti.func
def even_then_odd(count: ti.template(), visit: ti.template(), arguments: ti.template()):
    """visit(part, *arguments) for parts of which one writes to itself and the next: those with even numbers, then the others."""
    by_parity(count, visit, arguments, (0, 1))


@ti.func
def odd_then_even(count: ti.template(), visit: ti.template(), arguments: ti.template()):
    """visit(part, *arguments) as even_then_odd does, in the other order."""
    by_parity(count, visit, arguments, (1, 0))


@ti.func
def by_parity(count: ti.template(), visit: ti.template(), arguments: ti.template(), parities: ti.template()):
    """Loop over parts of each parity. At the top level of a kernel only an unrolled loop leaves the inner ones parallel."""
    grain = ti.static(1 if on_device() else GRAIN)
    for parity in ti.static(parities):
        for k in range((count + 1 - parity) // 2 * grain):
            if k % grain == 0:
                visit(k // grain * 2 + parity, *arguments)


@ti.func
def join(columns: ti.template(), parts: ti.template()):
    """Sum each of some columns of `parts` numbers by groups, where there are any; each has room for them behind its parts."""
    groups, size = ti.static(groups_of(parts), part_size())
    if ti.static(groups > 0):
        for g in range(groups):
            for column in ti.static(columns):
                total = column[g * size]
                for c in range(g * size + 1, ti.min((g + 1) * size, parts)):
                    total += column[c]
                column[parts + g] = total


@ti.func
def total(column: ti.template(), parts: ti.template()):
    """The sum of a column that is joined, for one thread: of its parts in their order, or of its groups."""
    groups = ti.static(groups_of(parts))
    first, last = ti.static((0, parts) if groups == 0 else (parts, parts + groups))
    sum = column[first]
    for c in range(first + 1, last):
        sum += column[c]
    return sum


@ti.func
def good(ball, far):
    """True if x and v are numbers below `far`. One by one: a comparison with nan is false, and a maximum may drop it."""
    fine = True
    for a in ti.static(range(ball.x.n)):
        fine = fine and ti.abs(ball.x[a]) < far and ti.abs(ball.v[a]) < far
    return fine
