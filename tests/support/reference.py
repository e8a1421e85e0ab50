"""Slow, plain second implementation in NumPy float64, written from the physics notes; sharing no code with the program.

w = 1 / m and is 0 for a pinned ball; every function returns new arrays. Sections are those of the physics notes.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# Closed forms (section 7) -------------------------------------------------------------------------------------------


def free_fall(method: str, x0: ArrayLike, v0: ArrayLike, g: ArrayLike, h: float, steps: int) -> tuple[Array, Array]:
    """x0 + v0 t + g t^2/2 + s g t h/2 and v0 + g t; s = -1 explicit, +1 symplectic or implicit Euler, else 0."""
    x0, v0, g = (np.asarray(a, dtype=np.float64) for a in (x0, v0, g))
    sign = {"explicit_euler": -1.0, "symplectic_euler": 1.0, "implicit_euler": 1.0, "verlet": 0.0, "rk4": 0.0}[method]
    t = steps * h
    return x0 + v0 * t + g * t * t / 2 + sign * g * t * h / 2, v0 + g * t


def discrete_frequency(omega: float, h: float) -> float:
    """(2/h) asin(omega h / 2): what symplectic Euler and Verlet oscillate at (section 7, pair spring) [1/s]."""
    return 2.0 / h * float(np.arcsin(omega * h / 2.0))


def rk4_amplification(y: float) -> complex:
    """R = 1 + z + z^2/2 + z^3/6 + z^4/24 for z = i y, y = omega h; |R|^2 = 1 - y^6/72 + y^8/576."""
    z = 1j * y
    return 1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24


def damped_oscillator(t: ArrayLike, omega: float, zeta: float, x0: float, v0: float) -> tuple[Array, Array]:
    """Position and velocity of x'' + 2 zeta omega x' + omega^2 x = 0 at times t."""
    t = np.asarray(t, dtype=np.float64)
    b = zeta * omega
    if zeta == 1.0:
        decay, slope = np.exp(-b * t), v0 + b * x0
        return decay * (x0 + slope * t), decay * (v0 - b * slope * t)
    if zeta < 1.0:
        q = omega * np.sqrt(1.0 - zeta * zeta)
        decay, c, s = np.exp(-b * t), np.cos(q * t), np.sin(q * t) / q
        return decay * (x0 * c + (v0 + b * x0) * s), decay * (v0 * c - (b * v0 + omega**2 * x0) * s)
    q = omega * np.sqrt(zeta * zeta - 1.0)
    slow, fast = -(omega**2) / (b + q), -(b + q)  # the two roots; their product is omega^2, so nothing cancels
    a = (v0 - fast * x0) / (slow - fast)
    es, ef = np.exp(slow * t), np.exp(fast * t)
    return a * es + (x0 - a) * ef, slow * a * es + fast * (x0 - a) * ef


def modified_energy(method: str, x: ArrayLike, v: ArrayLike, omega: float, h: float) -> Array:
    """Constant per step: v^2 + w^2 x^2 - h w^2 x v (symplectic Euler), v^2 + w^2 x^2 (1 - w^2 h^2/4) (Verlet)."""
    x, v = np.asarray(x, dtype=np.float64), np.asarray(v, dtype=np.float64)
    cross = {"symplectic_euler": -h * omega**2 * x * v, "verlet": -(omega**4) * h * h / 4 * x * x}[method]
    return v * v + omega**2 * x * x + cross


def rotating_pair_length(rest: float, mu: float, angular_speed: float, k: float) -> float:
    """d = l / (1 - mu W^2 / k), mu = 1 / (w1 + w2): a pair turning steadily at W [1/s]."""
    return rest / (1.0 - mu * angular_speed**2 / k)


def chain_stretch(m: float, g: float, n: int, k: float) -> float:
    """m g N (N + 1) / (2 k): how much a chain of N balls on N springs, hung at its top, is longer at rest [m]."""
    return m * g * n * (n + 1) / (2 * k)


