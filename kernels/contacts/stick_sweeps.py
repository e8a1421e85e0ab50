"""All contacts of one stick in turn, until what they change is little: a heavy ball on light ends that lie on something takes as
many rounds as it is heavier, and what two iterations leave of it would let it through. Each round is followed by a line search.

Each ball takes part with the mass that it has for this stick, so sticks need not wait for each other.
"""

from taichi_sim.kernels.contacts.line_search import FURTHEST_EXTENSION, best_extension, last_change

from taichi_sim.device.engine import ti

STICK_ROUNDS = 32  # at most
LITTLE_CHANGE = 1e-4  # of the first change of a relative velocity, or of the threshold speed: less is little


@ti.func
def solve(sticks: ti.template(), solver: ti.template(), ball: ti.template(), s, time):
    """Further impulses of all contacts of stick s from the present velocities; viscous friction acts for `time` seconds."""
    one, two = sticks.one[s], sticks.two[s]
    a, b = ball[one].v, ball[two].v
    begin, end = sticks.begin[s], sticks.begin[s] + sticks.length[s]
    for c in range(begin, end):
        sticks.applied_impulse[c] = 0.0 * a
    little, done, going = 0.0 * time, 0, True
    while going:
        most = 0.0 * time
        for c in range(begin, end):
            p, change = one_contact(sticks, solver, ball, c, a, b, ti.select(done == 0, time, 0.0 * time))
            t = sticks.contact[c].at
            a -= (solver.effective_inverse_mass[one] * (1.0 - t)) * p
            b -= (solver.effective_inverse_mass[two] * t) * p
            most = ti.max(most, change)
        if done == 0:
            little = LITTLE_CHANGE * ti.max(most, solver.threshold[0])
        done += 1
        going = end - begin > 1 and most > little and done < STICK_ROUNDS
        if going:
            p, q = extend(sticks, solver, ball, s, a, b)
            a -= solver.effective_inverse_mass[one] * p
            b -= solver.effective_inverse_mass[two] * q


@ti.func
def one_contact(sticks: ti.template(), solver: ti.template(), ball: ti.template(), c, a, b, time):
    """Further impulse of contact c where the ends have the velocities a and b, and what it changes of the relative velocity."""
    applied, inverse = sticks.applied_impulse[c], sticks.inverse_mass(solver, c)
    sticks.contact[c].previous_impulse = sticks.contact[c].impulse
    p = sticks.further_impulse(solver, c, relative_velocity(sticks, solver, ball, c, a, b), inverse, applied, time)
    sticks.applied_impulse[c] = applied + p
    return p, inverse * p.norm()


@ti.func
def relative_velocity(sticks: ti.template(), solver: ti.template(), ball: ti.template(), c, a, b):
    """Velocity of the ball of contact c from the stick where it touches, whose ends have the velocities a and b."""
    i, t = sticks.contact[c].ball, sticks.contact[c].at
    return ball[i].v + solver.effective_inverse_mass[i] * sticks.applied_impulse[c] - (1.0 - t) * a - t * b


@ti.func
def extend(sticks: ti.template(), solver: ti.template(), ball: ti.template(), s, a, b):
    """Go on along the normal impulses of the last round; returns the parts that the ends give."""
    one, two = sticks.one[s], sticks.two[s]
    p, q = 0.0 * a, 0.0 * a
    slope, curvature, longest = 0.0 * a[0], 0.0 * a[0], FURTHEST_EXTENSION + 0.0 * a[0]
    for c in range(sticks.begin[s], sticks.begin[s] + sticks.length[s]):
        contact = sticks.contact[c]
        change, longest = last_change(sticks.contact, c, contact.impulse, longest)
        w, t = solver.effective_inverse_mass[contact.ball], contact.at
        u = relative_velocity(sticks, solver, ball, c, a, b)
        slope += change * (u.dot(contact.normal) - contact.target)
        curvature += w * change * change
        p += ((1.0 - t) * change) * contact.normal
        q += (t * change) * contact.normal
    curvature += solver.effective_inverse_mass[one] * p.dot(p) + solver.effective_inverse_mass[two] * q.dot(q)
    times = best_extension(slope, curvature, longest)
    for c in range(sticks.begin[s], sticks.begin[s] + sticks.length[s]):
        change = times * (sticks.contact[c].impulse - sticks.contact[c].previous_impulse)
        sticks.contact[c].impulse = ti.max(0.0, sticks.contact[c].impulse + change)
        sticks.applied_impulse[c] += change * sticks.contact[c].normal
    return times * p, times * q
