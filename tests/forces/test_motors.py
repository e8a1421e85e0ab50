"""Springs whose rest length follows a sine or keyframes, against closed forms; every method, order of sums and driver."""

import numpy as np
import pytest
from physics_support import EPS, F64, PRECISION, simulate
from scene_files import assert_refused
from trajectories import KEYS

import taichi_sim as ts

K, M, LENGTH, PART, FREQUENCY = 40.0, 0.5, 1.0, 0.1, 0.8  # N/m, kg, m, 1, 1/s
RATE = 2.0 * np.pi * FREQUENCY
AMPLITUDE = PART * LENGTH * (K / M) / (K / M - RATE**2)  # m, of the steady motion


def oscillator() -> ts.Scene:
    """A mass on a driven spring without damping, begun in its steady motion: x = L + A sin(w t), for m x'' = k (l(t) - x)."""
    scene = ts.Scene(dim=2)
    position, velocity = [[0.0, 0.0], [LENGTH, 0.0]], [[0.0, 0.0], [AMPLITUDE * RATE, 0.0]]
    balls = scene.add_balls(position, radius=0.01, mass=M, pinned=[0], velocity=velocity)
    scene.add_motor(scene.add_springs([balls], stiffness=K), amplitude=PART, frequency=FREQUENCY)
    return scene


@pytest.mark.slow_where(method=["rk4", "symplectic_euler", "explicit_euler", "xpbd", "implicit_euler"])
@pytest.mark.parametrize(
    ("method", "order", "off"),  # off: at 2 ms, after a second, parts of the amplitude
    [
        pytest.param("verlet", 2, 3e-5, id="verlet"),
        pytest.param("rk4", 4, 1e-8, id="rk4"),
        pytest.param("symplectic_euler", 2, 3e-5, id="symplectic_euler"),  # of places; velocities are half a step off
        pytest.param("explicit_euler", 1, 1e-2, id="explicit_euler"),
        pytest.param("xpbd", 1, 1e-2, id="xpbd"),
        pytest.param("implicit_euler", 1, 1e-2, id="implicit_euler"),
        pytest.param("tr_bdf2", 2, 3e-5, id="tr_bdf2"),
    ],
)
def test_steady_motion_with_the_order_of_each_method(method, order, off):
    errors = []
    for h in (4e-3, 2e-3):
        with simulate(oscillator(), integrator=method, dt=h, substeps=1, contacts="off") as sim:
            sim.step(round(1.0 / h))
            errors.append(abs(sim.position[1, 0] - LENGTH - AMPLITUDE * np.sin(RATE * sim.time)) / AMPLITUDE)
    assert errors[1] < max(off, 40 * EPS)
    if errors[1] > 400 * EPS:
        assert abs(np.log2(errors[0] / errors[1]) - order) < 0.3


def test_energy_strain_and_tension_are_those_of_the_present_rest_length():
    """A spring between two pins carries k l (1 - (1 + e)); what a motor does is no gain of energy that nothing explains."""
    scene = ts.Scene(dim=2)
    balls = scene.add_balls([[0.0, 0.0], [2.0, 0.0]], radius=0.1, pinned=True)
    balls = np.append(balls, scene.add_balls([[0.0, 5.0]], radius=0.1))
    spring = scene.add_springs([balls[:2]], stiffness=30.0)
    scene.add_motor(spring, path=KEYS, repeat=True)
    scene.add_probe("load", "tension", spring=int(spring[0]))
    scene.add_probe("pull", "strain", springs=spring)
    with simulate(scene, dt=1e-3, contacts="off") as sim:
        for frame in sim.frames(fps=20, duration=1.2):
            strain = np.interp(0.1 + np.mod(max(frame.time - 0.1, 0.0), 0.5), *zip(*KEYS))
            assert frame.energy.spring == pytest.approx(0.5 * 30.0 * (2.0 * strain) ** 2, abs=1e-9)
            assert frame.strain[0] == pytest.approx(1.0 / (1.0 + strain) - 1.0, abs=1e-9)
            assert sim.energy() == frame.energy
            assert sim.probe("load.tension") == pytest.approx(-30.0 * 2.0 * strain, abs=1e-9)
            assert sim.probe("pull.max") == pytest.approx(frame.strain[0], abs=1e-9)
            sample = sim.parts.state_probe.sample()
            assert sample.elastic == pytest.approx(frame.energy.spring, rel=2e-3 if not F64 else 1e-9, abs=1e-6)
        assert np.array_equal(scene.rest_length, [2.0])