def chain_mode(k: float, m: float, n: int, p: int) -> float:
    """2 sqrt(k/m) sin(p pi / (2 (N + 1))), p = 1..N: longitudinal modes of N balls between two walls [1/s]."""
    return float(2 * np.sqrt(k / m) * np.sin(p * np.pi / (2 * (n + 1))))


def bounces(h0: float, g: float, e: float, n: int) -> tuple[float, float]:
    """Height e^(2 n) h0 after the n-th bounce [m], and the time of rest sqrt(2 h0 / g) (1 + e) / (1 - e), e < 1 [s]."""
    return h0 * e ** (2 * n), float(np.sqrt(2 * h0 / g) * (1 + e) / (1 - e)) if e < 1 else float("inf")


def two_body_collision(m1: float, m2: float, v1: Array, v2: Array, n: Array, e: float) -> tuple[Array, Array]:
    """Velocities after: momentum kept, u = n . (v2 - v1) becomes -e u; n from 1 to 2, nothing when they separate."""
    u = float(n @ (v2 - v1))
    if u >= 0:
        return v1.copy(), v2.copy()
    return v1 + (1 + e) * u * m2 / (m1 + m2) * n, v2 - (1 + e) * u * m1 / (m1 + m2) * n


def viscous_slide(v0: float, f: float, t: float) -> tuple[float, float]:
    """Speed v0 exp(-f t) and distance v0 (1 - exp(-f t)) / f."""
    return float(v0 * np.exp(-f * t)), float(-v0 * np.expm1(-f * t) / f)


def coulomb_stop_distance(v0: float, mu: float, g: float) -> float:
    """v0^2 / (2 mu g) [m]."""
    return v0 * v0 / (2 * mu * g)


# A spring network (section 5) ---------------------------------------------------------------------------------------


class Network(NamedTuple):
    """n balls, m springs, no contacts."""

    w: Array  # (n,) 1/kg; 0: pinned
    pairs: NDArray[np.int_]  # (m, 2)
    k: Array  # (m,) N/m
    c: Array  # (m,) N s/m
    rest: Array  # (m,) m
    gravity: Array  # (dim,) m/s^2


def network(w: ArrayLike, pairs: ArrayLike, k: ArrayLike, c: ArrayLike, rest: ArrayLike, gravity: ArrayLike) -> Network:
    """A Network from lists; k, c, rest: one, or one per spring."""
    ij = np.asarray(pairs, dtype=np.int64).reshape(-1, 2)
    ks, cs, ls = (np.broadcast_to(np.asarray(a, dtype=np.float64), (len(ij),)).copy() for a in (k, c, rest))
    return Network(np.asarray(w, dtype=np.float64), ij, ks, cs, ls, np.asarray(gravity, dtype=np.float64))


def direction(x: Array, i: int, j: int) -> tuple[Array, float]:
    """Unit vector from ball i to ball j and the distance; coincident: the first axis, its sign by the order of i, j."""
    r = x[j] - x[i]
    d = float(np.sqrt(r @ r))
    if d > 0.0:
        return r / d, d
    n = np.zeros(x.shape[1])
    n[0] = 1.0 if i < j else -1.0
    return n, 0.0


def spring_forces(x: Array, v: Array, pairs: ArrayLike, k: ArrayLike, c: ArrayLike, rest: ArrayLike) -> Array:
    """(n, dim) N: k (d - l) n + c (n . (v_j - v_i)) n on ball i, the opposite on j (section 1)."""
    force = np.zeros_like(x)
    net = network(np.ones(len(x)), pairs, k, c, rest, np.zeros(x.shape[1]))
    for (i, j), ke, ce, le in zip(net.pairs, net.k, net.c, net.rest):
        n, d = direction(x, i, j)
        f = (ke * (d - le) + ce * float(n @ (v[j] - v[i]))) * n
        force[i] += f
        force[j] -= f
    return force


def acceleration(net: Network, x: Array, v: Array, damping: bool = True) -> Array:
    """w F + g; pinned balls 0."""
    force = spring_forces(x, v, net.pairs, net.k, net.c if damping else 0.0 * net.c, net.rest)
    return net.w[:, None] * force + net.gravity * (net.w > 0)[:, None]


