"""What a user of Simulation sees: time and frames, warnings and errors, changes between steps, own forces and methods."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from physics_support import EPS, PRECISION, each_dim, error, exact, simulate, vector

import taichi_sim as ts
from taichi_sim.analysis.methods import named
from taichi_sim.analysis.stability import stability

pytestmark = pytest.mark.long_in("f64")

H = 1e-3


def falling(dim=2):
    scene = ts.Scene(dim=dim, gravity=vector(dim, 0.0, -10.0))
    scene.add_balls([vector(dim, 0.0, 1.0)], radius=0.1)
    return scene


def oscillator(k=100.0, c=0.0, rest=1.0):
    scene = ts.Scene(dim=2)
    b = scene.add_balls([[0, 0], [1.1, 0]], radius=0.01, pinned=[0])
    scene.add_springs([b], stiffness=k, damping=c, rest_length=rest)
    return scene


# Time and frames ------------------------------------------------------------------------------------------------------


@each_dim
def test_steps_seconds_and_time(dim):
    with simulate(falling(dim), dt=H) as sim:
        assert sim.time == 0.0
        start = sim.position
        sim.step(0)
        assert sim.time == 0.0
        assert np.array_equal(sim.position, start)
        sim.step()
        sim.step(9)
        assert sim.time == 10 * H
        sim.run(0.25)
        assert sim.time == 260 * H
        sim.run(1.4 * H)  # rounded to whole steps
        assert sim.time == 261 * H
        assert sim.position.shape == sim.velocity.shape == (1, dim)
        assert sim.position.dtype == np.float64
        assert error(sim.velocity[0, 1], -10.0 * 261 * H) < exact(261)


@pytest.mark.parametrize("driver", ["fused", "parallel"])
def test_step_0_only_compiles(driver):
    with simulate(oscillator(), ("ordered", driver), dt=H) as sim:
        start = sim.position
        sim.step(0)
        assert np.array_equal(sim.position, start)
        sim.step(20)
        after = sim.position
    with simulate(oscillator(), ("ordered", driver), dt=H) as sim:
        sim.step(20)
        assert np.array_equal(sim.position, after)


@pytest.fixture(scope="module")
def compiled_fall():
    with simulate(falling(), dt=H) as sim:
        yield sim


@pytest.fixture
def fall(compiled_fall):
    """A ball that falls, at its start."""
    compiled_fall.resume(ts.Snapshot(compiled_fall.scene.position, compiled_fall.scene.velocity))
    return compiled_fall


@pytest.mark.parametrize(
    ("fps", "duration", "count"),
    [(60, 0.5, 31), (30, 0.1, 4), (7, 1.0, 8), (24, 0.0, 1), (10, 0.26, 3), (2, 0.8, 2), (24, 0.15, 4), (30, 0.333333, 11)],
)  # fmt: skip
def test_frames(fall, fps, duration, count):
    """The start, and each k / fps up to the duration and not beyond, each at the step nearest to its time."""
    frames = list(fall.frames(fps=fps, duration=duration))
    assert len(frames) == count
    for k, frame in enumerate(frames):
        assert frame.time == round(k / fps / H) * H
        assert frame.position[0, 1] == pytest.approx(1.0 - 5.0 * frame.time**2, abs=exact(1000))
    assert duration - 1 / fps < frames[-1].time <= duration + H / 2
    assert len(frames) == 1 or frames[0].position is not frames[-1].position


def test_frames_go_on_from_the_present(fall):
    fall.step(100)
    times = [f.time for f in fall.frames(fps=50, duration=0.06)]
    np.testing.assert_allclose(times, [0.1, 0.12, 0.14, 0.16])


def test_substeps_divide_a_step():
    ends = []
    for settings in ({"dt": H, "substeps": 4}, {"dt": H / 4, "substeps": 1}):
        with simulate(oscillator(), **settings) as sim:
            assert sim.substeps == settings["substeps"]
            sim.run(0.2)
            assert sim.time == pytest.approx(0.2)
            ends.append(sim.position)
    assert error(ends[0], ends[1]) < exact(800)
    with simulate(oscillator()) as sim:
        assert sim.substeps >= 1  # "auto" is resolved and reported


def test_half_a_step_is_the_one_given_or_refused(fall):
    with fall.at_half_step() as half:
        assert half.dt == fall.dt / 2.0
    for step in (0, 0.0):
        with pytest.raises(ts.SceneError, match=r"^dt: 0.* is not allowed"):
            fall.at_half_step(half=step)


def test_dt_auto_is_safe_and_at_most_1_ms():
    with simulate(falling()) as sim:
        assert sim.dt == 1e-3
    scene = oscillator(k=1e8)
    for method, part in (("verlet", 0.4), ("symplectic_euler", 0.4), ("rk4", 0.9)):  # an undamped spring
        with simulate(scene, integrator=method) as sim:
            assert sim.dt == pytest.approx(part * sim.stability().dt_any_shape)
            sim.step(500)
            assert np.max(np.abs(sim.position)) < 1.2
    with pytest.raises(ValueError, match="dt"):
        simulate(scene, integrator="explicit_euler")  # nothing is safe with an undamped spring


def test_settings_of_the_scene_are_defaults():
    scene = oscillator()
    scene.settings = {"dt": 2e-3, "integrator": "rk4"}
    with simulate(scene) as sim:
        assert sim.dt == 2e-3
        assert "integrator.rk4" in sim.kernels()
    with simulate(scene, dt=5e-4) as sim:
        assert sim.dt == 5e-4


# Stability ------------------------------------------------------------------------------------------------------------


@pytest.mark.once
@pytest.mark.parametrize(
    ("method", "c", "limit"),
    [
        ("verlet", 0.0, 2.0),
        ("verlet", 20.0, 2.0),
        ("symplectic_euler", 0.0, 2.0),
        ("symplectic_euler", 20.0, 2 * (np.sqrt(2.0) - 1.0)),  # zeta 1: .828
        ("rk4", 0.0, 2.61),
        ("explicit_euler", 20.0, 1.0),
        ("explicit_euler", 2.0, 0.2),
    ],
)
def test_safe_step_of_one_oscillator(method, c, limit):
    """omega = 10: the declared limit on omega h; where motion starts to grow validation/test_limits.py finds by runs."""
    found = stability(oscillator(k=100.0, c=c, rest=0.0), named(method))
    assert found.dt_any_shape == pytest.approx(limit / 10.0, rel=1e-6)
    assert (found.spring, found.ball) == (0, 1)


def test_steps_below_the_bound_are_stable_and_those_above_are_not():
    scene = oscillator(k=100.0, rest=0.0)  # linear, also far from rest
    with simulate(scene, dt=0.98 * 0.2) as sim:
        sim.step(2000)
        assert np.max(np.abs(sim.position)) < 10.0
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a step above the safe bound is meant
            sim.set_dt(1.02 * 0.2)
        with pytest.raises(ts.UnstableError):
            sim.step(2000)


def test_dt_above_the_bound_warns_before_the_first_step():
    with pytest.warns(UserWarning, match=r"0\.2\b.*spring 0") as seen:
        ts.Simulation(oscillator(), arch="cpu", precision=PRECISION, dt=0.21).close()
    assert "safe" in str(seen[0].message)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ts.Simulation(oscillator(), arch="cpu", precision=PRECISION, dt=0.199).close()
        ts.Simulation(oscillator(), arch="cpu", precision=PRECISION, dt=0.3, substeps=2).close()


@pytest.mark.parametrize("driver", ["fused", "parallel"])
@pytest.mark.slow
def test_unstable_error_and_what_is_kept(driver):
    scene = oscillator(k=1e4)
    scene.add_balls([[0.0, 50.0]], radius=0.01, velocity=[1.0, 0.0])
    frames = []
    with simulate(scene, ("ordered", driver), dt=0.03, contacts="off") as sim:
        with pytest.raises(ts.UnstableError) as caught:
            frames.extend(sim.frames(fps=100 / 3, duration=60.0))  # keeps those that came before the error
        problem = caught.value
        assert problem.ball == 1
        assert problem.spring == 0
        assert problem.safe_dt == pytest.approx(0.02)
        assert problem.time == pytest.approx(sim.time + sim.dt)
        for part in ("ball 1", "spring 0", "0.02"):
            assert part in str(problem)
        assert len(frames) > 3
        assert all(np.all(np.isfinite(f.position)) for f in frames)
        # the last good state is kept and can be used: put it right and go on
        assert np.all(np.isfinite(sim.position))
        assert np.all(np.isfinite(sim.velocity))
        assert sim.position[2, 0] == pytest.approx(sim.time, rel=1e-5)
        time = sim.time
        sim.set_position([[0, 0], [1.0, 0], [50, 0]])
        sim.set_velocity(np.zeros((3, 2)))
        sim.step(5)
        assert sim.time == pytest.approx(time + 5 * 0.03)
        assert np.all(np.isfinite(sim.position))


def test_unstable_without_springs_has_no_safe_dt():
    scene = falling()
    with simulate(scene, dt=H) as sim:
        sim.set_velocity([[1e11, 0.0]])
        with pytest.raises(ts.UnstableError) as caught:
            sim.step(100_000)
        assert caught.value.spring is None
        assert caught.value.safe_dt is None
        assert caught.value.ball == 0


# Changing it between steps --------------------------------------------------------------------------------------------


@pytest.mark.slow_where(dim=2)
@each_dim
@pytest.mark.slow
def test_impulse_position_velocity(dim):
    scene = ts.Scene(dim=dim)
    scene.add_balls(np.arange(3)[:, None] * vector(dim, 1.0), radius=0.1, mass=[1.0, 2.0, 4.0], pinned=[2])
    with simulate(scene, dt=H, contacts="off") as sim:
        p = vector(dim, 1.0, 2.0, 3.0)
        sim.apply_impulse([0, 1, 2], p)
        want = np.array([p, p / 2, 0 * p])
        assert np.max(np.abs(sim.velocity - want)) < 8 * EPS
        sim.apply_impulse([1, 1], [p, p])  # twice the same ball: both count
        want[1] += p
        assert np.max(np.abs(sim.velocity - want)) < 8 * EPS
        sim.step(100)
        assert np.max(np.abs(sim.position - scene.position - 0.1 * want)) < 100 * EPS * 4
        x = np.arange(3.0 * dim).reshape(3, dim)
        sim.set_position(x)
        sim.set_velocity(-np.ones((3, dim)))
        assert np.array_equal(sim.position, x)
        assert np.all(sim.velocity[2] == 0.0)
        sim.step(10)
        assert np.max(np.abs(sim.position[:2] - x[:2] + 0.01)) < 100 * EPS * 8
        assert np.array_equal(sim.position[2], x[2])
        for bad in ([[np.nan] * dim] * 3, np.zeros((2, dim)), np.zeros((3, dim + 1)), "here"):
            with pytest.raises(ts.SceneError, match="position"):
                sim.set_position(bad)
            with pytest.raises(ts.SceneError, match="velocity"):
                sim.set_velocity(bad)
        with pytest.raises(ts.SceneError, match=r"balls\[0\]"):
            sim.apply_impulse([3], p)


def test_forces_follow_a_changed_position():
    """The force that the second half of a step left behind is not used after set_position."""
    ends = []
    for moved in (False, True):
        with simulate(oscillator(), dt=H) as sim:
            if moved:
                sim.set_position([[0, 0], [3.0, 0]])
                sim.step(50)
                sim.set_position([[0, 0], [1.1, 0]])
                sim.set_velocity(np.zeros((2, 2)))
            sim.step(100)
            ends.append(sim.position)
    assert np.array_equal(ends[0], ends[1])


@each_dim
def test_conventions_of_energy_and_momentum(dim):
    g = vector(dim, 0.0, -10.0)
    scene = ts.Scene(dim=dim, gravity=g)
    v = vector(dim, 3.0, 4.0)
    b = scene.add_balls(
        [vector(dim, 0.0, 2.0), vector(dim, 1.0, 2.0)], radius=0.01, velocity=v, mass=[2.0, 7.0], pinned=[1]
    )
    scene.add_springs([b], stiffness=50.0, rest_length=0.8)
    with simulate(scene, dt=H) as sim:
        e = sim.energy()
        assert e.kinetic == pytest.approx(25.0, rel=8 * EPS)  # 2 kg at 5 m/s; the pinned ball counts in nothing
        assert e.spring == pytest.approx(0.5 * 50 * 0.04, rel=100 * EPS)
        assert e.gravity == pytest.approx(40.0)  # 0 at the origin
        assert e.total == pytest.approx(e.kinetic + e.spring + e.gravity)
        np.testing.assert_allclose(sim.momentum(), 2.0 * v, rtol=8 * EPS)
        spin = np.asarray(sim.angular_momentum())
        assert spin.shape == (() if dim == 2 else (3,))
        assert (spin if dim == 2 else spin[2]) == pytest.approx(-12.0)  # x v_y - y v_x = -2 * 3, times 2 kg
        assert np.all(sim.velocity[1] == 0.0)
        sim.step(200)
        assert np.array_equal(sim.position[1], vector(dim, 1.0, 2.0))


@pytest.mark.slow
def test_nothing_and_everything_pinned():
    for dim in (2, 3):
        with simulate(ts.Scene(dim=dim, gravity=vector(dim, 0.0, -10.0)), dt=H) as sim:
            sim.step(10)
            assert sim.time == pytest.approx(10 * H)
            assert sim.position.shape == (0, dim)
            assert sim.energy().total == 0.0
            assert len(list(sim.frames(fps=10, duration=0.3))) == 4
        scene = ts.Scene(dim=dim, gravity=vector(dim, 0.0, -10.0))
        b = scene.add_balls(np.zeros((3, dim)), radius=0.1, pinned=True)
        scene.add_springs([b[:2]], stiffness=10.0, damping=1.0, rest_length=1.0, collides=True)
        scene.add_wall(vector(dim, 0.0, 1.0), 1.0)
        with simulate(scene, dt=H) as sim:
            sim.step(10)
            assert np.all(sim.position == 0.0)
            assert np.all(sim.velocity == 0.0)
            assert sim.stability().dt_any_shape == np.inf


# Own parts, and only what is needed -----------------------------------------------------------------------------------


@pytest.mark.parametrize("driver", ["fused", "parallel"])
def test_a_springs_only_scene_has_only_springs(driver):
    """Springs between all balls: no grid, no contact, no wall, by name and by what exists."""
    scene = oscillator()
    with simulate(scene, ("ordered", driver), dt=H) as sim:
        names = " ".join(sim.kernels())
        assert f"driver.{driver}" in names
        assert "springs" in names
        for absent in ("grid", "pairs", "contacts", "walls", "sticks", "gravity", "damping"):
            assert absent not in names, names
        contacts, model = sim.parts.contacts, sim.parts.model
        assert (contacts.walls, contacts.pairs, contacts.sticks) == (None, None, None)
        for absent in ("lightness", "push", "offset"):
            assert not hasattr(contacts, absent)
        for absent in ("radius", "surface", "laws"):
            assert not hasattr(model, absent)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"position": [0.0, 0.0]}, r"position: shape \(2,\) does not fit"),  # not one place for all balls
        ({"position": [[0.0, 0.0]] * 2}, r"position: shape \(2, 2\) does not fit; it must be \(3, 2\)"),
        ({"velocity": None}, "velocity: None is not a list of 2-vectors"),
        ({"velocity": [[1.0, 2.0], [3.0]]}, "velocity: .* is not a list of 2-vectors"),
        ({"stepping": 3}, "stepping: 3 is not allowed; it must be a mapping"),
        ({"memory": {"ball.0.x": np.zeros((2, 2))}}, r"ball\.0\.x has (the wrong type|2 entries)"),
    ],
)
def test_a_snapshot_that_does_not_fit_changes_nothing(changed, words):
    scene = ts.Scene(dim=2)
    scene.add_balls([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]], radius=0.1, velocity=[1.0, 0.0])
    with simulate(scene, contacts="off", dt=1e-3) as sim:
        start = sim.snapshot()
        sim.step(5)
        x, time = sim.position, sim.time
        with pytest.raises(ts.SceneError, match=words):
            sim.resume(replace(start, **changed))
        assert np.array_equal(sim.position, x)
        assert sim.time == time
        sim.resume(start)
        assert sim.time == 0.0


def test_a_closed_simulation_takes_no_snapshot():
    scene = ts.Scene(dim=2)
    scene.add_balls([[0.0, 0.0]], radius=0.1)
    with simulate(scene, contacts="off", dt=1e-3) as sim:
        start = sim.snapshot()
    with pytest.raises(RuntimeError, match="is closed"):
        sim.resume(start)


def test_a_simulation_says_what_it_is():
    scene = ts.Scene(dim=2)
    scene.add_balls([[0.0, 0.0]], radius=0.1)
    with simulate(scene, contacts="off", dt=1e-3) as sim:
        sim.step(5)
        for part in ("Scene in 2D: 1 ball", "time 0.005 s", "integrator verlet", "step 0.001 s", "contacts off"):
            assert part in repr(sim)
        assert '<img alt="" src="data:image/png;base64,' in sim._repr_html_()
    assert repr(sim).startswith("<Simulation, closed")
