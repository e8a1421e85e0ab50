"""Springs against continuum mechanics: catenary, dispersion, moduli of lattices, cantilever.

Statics are found by implicit Euler at steps much longer than any period, which damp all motion.
"""

from typing import NamedTuple

import numpy as np
import pytest
import taichi as ti
from physics_support import F64, simulate

import taichi_sim as ts
from taichi_sim.integrators import ImplicitEuler

pytestmark = pytest.mark.skipif(
    not F64, reason="at such steps the rounding of a velocity in single precision moves a ball"
)

SMALL = 1e-6  # strain, and sag by length: the error of linear theory, far above rounding


def settled(scene, dt, steps, forces=()):
    """Positions (n, dim) at rest."""
    with simulate(scene, integrator=ImplicitEuler(tolerance=1e-9), dt=dt, contacts="off", forces=forces) as sim:
        sim.step(steps)
        assert np.max(np.abs(sim.velocity)) * dt < 1e-3 * np.max(np.abs(sim.position - scene.position)), "not at rest"
        return sim.position


# Chains ---------------------------------------------------------------------------------------------------------------


def elastic_catenary(span, length, weight, strength, s):
    """(k, 2) m: where what lies s along the slack chain hangs, between supports at equal height.

    weight [N/m] of the slack chain, strength EA [N]. With the pull H along and V = weight length / 2 up at a support:
    x = H s / EA + H / w (asinh(V / H) - asinh((V - w s) / H)), y likewise with the roots of 1 + (...)^2. H by bisection.
    """
    up = weight * length / 2

    def at(pull, s):
        a, b = up / pull, (up - weight * s) / pull
        x = pull * s / strength + pull / weight * (np.arcsinh(a) - np.arcsinh(b))
        y = -s * (up - weight * s / 2) / strength + pull / weight * (np.sqrt(1 + b**2) - np.sqrt(1 + a**2))
        return np.stack([x, y], axis=-1)

    low, high = 1e-6 * up, 1e6 * up
    for _ in range(200):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if at(middle, length)[0] < span else (low, middle)
    return at(middle, s)


def test_hanging_chain_is_an_elastic_catenary():
    """A chain of n springs, each end of each with half of its mass: off by n^-2. It stretches by a tenth."""
    span, length, weight, strength = 1.0, 1.2, 3.0, 15.0
    scene, chains = ts.Scene(dim=2, gravity=(0, -10)), []
    for n in (12, 24, 48):
        s = np.linspace(0.0, length, n + 1)
        start = np.stack([s * span / length, -0.3 * np.sin(np.pi * s / length)], axis=1)
        b = scene.add_balls(start, radius=1e-3, mass=weight / 10.0 * length / n, pinned=[0, n])
        joint = np.stack([b[:-1], b[1:]], axis=1)
        scene.add_springs(joint, stiffness=strength * n / length, rest_length=length / n)
        chains.append((b, elastic_catenary(span, length, weight, strength, s)))
    x = settled(scene, 5.0, 40)
    off = [np.max(np.abs(x[b] - exact)) / -exact[:, 1].min() for b, exact in chains]
    print(f"catenary: off by {np.round(off, 6)} of its sag")
    assert off[2] < 1e-3
    assert np.all(np.abs(np.log2(np.divide(off[:-1], off[1:])) - 2.0) < 0.1)


def test_dispersion_of_a_chain():
    """2 sqrt(k/m) |sin(q a / 2)| for all waves that fit between two walls, told from one run that holds all of them.

    Verlet keeps a(t + h) + a(t - h) = (2 - h^2 omega^2) a(t) for each wave's amplitude a, omega that of the exact motion.
    """
    n, k, m, h = 48, 300.0, 0.2, 0.01
    rng = np.random.default_rng(0)
    scene = ts.Scene(dim=2)
    x = np.stack([np.arange(n + 2.0), np.zeros(n + 2)], axis=1)
    b = scene.add_balls(x, radius=1e-3, mass=m, pinned=[0, n + 1], velocity=[(u, 0.0) for u in rng.normal(size=n + 2)])
    scene.add_springs(np.stack([b[:-1], b[1:]], axis=1), stiffness=k)
    q = np.arange(1, n + 1) * np.pi / (n + 1)
    waves = np.sin(q[:, None] * np.arange(1, n + 1))
    amplitude = []
    with simulate(scene, integrator="verlet", dt=h, contacts="off") as sim:
        for _ in range(2000):
            sim.step()
            amplitude.append(waves @ (sim.position - x)[1:-1, 0])
    a = np.array(amplitude)
    bend = 2 * a[1:-1] - a[2:] - a[:-2]
    omega = np.sqrt(np.sum(bend * a[1:-1], axis=0) / np.sum(a[1:-1] ** 2, axis=0)) / h
    off = np.max(np.abs(omega / (2 * np.sqrt(k / m) * np.sin(q / 2)) - 1.0))
    print(f"dispersion: {n} waves, off by {off:.1e}")
    assert off < 1e-9


