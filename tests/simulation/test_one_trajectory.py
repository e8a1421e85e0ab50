"""Positions after n steps depend on n alone: not on the driver, calls, frames, looks, checkpoints, nor on where a saved run went
on."""

import warnings

import numpy as np
import pytest
import taichi as ti
import trajectories
from physics_support import PRECISION, simulate

import taichi_sim as ts
from taichi_sim.device import parts

QUICK = {"motors_verlet"}
SLOWER = {"tearing_in_wind", "led_by_pins", "elements"}
MARKS = {
    name: [pytest.mark.long_in("f64")]
    if name in QUICK
    else [pytest.mark.slow, pytest.mark.long_in("f64")]
    if name in SLOWER
    else [pytest.mark.long]
    for name in trajectories.BY_NAME
}


@pytest.mark.parametrize("name", [pytest.param(name, marks=MARKS[name]) for name in trajectories.BY_NAME])
def test_a_run_has_one_trajectory(name, monkeypatch):
    """In either driver; in 1, 7 and 50 calls, as frames of 24, 30 and 60 a second, from ten moments and from a file. Chunks are
    short, so that all this lies across their ends."""
    trajectories.short_chunks(monkeypatch)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert trajectories.differences(trajectories.BY_NAME[name], PRECISION) == []


def swung_too_fast():
    """An undamped net, and a step beyond what is safe that passes as found by the program."""
    scene = ts.Scene(dim=2, gravity=(0, -9.81))
    x = 0.1 * np.stack(np.meshgrid(np.arange(5), np.arange(5)), axis=-1).reshape(-1, 2)
    scene.add_balls(x + 0.01 * np.sin(7.0 * x[:, ::-1]), radius=0.01, mass=0.1, pinned=[20, 24])
    number = np.arange(25).reshape(5, 5)
    pairs = [np.stack([number[:, :-1], number[:, 1:]], -1), np.stack([number[:-1], number[1:]], -1)]
    scene.add_springs(np.concatenate([p.reshape(-1, 2) for p in pairs]), stiffness=500.0, rest_length=0.1)
    return scene


def test_substeps_are_halved_at_the_same_steps_however_these_are_made(monkeypatch):
    """A ball is lost in the midst of a chunk, or energy grows until its end: what is shown after n steps is the same."""
    trajectories.short_chunks(monkeypatch)
    with simulate(swung_too_fast(), contacts="off", substeps=1) as sim, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        own = sim._stepper
        sim.dt = own.dt = 2.2 * sim.stability().dt_present
        sim.parts.set_step(own.h)
        start = sim.snapshot()
        shown, decisions = {}, []
        for calls in ([400], [1, 3, 60, 70, 66, 150, 50], [37] * 10 + [30]):
            sim.resume(start)
            assert sim.substeps == 1
            for n in calls:
                sim.step(n)
                assert shown.setdefault(own.steps, trajectories.digest(sim)) == trajectories.digest(sim)
            decisions.append(sim.decisions())
        assert sim.substeps > 1
        assert "substeps of" in decisions[0][0]
        assert decisions[0] == decisions[1] == decisions[2]


@ti.data_oriented
class Swing:
    """Pushes to and fro."""

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        for i in range(model.n):
            impulse[i] += h * ti.cos(7.0 * time + i) / model.inverse_mass[i] * ti.Vector([2.0, 1.0])


@pytest.mark.slow
@pytest.mark.long_in("f64")
def test_the_times_that_a_users_force_sees_do_not_depend_on_calls():
    """Calls are where what was run before is kept for good; across chunks, frames, and a state that was taken up again."""
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_balls([[0.0, 0.3], [0.15, 0.5], [-0.1, 0.7]], radius=0.06, mass=[0.2, 0.1, 0.4])
    scene.add_wall((0.2, 1), 0.0)
    with ts.Simulation(scene, forces=[Swing()], dt=1.1e-3, precision=PRECISION, arch="cpu") as sim:
        start, ends = sim.snapshot(), []
        for calls in ([900], [1, 130, 3, 500, 266], [19] * 47 + [7]):
            sim.resume(start)
            for n in calls:
                sim.step(n)
            ends.append(trajectories.digest(sim))
        sim.resume(start)
        sim.step(613)
        halfway = sim.snapshot()
        sim.resume(start)
        sim.step(8)
        sim.resume(halfway)
        sim.step(287)
        assert [*ends[1:], trajectories.digest(sim)] == [ends[0]] * 3


@pytest.mark.long
def test_more_room_for_contacts_changes_nothing(monkeypatch):
    """Lists that overflow are made longer in the midst of a chunk: bits are those of a run that had the room."""
    trajectories.short_chunks(monkeypatch)
    scene, settings = trajectories.lists_that_grow()
    with simulate(scene, **settings) as sim:
        start = sim.snapshot()
        first = trajectories.whole(sim, start, 120)
        grown = sim.decisions()
        assert "more room for contacts" in grown[0]  # the case is what it says
        assert trajectories.in_calls(sim, start, 120, 50) == first
    with simulate(scene, **settings) as sim:
        assert trajectories.in_calls(sim, sim.snapshot(), 120, 50) == first
        assert sim.decisions() == grown