def damped_kick(net: Network, x: Array, v: Array, tau: float) -> Array:
    """v after tau of dv/dt = W (F - D v), x and F held, D the damping, exact: in eigenvectors of W^1/2 D W^1/2."""
    n, dim = x.shape
    root = np.repeat(np.sqrt(net.w), dim)
    D = np.zeros((n * dim, n * dim))
    for (i, j), c in zip(net.pairs, net.c):
        e = np.zeros((n, dim))
        e[i], e[j] = -direction(x, i, j)[0], direction(x, i, j)[0]
        D += c * np.outer(e, e)
    z, q = np.linalg.eigh(tau * D * np.outer(root, root))
    moving = root > 0  # in y = v / root; what is pinned acts through D on the others
    y = np.divide(v.ravel(), root, out=np.zeros(n * dim), where=moving)
    held = np.where(moving, 0.0, v.ravel())
    pull = np.divide(acceleration(net, x, v, damping=False).ravel(), root, out=np.zeros(n * dim), where=moving)
    pull -= root * (D @ held)
    part = np.where(z > 1e-9, -np.expm1(-z) / np.where(z > 1e-9, z, 1.0), 1.0)
    after = q @ (np.exp(-z) * (q.T @ y) + tau * part * (q.T @ pull))
    return np.where(moving, root * after, held).reshape(n, dim)


def step_explicit_euler(net: Network, x: Array, v: Array, h: float) -> tuple[Array, Array]:
    """x + h v, v + h a(x, v)."""
    return x + h * v, v + h * acceleration(net, x, v)


def step_symplectic_euler(net: Network, x: Array, v: Array, h: float) -> tuple[Array, Array]:
    """v' = v + h a(x, v), x' = x + h v'."""
    v = v + h * acceleration(net, x, v)
    return x + h * v, v


def step_verlet(net: Network, x: Array, v: Array, h: float) -> tuple[Array, Array]:
    """B(h/2) A(h) B(h/2): half of the kick and the damping, exact, the drift, the other half."""
    x = x + h * (v := damped_kick(net, x, v, h / 2))
    return x, damped_kick(net, x, v, h / 2)


def step_rk4(net: Network, x: Array, v: Array, h: float) -> tuple[Array, Array]:
    """The classical Runge-Kutta method on (x, v)."""
    a1 = acceleration(net, x, v)
    v2 = v + h / 2 * a1
    a2 = acceleration(net, x + h / 2 * v, v2)
    v3 = v + h / 2 * a2
    a3 = acceleration(net, x + h / 2 * v2, v3)
    v4 = v + h * a3
    a4 = acceleration(net, x + h * v3, v4)
    return x + h / 6 * (v + 2 * v2 + 2 * v3 + v4), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)


STEPS: dict[str, Callable[[Network, Array, Array, float], tuple[Array, Array]]] = {
    "explicit_euler": step_explicit_euler,
    "symplectic_euler": step_symplectic_euler,
    "verlet": step_verlet,
    "rk4": step_rk4,
}


def run(method: str, net: Network, x: ArrayLike, v: ArrayLike, h: float, steps: int) -> tuple[Array, Array]:
    """`steps` steps of h."""
    x, v = np.array(x, dtype=np.float64), np.array(v, dtype=np.float64)
    for _ in range(steps):
        x, v = STEPS[method](net, x, v, h)
    return x, v


def energy(net: Network, x: Array, v: Array) -> tuple[float, float, float]:
    """Kinetic, spring and gravity energy [J]; pinned balls count in none, gravity is 0 at the origin."""
    free = net.w > 0
    m = 1.0 / net.w[free]
    d = np.array([direction(x, i, j)[1] for i, j in net.pairs])
    kinetic = 0.5 * float(np.sum(m[:, None] * v[free] ** 2))
    return kinetic, 0.5 * float(np.sum(net.k * (d - net.rest) ** 2)), -float(np.sum(m * (x[free] @ net.gravity)))


