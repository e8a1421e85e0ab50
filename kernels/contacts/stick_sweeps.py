"""All contacts of one stick in turn, until what they change is little: a heavy ball on light ends that lie on something takes as
many rounds as it is heavier, and what two passes leave of it would let it through.

What rounds lessen is the kinetic energy less the work of the target speeds, a parabola along the change that a round made: so
each goes on along it to the least, as far as no contact would pull (see kernels.settle). Each ball takes part with the mass that
it has for this stick, so sticks need not wait for each other.
"""

from taichi_sim.kernels.contacts import contact_law
from taichi_sim.kernels.contacts.wall_impacts import SPENT
from taichi_sim.kernels.vectors import cross, lever

from taichi_sim.device.engine import ti

ROUNDS = 32  # at most
NEAR = 1e-4  # of the first change of a relative velocity, or of the speed below which nothing bounces: less is little
FAR = 1e6  # times the change of a round: nothing goes further along it
TINY = 1e-30  # J


@ti.func
def solve(sticks: ti.template(), solver: ti.template(), ball: ti.template(), s, time):
    """Further impulses of all rows of stick s from the present velocities; viscous friction acts for `time` seconds."""
    one, two = sticks.one[s], sticks.two[s]
    a, b = ball[one].v, ball[two].v
    begin, end = sticks.begin[s], sticks.begin[s] + sticks.length[s]
    for c in range(begin, end):
        sticks.push[c] = 0.0 * a
    little, done, going = 0.0 * time, 0, True
    while going:
        most = 0.0 * time
        for c in range(begin, end):
            p, change = one_row(sticks, solver, ball, c, a, b, ti.select(done == 0, time, 0.0 * time))
            t = sticks.row[c].at
            a -= (solver.lightness[one] * (1.0 - t)) * p
            b -= (solver.lightness[two] * t) * p
            most = ti.max(most, change)
        if done == 0:
            little = NEAR * ti.max(most, solver.threshold[0])
        done += 1
        going = end - begin > 1 and most > little and done < ROUNDS
        if going:
            p, q = extend(sticks, solver, ball, s, a, b)
            a -= solver.lightness[one] * p
            b -= solver.lightness[two] * q


@ti.func
def one_row(sticks: ti.template(), solver: ti.template(), ball: ti.template(), c, a, b, time):
    """Further impulse of row c where the ends have the velocities a and b, and what it changes of the relative velocity."""
    row = sticks.row[c]
    n, t, w = row.normal, row.at, solver.lightness[row.ball]
    u = ball[row.ball].v + w * sticks.push[c] - (1.0 - t) * a - t * b
    inverse = sticks.inverse_mass(solver, row)
    mass = 1.0 / inverse
    total = contact_law.normal_impulse(u.dot(n), row.target, mass, row.impulse)
    p = (total - row.impulse) * n
    sticks.row[c].noted = row.impulse
    sticks.row[c].impulse = total
    if ti.static(sticks.model.has_friction):
        law = sticks.law(row)
        slip = contact_law.viscous_share(sticks.model, law, total, mass, solver.threshold[0], u, time)
        if ti.static(solver.spins):
            rolling = sticks.model.spin_response(row.ball) * w
            u -= lever(solver.state.spin[row.ball] - rolling * cross(n, sticks.push[c]), n)
            mass = 1.0 / (inverse + rolling)
        change, slide = contact_law.sliding_impulse(sticks.model, u, n, mass, row.slide, law.friction * total, slip)
        sticks.row[c].slide = slide
        p += change
    sticks.push[c] += p
    return p, inverse * p.norm()


@ti.func
def extend(sticks: ti.template(), solver: ti.template(), ball: ti.template(), s, a, b):
    """Go on along the normal impulses of the last round; returns the parts that the ends give."""
    one, two = sticks.one[s], sticks.two[s]
    p, q = 0.0 * a, 0.0 * a
    slope, bend, far = 0.0 * a[0], 0.0 * a[0], FAR + 0.0 * a[0]
    for c in range(sticks.begin[s], sticks.begin[s] + sticks.length[s]):
        row = sticks.row[c]
        change = row.impulse - row.noted
        if row.impulse < -SPENT * change:  # it is about to let go, and stays out lest it stops the others
            sticks.row[c].noted = row.impulse
            change = 0.0
        w, t = solver.lightness[row.ball], row.at
        u = ball[row.ball].v + w * sticks.push[c] - (1.0 - t) * a - t * b
        slope += change * (u.dot(row.normal) - row.target)
        bend += w * change * change
        p += ((1.0 - t) * change) * row.normal
        q += (t * change) * row.normal
        if change < 0.0:
            far = ti.min(far, row.impulse / -change)
    bend += solver.lightness[one] * p.dot(p) + solver.lightness[two] * q.dot(q)
    times = ti.max(0.0, ti.min(-slope / ti.max(bend, TINY), far))
    for c in range(sticks.begin[s], sticks.begin[s] + sticks.length[s]):
        change = times * (sticks.row[c].impulse - sticks.row[c].noted)
        sticks.row[c].impulse = ti.max(0.0, sticks.row[c].impulse + change)
        sticks.push[c] += change * sticks.row[c].normal
    return times * p, times * q
