"""xpbd with elements: a stage of implicit Euler between its two passes over springs."""

import numpy as np
import pytest
import taichi as ti
from physics_support import F64, simulate

import taichi_sim as ts
from taichi_sim.analysis.element_rates import Declared
from taichi_sim.analysis.methods import named
from taichi_sim.analysis.stability import OVERLOAD, explicit_parts, overload_step, overloaded_spring, stability
from taichi_sim.integrators import XPBD, ImplicitEuler

pytestmark = pytest.mark.long_in("f32")

G = 9.81
ORDERS = [("ordered", "fused"), ("gather", "parallel"), ("atomic", "fused")]


def triangles_of_rows(rows, columns):
    """Triangles of a grid of squares."""
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel()
    return np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])


def flat(kind):
    """A strip in 2D of bricks, solids or cells with springs, held at one end and struck."""
    rng, scene = np.random.default_rng(5), ts.Scene(dim=2, gravity=(0.0, -G))
    x = np.stack(np.meshgrid(0.1 * np.arange(5), 0.1 * np.arange(3), indexing="ij"), axis=-1).reshape(-1, 2)
    mass, v = rng.uniform(0.1, 0.4, len(x)), 0.5 * rng.normal(size=x.shape)
    balls = scene.add_balls(x, mass=mass, velocity=v, radius=0.01, pinned=[0, 1, 2])
    triangles = balls[triangles_of_rows(5, 3)]
    if kind == "bricks":
        squares = np.stack([balls.reshape(5, 3)[i : 4 + i, j : 2 + j].ravel() for i in (0, 1) for j in (0, 1)], axis=1)
        scene.add_bricks(squares, young_modulus=3e5, poisson_ratio=0.45, viscosity=200.0)
    elif kind == "solids":
        scene.add_solids(triangles, young_modulus=2e5, poisson_ratio=0.4)
    else:
        scene.add_cells(triangles, bulk_modulus=4e4, crush_modulus=1e4)
    return scene


def sheet():
    """A sheet in 3D of membranes with bending, held at one side."""
    rng, scene = np.random.default_rng(6), ts.Scene(dim=3, gravity=(0.0, -G, 0.0))
    grid = np.stack(np.meshgrid(0.1 * np.arange(5), 0.1 * np.arange(4), indexing="ij"), axis=-1).reshape(-1, 2)
    x = np.insert(grid, 1, 0.0, axis=1)
    balls = scene.add_balls(x, mass=0.02, velocity=0.3 * rng.normal(size=x.shape), radius=0.01, pinned=[0, 1, 2, 3])
    triangles = balls[triangles_of_rows(5, 4)]
    scene.add_membranes(triangles, warp=3e3, weft=2e3, shear=500.0, coupling=300.0, damping=1e-3)
    half = len(triangles) // 2
    hinges = np.stack([triangles[:half, 0], triangles[:half, 2], triangles[:half, 1], triangles[half:, 2]], axis=1)
    scene.add_bending(hinges, weights=[[1.0, 1.0, -1.0, -1.0]] * half, stiffness=30.0, damping=0.01)
    return scene


SCENES = {"membranes": sheet, **{kind: (lambda kind=kind: flat(kind)) for kind in ("bricks", "solids", "cells")}}


@pytest.mark.slow
@pytest.mark.long_where(kind=["membranes", "bricks"])
@pytest.mark.parametrize("kind", SCENES)
def test_elements_alone_are_implicit_euler(kind):
    """At steps for which Verlet takes tens."""
    h, scene = 1 / 40, SCENES[kind]()
    places = []
    fine = 1e-10 if F64 else 1e-4
    for method in (ImplicitEuler(tolerance=fine), XPBD(tolerance=fine)):
        with simulate(scene, integrator=method, dt=h, substeps=1, contacts="off") as sim:
            sim.step(6)
            places.append(sim.position)
    way = np.abs(places[0] - scene.position).max()
    assert np.abs(places[1] - places[0]).max() < (1e-7 if F64 else 2e-3) * way