def angular_momentum(mass: ArrayLike, x: Array, v: Array) -> Array:
    """sum m x cross v about the origin: a scalar in 2D, a vector in 3D."""
    if x.shape[1] == 2:
        return np.asarray(mass) @ (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0])
    return np.asarray(mass) @ np.cross(x, v)


# Contacts (sections 4 and 6) ----------------------------------------------------------------------------------------


class Contact(NamedTuple):
    """Weights g on the balls it touches, the unit normal and the depth of the overlap [m]."""

    balls: tuple[int, ...]
    g: tuple[float, ...]
    normal: Array
    depth: float


def contact_impulse(g: ArrayLike, w: ArrayLike, v: ArrayLike, n: ArrayLike, e: float) -> tuple[Array, float]:
    """Velocities after and lambda = max(0, -(1 + e) u / W), u = n . sum g v, W = sum w g^2, v_i += w_i g_i lambda n."""
    g, w, v, n = (np.asarray(a, dtype=np.float64) for a in (g, w, v, n))
    W = float(np.sum(w * g * g))
    if W == 0.0:
        return v.copy(), 0.0
    lam = max(0.0, -(1 + e) * float(n @ (g @ v)) / W)
    return v + (w * g * lam)[:, None] * n, lam


def contact_offset(g: ArrayLike, w: ArrayLike, n: ArrayLike, depth: float) -> Array:
    """w_i g_i (depth / W) n for each ball: what removes the overlap and keeps the centre of mass."""
    g, w, n = (np.asarray(a, dtype=np.float64) for a in (g, w, n))
    W = float(np.sum(w * g * g))
    return (w * g * (depth / W if W > 0 else 0.0))[:, None] * n


def closest_on_segment(p: Array, a: Array, b: Array) -> tuple[float, Array]:
    """t in [0, 1] and the point (1 - t) a + t b of the segment nearest to p."""
    r = b - a
    t = float(np.clip((p - a) @ r / (r @ r), 0.0, 1.0)) if r @ r > 0 else 0.0
    return t, (1 - t) * a + t * b


def ball_contacts(x: Array, radius: Array, joined: Iterable[Sequence[int]] = ()) -> list[Contact]:
    """All overlapping pairs i < j by brute force, normal from i to j; pairs joined by a spring do not collide."""
    skip = {(min(p), max(p)) for p in joined}
    found = []
    for i in range(len(x)):
        for j in range(i + 1, len(x)):
            n, d = direction(x, i, j)
            depth = radius[i] + radius[j] - d
            if depth > 0 and (i, j) not in skip:
                found.append(Contact((i, j), (-1.0, 1.0), n, float(depth)))
    return found


def stick_contacts(x: Array, radius: Array, sticks: Iterable[Sequence[int]]) -> list[Contact]:
    """All balls against all sticks (a, b) but the ends' own, normal from the stick to the ball.

    Only 0 < t < 1: an end hit is the ball-ball contact with the end ball, so it counts once, not once per stick.
    A ball exactly on the stick takes the axis least along it, made perpendicular.
    """
    found = []
    for a, b in sticks:
        for i in range(len(x)):
            t, q = closest_on_segment(x[i], x[a], x[b])
            d = float(np.linalg.norm(x[i] - q))
            if i in (a, b) or not 0.0 < t < 1.0 or d >= radius[i]:
                continue
            along, _ = direction(x, a, b)
            away = np.eye(x.shape[1])[int(np.argmin(np.abs(along)))]
            away = away - (away @ along) * along
            n = (x[i] - q) / d if d > 0 else away / np.linalg.norm(away)
            found.append(Contact((i, int(a), int(b)), (1.0, -(1 - t), -t), n, float(radius[i] - d)))
    return found


def wall_contacts(x: Array, radius: Array, walls: Iterable[tuple[ArrayLike, float]]) -> list[Contact]:
    """Balls with normal . x - offset < radius; walls are (unit normal, offset)."""
    found = []
    for normal, offset in walls:
        n = np.asarray(normal, dtype=np.float64)
        for i in range(len(x)):
            depth = radius[i] - (float(n @ x[i]) - offset)
            if depth > 0:
                found.append(Contact((i,), (1.0,), n, depth))
    return found


