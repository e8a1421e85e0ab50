"""The pointer's law against plain NumPy, and what it may and may not change."""

import numpy as np
import pytest

from taichi_sim import Pointer, Scene, SceneError, Simulation, Snapshot, shapes
from taichi_sim.analysis.methods import named
from taichi_sim.analysis.stability import stability
from taichi_sim.forces.pointer import DRAGGED_PART, MOST_RATE_STEP
from taichi_sim.simulation.contact_capacity import ContactCapacity

pytestmark = pytest.mark.long_in("f64")

DT = 1e-3
HELD, FREE, PINNED = 1, 0, 2
TARGET = np.array([0.3, 1.2])


def three() -> Scene:
    """A free ball, a heavy one to hold and a pinned one, in 2D, with gravity."""
    scene = Scene(dim=2, gravity=(0.0, -10.0))
    velocity = [[0.1, 0.2], [1.0, -2.0], [0, 0]]
    scene.add_balls([[-1, 1], [0, 1], [1, 1]], velocity=velocity, mass=[0.01, 700.0, 1.0], radius=0.05, pinned=[PINNED])
    return scene


@pytest.fixture(scope="module")
def played():
    """A simulation of `three` by symplectic Euler with a pointer; `start` puts it back."""
    pointer = Pointer(rate=40.0)
    with Simulation(three(), integrator="symplectic_euler", dt=DT, contacts="off", forces=[pointer]) as sim:
        yield sim, pointer


@pytest.fixture
def dragged(played):
    sim, pointer = played
    pointer.release()
    sim.resume(Snapshot(sim.scene.position, sim.scene.velocity))
    return sim, pointer