def test_the_work_of_a_motor_is_no_error(tmp_path, recwarn):
    """At resonance the energy grows without end, with the step left to the program: no warning, no shorter steps, no verdict."""
    scene = ts.Scene(dim=2)
    balls = scene.add_balls([[0.0, 0.0], [1.0, 0.0]], radius=0.01, mass=M, pinned=[0])
    frequency = float(np.sqrt(K / M) / (2.0 * np.pi))
    scene.add_motor(scene.add_springs([balls], stiffness=K), amplitude=0.02, frequency=frequency)
    with ts.Simulation(scene, precision=PRECISION, contacts="off") as sim:
        summary = ts.export(sim, None, fps=10, duration=8.0)
        # from rest: x - L = (a L / 2) (sin(w t) - w t cos(w t))
        angle = 2.0 * np.pi * frequency * sim.time
        assert sim.position[1, 0] - 1.0 == pytest.approx(0.01 * (np.sin(angle) - angle * np.cos(angle)), abs=2e-4)
        assert sim.decisions() == []
    assert summary.energy_end[3] > 50 * 0.5 * K * 0.02**2
    assert not any("gained" in line or "wrong" in line for line in summary.lines())
    assert not recwarn.list


@pytest.mark.slow
def test_a_tolerance_holds():
    with simulate(oscillator(), tolerance=1e-4, contacts="off") as sim:
        sim.run(1.0)
        assert abs(sim.position[1, 0] - LENGTH - AMPLITUDE * np.sin(RATE * sim.time)) < 1e-4 * 1.02


FILE = """
format = 1
dim = 3
[[rope]]
name = "worm"
start = [0.0, 0.0, 0.0]
end = [1.0, 0.0, 0.0]
n = 5
[[motors]]
balls = "worm"
members = [0, 1, 2]
amplitude = 0.2
frequency = 2.0
phase = 90.0
[[motors]]
springs = [3]
path = [{ time = 0.0, strain = 0.0 }, { time = 1.0, strain = -0.5 }]
"""


def test_scene_files_name_the_springs_of_motors(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text(FILE)
    scene = ts.load_scene(file)
    assert [motor.springs.tolist() for motor in scene.motors] == [[0, 1], [3]]
    assert np.allclose(scene.at(0.0).rest_length / scene.rest_length, [1.2, 1.2, 1.0, 1.0])
    assert np.allclose(scene.at(0.5).rest_length / scene.rest_length, [0.8 + 0.4, 1.2, 1.0, 0.75])
    assert "2 motors" in repr(scene)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('balls = "worm"', 'balls = "warm"', r"line 10: motors\[0\].balls: 'warm' is not a name"),
        ("members = [0, 1, 2]", "members = [0, 2]", r"motors\[0\].balls: no spring joins two of them"),
        ("members = [0, 1, 2]", "springs = [0]", r"motors\[0\].springs: or `balls` must say which springs"),
        ('balls = "worm"', "springs = [0]", r"line 11: motors\[0\].members: count within `balls`"),
        ("amplitude = 0.2", "amplitude = 1.5", r"line 12: motors\[0\].amplitude: 1.5 .*between -1 and 1"),
        ("amplitude = 0.2", "", r"motors\[0\].amplitude: is missing"),
        ("frequency = 2.0", "frequency = -2.0", r"line 13: motors\[0\].frequency"),
        ("frequency = 2.0", "frequency = 2.0\nrepeat = true", r"motors\[0\].repeat: there is no path"),
        ("springs = [3]", "springs = [4]", r"line 16: motors\[1\].springs\[0\]"),
        ("springs = [3]", "springs = [1]", r"motors\[1\]: spring 1 is driven twice"),
        ("springs = [3]", "springs = []", r"motors\[1\].springs: is empty"),
        ("strain = 0.0", "strain = 0.1", r"line 17: motors\[1\].path\[0\].strain: 0.1 .*jump"),
        ("strain = -0.5", "strain = -1.0", r"motors\[1\].path\[1\].strain: -1.0 .*more than -1"),
        ("time = 1.0", "time = 0.0", r"motors\[1\].path\[1\].time: 0.0 .*times must rise"),
        ("time = 1.0, strain", "time = 1.0, length", r"motors\[1\].path\[1\].length: is not a known key"),
        ("strain = -0.5 }]", "strain = -0.5 }]\nrepeat = true", r"motors\[1\].path\[1\].strain: -0.5 .*jump"),
        ("springs = [3]", "springs = [3]\namplitude = 0.1", r"motors\[1\].amplitude: is given together with a path"),
    ],
)
def test_mistakes_are_named(tmp_path, old, new, words):
    assert_refused(tmp_path, FILE, old, new, words)


def test_what_springs_cannot_follow_is_said(recwarn):
    fast = ts.Scene(dim=2)
    balls = fast.add_balls([[0.0, 0.0], [1.0, 0.0]], radius=0.1)
    fast.add_motor(fast.add_springs([balls], stiffness=1.0), amplitude=0.5, frequency=100.0)
    for scene in (oscillator(), fast):
        ts.Simulation(scene, precision=PRECISION, dt=1e-3).close()
    assert ["motors[0]: changes rest lengths by 0.31" in str(one.message) for one in recwarn] == [True]