def contact_pass(contacts: Sequence[Contact], v: Array, w: Array, e: float, split: str = "count") -> Array:
    """One accumulate-then-apply pass; lambda = max(0, -(1 + e) u / D), D = sum w g^2 s (section 6).

    s of a ball: "none" 1 (the article's sum, wrong), "count" its contacts, "tensor" lambda_max of its sum of n n^T.
    """
    n, dim = v.shape
    count, tensor = np.zeros(n), np.zeros((n, dim, dim))
    for contact in contacts:
        for i in contact.balls:
            count[i] += 1
            tensor[i] += np.outer(contact.normal, contact.normal)
    s = {"none": np.ones(n), "count": count, "tensor": np.maximum(np.linalg.eigvalsh(tensor)[:, -1], 1.0)}[split]
    dv = np.zeros_like(v)
    for contact in contacts:
        at, g = list(contact.balls), np.array(contact.g)
        D = float(np.sum(w[at] * g * g * s[at]))
        if D > 0:
            lam = max(0.0, -(1 + e) * float(contact.normal @ (g @ v[at])) / D)
            dv[at] += (w[at] * g * lam)[:, None] * contact.normal
    return v + dv


# The article's rules that are wrong (section 3, left column): each must fail where the right one passes -------------


def wrong_drift(q: Array, h: float) -> Array:
    """q + q h, the slip in the article's first update."""
    return q + q * h


def wrong_ball_ball(v1: Array, v2: Array, n: Array, e: float, fh: float) -> tuple[Array, Array]:
    """v_t = v - v_n with the ball's own v: two balls that move sideways together are pulled apart by friction."""
    vn = n * (n @ (v2 - v1))
    vt = v2 - vn
    return v1 + vn * (1 + e) / 2 + fh * vt / 2, v2 - vn * (1 + e) / 2 - fh * vt / 2


def wrong_equal_halves(v1: Array, v2: Array, n: Array, e: float) -> tuple[Array, Array]:
    """Half of the velocity change each, whatever the masses: momentum is lost."""
    half = n * (n @ (v2 - v1)) * (1 + e) / 2
    return v1 + half, v2 - half


def wrong_stick(v: Array, t: float, n: Array, e: float) -> Array:
    """2/3, (1 - t)/3, t/3 of j on rows (ball, end 2, end 3): the momentum of unit masses changes by j/3."""
    j = -(1 + e) * (n @ (v[0] - (1 - t) * v[1] - t * v[2])) * n
    return v + np.outer([2 / 3, -(1 - t) / 3, -t / 3], j)


def wrong_stick_distance(p: Array, a: Array, b: Array) -> float:
    """2D distance to the infinite line through a and b: hits far beyond the ends."""
    r = (b - a) / np.linalg.norm(b - a)
    return float(abs(r[1] * (p - a)[0] - r[0] * (p - a)[1]))


def wrong_decay(u: Array, rate: float, h: float) -> Array:
    """u (1 - rate h), for friction f and damping C alike: reverses when rate h > 1, grows when rate h > 2."""
    return u * (1 - rate * h)


def wrong_resting_step(y: float, v: float, g: float, h: float, e: float) -> tuple[float, float]:
    """Floor at y = 0: the test sees the old y and v, gravity comes after it, so a resting ball never has speed 0."""
    dv = g * -h + (-(1 + e) * v if y <= 0 and v < 0 else 0.0)
    return y + h * (v + dv), v + dv


def wrong_push_out(y: float) -> float:
    """The full depth at once, into the true position: the energy rises by m g depth."""
    return max(y, 0.0)


def wrong_bounce_step(y: float, v: float, g: float, h: float, e: float) -> tuple[float, float]:
    """Symplectic Euler, reflected at the end of the step in which y < 0: an energy error of order h at each bounce."""
    y, v = y + h * (v - g * h), v - g * h
    return y, -e * v if y < 0 and v < 0 else v


def wrong_direction(x1: Array, x2: Array) -> Array:
    """r / |r| without care: 0/0 for coincident balls."""
    r = x2 - x1
    return r / np.sqrt(r @ r)