def reference(steps: int, rate: float = 40.0) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity (3, 2) of `three` after steps of symplectic Euler, in float64, the middle ball dragged."""
    scene = three()
    x, v, m = scene.position.copy(), scene.velocity.copy(), scene.mass[:, None]
    for _ in range(steps):
        force = m * scene.gravity
        force[HELD] -= m[HELD] * rate * (rate * (x[HELD] - TARGET) + 2.0 * v[HELD])
        v = np.where(scene.pinned[:, None], 0.0, v + DT * force / m)
        x = x + DT * v
    return x, v


def close(precision: str) -> float:
    return 1e-12 if precision == "f64" else 3e-6


def test_a_dragged_ball_moves_by_the_law(dragged, precision):
    sim, pointer = dragged
    pointer.grab(HELD, TARGET)
    sim.step(60)
    x, v = reference(60)
    assert sim.position == pytest.approx(x, abs=close(precision))
    assert sim.velocity == pytest.approx(v, abs=40 * close(precision))


def test_momentum_changes_by_the_impulse_alone(dragged, precision):
    sim, pointer = dragged
    scene = sim.scene
    pointer.grab(HELD, TARGET)
    before, at = sim.momentum(), sim.position[HELD]
    sim.step()
    away, mass = at - TARGET, scene.mass[HELD]
    impulse = -DT * mass * 40.0 * (40.0 * away + 2.0 * scene.velocity[HELD])
    weight = DT * scene.mass[~scene.pinned].sum() * scene.gravity
    assert sim.momentum() - before == pytest.approx(impulse + weight, rel=10 * close(precision))
    assert pointer.ball == HELD
    assert pointer.target == pytest.approx(TARGET)


def test_it_follows_the_target(dragged):
    sim, pointer = dragged
    pointer.grab(HELD, TARGET)
    sim.run(0.3)
    sag = np.array([0.0, -10.0]) / 40.0**2  # where weight and spring balance
    assert sim.position[HELD] == pytest.approx(TARGET + sag, abs=2e-3)
    pointer.move([-0.5, 0.4])
    sim.run(0.3)
    assert sim.position[HELD] == pytest.approx(np.array([-0.5, 0.4]) + sag, abs=2e-3)


def test_a_ball_let_go_flies_as_one_that_was_never_dragged(dragged, precision):
    sim, pointer = dragged
    pointer.grab(HELD, TARGET)
    pointer.release()
    pointer.move([9.0, 9.0])  # nothing is dragged
    sim.step(100)
    touched = sim.position
    assert pointer.ball is None
    assert pointer.target is None
    with Simulation(three(), integrator="symplectic_euler", dt=DT, contacts="off") as free:
        free.step(100)
        assert touched == pytest.approx(free.position, abs=close(precision))
    sim.resume(Snapshot(sim.scene.position, sim.scene.velocity))
    sim.step(100)
    assert np.array_equal(sim.position, touched)


def test_one_after_the_other(dragged):
    """A second grab lets the first ball go."""
    sim, pointer = dragged
    pointer.grab(FREE, TARGET)
    pointer.grab(HELD, TARGET)
    before = sim.velocity[FREE]
    sim.step()
    assert sim.velocity[FREE] - before == pytest.approx([0.0, -10.0 * DT], rel=1e-3)


def test_it_holds_on_where_a_simulation_is_made_anew_inside(dragged, precision):
    """As when lists of contacts have grown."""
    sim, pointer = dragged
    pointer.grab(HELD, [9.0, 9.0])
    pointer.move(TARGET)
    sim.step(30)
    stepper = sim._stepper
    stepper.parts = stepper.parts.with_capacity(ContactCapacity())
    stepper.primed = False
    sim.step(30)
    x, _ = reference(60)
    assert sim.position == pytest.approx(x, abs=close(precision))


def test_what_cannot_be_dragged(dragged):
    sim, pointer = dragged
    pointer.grab(HELD, TARGET)
    for ball, target, message in (
        (PINNED, TARGET, "ball: 2 is pinned; only balls that move can be dragged"),
        (3, TARGET, r"ball\[0\]: 3 is not allowed; it must name a ball, from 0 to 2"),
        (FREE, [0.0, np.nan], r"target\[1\]: nan is not allowed; it must be a finite number"),
        (FREE, [0.0, 1.0, 2.0], r"target: shape \(3,\) does not fit; it must be \(2,\)"),
    ):
        with pytest.raises(SceneError, match=message):
            pointer.grab(ball, target)
    assert pointer.ball == HELD  # as it was
    with pytest.raises(SceneError, match="target"):
        pointer.move([np.inf, 0.0])
    sim.step()
    assert np.all(np.isfinite(sim.position))
    with pytest.raises(RuntimeError, match="belongs to no open simulation"):
        Pointer().grab(0, TARGET)
    with pytest.raises(ValueError, match="rate: -1"):
        Pointer(rate=-1.0)


def test_a_closed_simulation_is_not_touched():
    pointer = Pointer()
    with Simulation(three(), contacts="off", integrator="symplectic_euler", forces=[pointer]) as sim:
        assert "force.Pointer" in sim.kernels()
    with pytest.raises(RuntimeError, match="belongs to no open simulation"):
        pointer.grab(HELD, TARGET)


def sheet(**balls: object) -> Scene:
    scene = Scene(dim=3, gravity=(0.0, -10.0, 0.0))
    shapes.cloth(scene, size=(1, 1), resolution=(12, 12), **balls)
    return scene


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "mass"), [("verlet", 1e-3), ("verlet", 1e4), ("xpbd", 1.0), ("implicit_euler", 1e4)]
)
def test_a_cloth_of_any_mass_hangs_from_the_hand(method, mass):
    """It comes to rest below the pointer, at nine tenths of the largest step that is safe without it."""
    pointer = Pointer()
    scene = sheet(mass=mass)
    dt = min(4e-3, 0.9 * stability(scene, named(method)).dt_any_shape)
    with Simulation(scene, integrator=method, dt=dt, contacts="off", forces=[pointer]) as sim:
        target = np.array([0.5, 0.5, 0.5])
        pointer.grab(70, target)
        dragged = pointer._balls
        assert scene.mass[dragged].sum() == pytest.approx(DRAGGED_PART * scene.mass.sum(), abs=1.001 * scene.mass[0])
        sim.run(2.0)
        x = sim.position
        rate = min(50.0, MOST_RATE_STEP / sim.dt)
        sag = 10.0 / DRAGGED_PART / rate**2
        assert np.linalg.norm(x[dragged].mean(axis=0) - target) < 2 * sag + 0.1
        assert sim.energy().kinetic < 0.5 * scene.mass.sum() * 2.0**2  # it still swings


def test_two_bodies_are_told_apart():
    """Only what springs join is dragged with the ball, though another lies nearer."""
    scene = Scene(dim=2)
    scene.add_balls([[0, 0], [1, 0], [0.1, 0], [2, 0]], mass=[0.01, 1, 100, 1], radius=0.01, pinned=[3])
    scene.add_springs([[0, 1], [1, 3]], stiffness=1.0)
    pointer = Pointer()
    with Simulation(scene, contacts="off", integrator="symplectic_euler", forces=[pointer]):
        pointer.grab(0, [0, 0])
        assert pointer._balls.tolist() == [0, 1]
        pointer.grab(1, [0, 0])
        assert pointer._balls.tolist() == [1]
