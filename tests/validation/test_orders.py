"""Order of convergence of every integrator: the phase-space error over four halvings of the step, in f64.

In f32 round-off hides the small steps, so there these tests are not collected at all.
"""

import functools

import numpy as np
import pytest
import reference as ref
from physics_support import F64, each_dim, simulate, vector

import taichi_sim as ts
from taichi_sim.analysis.damping import predicts_damping
from taichi_sim.integrators import BUILT_IN

ORDERS = {kind.method.name: kind.method.order for kind in BUILT_IN}
HALVINGS = 4
T = 0.32  # s
FIRST = {
    "explicit_euler": 1e-3,
    "symplectic_euler": 2e-3,
    "verlet": 4e-3,
    "rk4": 2e-2,
    "xpbd": 2e-3,
    "implicit_euler": 2e-3,
    "tr_bdf2": 2e-3,
}
K, M = 60.0, (1.0, 2.5)
OMEGA = np.sqrt(K * sum(1 / m for m in M))


def test_declared_orders():
    explicit = {"explicit_euler": 1, "symplectic_euler": 1, "verlet": 2, "rk4": 4}
    assert explicit | {"xpbd": 1, "implicit_euler": 1, "tr_bdf2": 2} == ORDERS


def turning_pair(scene, dim, damping):
    """Two balls that turn about each other while their spring swings: smooth, and not linear."""
    x = [vector(dim), vector(dim, 1.1, 0.3, 0.2)]
    v = [vector(dim, -0.4, -1.0, 0.2), vector(dim, 0.7, 0.6, -0.9)]
    b = scene.add_balls(x, radius=0.01, velocity=v, mass=M)
    scene.add_springs([b], stiffness=K, damping=damping, rest_length=1.0)
    return b


def hanging_net(scene, dim, damping):
    """A 3 x 3 net held at two corners that swings."""
    at = [(i, j) for j in range(3) for i in range(3)]
    x = [vector(dim, 0.5 * i, -0.5 * j + 0.05 * i * j, 0.1 * i) for i, j in at]
    b = scene.add_balls(x, radius=0.01, mass=np.linspace(0.5, 1.5, 9), pinned=[0, 2])
    pairs = [(p, q) for p in range(9) for q in range(p) if np.hypot(*np.subtract(at[p], at[q])) < 1.5]
    scene.add_springs(b[np.array(pairs)], stiffness=K, damping=damping, rest_length=0.45)
    return b


@functools.cache
def everything(dim, weak=False):
    """All experiments side by side, and which balls belong to which. weak: as weakly damped as `verlet` takes at predicted
    velocities."""
    scene = ts.Scene(dim=dim, gravity=vector(dim, 0.5, -9.81, 1.0))
    if weak:
        balls = {
            "weakly damped pair": turning_pair(scene, dim, 0.1),
            "weakly damped net": hanging_net(scene, dim, 0.1),
        }
    else:
        balls = {
            "pair": turning_pair(scene, dim, 0.0),
            "damped pair": turning_pair(scene, dim, 3.0),
            "net": hanging_net(scene, dim, 0.0),
            "damped net": hanging_net(scene, dim, 1.0),
        }
    assert predicts_damping(scene) == weak
    return scene, balls


@functools.cache
def converged(dim, weak=False):
    """The reference's RK4 at steps that leave a tenth at most of the smallest error that is compared here."""
    scene, _ = everything(dim, weak)
    w = np.where(scene.pinned, 0.0, 1.0 / scene.mass)
    net = ref.network(w, scene.pairs, scene.stiffness, scene.damping, scene.rest_length, scene.gravity)
    return ref.run("rk4", net, scene.position, scene.velocity, 2e-4, round(T / 2e-4))


@functools.cache
def errors(dim, method, first, weak=False):
    """Phase-space error of each experiment at `first` and its halvings."""
    scene, balls = everything(dim, weak)
    x, v = converged(dim, weak)
    found = {name: [] for name in balls}
    with simulate(scene, integrator=method, dt=first, contacts="off") as sim:
        for k in range(HALVINGS + 1):
            h = first / 2**k
            sim.set_dt(h)
            sim.set_position(scene.position)
            sim.set_velocity(scene.velocity)
            sim.step(round(T / h))
            dx, dv = sim.position - x, (sim.velocity - v) / OMEGA
            for name, b in balls.items():
                found[name].append(float(np.sqrt(np.sum(dx[b] ** 2) + np.sum(dv[b] ** 2))))
    return found


def orders(dim, method, name):
    e = np.array(errors(dim, method, FIRST[method], name.startswith("weakly"))[name])
    return np.log2(e[:-1] / e[1:]), e


if F64:

    @pytest.mark.slow_where(name="pair", method=["implicit_euler", "tr_bdf2"])
    @pytest.mark.slow_where(dim=3, method=["explicit_euler", "rk4", "xpbd", "implicit_euler", "tr_bdf2"])
    @each_dim
    @pytest.mark.parametrize("method", FIRST)
    @pytest.mark.parametrize("name", ["pair", "damped pair", "net", "damped net"])
    def test_order_f64(name, method, dim):
        found, e = orders(dim, method, name)
        assert np.all(np.abs(found - ORDERS[method]) < 0.15), f"orders {np.round(found, 3)}, errors {e}"

    @pytest.mark.slow_where(dim=3)
    @each_dim
    @pytest.mark.parametrize("name", ["weakly damped pair", "weakly damped net"])
    def test_order_of_verlet_with_weak_damping_f64(name, dim):
        """Damping at predicted velocities: order 2 in networks, too."""
        found, e = orders(dim, "verlet", name)
        assert np.all(np.abs(found - 2.0) < 0.15), f"orders {np.round(found, 3)}, errors {e}"

    @each_dim
    def test_verlet_in_a_damped_net_f64(dim):
        """An eighth of symplectic Euler's error at most, at equal work."""
        _, e = orders(dim, "verlet", "damped net")
        other = np.array(errors(dim, "symplectic_euler", FIRST["symplectic_euler"])["damped net"])
        assert np.all(e[1:] < 0.125 * other[:-1]), (e, other)
