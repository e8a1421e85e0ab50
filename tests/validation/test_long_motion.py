"""Motion without contacts over longer times, against the continuum, and its conserved quantities."""

import numpy as np
import pytest
import reference as ref
from physics_support import (
    F64,
    METHODS,
    each_dim,
    each_extreme,
    exact,
    simulate,
    vector,
)

import taichi_sim as ts

pytestmark = [pytest.mark.long_in("f32"), pytest.mark.slow_where(dim=2)]

H = 1e-3


# Long runs ------------------------------------------------------------------------------------------------------------


@each_dim
@pytest.mark.parametrize("method", ["symplectic_euler", "verlet"])
def test_modified_energy_over_1e5_steps(dim, method):
    omega, h = 20.0, 0.01
    scene = ts.Scene(dim=dim)
    b = scene.add_balls(
        [np.zeros(dim), vector(dim, 0.5)], radius=0.01, velocity=[np.zeros(dim), vector(dim, 2.0)], pinned=[0]
    )
    scene.add_springs([b], stiffness=omega**2, rest_length=0.0)
    start = ref.modified_energy(method, 0.5, 2.0, omega, h)
    worst = 0.0
    with simulate(scene, integrator=method, dt=h, contacts="off") as sim:
        for _ in range(100):
            sim.step(1000)
            now = ref.modified_energy(method, sim.position[1, 0], sim.velocity[1, 0], omega, h)
            worst = max(worst, abs(float(now / start) - 1.0))
    assert worst < (1e-12 if F64 else 2e-4), f"drift {worst:.2e}"


def _bottom_crossing(sim, ball):
    """Time at which the ball next passes x = 0, from the cubic through both ends of the step."""
    x, v, h = sim.position[ball, 0], sim.velocity[ball, 0], sim.dt
    while True:
        t0, x0, v0 = sim.time, x, v
        sim.step()
        x, v = sim.position[ball, 0], sim.velocity[ball, 0]
        if x0 * x <= 0 and x0 != 0:
            cubic = np.array([2 * x0 - 2 * x + h * (v0 + v), -3 * x0 + 3 * x - h * (2 * v0 + v), h * v0, x0])
            roots = np.roots(cubic)
            real = roots[np.abs(roots.imag) < 1e-9].real
            return t0 + h * float(real[(real >= -1e-9) & (real <= 1 + 1e-9)][0])


@pytest.mark.parametrize("method", ["symplectic_euler", "verlet", "rk4"])
@each_dim
def test_pendulum_period(dim, method):
    """L = 1, g = 9.81, 90 degrees: 2.36784195 s. On springs of k and 2k the excess is as 2 to 1, and is taken out."""
    k, h = (1e6, 2e-4) if F64 else (1e5, 4e-4)
    down = np.array([0.0, -9.81, 0.0])[:dim]
    scene = ts.Scene(dim=dim, gravity=down)
    for stiffness in (k, 2 * k):
        b = scene.add_balls([np.zeros(dim), vector(dim, 1.0)], radius=0.01, pinned=[0])
        scene.add_springs([b], stiffness=stiffness)
    T = ref.pendulum_period(1.0, 9.81)
    assert abs(T - 2.36784195) < 1e-8
    periods = []
    with simulate(scene, integrator=method, dt=h, contacts="off") as sim:
        for ball in (1, 3):
            sim.set_position(scene.position)
            sim.set_velocity(np.zeros((4, dim)))
            times, begin = [], round(sim.time / h)
            for quarter in (1, 5):  # the bottom is passed after a quarter, and a whole period later
                target = round(quarter * T / 4 / h) - 20
                sim.step(begin + target - round(sim.time / h))
                times.append(_bottom_crossing(sim, ball))
            periods.append(times[1] - times[0])
    found = 2 * periods[1] - periods[0]
    tolerance = {"symplectic_euler": 1e-6, "verlet": 2e-7, "rk4": 2e-7}[method] if F64 else exact(round(T / h))
    assert abs(found / T - 1) < tolerance, f"T = {found:.9f} s, relative {found / T - 1:.2e}"


# Momentum -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow_where(method=["explicit_euler", "symplectic_euler"])
@pytest.mark.parametrize("method", METHODS)
@each_extreme
@each_dim
def test_momentum_and_angular_momentum_of_1000_balls_and_springs(dim, method, variant):
    """No contacts, so neither friction nor offsets: both are kept to 1e-13 sum m|v| sqrt(steps) in f64."""
    rng = np.random.default_rng(3)
    n, steps = 1000, 100
    scene = ts.Scene(dim=dim)
    b = scene.add_balls(
        rng.uniform(-1, 1, (n, dim)), radius=0.05, velocity=rng.normal(size=(n, dim)), mass=10 ** rng.uniform(-1, 1, n)
    )
    pairs = np.array([rng.choice(n, 2, replace=False) for _ in range(2000)])
    scene.add_springs(
        b[pairs],
        stiffness=10 ** rng.uniform(0, 2, 2000),
        damping=rng.uniform(0, 0.5, 2000),
        collides=pairs[:, 0] % 2 == 0,
    )
    p0 = scene.mass @ scene.velocity
    l0 = ref.angular_momentum(scene.mass, scene.position, scene.velocity)
    with simulate(scene, variant, integrator=method, dt=H, contacts="off") as sim:
        sim.step(steps)
        p, l = sim.momentum(), sim.angular_momentum()
        size = float(scene.mass @ np.linalg.norm(sim.velocity, axis=1))
        arm = float(np.max(np.abs(sim.position)))
    tolerance = (
        (1e-13 if F64 else 1e-13 * 2.0**29)
        * max(size, float(scene.mass @ np.linalg.norm(scene.velocity, axis=1)))
        * np.sqrt(steps)
    )
    assert np.max(np.abs(p - p0)) < tolerance
    if method in ("symplectic_euler", "verlet"):  # explicit Euler and RK4 keep it to the order of their step only
        assert np.max(np.abs(l - l0)) < tolerance * arm