def linear_scene(seed):
    """Balls that springs of the length 0 and bending join: a step is linear in their places, in each direction alike."""
    rng, scene, n = np.random.default_rng(seed), ts.Scene(dim=3, gravity=(0.0, 0.0, 0.0)), 7
    scene.add_balls(rng.normal(size=(n, 3)), mass=10.0 ** rng.uniform(-1, 1, n), radius=0.01)
    pairs = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [5, 6], [0, 3], [2, 6], [1, 5]])
    scene.add_springs(pairs, stiffness=10.0 ** rng.uniform(3, 5, len(pairs)), rest_length=0.0)
    fours = np.array([[0, 1, 2, 3], [2, 3, 4, 5], [3, 4, 5, 6], [6, 1, 0, 4]])
    scene.add_bending(fours, weights=rng.normal(size=(4, 3)) @ [[1, 0, 0, -1], [0, 1, 0, -1], [0, 0, 1, -1]],
                      stiffness=10.0 ** rng.uniform(3, 5, 4))  # fmt: skip
    return scene


def step_of(scene, h, order):
    """P (n, n) of a step from rest, x(t + h) = P x(t)."""
    n, rng = scene.n_balls, np.random.default_rng(7)
    method = XPBD(tolerance=1e-12 if F64 else 1e-6)
    before, after = np.zeros((n, 0)), np.zeros((n, 0))
    with simulate(scene, order, integrator=method, dt=h, substeps=1, contacts="off") as sim:
        for _ in range(4):
            x = rng.normal(size=(n, 3))
            sim.set_position(x)
            sim.set_velocity(np.zeros((n, 3)))
            sim.step(1)
            before, after = np.hstack([before, x]), np.hstack([after, x + h * sim.velocity])
    return after @ np.linalg.pinv(before)


@pytest.mark.slow
@pytest.mark.parametrize("order", ORDERS, ids="-".join)
def test_a_step_with_elements_between_springs_is_symmetric_in_the_mass(order):
    """Its eigenvalues lie in (0, 1], so that any step is stable; elements after both passes fail here."""
    scene, h = linear_scene(3), 0.03
    P = step_of(scene, h, order)
    small = 1e-8 if F64 else 1e-3
    weighed = scene.mass[:, None] * P
    assert np.abs(weighed - weighed.T).max() < small * np.abs(weighed).max()
    values = np.linalg.eigvals(P)
    assert np.abs(values.imag).max() < small
    assert (values.real > -small).all()
    assert (values.real < 1.0 + small).all()
    assert values.real.min() < 0.1  # a step that binds


@pytest.mark.once
def test_no_element_limits_xpbd():
    """Nor does a gas that membranes hold; one that springs hold does."""
    for make in SCENES.values():
        assert stability(make(), named("xpbd")).dt_any_shape == np.inf
        assert explicit_parts(make(), named("xpbd"), Declared()) == ""
    held = {}
    for springs in (False, True):
        scene = ts.Scene(dim=3)
        corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
        faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
        scene.add_balls(corners, mass=0.01, radius=0.01)
        if springs:
            scene.add_springs([[i, j] for i in range(4) for j in range(i)], stiffness=1e4)
        else:
            scene.add_membranes(faces, warp=1e4)
        scene.add_gas(faces, pressure=100.0)
        held[springs] = stability(scene, named("xpbd")).dt_any_shape
    assert held[False] == np.inf
    assert held[True] < 0.1


@ti.data_oriented
class Stiff(ts.Element):
    """A spring of the length 0 between two balls, as a user writes it with its derivatives."""

    def __init__(self, balls, stiffness):
        self.balls, self.columns = balls, {"stiffness": stiffness}

    @ti.func
    def _apart(self, ball: ti.template(), row):
        return ti.select(row.corner == 0, 1.0, -1.0) * (ball[row.a].x - ball[row.b].x)

    @ti.func
    def force(self, ball: ti.template(), row, time):
        return -row.stiffness * self._apart(ball, row)

    @ti.func
    def product(self, ball: ti.template(), row, s):
        return s * s * row.stiffness * ti.select(row.corner == 0, 1.0, -1.0) * (ball[row.a].p - ball[row.b].p)

    @ti.func
    def block(self, ball: ti.template(), row, s):
        return s * s * row.stiffness * ti.Matrix.identity(float, 2)

    @ti.func
    def potential(self, ball: ti.template(), row, s):
        apart = ball[row.a].x - ball[row.b].x
        return 0.25 * row.stiffness * apart.dot(apart)


