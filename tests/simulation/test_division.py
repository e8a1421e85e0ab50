"""Substeps of implicit methods that gain energy are made again in shorter parts, where their number is left to the program."""

import numpy as np
import pytest
from physics_support import simulate

import taichi_sim as ts
from taichi_sim.simulation.assembly import Assembly

STEPS = 14


def meeting():
    """Two bodies of bricks, one three times as heavy as the other, that meet off centre."""
    scene = ts.Scene(dim=3, gravity=(0.0, 0.0, 0.0))
    for k, density in enumerate((500.0, 1500.0)):
        law = {"density": density, "young_modulus": 3e5, "poisson_ratio": 0.25, "radius": 0.025}
        place = (0.04 * k, 0.17 * k, 0.02 * k)
        balls = ts.shapes.jelly(scene, (0.1, 0.1, 0.1), (2, 2, 2), position=place, **law).balls
        scene.set_balls(balls, velocity=(0.0, 1.1 - 1.7 * k, 0.1))
    return scene


def landing(phase, h):
    """A square of solids that lands flat, `phase` of a step after an end of one."""
    scene = ts.Scene(dim=2, gravity=(0.0, -2.0))
    scene.add_wall((0, 1))
    grid = 0.1 * np.stack(np.meshgrid(*[np.arange(3.0)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    first = np.array([0, 1, 3, 4])
    cut = [[a, a + 3, a + 4] for a in first] + [[a, a + 4, a + 1] for a in first]
    balls = scene.add_balls(
        grid + np.array([0.0, 0.02 + (1.5 + phase) * 2.0 * h]), mass=0.1, radius=0.02, velocity=(0.0, -2.0)
    )
    scene.add_solids(balls[cut], young_modulus=3e4, poisson_ratio=0.2)
    return scene


def rise(sim, steps):
    """The largest gain of a step, in parts of the largest kinetic energy, and the last energy."""
    stored = [sim.energy()]
    for _ in range(steps):
        sim.step()
        stored.append(sim.energy())
    total = [one.total for one in stored]
    return np.diff(total).max() / max(one.kinetic for one in stored), total[-1]


@pytest.mark.slow
@pytest.mark.long_in("f64")
@pytest.mark.filterwarnings(
    "ignore::UserWarning"
)  # impacts may give energy in steps so long, and one substep is asked for
def test_bodies_that_meet_gain_no_energy():
    """Contacts stop balls after the stage, which strains what holds them: two substeps gave several times the energy."""
    scene, h = meeting(), 1 / 70
    with simulate(scene, integrator="implicit_euler", dt=h, substeps=1) as sim:
        assert rise(sim, STEPS)[0] > 0.5
        assert not any("made again" in one for one in sim.decisions())
    with simulate(scene, integrator="implicit_euler", dt=h) as sim:
        gain, end = rise(sim, STEPS)
        momentum = scene.mass @ sim.velocity
        assert sum("made again in parts" in one for one in sim.decisions()) == 1
        assert sim.scales().gained == 0.0
        assert sim.scales().risen == 0.0
    assert gain < 5e-3
    assert end < 0.9 * np.sum(0.5 * scene.mass * (scene.velocity**2).sum(axis=1))
    np.testing.assert_allclose(momentum, scene.mass @ scene.velocity, atol=1e-5 * scene.mass.sum())


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_divided_substeps_are_the_same_bits_in_other_calls_and_after_a_snapshot(monkeypatch):
    scene, primed = meeting(), []
    prime = Assembly.prime
    monkeypatch.setattr(Assembly, "prime", lambda parts, *time: primed.append(time) or prime(parts, *time))
    with simulate(scene, integrator="implicit_euler", dt=1 / 70) as sim:
        start, found, divided = sim.snapshot(), [], []
        for _ in range(STEPS):
            sim.step()
            found.append(sim.position)
            divided.append(sim.decisions()[-1:])
        changes = [k for k in range(1, STEPS) if divided[k] != divided[k - 1]]
        assert changes
        sim.resume(start)
        primed.clear()
        sim.step(STEPS)
        assert np.array_equal(sim.position, found[-1])
        assert sim.decisions()[-1:] == divided[-1]
        assert len(primed) < STEPS  # as many parts as before go on from what is there
        for halfway in (changes[0], changes[0] + 1, STEPS - 3):
            sim.resume(start)
            sim.step(halfway)
            state, watch = sim.snapshot(), sim._stepper.monitor.stored()
            sim.step(2)
            sim.reset(meeting())
            sim.resume(state)
            assert sim._stepper.monitor.stored() == watch
            assert sim.decisions()[-1:] == divided[halfway - 1]
            sim.step(STEPS - halfway)
            assert np.array_equal(sim.position, found[-1])
            assert sim.decisions()[-1:] == divided[-1]


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.slow
def test_a_body_that_lifts_off_gains_no_energy():
    """One that landed at certain moments of a step gained a tenth of its energy in the one in which it left."""
    h, gains = 1 / 80, []
    for substeps in (1, "auto"):
        each = []
        for phase in np.arange(10) / 10:
            with simulate(landing(phase, h), integrator="tr_bdf2", dt=h, substeps=substeps) as sim:
                each.append(rise(sim, 11)[0])
        gains.append(max(each))
    assert gains[0] > 0.02
    assert gains[1] < 5e-3
