"""Saving a simulation and going on from it."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import taichi_sim as ts
from taichi_sim.analysis.damping import predicts_damping
from taichi_sim.files import checkpoint
from taichi_sim.files.checkpoint import FORMAT
from taichi_sim.files.source import checked_output
from taichi_sim.outputs.recording import Recording

pytestmark = pytest.mark.long_in("f64")


def small_scene():
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_material("rubber", restitution=0.5, colour=(0.2, 0.4, 0.8))
    scene.add_balls([[0, 1], [1, 1]], radius=0.1, velocity=[[0, 0], [0.5, 1]], material="rubber", pinned=[0])
    scene.add_springs([0, 1], stiffness=100.0, damping=1.0, rest_length=0.5)
    scene.add_wall((0, 1), -3.0, material="rubber")
    scene.output = {"fps": 30.0}
    return scene


def test_restored_run_continues_with_the_same_bits(tmp_path):
    with ts.Simulation(small_scene(), dt=2e-3, integrator="symplectic_euler") as sim:
        sim.step(100)
        sim.save(tmp_path / "state.npz")
        sim.step(50)
        with ts.Simulation.restore(tmp_path / "state.npz") as again:
            assert again.time == pytest.approx(0.2)
            assert again.settings.integrator.method.name == "symplectic_euler"
            assert again.scene.materials == sim.scene.materials
            assert again.scene.output == {"fps": 30.0}
            kept = np.load(tmp_path / "state.npz")
            restored = again.snapshot()
            if restored.low_position is not None:  # single precision
                assert np.any(kept["low_position"] != 0.0)
                assert np.array_equal(restored.low_position, kept["low_position"])
                assert np.array_equal(restored.low_velocity, kept["low_velocity"])
            again.step(50)
            assert np.array_equal(again.position, sim.position)
            assert np.array_equal(again.velocity, sim.velocity)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["verlet", "tr_bdf2"])
def test_what_a_method_remembers_is_saved(tmp_path, monkeypatch, method):
    """Accelerations at predicted velocities, slopes; TR-BDF2 solves its first stage from another guess."""
    scene = small_scene()
    scene.set_springs(damping=0.1)
    assert predicts_damping(scene)
    path = tmp_path / "state.npz"
    with ts.Simulation(scene, dt=2e-3, integrator=method, contacts="off") as sim:
        monkeypatch.setattr(sim._stepper, "chunk", 64)
        sim.step(100)  # in the second chunk, whose start needs it
        sim.save(path)
        sim.step(50)
        with ts.Simulation.restore(path) as again:
            again.step(50)
            assert np.array_equal(again.position, sim.position)
            assert np.array_equal(again.velocity, sim.velocity)
        name = f"stepping.ball.{sim.parts.moments.first}"
        _edited(path, signed=True, **{name: 0.5 * np.load(path)[name]})
        with pytest.warns(UserWarning, match="goes on from the positions saved"):
            again = ts.Simulation.restore(path)
        with again:
            again.step(50)
            assert not np.array_equal(again.velocity, sim.velocity)
        _edited(path, signed=True, **{name: None})
        with pytest.raises(
            ts.SceneError, match=r"state\.npz: stepping: is not what Simulation\.snapshot gives \(ball\.\d is missing\)"
        ):
            ts.Simulation.restore(path)


@pytest.mark.long
def test_a_crowd_is_restored_whose_lists_have_grown(tmp_path):
    """Lists grow as soon as it is primed; what the method remembers goes into the fields that are there then."""
    scene = ts.Scene(dim=2, gravity=(0, -9.81))
    scene.add_balls(np.random.default_rng(0).uniform(-0.02, 0.02, (1600, 2)), radius=0.05)
    scene.add_springs([(i, i + 1) for i in range(1599)], stiffness=100.0, damping=0.001, rest_length=0.1)
    assert predicts_damping(scene)
    with ts.Simulation(scene, dt=1e-4) as sim:
        had = sim.parts.contacts.pairs.capacity
        sim.step(1)
        assert sim.parts.contacts.pairs.capacity > had  # the case is what it says
        sim.save(tmp_path / "state.npz")
        with ts.Simulation.restore(tmp_path / "state.npz") as again:
            for pull in (again.parts.integrator.pull, sim.parts.integrator.pull):
                assert np.any(pull.to_numpy() != 0.0)
            assert np.array_equal(again.parts.integrator.pull.to_numpy(), sim.parts.integrator.pull.to_numpy())


@pytest.mark.slow
def test_an_argument_can_be_replaced(tmp_path):
    with ts.Simulation(small_scene(), dt=2e-3) as sim:
        sim.step(100)
        sim.save(tmp_path / "state.npz")
    with ts.Simulation.restore(tmp_path / "state.npz", dt=1e-3) as again:
        assert again.dt == 1e-3
        assert again.time == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("put", "said"),
    [
        (lambda path: path.write_bytes(b"not an archive"), r"other\.npz: is not a state that Simulation\.save wrote"),
        (lambda path: path.write_bytes(b""), r"other\.npz: is not a state"),
        (Path.mkdir, "is not a state"),
        (lambda path: np.savez(path, about=np.array("[" * 50_000)), r"is not a state that Simulation\.save wrote"),
        (lambda path: None, "there is no such file"),
        (
            lambda path: np.savez(path, about=np.array(json.dumps({"format": 99}))),
            f"format: 99 is not allowed; it must be {FORMAT}",
        ),
    ],
    ids=["text", "empty", "folder", "deep", "missing", "later"],
)
def test_another_file_is_refused(tmp_path, put, said):
    put(tmp_path / "other.npz")
    with pytest.raises(ts.SceneError, match=said):
        ts.Simulation.restore(tmp_path / "other.npz")


def test_what_is_no_file_is_refused():
    with (
        ts.Simulation(small_scene()) as sim,
        pytest.raises(ts.SceneError, match=r"path: a Snapshot is no file.*resume"),
    ):
        ts.Simulation.restore(sim.snapshot())
    with pytest.raises(ts.SceneError, match=r"path: 3 is not allowed.*Simulation\.save"):
        ts.Simulation.restore(3)


def test_saving_into_a_missing_folder_writes_nothing(tmp_path):
    with ts.Simulation(small_scene()) as sim, pytest.raises(FileNotFoundError, match="there is no folder"):
        sim.save(tmp_path / "none" / "state.npz")
    assert list(tmp_path.iterdir()) == []


def _edited(path, signed=False, **changes):
    """The archive with some arrays replaced, or left out where the new one is None. signed: as if the program had written it."""
    with np.load(path) as file:
        arrays = dict(file)
    about = json.loads(str(arrays.pop("about")))
    about.update(changes.pop("about", {}))
    arrays = {name: array for name, array in (arrays | changes).items() if array is not None}
    if signed:
        about["digest"] = checkpoint.digest(about, arrays)
    np.savez(path, about=np.array(json.dumps(about)), **arrays)


@pytest.mark.slow
@pytest.mark.parametrize(
    "edit",
    [
        lambda arrays, about: arrays["stepping.contact.0"].fill(2**31 - 1),
        lambda arrays, about: arrays.pop("stepping.contact.0"),
        lambda arrays, about: about["stepping"].update(monitor=-1),
        lambda arrays, about: about["stepping"].update(largest_motion=None),
        lambda arrays, about: about.pop("digest"),
    ],
    ids=["list", "no list", "monitor", "motion", "unsigned"],
)
def test_what_kernels_follow_is_not_taken_from_an_edited_file(tmp_path, edit):
    """Lists of contacts name balls and places of each other: a wrong one would end the process."""
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_balls([[0, 0.1], [0, 0.3]], radius=0.1)
    scene.add_wall((0, 1))
    path = tmp_path / "state.npz"
    with ts.Simulation(scene, dt=1e-3) as sim:
        sim.step(20)
        sim.save(path)
        with np.load(path) as file:
            arrays = dict(file)
        about = json.loads(str(arrays.pop("about")))
        edit(arrays, about)
        np.savez(path, about=np.array(json.dumps(about)), **arrays)
        with pytest.warns(
            UserWarning, match=r"state\.npz: was edited, or written by an earlier version: it goes on from"
        ):
            again = ts.Simulation.restore(path)
        with again:
            assert np.array_equal(again.position, sim.position)
            again.step(20)
            assert np.abs(again.position - sim.position).max() < 1e-3


@pytest.fixture(scope="module")
def state(tmp_path_factory):
    """A state that was saved, what its run counts by and its settings."""
    path = tmp_path_factory.mktemp("saved") / "state.npz"
    with ts.Simulation(small_scene(), dt=2e-3) as sim:
        sim.step(3)
        sim.save(path)
        stepping = json.loads(json.dumps(dict(sim.snapshot().stepping)))
    return path, stepping, json.loads(str(np.load(path)["about"]))["settings"]


NOT_GIVEN = r"state\.npz: stepping: is not what Simulation\.snapshot gives"


@pytest.mark.parametrize(
    ("stepping", "settings", "said"),
    [
        ({"monitor": -1}, {}, NOT_GIVEN),
        ({"monitor": [1, 2]}, {}, NOT_GIVEN),
        ({"largest_motion": None}, {}, NOT_GIVEN),
        ({"begin": 10**400}, {}, NOT_GIVEN),
        ({}, {"dt": -1.0}, r"state\.npz: dt: -1\.0 is not allowed"),
    ],
    ids=str,
)
def test_plain_values_of_a_run_are_judged(tmp_path, state, stepping, settings, said):
    """Those of a file that says that the program wrote it."""
    path = shutil.copy(state[0], tmp_path)
    _edited(path, signed=True, about={"stepping": state[1] | stepping, "settings": state[2] | settings})
    with pytest.raises(ts.SceneError, match=said):
        ts.Simulation.restore(path)


@pytest.mark.parametrize(
    "changes",
    [
        {"position": None},
        {"low_position": np.zeros((2, 2)), "low_velocity": None},
        {"low_position": np.zeros((2, 2)), "low_velocity": np.zeros((3, 2))},
        {"velocity": np.zeros((7, 2))},
        {"position": np.full((2, 2), np.nan)},
        {"about": {"time": "x"}},
        {"about": {"walls": [{"normal": [0.0, 1.0], "offset": 0.0, "material": 7}]}},
        {"about": {"settings": None}},
    ],
    ids=str,
)
def test_a_damaged_file_is_refused_in_one_sentence(tmp_path, state, changes):
    path = shutil.copy(state[0], tmp_path)
    _edited(path, **changes)
    with pytest.raises(ts.SceneError, match=r"state\.npz: is not a state"):
        ts.Simulation.restore(path)


@pytest.mark.slow
def test_another_step_keeps_the_clock(tmp_path):
    with ts.Simulation(small_scene(), dt=1e-3) as sim:
        sim.step(300)
        sim.save(tmp_path / "state.npz")
    with ts.Simulation.restore(tmp_path / "state.npz", dt=7e-4) as again:
        assert again.time == pytest.approx(0.3, rel=1e-12)
        again.step(10)
        assert again.time == pytest.approx(0.307, rel=1e-12)


@pytest.mark.long
def test_numbers_of_numpy_in_the_output_are_plain_everywhere(tmp_path):
    """What Python computes a camera by is of NumPy, and so are flags, sizes and paths."""
    scene = small_scene()
    scene.add_balls([[3, np.float32(1)]], radius=np.float32(0.1), mass=np.int64(2))
    scene.add_collider(ts.Sphere((np.float32(5), 5), np.float32(0.5), velocity=np.array([1, 0])))
    scene.output = {
        "fps": np.float32(30),
        "size": np.array([640, 360]),
        "shadow": np.bool_(False),
        "subdivide": np.int64(1),
        "background": (np.float32(0.5), 0, np.float64(1)),
        "camera": {"centre": np.array([1.0, 2.0]), "width": np.float32(4)},
    }
    wanted = {"fps": 30.0, "size": [640, 360], "shadow": False, "subdivide": 1, "background": [0.5, 0, 1.0]}
    wanted["camera"] = {"centre": [1.0, 2.0], "width": 4.0}
    assert json.loads(json.dumps(checked_output(scene))) == wanted
    with ts.Simulation(scene, dt=np.float32(2e-3), contact_iterations=np.int64(4)) as sim:
        sim.save(tmp_path / "state.npz")
        ts.export(sim, ts.open_output(tmp_path / "x.npz"), duration=0.05, checkpoint=1e-9)
    with ts.Simulation.restore(tmp_path / "state.npz") as again:
        assert json.loads(json.dumps(again.scene.output)) == wanted
    assert json.loads(json.dumps(Recording(tmp_path / "x.npz").scene.output)) == wanted
    scene.save(tmp_path / "x.toml")
    assert json.loads(json.dumps(ts.load_scene(tmp_path / "x.toml").output)) == wanted


def test_paths_in_the_output_are_texts(tmp_path):
    scene = ts.Scene(dim=3)
    scene.add_balls([[0, 0, 0]], radius=0.1)
    scene.add_collider(ts.Sphere(center=(0, -1, 0), radius=0.5, name="globe"))
    scene.output = {"looks": [{"of": "globe", "texture": tmp_path / "wood.png"}], "camera": {"azimuth": np.float32(30)}}
    with ts.Simulation(scene) as sim:
        sim.save(tmp_path / "state.npz")
    with ts.Simulation.restore(tmp_path / "state.npz") as sim:
        assert sim.scene.output["looks"][0]["texture"] == str(tmp_path / "wood.png")
        assert sim.scene.output["camera"] == {"azimuth": 30.0}
    scene.save(tmp_path / "x.toml")
    assert "wood.png" in (tmp_path / "x.toml").read_text()


def test_an_output_that_restore_would_refuse_is_not_saved(tmp_path):
    scene = small_scene()
    scene.output = {"fps": "x"}
    with ts.Simulation(scene) as sim, pytest.raises(ts.SceneError, match=r"scene\.output\.fps: 'x' is not allowed"):
        sim.save(tmp_path / "state.npz")
    assert not list(tmp_path.iterdir())
