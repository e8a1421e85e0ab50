"""Elements that implicit methods solve for: bending, and a user's own."""

import numpy as np
import pytest
import taichi as ti
from physics_support import simulate

import taichi_sim as ts
from taichi_sim.device.engine import CompilationError
from taichi_sim.integrators import TRBDF2, ImplicitEuler

STIFFNESS = 3e5  # N/m, for balls of some grams: omega h is some hundreds


@ti.data_oriented
class Curve(ts.Element):
    """A bending element of three balls as a user writes it."""

    def __init__(self, balls, stiffness):
        self.balls, self.columns = balls, {"stiffness": stiffness}

    @ti.func
    def _weight(self, row):
        return ti.select(row.corner == 1, -2.0, 1.0)

    @ti.func
    def force(self, ball: ti.template(), row, time):
        bend = ball[row.a].x - 2.0 * ball[row.b].x + ball[row.c].x
        return -row.stiffness * self._weight(row) * bend

    @ti.func
    def product(self, ball: ti.template(), row, s):
        bend = ball[row.a].p - 2.0 * ball[row.b].p + ball[row.c].p
        return s * s * row.stiffness * self._weight(row) * bend

    @ti.func
    def block(self, ball: ti.template(), row, s):
        return s * s * row.stiffness * self._weight(row) ** 2 * ti.Matrix.identity(float, 3)

    @ti.func
    def potential(self, ball: ti.template(), row, s):
        bend = ball[row.a].x - 2.0 * ball[row.b].x + ball[row.c].x
        return row.stiffness * bend.dot(bend) / 6.0


def rod(n=7, **bending):
    """A rod of balls that bending alone holds together, bent and moving, its first two balls pinned."""
    rng = np.random.default_rng(3)
    scene = ts.Scene(dim=3, gravity=(0.0, -9.81, 0.0))
    x = np.stack([0.1 * np.arange(n), 0.002 * rng.normal(size=n), 0.002 * rng.normal(size=n)], axis=1)
    v, mass = 0.3 * rng.normal(size=(n, 3)), rng.uniform(1e-3, 9e-3, n)
    scene.add_balls(x, velocity=v, mass=mass, radius=0.01, pinned=[0, 1])
    if bending:
        threes = np.stack([np.arange(n - 2) + k for k in range(3)], axis=1)
        scene.add_bending(threes[:, [1, 1, 0, 2]], weights=[[-1.0, -1.0, 1.0, 1.0]] * (n - 2), **bending)
    return scene


@pytest.mark.slow
@pytest.mark.parametrize("method", [ImplicitEuler, TRBDF2])
def test_an_element_of_the_user_moves_as_the_one_that_is_built_in(method):
    runs = []
    for forces in ((), (Curve([[k, k + 1, k + 2] for k in range(5)], STIFFNESS),)):
        scene = rod() if forces else rod(stiffness=STIFFNESS)
        with simulate(scene, forces=forces, integrator=method(tolerance=1e-5), dt=0.01, contacts="off") as sim:
            assert sim.stability().dt_any_shape == np.inf
            sim.step(20)
            runs.append(sim.position)
    assert np.abs(runs[0] - runs[1]).max() < 1e-5
    assert np.abs(runs[0] - scene.position).max() > 1e-3  # they move


def test_a_block_of_the_wrong_sign_is_said():
    """It makes every size of an impulse negative, which looks like a scene at rest."""

    @ti.data_oriented
    class Turned(Curve):
        @ti.func
        def block(self, ball: ti.template(), row, s):
            return -s * s * row.stiffness * self._weight(row) ** 2 * ti.Matrix.identity(float, 3)

    scene = ts.Scene(dim=3, gravity=(0.0, 0.0, 0.0))
    scene.add_balls([[0.0, 0.0, 0.0], [0.8, 0.2, 0.0], [1.7, 0.0, 0.1]], mass=0.5, radius=0.1)
    with simulate(
        scene, forces=[Turned([[0, 1, 2]], 4e4)], integrator="implicit_euler", dt=0.01, contacts="off"
    ) as sim:
        with pytest.warns(UserWarning, match="left 1 of the impulses of a stage unsolved"):
            sim.step(3)
        assert sim.solver().misses == 3


@pytest.mark.once
def test_some_of_the_derivatives_are_refused():
    class Half(Curve):
        block = potential = None

    with pytest.raises(ts.SceneError, match=r"Half.product: is given without block, potential"):
        ts.Simulation(rod(), forces=[Half([[0, 1, 2]], 1.0)])


@ti.data_oriented
class NumberForForce(Curve):
    @ti.func
    def force(self, ball: ti.template(), row, time):
        return row.stiffness


@ti.data_oriented
class MatrixForProduct(Curve):
    @ti.func
    def product(self, ball: ti.template(), row, s):
        return ti.Matrix.identity(float, 3)


@ti.data_oriented
class SmallBlock(Curve):
    @ti.func
    def block(self, ball: ti.template(), row, s):
        return ti.Matrix.identity(float, 2)


@pytest.mark.once
@pytest.mark.parametrize(
    ("kind", "says"),
    [
        (NumberForForce, r"force: returns a number; it must return a vector or matrix of shape \(3,\)"),
        (MatrixForProduct, r"product: returns a vector or matrix of shape \(3, 3\); it must return .* \(3,\)"),
        (SmallBlock, r"block: returns a vector or matrix of shape \(2, 2\); it must return .* \(3, 3\)"),
    ],
)
def test_functions_that_return_another_shape_are_named(kind, says):
    """A number for a vector was added to each of its components, and a block of another size ended the process."""
    with (
        ts.Simulation(rod(), forces=[kind([[0, 1, 2]], 1.0)], integrator="implicit_euler", dt=1e-3) as sim,
        pytest.raises(CompilationError, match=f"^{kind.__name__}.{says}$"),
    ):
        sim.step()


@pytest.mark.slow
@pytest.mark.long_in("f64")
def test_a_bar_far_from_the_origin_comes_to_rest_by_xpbd():
    """A cantilever of stiff bricks 40 m from the origin, where single precision knows places to 4e-6 m; xpbd left it at 3e-4 m/s
    until its stages began from all digits of the places."""
    scene = ts.Scene(dim=3, gravity=(0.0, -9.81, 0.0))
    ts.shapes.jelly(scene, size=(0.4, 0.1, 0.1), resolution=(5, 2, 2), density=1200, young_modulus=3e9,
                    poisson_ratio=0.3, position=(40.0, 25.0, 0.0), pinned="left")  # fmt: skip
    with simulate(scene, integrator="xpbd", dt=1 / 100, substeps=1, contacts="off") as sim:
        sim.step(60)
        fastest = [np.abs(sim.step(1) or sim.velocity).max() for _ in range(20)]
    assert max(fastest) < 2e-5
