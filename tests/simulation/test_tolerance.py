"""tolerance: the step is chosen by its error, which is what was asked; with files, frames, drivers, contacts."""

import warnings

import numpy as np
import pytest
from calibration import KINDS, rows
from physics_support import F64, PRECISION, error, simulate

import taichi_sim as ts
from taichi_sim.simulation import error_control

pytestmark = pytest.mark.long_in("f32")

T = 0.5


def pair():
    """Two balls on a spring, 200 rad/s: 48 s of the clock for each second of the motion at 60 fps."""
    scene = ts.Scene(dim=2)
    b = scene.add_balls([[0, 0], [1.1, 0]], radius=0.01, pinned=[0])
    scene.add_springs([b], stiffness=4e4, rest_length=1.0)
    return scene


def exact_end(seconds=T):
    return 1.0 + 0.1 * np.cos(200.0 * seconds)


@pytest.mark.slow_where(method="tr_bdf2")
@pytest.mark.parametrize("method", ["verlet", "rk4", "tr_bdf2"])
def test_the_error_is_what_was_asked_for(method):
    """Never above, and not far below, where stability leaves a choice; the estimate tells it within a factor of 8."""
    for tolerance in (1e-3, 1e-5) if F64 else (1e-3,):
        with simulate(pair(), integrator=method, tolerance=tolerance) as sim:
            sim.run(T)
            found = sim.error()
            got = abs(sim.position[1, 0] - exact_end()) / found.size
            assert got < tolerance * T
            assert got < found.estimate
            assert found.estimate < tolerance * T
            assert found.lost is None
            assert found.estimate > tolerance * T / 30
            assert found.tolerance == pytest.approx(tolerance)
            assert found.size == pytest.approx(1.12)


@pytest.mark.slow
def test_what_contacts_hold_goes_with_the_step():
    """Loaded for a step twice as long, they hold twice the impulse: along normals and along surfaces."""
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_material("rubber", friction=0.5)
    scene.add_balls([[0, 0.1], [0.19, 0.1], [0.1, 0.26]], radius=0.1, material="rubber")
    scene.add_wall((0, 1), 0.0, "rubber")
    with simulate(scene, tolerance=1e-3) as sim:
        sim.step(1)
        contacts, second = sim.parts.contacts, sim.parts.moments
        held = [
            table.get_member_field(name)
            for table in (contacts.pairs.link, contacts.walls.contact)
            for name in ("impulse", "tangential_impulse")
        ]
        for field in held:
            field.fill(3.0)
        second.store(0)
        second.load(0, 2.0 * second.h[0])
        for field in held:
            assert np.all(field.to_numpy()[0] == 6.0)


@pytest.fixture(scope="module")
def swinging():
    """A damped net of 25 balls in 3D with verlet, whose damping depends on the step."""
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    sheet = ts.shapes.cloth(scene, size=(1, 1), resolution=(5, 5), stiffness=200.0, damping=0.005)
    scene.set_balls(sheet.balls[:5], pinned=True)
    return scene


TOLERANCE = 1e-4


def test_it_ends_where_small_steps_end(swinging):
    with simulate(swinging, tolerance=TOLERANCE) as sim:
        frames = list(sim.frames(fps=60, duration=T))
        sim.run(T - sim.time)
        assert [f.time for f in frames] == pytest.approx([k / 60 for k in range(31)])
        end, found = sim.position, sim.error()
    with simulate(swinging, dt=5e-5) as sim:
        sim.run(T)
        apart = np.linalg.norm(sim.position - end, axis=1).max() / found.size
    assert apart < TOLERANCE * T


def met(scene, x, v, seconds):
    """Where two elastic balls without friction are after so many seconds, (2, dim): the exact law."""
    r, u, reach = x[1] - x[0], v[1] - v[0], scene.radius.sum()
    along = r @ u
    at = (-along - np.sqrt(along**2 - (u @ u) * (r @ r - reach**2))) / (u @ u)
    n = (r + at * u) / reach
    w = 1.0 / scene.mass
    j = 2.0 * (u @ n) / w.sum()
    after = v + np.array([w[0] * j * n, -w[1] * j * n])
    return x + at * v + (seconds - at) * after