@pytest.mark.slow
@pytest.mark.long_in("f64")
def test_what_follows_depends_on_nothing_but_what_is_kept():
    """Whatever the fields hold that are no part of a moment: here those of another run."""
    scene, settings = trajectories.bits.crowd_gauss_seidel()
    with simulate(scene, **settings) as sim:
        sim.step(100)
        snapshot = sim.snapshot()
        sim.step(60)
        one = trajectories.digest(sim)
        sim.resume(ts.Snapshot(scene.position[::-1].copy(), -3.0 * scene.velocity))
        sim.step(77)
        sim.resume(snapshot)
        sim.step(60)
        assert trajectories.digest(sim) == one


def interrupt_launch(patched, number):
    """Let the launch of that number end as by Ctrl-C, of those from the second substep of a call on."""
    repeated, launched = parts.repeated, []

    def interrupted(*arguments):
        launch = repeated(*arguments)

        def one(value):
            launched.append(value)
            if len(launched) == number:
                raise KeyboardInterrupt
            launch(value)

        return one

    patched.setattr(parts, "repeated", interrupted)


@pytest.mark.once
def test_a_run_is_saved_between_a_new_step_and_the_first_of_it(tmp_path):
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_balls([(0, 0), (0.1, -1)], radius=0.01, pinned=[True, False])
    scene.add_springs([[0, 1]], stiffness=700.0, damping=3.0)
    with simulate(scene, dt=1e-3, contacts="off") as sim, warnings.catch_warnings():
        warnings.simplefilter("error")
        sim.step(7)
        sim.set_dt(4e-4)
        sim.save(tmp_path / "state.npz")
        sim.resume(sim.snapshot())
        sim.step(21)
        with ts.Simulation.restore(tmp_path / "state.npz", dt=3e-4) as other:
            other.save(tmp_path / "other.npz")
        with ts.Simulation.restore(tmp_path / "state.npz") as other:
            other.step(21)
            assert np.array_equal(other.position, sim.position)
        with ts.Simulation.restore(tmp_path / "other.npz") as other:
            assert other.time == pytest.approx(7e-3)


@pytest.mark.slow
@pytest.mark.once
def test_what_is_run_again_from_a_saved_state_is_counted_once():
    scene = ts.Scene(dim=2, gravity=(0, -10))
    ts.shapes.jelly(scene, (0.2, 0.2), (3, 3), material="rubber", position=(0, 0.02))
    scene.add_wall((0, 1), 0.0)
    with simulate(scene, integrator="implicit_euler", dt=0.01) as sim:
        start = sim.snapshot()
        sim.step(19)
        whole = sim.solver()
        sim.resume(start)
        sim.step(12)
        halfway = sim.snapshot()
        sim.step(3)
        sim.resume(halfway)
        sim.step(7)
        assert sim.solver() == whole


@pytest.mark.slow
@pytest.mark.parametrize("saves", [False, True])
@pytest.mark.long_in("f64")
def test_an_interrupted_call_changes_nothing(saves, monkeypatch):
    """As by Ctrl-C in the midst of a call: what was made of it is made again."""
    scene, settings = trajectories.bits.crowd_gauss_seidel()
    with simulate(scene, ("ordered", "parallel"), **settings) as sim:
        start = sim.snapshot()
        whole = trajectories.whole(sim, start, 40)
        sim.resume(start)
        sim.step(10)
        with monkeypatch.context() as patched:
            interrupt_launch(patched, 17)
            with pytest.raises(KeyboardInterrupt):
                sim.step(10)
        assert sim.time == pytest.approx(10 * sim.dt)
        if saves:
            sim.resume(sim.snapshot())
        sim.step(30)
        assert trajectories.digest(sim) == whole


@pytest.mark.slow
def test_what_is_set_after_an_interrupted_call_stays(monkeypatch):
    """The rest of that call is not made again over it."""
    scene, settings = trajectories.bits.crowd_gauss_seidel()
    with simulate(scene, ("ordered", "parallel"), **settings) as sim:
        sim.step(10)
        with monkeypatch.context() as patched:
            interrupt_launch(patched, 1)
            with pytest.raises(KeyboardInterrupt):
                sim.step(10)
        sim.set_position(scene.position)
        assert np.array_equal(sim.snapshot().position, sim.position)
        assert np.abs(sim.position - scene.position).max() < 1e-6


@pytest.mark.once
@pytest.mark.long_in("f64")
def test_a_resumed_ball_has_forgotten_the_walls_that_it_left():
    """Out of a corner into the air, then on the floor: the other wall is 3 m away."""
    scene = ts.Scene(dim=2, gravity=(0, -9.81))
    scene.add_balls([[0.1, 0.1]], radius=0.1)
    scene.add_wall((0, 1), 0.0)
    scene.add_wall((1, 0), 0.0)
    with ts.Simulation(scene, dt=1e-3) as sim, ts.Simulation(scene, dt=1e-3) as other:
        sim.set_velocity([[-0.005, 0.0]])
        sim.step(20)
        sim.set_position([[3.0, 0.101]])
        sim.set_velocity([[-1.0, 0.0]])
        sim.step(5)
        other.resume(sim.snapshot())
        for each in (sim, other):
            each.step(30)
            assert each.velocity[0, 0] == pytest.approx(-1.0, abs=1e-6)
        np.testing.assert_array_equal(other.position, sim.position)