# Lattices -------------------------------------------------------------------------------------------------------------


class Lattice(NamedTuple):
    """Balls in cells that share their sides. A spring on a side counts once for each cell: on a border it is as strong as its
    part of the bulk, so that a uniform stress is held by a uniform strain."""

    points: np.ndarray  # (n, dim) m
    cells: np.ndarray  # (c, corners)
    springs: dict[tuple[int, int], float]  # between corners of a cell: N/m
    measure: float  # of a cell: m^2 or m^3

    def add_to(self, scene, **balls):
        """Add the balls and springs; indices of the balls."""
        b = scene.add_balls(self.points, radius=1e-3, **balls)
        ends = np.sort(self.cells[:, list(self.springs)].reshape(-1, 2), axis=1)
        pairs, each = np.unique(ends, axis=0, return_inverse=True)
        k = np.bincount(each.ravel(), np.tile(list(self.springs.values()), len(self.cells)))
        scene.add_springs(b[pairs], stiffness=k)
        return b

    def loads(self, stress):
        """(n, dim) N: what a uniform stress (dim, dim) [N/m, N/m^2] does to the balls; 0 within."""
        r = self.points[self.cells]
        r = r - r.mean(axis=1, keepdims=True)
        slope = np.einsum("cab,cib->cia", np.linalg.inv(np.einsum("cia,cib->cab", r, r)), r)  # of each corner's share
        out = np.zeros_like(self.points)
        np.add.at(out, self.cells, self.measure * slope @ stress)
        return out

    def strain(self, moved):
        """(dim, dim), by least squares over all balls; and how far the motion is from uniform."""
        r = self.points - self.points.mean(axis=0)
        u = moved - self.points
        u = u - u.mean(axis=0)
        slope = np.linalg.lstsq(r, u, rcond=None)[0]
        return (slope + slope.T) / 2, np.max(np.abs(u - r @ slope)) / np.max(np.abs(u))


def grid(*cells):
    """Balls at whole numbers, and the corners of their cells, in the order of np.ndindex."""
    points = np.array(list(np.ndindex(*(n + 1 for n in cells))))
    corners = np.array(list(np.ndindex(*(2 for _ in cells))))
    first = np.array(list(np.ndindex(*cells)))
    at = np.ravel_multi_index((first[:, None] + corners).transpose(2, 0, 1), [n + 1 for n in cells])
    return points.astype(float), at, corners


def boxes(cells, k1, k2):
    """Squares (2D) or cubes (3D) of 1 m: k1 along edges, k2 along the diagonals of faces."""
    points, at, corners = grid(*cells)
    springs = {}
    for i, j in np.argwhere(np.triu(np.ones((len(corners),) * 2), 1)):
        across = np.sum(corners[i] != corners[j])
        shared = 2 ** (len(cells) - across)  # cells that a spring of the bulk lies in
        if across <= 2:
            springs[i, j] = (k1 if across == 1 else k2) / shared
    return Lattice(points, at, springs, 1.0)


def triangles(n, k):
    """Triangles with sides of 1 m."""
    points, at, _ = grid(n, n)
    cells = np.concatenate([at[:, [0, 2, 1]], at[:, [3, 1, 2]]])
    skewed = points @ np.array([[1.0, 0.0], [0.5, 0.75**0.5]])
    return Lattice(skewed, cells, dict.fromkeys([(0, 1), (1, 2), (0, 2)], k / 2), 0.75**0.5 / 2)


@ti.data_oriented
class Load:
    """A constant force on each ball (n, dim) [N]."""

    def __init__(self, force):
        self.force = ti.Vector.field(force.shape[1], float, shape=len(force))
        self.force.from_numpy(force)

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        for i in range(model.n):
            impulse[i] += h * self.force[i]