@pytest.mark.slow
def test_balls_that_glance_end_where_they_should():
    """Both solutions would notice the hit in the same instant, did they share any: their distance was 1e-14."""
    scene = ts.Scene(dim=2)
    scene.add_material("hard", restitution=1.0)
    scene.add_balls([[0, 0], [0.9, 0.1]], radius=[0.12, 0.09], mass=[1.0, 0.6], material="hard")
    tolerance = 1e-3
    with simulate(scene, tolerance=tolerance) as sim:
        for offset, speed in ((0.205, 3.1), (0.195, 1.7), (0.15, 4.3), (0.11, 2.3), (0.0, 6.1), (0.18, 1.2)):
            x, v = np.array([[0.0, 0.0], [0.6, offset]]), np.array([[speed, 0.0], [0.1, 0.0]])
            sim.resume(ts.Snapshot(x, v))
            sim.run(T)
            found = sim.error()
            off = np.linalg.norm(sim.position - met(scene, x, v, T), axis=1).max() / found.size
            assert found.lost is None
            assert off < min(tolerance * T, found.estimate), (offset, speed)


def hand(scene, **settings):
    """What a held ball does whose hand moves between steps."""
    pointer = ts.Pointer(rate=20.0)
    with simulate(scene, forces=[pointer], **settings) as sim:
        pointer.grab(1, target=(1.1, 0.5))
        sim.run(0.2)
        pointer.move((0.4, -1.0))
        sim.run(0.3)
        return sim.position, sim.error()


@pytest.mark.slow
def test_what_a_hand_did_before_is_not_repeated():
    """With user-defined forces, steps go back no further than to where they were last asked for."""
    scene = pair()
    end, found = hand(scene, tolerance=1e-3)
    exact, _ = hand(scene, dt=2e-5)
    assert found.repeated > 0
    assert np.linalg.norm(end - exact, axis=1).max() / found.size < 1e-3 * 0.5


@pytest.mark.long
@pytest.mark.parametrize("name", KINDS)
def test_calibration(name):
    """Of scenes drawn at random: what is promised is kept."""
    for row in rows(name, 1, 4, 11):
        assert row.lost is not None or row.unsure is not None or row.error < 1.0 + row.known, row
        assert row.said


@pytest.mark.slow
def test_contacts_that_act_together_are_no_promise():
    """A ball by itself is one; three that lie on each other are not, and that is said once, in the summary, too."""
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_wall((0, 1), 0.0)
    scene.add_balls([[0.0, 0.4]], radius=0.1)
    with simulate(scene, tolerance=1e-3) as sim:
        sim.run(0.3)
        assert sim.error().unsure is None
    scene.add_balls([[1.0, 0.1], [1.0, 0.3], [1.0, 0.5]], radius=0.1)
    with simulate(scene, tolerance=1e-3) as sim:
        with pytest.warns(UserWarning, match="no promise from t = .* contacts act"):
            sim.run(0.3)
        assert 0.0 <= sim.error().unsure < 0.1
        assert sim.error().lost is None


@pytest.mark.long
def test_impacts_do_not_drive_the_step_to_nothing():
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_material("rubber", restitution=0.5)
    scene.add_balls([[0, 0.5], [0.05, 0.8], [0, 1.1]], radius=0.1, material="rubber")
    scene.add_wall((0, 1), 0.0, material="rubber")
    for normal in ((1, 0), (-1, 0)):
        scene.add_wall(normal, -0.3, material="rubber")
    with simulate(scene, tolerance=1e-3) as sim:
        start = sim.energy().total
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            sim.run(0.8)
        found = sim.error()
        assert found.most <= 2**15
        assert (found.lost is None) == (not any("cannot be kept" in str(warning.message) for warning in said))
        assert found.estimate < 1e-3 * 0.8 or found.lost is not None
        assert sim.energy().total < start
        assert sim.penetration() < 0.02


