"""The stiff methods once more, slow and plain, in NumPy float64, with dense matrices; no contacts."""

import numpy as np
import reference as ref

Array = np.ndarray
ROUNDS = 200  # of Newton's method; its matrix leaves out the negative geometric stiffness, so it converges linearly


def damping_forces(net: ref.Network, x: Array, v: Array, s: float, e: Array) -> Array:
    """(n, dim) N: c (d^2 / 2 - e) / (s d) n on ball i, the opposite on j; e (m,) m^2: d^2 / 2 where the stage starts. No
    further from c u . n than half of c |u|."""
    force = np.zeros_like(x)
    for (i, j), c, start in zip(net.pairs, net.c, e):
        n, d = ref.direction(x, i, j)
        u = v[j] - v[i]
        bound = 0.5 * np.linalg.norm(u)
        rate = np.clip((0.5 * d * d - start) / (s * d), n @ u - bound, n @ u + bound)
        force[i] += c * rate * n
        force[j] -= c * rate * n
    return force


def squares(net: ref.Network, x: Array) -> Array:
    """(m,) d^2 / 2 of each spring."""
    return np.array([0.5 * float((x[j] - x[i]) @ (x[j] - x[i])) for i, j in net.pairs])


def square_rates(net: ref.Network, x: Array, v: Array) -> Array:
    """(m,) rate of d^2 / 2."""
    return np.array([float((x[j] - x[i]) @ (v[j] - v[i])) for i, j in net.pairs])


def solve_stage(net: ref.Network, p: Array, q: Array, v: Array, s: float, e: Array) -> Array:
    """v with v = q + s w F(p + s v, v), from the guess v; e as in damping_forces."""
    dim = p.shape[1]
    free = np.repeat(net.w > 0, dim)
    m = np.repeat(1.0 / np.where(net.w > 0, net.w, 1.0), dim)
    v = v.copy()
    for _ in range(ROUNDS):
        x = p + s * v
        force = ref.spring_forces(x, v, net.pairs, net.k, 0.0 * net.c, net.rest) + damping_forces(net, x, v, s, e)
        r = m * (q - v).ravel() + s * force.ravel()
        r[~free] = 0.0
        A = np.diag(m)
        for (i, j), k, c, rest in zip(net.pairs, net.k, net.c, net.rest):
            u, d = ref.direction(x, i, j)
            along = np.outer(u, u)
            geometric = max(0.0, 1.0 - rest / d) if d > 0 else float(rest == 0.0)
            block = s * c * along + s * s * k * (along + geometric * (np.eye(dim) - along))
            for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
                A[dim * a : dim * a + dim, dim * b : dim * b + dim] += sign * block
        A[~free] = 0.0
        A[~free, ~free] = 1.0
        dv = np.linalg.solve(A, r)
        v += dv.reshape(v.shape)
        if np.max(np.abs(dv)) < 1e-15 * max(1.0, np.max(np.abs(v))):
            break
    return v


def implicit_euler(net: ref.Network, x: Array, v: Array, h: float, steps: int) -> tuple[Array, Array]:
    """x + h v', v' = v + h a(x + h v', v')."""
    push = h * net.gravity * (net.w > 0)[:, None]
    for _ in range(steps):
        v = solve_stage(net, x, v + push, v, h, squares(net, x))
        x = x + h * v
    return x, v


def tr_bdf2(net: ref.Network, x: Array, v: Array, h: float, steps: int) -> tuple[Array, Array]:
    """Trapezoidal rule to g h, then BDF2 to h, g = 2 - sqrt 2; the first slope by implicit Euler over g h / 2."""
    g = 2.0 - np.sqrt(2.0)
    s, c = 0.5 * g * h, 1.0 / (g * (2.0 - g))
    push = net.gravity * (net.w > 0)[:, None]
    q = v + s * push
    slope = (solve_stage(net, x, q, v, s, squares(net, x)) - q) / s
    for _ in range(steps):
        e = squares(net, x) + s * square_rates(net, x, v)
        middle = solve_stage(net, x + s * v, v + s * slope + g * h * push, v, s, e)
        x_middle = x + s * (v + middle)
        p = c * x_middle + (1.0 - c) * x
        q = c * middle + (1.0 - c) * v + s * push
        e = c * squares(net, x_middle) + (1.0 - c) * squares(net, x)
        v = solve_stage(net, p, q, middle, s, e)
        x = p + s * v
        slope = (v - q) / s
    return x, v


def xpbd(net: ref.Network, x: Array, v: Array, h: float, steps: int) -> tuple[Array, Array]:
    """XPBD in positions: half of each spring in turn, ordered by its lower ball, then the other one, and again in reverse.

    Predict y = x + h v; for each spring C = |y_j - y_i| - l, with compliance 1 / k and damping as Macklin et al. (2016, eq. 26)
    have it, beta = c / k^2: lambda = -(C + gamma n.(y_j - x_j - y_i + x_i)) / ((1 + gamma) W + a), a = 1 / (k h^2),
    gamma = a beta k^2 h ... = c / (k h), and y_i -= w_i lambda n, y_j += w_j lambda n; n along x_j - x_i where C < 0, else along
    y_j - y_i. In the end v = (y - x) / h.
    """
    order = np.lexsort((net.pairs.max(axis=1), net.pairs.min(axis=1)))
    for _ in range(steps):
        y = x + h * (v + h * net.gravity * (net.w > 0)[:, None])
        for e in (*order, *order[::-1]):
            i, j = net.pairs[e]
            n, d = ref.direction(y, i, j)
            if d < net.rest[e]:
                n, _ = ref.direction(x, i, j)
            a, gamma = 2.0 / (net.k[e] * h * h), net.c[e] / (net.k[e] * h)
            moved = n @ ((y[j] - x[j]) - (y[i] - x[i]))
            lam = -(d - net.rest[e] + gamma * moved) / ((1.0 + gamma) * (net.w[i] + net.w[j]) + a)
            y[i] -= net.w[i] * lam * n
            y[j] += net.w[j] * lam * n
        x, v = y, (y - x) / h
    return x, v


RUN = {"xpbd": xpbd, "implicit_euler": implicit_euler, "tr_bdf2": tr_bdf2}
