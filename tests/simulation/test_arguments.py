"""Bad arguments of Simulation, and backends that this process cannot have: one message that names what is allowed."""

import numpy as np
import pytest
import taichi as ti
from physics_support import F64, PRECISION, simulate

import taichi_sim as ts
from taichi_sim.device import backend
from taichi_sim.device.engine import CompilationError
from taichi_sim.device.parts import STEP, Part
from taichi_sim.integrators.verlet import Verlet

pytestmark = pytest.mark.long_in("f64")

H = 1e-3
OTHER = "f32" if F64 else "f64"


def falling():
    scene = ts.Scene(dim=2, gravity=(0.0, -10.0))
    scene.add_balls([[0.0, 1.0]], radius=0.1)
    return scene


BAD = [
    ({"integrater": "verlet"}, "integrator"),
    ({"contact": "off"}, "contacts"),
    ({"integrator": "verlett"}, "verlet"),
    ({"integrator": 3}, "integrator"),
    ({"dt": float("nan")}, "dt"),
    ({"dt": float("inf")}, "dt"),
    ({"dt": 0.0}, "dt"),
    ({"dt": -1e-3}, "dt"),
    ({"dt": 1e-300}, "from 1e-12 to 1e\\+06 seconds"),
    ({"dt": 1e300}, "from 1e-12 to 1e\\+06 seconds"),
    ({"dt": "fast"}, "dt"),
    ({"dt": [1e-3]}, "dt"),
    ({"substeps": 0}, "substeps"),
    ({"substeps": 1.5}, "substeps"),
    ({"contact_iterations": 0}, "contact_iterations"),
    ({"contact_iterations": True}, "contact_iterations"),
    ({"contacts": "maybe"}, "jacobi"),
    ({"accumulate": "fast"}, "ordered"),
    ({"driver": "both"}, "fused"),
    ({"spin": "yes"}, "spin"),
    ({"arch": "abacus"}, "cpu"),
    ({"precision": "f16"}, "f32"),
    ({"threads": 0}, "threads"),
    ({"threads": 1.5}, "threads"),
    ({"threads": 99_999_999_999}, "threads"),
]


@pytest.mark.parametrize(("settings", "named"), BAD, ids=[f"{k}-{v}" for s, _ in BAD for k, v in s.items()])
def test_bad_arguments(settings, named):
    with pytest.raises(ValueError, match=named):
        ts.Simulation(falling(), **settings)
    scene = falling()
    scene.settings = settings  # from a scene file: the same words
    with pytest.raises(ValueError, match=named):
        ts.Simulation(scene)


def test_unknown_argument_names_the_nearest():
    with pytest.raises(ValueError, match="did you mean 'precision'"):
        ts.Simulation(falling(), precison="f32")
    with pytest.raises(ValueError, match="contact_passes: is now called 'contact_iterations'"):
        ts.Simulation(falling(), contact_passes=4)


def test_another_precision_in_the_same_process():
    with pytest.raises(ts.BackendError, match=r"precision.*process"):
        ts.Simulation(falling(), precision=OTHER)
    with pytest.raises(ts.BackendError, match=r"threads.*process"):
        ts.Simulation(falling(), threads=backend.running().threads + 1)
    with simulate(falling(), dt=H) as sim:
        sim.step(10)  # what runs is unharmed
        assert sim.backend.precision == PRECISION


def test_cuda_without_a_gpu():
    if backend._works("cuda"):
        pytest.skip("this machine has one")
    with pytest.raises(ts.BackendError, match="cuda"):
        ts.Simulation(falling(), arch="cuda")


@pytest.mark.parametrize("n", [-1, 1.5, True, "two", float("nan")])
def test_bad_numbers_of_steps(n):
    with simulate(falling(), dt=H) as sim:
        with pytest.raises(ValueError, match="step"):
            sim.step(n)
        assert sim.time == 0.0


def test_bad_durations_and_rates():
    with simulate(falling(), dt=H) as sim:
        for bad in (-1.0, float("nan"), float("inf")):
            with pytest.raises(ValueError, match="duration"):
                sim.run(bad)
        with pytest.raises(ValueError, match="fps"):
            list(sim.frames(fps=0, duration=1))


@pytest.mark.parametrize("state", [([1e13, 0.0], [0.0, 0.0]), ([0.0, 0.0], [0.0, 1e13])], ids=["position", "velocity"])
def test_a_start_outside_the_world(state):
    with simulate(falling(), dt=H) as sim:
        sim.set_position([state[0]])
        sim.set_velocity([state[1]])
        with pytest.raises(ts.SceneError, match="ball 0 starts at"):
            sim.step()


def test_f32_far_from_the_origin_is_warned_of(recwarn):
    scene = ts.Scene(dim=2)
    scene.add_balls([[1e6, 0.0]], radius=0.1)
    with ts.Simulation(scene, dt=H, precision=PRECISION, arch="cpu"):
        said = [str(w.message) for w in recwarn if "single precision" in str(w.message)]
    assert len(said) == (0 if F64 else 1)


def test_a_step_longer_than_a_frame_is_warned_of():
    with simulate(falling(), dt=0.5) as sim, pytest.warns(UserWarning, match="longer than a frame"):
        assert len(list(sim.frames(fps=10, duration=1.0))) == 11