@pytest.mark.once
def test_a_lost_tolerance_is_said_of_the_line_that_asked_for_the_steps(monkeypatch):
    """By whatever way it asked, and after a reset."""
    monkeypatch.setattr(error_control, "DOUBLINGS", 0)
    with simulate(pair(), tolerance=2e-3) as sim:
        for go in (lambda: sim.step(40), lambda: sim.run(0.5), lambda: list(sim.frames(60, 0.5))):
            sim.reset(pair())
            with pytest.warns(UserWarning, match="cannot be kept") as said:
                go()
            assert [one.filename for one in said] == [__file__]
            assert sim.error().lost is not None


def test_what_is_refused():
    scene = pair()
    for bad, words in (
        ({"tolerance": 0.0}, "tolerance: 0"),
        ({"tolerance": 2.0}, r"tolerance: 2\.0 is not allowed; it must be less than 1"),
        ({"tolerance": "fine"}, "tolerance"),
        ({"tolerance": 1e-3, "dt": 1e-3}, r"tolerance: chooses the step, but dt = 0\.001 is given too"),
        ({"tolerance": 1e-3, "substeps": 2}, "but substeps = 2 is given too"),
        ({"tolerance": 1e-17}, "is less than what rounding leaves in f"),
    ):
        with pytest.raises(ValueError, match=words):
            ts.Simulation(scene, arch="cpu", precision=PRECISION, **bad)
    if not F64:
        with pytest.raises(ValueError, match='use precision "f64"'):
            simulate(scene, tolerance=1e-7)
        scene = ts.Scene(dim=2, gravity=(0, -10))
        scene.add_springs([scene.add_balls([[0, 0], [0, -1]], radius=0.01, pinned=[True, False])], stiffness=1e9)
        with pytest.raises(ValueError, match="tolerance: cannot be met in f32: the weight at spring 0 "):
            simulate(scene, tolerance=1e-3)


def test_arguments_replace_what_the_scene_says():
    scene = pair()
    scene.settings = {"dt": 1e-3, "substeps": 2}
    with simulate(scene, tolerance=1e-2) as sim:
        assert sim.error() is not None
    scene.settings = {"tolerance": 1e-2}
    with simulate(scene, dt=1e-3) as sim:
        assert sim.error() is None
        assert sim.dt == 1e-3


def test_a_scene_file_may_name_it(tmp_path):
    scene = pair()
    scene.settings = {"tolerance": 2e-3}
    scene.save(tmp_path / "pair.toml")
    again = ts.load_scene(tmp_path / "pair.toml")
    assert again.settings["tolerance"] == 2e-3
    assert error(again.position, scene.position) == 0.0


@pytest.mark.long
def test_an_error_above_what_was_asked_is_said():
    """Elastic discs in a box meet all the time: no step is short enough."""
    scene = ts.Scene(dim=2)
    scene.add_material("hard", restitution=1.0)
    rng = np.random.default_rng(1)
    x = 0.3 * np.stack(np.meshgrid(np.arange(5), np.arange(5)), axis=-1).reshape(-1, 2) + 0.2
    scene.add_balls(x, radius=0.1, velocity=rng.normal(0, 3, x.shape), material="hard")
    for normal, offset in (((1, 0), 0.0), ((-1, 0), -1.6), ((0, 1), 0.0), ((0, -1), -1.6)):
        scene.add_wall(normal, offset, material="hard")
    with simulate(scene, tolerance=1e-4) as sim:
        with pytest.warns(
            UserWarning, match=r"the tolerance of 0\.0001 a second cannot be kept from t = .* s on"
        ) as said:
            sim.run(1.0)
        found = sim.error()
        assert len(said) == 1
        assert 0.0 < found.lost < 1.0
        assert found.estimate > 1e-4
        assert sim.substeps <= 8 * found.least  # what is lost costs no more