def strains(cases):
    """Strain of each (lattice, stress), all side by side in one scene."""
    scene = ts.Scene(dim=len(cases[0][1]))
    balls = [lattice.add_to(scene) for lattice, _ in cases]
    force = np.concatenate([lattice.loads(np.array(stress)) for lattice, stress in cases])
    moved = settled(scene, 30.0, 40, [Load(force)])
    found = []
    for b, (lattice, _) in zip(balls, cases):
        strain, off = lattice.strain(moved[b])
        assert off < 20 * SMALL, "not uniform"
        found.append(strain)
    return found


@pytest.mark.slow
def test_moduli_of_plane_lattices():
    """Triangles: E = 2 k / sqrt 3 and Poisson's ratio 1/3 in every direction. Squares with diagonals: C11 = k1 + k2,
    C12 = C44 = k2."""
    k, k1, k2, s = 3.0, 2.0, 0.7, SMALL
    along, up, shear = [[s, 0], [0, 0]], [[0, 0], [0, s]], [[0, s], [s, 0]]
    mesh, squares = triangles(5, k), boxes((5, 4), k1, k2)
    a, b, c, d = strains([(mesh, along), (mesh, up), (squares, along), (squares, shear)])
    E, c11, c12 = 2 * k / 3**0.5, k1 + k2, k2
    expected = {
        "triangles, E along": (s / a[0, 0], E),
        "triangles, E across": (s / b[1, 1], E),
        "triangles, Poisson": (-a[1, 1] / a[0, 0], 1 / 3),
        "squares, E": (s / c[0, 0], c11 - c12**2 / c11),
        "squares, Poisson": (-c[1, 1] / c[0, 0], c12 / c11),
        "squares, C44": (s / (2 * d[0, 1]), k2),
    }
    close(expected)


@pytest.mark.slow
def test_moduli_of_a_cubic_lattice():
    """Edges and diagonals of faces alike: E = 2.5 k / a, Poisson's ratio 1/4, and so C44 = k / a."""
    k, s = 3.0, SMALL
    along, shear = np.zeros((2, 3, 3))
    along[0, 0] = shear[0, 1] = shear[1, 0] = s
    cubes = boxes((3, 3, 3), k, k)
    a, b = strains([(cubes, along), (cubes, shear)])
    close({"E": (s / a[0, 0], 2.5 * k), "Poisson": (-a[1, 1] / a[0, 0], 0.25), "C44": (s / (2 * b[0, 1]), k)})


def close(expected):
    for name, (found, exact) in expected.items():
        print(f"{name}: {found:.6f} of {exact:.6f}")
        assert abs(found / exact - 1.0) < 10 * SMALL, name


@pytest.mark.slow
def test_cantilever():
    """A bar of squares, clamped at one end, sags under a small weight as the dense solution of K u = f says; its tip as that of
    Timoshenko's beam, but for what eight cells are off a continuum."""
    length, height, k1, k2 = 80, 8, 40.0, 20.0
    bar = boxes((length, height), k1, k2)
    clamped = bar.points[:, 0] == 0
    c11, c12, c44 = k1 + k2, k2, k2
    E, weight = c11 - c12**2 / c11, height  # N/m^2 and N/m for a gravity of 1
    bending, shearing = length**4 / (8 * E * height**3 / 12), length**2 / (2 * 5 / 6 * c44 * height)
    g = SMALL * length / (weight * (bending + shearing))
    scene = ts.Scene(dim=2, gravity=(0, -g))
    mass = np.bincount(bar.cells.ravel()) / 4.0
    bar.add_to(scene, mass=mass, pinned=clamped)
    moved = settled(scene, 3000.0, 30) - bar.points
    K = np.zeros((len(mass), 2, len(mass), 2))
    for (i, j), k in zip(scene.pairs, scene.stiffness):
        n = bar.points[j] - bar.points[i]
        block = k * np.outer(n, n) / (n @ n)
        for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            K[a, :, b, :] += sign * block
    free = np.repeat(~clamped, 2)
    f = np.stack([0 * mass, -g * mass], axis=1).ravel()
    exact = np.zeros(2 * len(mass))
    exact[free] = np.linalg.solve(K.reshape(2 * len(mass), -1)[np.ix_(free, free)], f[free])
    off = np.max(np.abs(moved.ravel() - exact)) / np.max(np.abs(exact))
    tip = -moved[bar.points[:, 0] == length, 1].mean() / (g * weight * (bending + shearing))
    print(f"cantilever: off the dense solution by {off:.1e}, tip {tip:.4f} of the beam's")
    assert off < 30 * SMALL
    assert abs(tip - 1.0) < 0.03
