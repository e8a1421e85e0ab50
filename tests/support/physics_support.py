"""What the physics tests share: tolerances of the physics notes, the variants of a run, and small builders."""

import os
import warnings

import numpy as np
import pytest

import taichi_sim as ts

PRECISION = os.environ.get("TAICHI_SIM_PRECISION", "f64")  # of this process; Taichi holds one for life
if PRECISION not in ("f32", "f64"):
    raise pytest.UsageError(f"TAICHI_SIM_PRECISION: {PRECISION!r} is not allowed; it must be f32 or f64")
F64 = PRECISION == "f64"
EPS = 2.0**-52 if F64 else 2.0**-23
METHODS = ("explicit_euler", "symplectic_euler", "verlet", "rk4")
DIMS = (2, 3)
# (accumulate, driver); every pair for springs, the two extremes where contacts make kernels slow to compile
VARIANTS = (("ordered", "fused"), ("ordered", "parallel"), ("atomic", "fused"), ("atomic", "parallel"))
EXTREMES = (VARIANTS[0], VARIANTS[3])
GATHERED = ("gather", "parallel")  # as on a device

QUICK_CONTACT = (3, "verlet", VARIANTS[3])  # (dim, method, variant): what `make test` has where contacts are compiled

SLOW_CONTACT = ((2, "verlet"), (2, "symplectic_euler"), (3, "verlet"), (3, "rk4"))


def _how_slow(case):
    if case == QUICK_CONTACT:
        return []
    return [pytest.mark.slow if case[:2] in SLOW_CONTACT and case[2] in EXTREMES else pytest.mark.long]


CONTACT_CASES = [
    pytest.param((d, m, v), id=f"{d}d-{m}-{'-'.join(v)}", marks=_how_slow((d, m, v)))
    for d in DIMS
    for m in METHODS
    for v in ((*VARIANTS, GATHERED) if m == "verlet" else EXTREMES[:1])
]

each_dim = pytest.mark.parametrize("dim", DIMS, ids=["2d", "3d"])
each_extreme = pytest.mark.parametrize("variant", EXTREMES, ids="-".join)


def exact(steps: int) -> float:
    """Relative tolerance of a discrete-exact result after so many steps (physics notes, section 7)."""
    return 1e-10 * max(1.0, steps / 1000) if F64 else 2e-6 * max(1.0, np.sqrt(steps / 100))


def simulate(scene: ts.Scene, variant: tuple[str, str] = VARIANTS[0], **settings) -> ts.Simulation:
    """A simulation in this process's precision; a step above the safe bound is meant (explicit Euler has none)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return ts.Simulation(
            scene, arch="cpu", precision=PRECISION, accumulate=variant[0], driver=variant[1], **settings
        )


def as_stored(a) -> np.ndarray:
    """The values as this precision holds them, in float64: what rounding the input alone does is no error of the method."""
    return np.asarray(a, dtype=np.float64 if F64 else np.float32).astype(np.float64)


def vector(dim: int, *values: float) -> np.ndarray:
    """The first `dim` of the values, filled up with zeros."""
    out = np.zeros(dim)
    out[: min(dim, len(values))] = values[:dim]
    return out


def error(actual, expected, scale=None) -> float:
    """Largest difference in units of the largest expected magnitude (or of `scale`)."""
    actual, expected = np.asarray(actual, dtype=float), np.asarray(expected, dtype=float)
    size = float(np.max(np.abs(expected))) if scale is None else scale
    return float(np.max(np.abs(actual - expected))) / size


def record(sim: ts.Simulation, steps: int, every: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities (k, n, dim) at the start and after each `every` steps."""
    x, v = [sim.position], [sim.velocity]
    for _ in range(steps // every):
        sim.step(every)
        x.append(sim.position)
        v.append(sim.velocity)
    return np.array(x), np.array(v)


def relaxed_pass(contacts, v, w, relaxation: float) -> np.ndarray:
    """One pass from rest impulses, e = 0, by the notes' section 6: lambda = -u min(relaxation / D, 1 / W), D by tensor."""
    n, dim = v.shape
    T = np.zeros((n, dim, dim))
    for c in contacts:
        for i in c.balls:
            T[i] += np.outer(c.normal, c.normal)
    s = np.maximum(np.linalg.eigvalsh(T)[:, -1], 1.0)
    out = v.copy()
    for c in contacts:
        at, g = list(c.balls), np.array(c.g)
        mass = min(relaxation / np.sum(w[at] * g**2 * s[at]), 1.0 / np.sum(w[at] * g**2))
        out[at] += (w[at] * g * max(0.0, -float(c.normal @ (g @ v[at])) * mass))[:, None] * c.normal
    return out


def transfer(method: str, omega: float, zeta: float, h: float) -> np.ndarray:
    """2x2 matrix that takes (x, v) of x'' + 2 zeta omega x' + omega^2 x = 0 through one step of the scheme, in float64."""
    k, c = omega**2, 2 * zeta * omega
    if method == "explicit_euler":
        return np.array([[1.0, h], [-k * h, 1.0 - c * h]])
    if method == "symplectic_euler":
        kick = np.array([[1.0, 0.0], [-k * h, 1.0 - c * h]])
        return np.array([[1.0, h], [0.0, 1.0]]) @ kick
    if method == "verlet":
        left = np.exp(-c * h / 2)
        kick = np.array([[1.0, 0.0], [-k * (-np.expm1(-c * h / 2) / c if c else h / 2), left]])
        return kick @ np.array([[1.0, h], [0.0, 1.0]]) @ kick
    a = h * np.array([[0.0, 1.0], [-k, -c]])
    return np.eye(2) + a @ (np.eye(2) + a @ (np.eye(2) + a @ (np.eye(2) + a / 4) / 3) / 2)


def discrete(method: str, omega: float, zeta: float, h: float, steps, x0: float, v0: float) -> np.ndarray:
    """(k, 2) of x and v after each of `steps` steps: the closed form of the scheme."""
    m = transfer(method, omega, zeta, h)
    return np.array([np.linalg.matrix_power(m, int(n)) @ [x0, v0] for n in np.atleast_1d(steps)])


def observe(scene, method, variant, steps, h=1e-3, **settings):
    """Positions and velocities (k, n, dim) after each of `steps` steps."""
    x, v, done = [], [], 0
    with simulate(scene, variant, integrator=method, dt=h, **settings) as sim:
        for n in steps:
            sim.step(n - done)
            done = n
            x.append(sim.position)
            v.append(sim.velocity)
    return np.array(x), np.array(v)


def box_mesh(size=1.0, centre=0.0):
    """Vertices (8, 3) and triangles (12, 3), counter-clockwise from outside, of a box [m]."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * size + centre
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))])


def add_network(scene, rng, n, damped, unit=1.0):
    """A random net, some of it pinned, masses over two decades; unit [s]: its time scale."""
    x = rng.uniform(-1.0, 1.0, (n, scene.dim))
    b = scene.add_balls(x, radius=1e-3, mass=10.0 ** rng.uniform(-1, 1, n), pinned=rng.uniform(size=n) < 0.15)
    pairs = np.array([(i, j) for i in range(n) for j in range(i) if rng.uniform() < 0.25])
    m = len(pairs)
    k, c = 10.0 ** rng.uniform(1, 3, m), damped * 10.0 ** rng.uniform(-2, 1, m)
    length = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    scene.add_springs(b[pairs], stiffness=k / unit**2, damping=c / unit, rest_length=length * rng.uniform(0.7, 1.3, m))