def test_steps_between_frames_count_towards_the_next():
    with simulate(falling(), dt=H) as sim:
        times = []
        for frame in sim.frames(fps=100, duration=0.05):
            times.append(frame.time)
            sim.step(15 if len(times) == 1 else 0)
    assert times == pytest.approx([0.0, 0.015, 0.02, 0.03, 0.04, 0.05])


def test_more_frames_than_anyone_can_use():
    with simulate(falling(), dt=H) as sim, pytest.raises(ValueError, match="more than 10000000"):
        next(iter(sim.frames(fps=1e9, duration=1e12)))


@pytest.mark.slow
def test_each_part_appears_with_what_needs_it():
    def parts(scene, **settings):
        with simulate(scene, dt=1e-3, **settings) as sim:
            return " ".join(sim.kernels())

    scene = ts.Scene(dim=2, gravity=(0, -10))
    b = scene.add_balls([[0, 1], [1, 1], [0.5, 2]], radius=0.1)
    assert "gravity" in parts(scene, contacts="off")
    assert "grid" not in parts(scene, contacts="off")
    assert "grid" in parts(scene)
    assert "walls" not in parts(scene)
    assert "springs" not in parts(scene)
    scene.add_springs([b[:2]], stiffness=10.0, damping=1.0)
    assert "springs.damping" in parts(scene, contacts="off")
    alone = ts.Scene(dim=2, gravity=(0, -10))
    alone.add_balls([[0, 1]], radius=0.1)
    alone.add_wall((0, 1))
    assert "walls" in parts(alone)
    assert "grid" not in parts(alone)
    for rule in ("jacobi", "sum"):
        assert f"contacts.{rule}" in parts(alone, contacts=rule)


def test_balls_that_start_in_a_wall_are_warned_of():
    scene = falling()
    scene.add_wall((0, 1), float(scene.position[0, 1]) + 7.0)
    with pytest.warns(UserWarning, match=r"walls\[0\]: ball 0 starts with the centre in the solid, up to 7 m deep"):
        ts.Simulation(scene, arch="cpu", precision=PRECISION, dt=H).close()


if not F64:

    def test_a_number_too_large_for_single_precision_spoils_nothing_for_others_f32():
        scene = falling()
        scene.add_wall((0, 1), -1e39)
        with pytest.raises(ts.SceneError, match=r"precision: the offset -1e\+39 does not fit into single precision"):
            simulate(scene, dt=H)
        with simulate(falling(), dt=H) as sim:
            sim.step(1)

    @pytest.mark.parametrize("small", [2e-39, 7e-50])
    def test_a_number_too_small_for_single_precision_is_zero_f32(small):
        """In any column, of the start or set later."""
        scene = ts.Scene(dim=2, gravity=(small, -9.81))
        scene.add_material("oil", restitution=small, friction=small, viscous_friction=small)
        b = scene.add_balls([[small, 1], [1, 1]], radius=[0.1, small], velocity=(small, 1), material="oil")
        scene.add_springs([b], stiffness=small, damping=small, rest_length=small)
        scene.add_wall((0, 1), small, material="oil")
        with simulate(scene, dt=H) as sim:
            sim.step(2)
            sim.set_velocity([[0, -small], [small, 0]])
            sim.set_position([[0, small], [1, small]])
            sim.apply_impulse([0], [[small, 0]])
            sim.step(2)
            assert np.isfinite(sim.position).all()
            assert np.abs(sim.velocity[:, 0]).max() < 1e-30


@ti.data_oriented
class Mistaken:
    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        impulse[0] += nonsense  # noqa: F821


def test_a_mistake_in_ones_own_force_is_shown_with_its_line():
    with pytest.raises(CompilationError) as caught:
        simulate(falling(), dt=H, forces=[Mistaken()]).step(1)
    text = str(caught.value)
    assert 'test_arguments.py", line' in text
    assert "in accumulate" in text
    assert "impulse[0] += nonsense" in text


@ti.data_oriented
class _Mine(ts.Integrator):
    """A method of somebody's own that is made of parts."""

    method = Verlet.method
    given: object = None

    def parts(self):
        return self.given(self) if callable(self.given) else self.given

    @ti.func
    def kick(self, h):
        pass

    def move(self, role, h, time):
        pass


@pytest.mark.once
@pytest.mark.parametrize(
    ("given", "why"),
    [
        (None, r"parts\(\): None is not allowed; it must be a list of Part, of at least one"),
        ([], r"parts\(\): \[\] is not allowed; it must be a list of Part"),
        (["kick"], r"parts\(\)\[0\]: 'kick' is not allowed; it must be a Part\(owner, name, roles\)"),
        (lambda one: [Part(one, "kik", STEP)], r"parts\(\)\[0\]: _Mine has no function kik\(role, h, time\)"),
        (lambda one: [Part(one, "kick", STEP)], r"_Mine.kick takes \(h\); it must take \(role, h, time\)"),
        (lambda one: [Part(one, "move", STEP)], r"_Mine.move is not a Taichi function; write @ti.func above it"),
    ],
)
def test_parts_of_a_method_are_judged_before_they_are_compiled(given, why):
    scene = ts.Scene(dim=2)
    scene.add_balls([[0.0, 1.0]], radius=0.1)
    mine = _Mine()
    mine.given = given
    with pytest.raises(ts.SceneError, match=rf"^integrator _Mine\.{why}" if "parts" in why else why):
        ts.Simulation(scene, integrator=mine, dt=1e-3)