@pytest.mark.slow
def test_an_element_of_a_user_is_solved_for():
    """Two balls, w h = 60: each step takes the distance on by the equation of implicit Euler."""
    scene, h, k, mass = ts.Scene(dim=2, gravity=(0.0, 0.0)), 0.02, 4.5e6, 1.0
    scene.add_balls([[0.0, 0.0], [1.0, 0.0]], velocity=[[0.0, 0.2], [0.0, -0.2]], mass=mass, radius=0.01)
    with simulate(scene, integrator=XPBD(tolerance=1e-10 if F64 else 1e-5), dt=h, substeps=1, contacts="off",
                  forces=[Stiff([[0, 1]], k)]) as sim:  # fmt: skip
        x, v = np.array([1.0, 0.0]), np.array([0.0, -0.4])
        for _ in range(3):
            sim.step(1)
            v = (v - h * 2.0 * k / mass * x) / (1.0 + h * h * 2.0 * k / mass)
            x = x + h * v
            assert sim.position[1] - sim.position[0] == pytest.approx(x, abs=1e-8 if F64 else 1e-3)


@pytest.mark.once
def test_large_nets_of_springs_alone_do_not_pay_for_digits_that_springs_do_not_read():
    """Compensated sums of places take a tenth of the speed of large scenes."""
    scene = ts.Scene(dim=2)
    balls = scene.add_balls([[0.1 * k, 0.0] for k in range(4)], radius=0.01)
    scene.add_springs([[balls[0], balls[1]]], stiffness=10.0)
    assert not XPBD().refines(scene)
    scene.add_bending([balls], weights=[[1.0, -2.0, 1.0, 0.0]], stiffness=10.0)
    assert XPBD().refines(scene)


@pytest.mark.slow
def test_what_springs_show_that_hold_a_body_of_bricks():
    """A block of bricks hangs on two damped springs: the sum of their tensions is what the warning says, above its weight."""
    h, k, scene = 1 / 120, 700.0, ts.Scene(dim=2, gravity=(0.0, -G))
    block = ts.shapes.jelly(
        scene, size=(0.3, 0.2), resolution=(4, 3), density=200, young_modulus=1e5, poisson_ratio=0.3
    )
    x = scene.position[block.balls]
    top = block.balls[
        np.isclose(x[:, 1], x[:, 1].max()) & (np.isclose(x[:, 0], x[:, 0].min()) | np.isclose(x[:, 0], x[:, 0].max()))
    ]
    pins = scene.add_balls(scene.position[top] + [0.0, 0.4], radius=0.01, pinned=True)
    scene.attach(pins, top, stiffness=k, damping=40.0)
    found, weight = overloaded_spring(scene, h), G * scene.mass[block.balls].sum()
    assert found.load == pytest.approx(weight / 2)
    assert overloaded_spring(scene, 0.99 * overload_step(scene)) is None
    assert overloaded_spring(scene, 1.01 * overload_step(scene)).part == pytest.approx(OVERLOAD, rel=0.02)
    with pytest.warns(
        UserWarning, match=f"xpbd: spring {found.spring} carries .* and shows about {found.part:.0%} more"
    ):
        sim = ts.Simulation(scene, integrator="xpbd", dt=h, substeps=1, contacts="off")
    with sim:
        sim.run(3.0)
        shown = k * (np.linalg.norm(sim.position[top] - sim.position[pins], axis=1) - 0.4).sum()
    assert shown == pytest.approx((1.0 + found.part) * weight, rel=2e-3)
    assert found.part > 0.1
