"""Cameras that move: where they are at a time, how smoothly, what is refused, and that files keep them."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from taichi_sim.kernels.render.shade import pixel_ray

from taichi_sim import Capsule, Frame, Scene, SceneError, Simulation
from taichi_sim.analysis.frame import Placed
from taichi_sim.device.engine import ti
from taichi_sim.files.source import checked_output
from taichi_sim.files.toml_reader import load_scene
from taichi_sim.render import Camera, Renderer
from taichi_sim.render.camera import view_matrix
from taichi_sim.render.tracker import Tracker
from taichi_sim.scene.camera_path import CameraPath, eased
from taichi_sim.shapes import cloth

pytestmark = pytest.mark.once

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ASPECT = 16 / 9


def frame_at(time, position, velocity=None, dim=3):
    x = np.asarray(position, dtype=float).reshape(-1, dim)
    v = np.zeros_like(x) if velocity is None else np.asarray(velocity, dtype=float).reshape(-1, dim)
    return Frame(time=time, position=x, velocity=v, radius=np.full(len(x), 0.2))


START = frame_at(0.0, [[0, 0, 0], [2, 1, 0], [0, 1, 3]])


def test_the_default_shows_all():
    for given in (None, {}, CameraPath()):
        tracker = Tracker(START, given, ASPECT)
        assert tracker.at(frame_at(1.0, START.position)) == Camera.fit(START, ASPECT)


def on_screen(camera, frame):
    """Places of balls (n, 2), within -1 and 1 where they are in the picture."""
    local = (frame.position - camera.eye) @ camera.axes().T
    tall = np.tan(np.radians(camera.fov) / 2)
    return local[:, :2] / local[:, 2:] / (tall * ASPECT, tall)


def test_what_is_drawn_beyond_its_balls_is_in_the_picture():
    tip = Scene(dim=3)
    balls = tip.add_balls(START.position, radius=0.2)
    corners = np.tile(balls[:2], (3, 1))
    tip.add_embedded_surface(corners, [[-3.0, 4.0], [0.5, 0.5], [0.0, 1.0]], [[0, 1, 2]])
    frame = frame_at(0.0, START.position)
    frame.embedded_surfaces = tuple(tip.embedded_surfaces)
    drawn = frame_at(0.0, [[8, 4, 0], [1, 0.5, 0], [2, 1, 0]])
    assert np.abs(on_screen(Camera.fit(START, ASPECT), drawn)).max() > 1
    assert np.abs(on_screen(Camera.fit(frame, ASPECT), drawn)).max() < 0.97


RUN = [frame_at(t, np.add(START.position, (9 * t, 4 * t * (2 - t), -6 * t))) for t in np.linspace(0, 2, 9)]


@pytest.mark.parametrize(
    "given", [{}, {"azimuth": 80, "elevation": 5}, {"target": (3, 0, 0)}, {"orbit": 70}, {"fov": 70, "orbit": -90}]
)
def test_a_fitted_camera_shows_all_frames(given):
    tracker = Tracker(RUN[0], given, ASPECT)
    assert any(np.abs(on_screen(tracker.at(frame), frame)).max() > 1 for frame in RUN)
    tracker.fit(RUN)
    reach = max(np.abs(on_screen(tracker.at(frame), frame)).max() for frame in RUN)
    assert 0.7 < reach < 0.97  # no farther than it need be
    first = tracker.first
    if "azimuth" in given:
        assert first.eye == pytest.approx(np.add(first.target, _towards(first, 80, 5)))
    assert first.target == given.get("target", first.target)


def _towards(camera, azimuth, elevation):
    a, e = np.radians([azimuth, elevation])
    distance = np.linalg.norm(np.subtract(camera.eye, camera.target))
    return distance * np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])


def test_a_fitted_view_in_2d_shows_all_frames():
    frames = [frame_at(t, [[0, 0], [5 * t, 2 + t]], dim=2) for t in (0.0, 1.0, 2.0)]
    with Renderer(frames[0], size=(160, 90)) as renderer:
        start = renderer.camera
        renderer.fit(frames)
        assert renderer.camera.scale < 0.5 * start.scale
        for frame in frames:
            place = (frame.position - renderer.camera.low) * renderer.camera.scale
            assert np.all((place > 0) & (place < (160, 90)))
    with Renderer(frames[0], size=(160, 90), camera={"centre": (1.0, 2.0), "width": 8.0}) as renderer:
        renderer.fit(frames)
        assert renderer.camera.scale == 20.0
        assert renderer.camera.low == pytest.approx((-3.0, -0.25))


def test_what_is_left_open():
    for given, dim, is_open in (
        ({}, 3, True),
        ({"azimuth": 10, "elevation": 3, "orbit": 5, "fov": 20}, 3, True),
        ({"fit": "start"}, 3, False),
        ({"eye": (1, 2, 3), "target": (0, 0, 0)}, 3, False),
        ({"target": (0, 0, 0), "distance": 4}, 3, False),
        ({"follow": [0]}, 3, False),
        ({"path": KEYS}, 3, False),
        ({"width": 3}, 2, True),
        ({"width": 3, "centre": (0, 0)}, 2, False),
    ):
        assert CameraPath.of(given, dim, 1).is_open == is_open, given
    with pytest.raises(SceneError, match=r"camera\.fit: 'all' is not allowed; it must be \"run\" or \"start\""):
        CameraPath.of({"fit": "all"}, 3, 1)


def test_placed():
    camera = Tracker(START, {"eye": (0, 0, 9), "target": (0, 1, 0), "up": (1, 0, 0), "fov": 20}, ASPECT).first
    assert camera == Camera((0, 0, 9), (0, 1, 0), (1, 0, 0), 20)
    camera = Tracker(START, {"target": (1, 2, 3), "azimuth": 90, "elevation": 0, "distance": 4}, ASPECT).first
    assert camera.target == (1, 2, 3)
    assert camera.eye == pytest.approx((5, 2, 3))
    low, high = (Tracker(START, {"elevation": e}, ASPECT).first for e in (0.0, 80.0))
    assert high.eye[1] > low.eye[1] + 3
    near, far = (Tracker(START, {"fov": fov}, ASPECT).first for fov in (60.0, 20.0))
    assert np.linalg.norm(np.subtract(far.eye, far.target)) > 2 * np.linalg.norm(np.subtract(near.eye, near.target))


def test_orbit():
    """A quarter turn a second about y, counter-clockwise seen from above."""
    tracker = Tracker(START, {"eye": (4, 2, 0), "target": (0, 0, 0), "orbit": 90}, ASPECT)
    for time, eye in ((0, (4, 2, 0)), (1, (0, 2, -4)), (2, (-4, 2, 0)), (4, (4, 2, 0))):
        assert tracker.at(frame_at(time, START.position)).eye == pytest.approx(eye, abs=1e-12)


KEYS = [
    {"time": 0.0, "eye": (0.0, 1.0, 5.0), "target": (0.0, 0.0, 0.0)},
    {"time": 1.0, "eye": (3.0, 1.0, 5.0), "target": (0.0, 0.0, 0.0)},
    {"time": 1.5, "eye": (3.5, 1.0, 5.0), "target": (0.0, 2.0, 0.0)},
    {"time": 4.0, "eye": (0.0, 1.0, 5.0), "target": (0.0, 2.0, 0.0)},
]


def test_a_path_passes_through_its_keyframes():
    tracker = Tracker(START, {"path": KEYS}, ASPECT)
    assert tracker.first.eye == KEYS[0]["eye"]
    for key in KEYS:
        camera = tracker.at(frame_at(key["time"], START.position))
        assert camera.eye == pytest.approx(key["eye"])
        assert camera.target == pytest.approx(key["target"])
    assert tracker.at(frame_at(-1.0, START.position)).eye == KEYS[0]["eye"]
    assert tracker.at(frame_at(9.0, START.position)).target == KEYS[-1]["target"]
    wide = [key | {"fov": fov} for key, fov in zip(KEYS, (20, 30, 40, 50), strict=True)]
    assert Tracker(START, {"path": wide}, ASPECT).at(frame_at(1.5, START.position)).fov == pytest.approx(40)


def test_between_keyframes_nothing_overshoots_and_the_slope_is_continuous():
    rng = np.random.default_rng(7)
    times = np.cumsum(rng.uniform(0.1, 2.0, 9))
    values = rng.normal(size=(9, 3))
    values[4] = values[3]  # a rest
    fine = np.linspace(times[0] - 0.5, times[-1] + 0.5, 40_001)
    path = np.array([eased(times, values, t) for t in fine])
    k = np.clip(np.searchsorted(times, fine) - 1, 0, 7)
    low, high = np.minimum(values[k], values[k + 1]), np.maximum(values[k], values[k + 1])
    assert np.all((path > low - 1e-12) & (path < high + 1e-12))
    slope = np.diff(path, axis=0) / np.diff(fine)[:, None]
    assert np.abs(np.diff(slope, axis=0)).max() < 0.02 * np.abs(slope).max()


def follow(track, velocity=None, dt=1 / 60, camera=None):
    """Eyes (f, 3) of a camera that follows ball 1 along a track (f, 3)."""
    away = [9.0, 9.0, 9.0]
    frames = [frame_at(k * dt, [away, x], None if velocity is None else [away, velocity]) for k, x in enumerate(track)]
    tracker = Tracker(frames[0], {"follow": 1, **(camera or {})}, ASPECT)
    return np.array([tracker.at(frame).eye for frame in frames])


def test_what_moves_evenly_is_followed_without_lag():
    t = np.arange(60)[:, None] / 60
    track = t * (2.0, -1.0, 0.5)
    eyes = follow(track, velocity=(2.0, -1.0, 0.5))
    assert eyes - eyes[0] == pytest.approx(track, abs=1e-12)
    late = follow(track)  # from rest
    assert np.abs((late - late[0] - track)[-1]).max() < 0.02


def test_a_bounce_does_not_jerk_and_jitter_does_not_show():
    t = np.arange(240) / 60
    height = np.abs(np.sin(3 * t))  # speed jumps by 6 m/s where it touches the ground
    eyes = follow(np.stack([0 * t, height, 0 * t], 1))
    change = np.abs(np.diff(eyes[:, 1], 2)).max() * 60
    assert change < 0.2 * np.abs(np.diff(height, 2)).max() * 60
    noise = np.random.default_rng(2).normal(scale=0.01, size=(240, 3))
    eyes = follow(noise)
    assert np.diff(eyes, axis=0).std() < 0.15 * np.diff(noise, axis=0).std()


@pytest.mark.slow
def test_frames_that_are_not_drawn_count():
    """A resumed run shows what one that was not cut off does."""
    t = np.arange(30) / 10
    frames = [frame_at(a, [[0, 0, 0], [np.sin(a), 0, 0]]) for a in t]
    options = {"size": (64, 48), "camera": {"follow": [1], "orbit": 30.0}}
    with Renderer(frames[0], **options) as renderer:
        whole = [renderer.render(frame) for frame in frames]
    with Renderer(frames[0], **options) as renderer:
        for frame in frames[:20]:
            renderer.skip(frame)
        assert all(np.array_equal(renderer.render(frame), image) for frame, image in zip(frames[20:], whole[20:]))
    assert not np.array_equal(whole[0], whole[20])


def test_flat_pictures_follow_too():
    """The ball stays in the middle, the other one leaves; the picture is as wide as asked."""
    points = [[0.0, 0.0], [1.0, 0.0]]
    frames = [frame_at(k / 10, [points[0], [1.0 + k / 10, 0.0]], [[0, 0], [1.0, 0]], dim=2) for k in range(40)]
    for frame in frames:
        frame.colour = np.array([[0.9, 0.1, 0.1], [0.1, 0.8, 0.1]])
    with Renderer(frames[0], size=(120, 80), camera={"width": 3.0, "follow": 1}) as renderer:
        first, *_, last = [renderer.render(frame).astype(int) for frame in frames]
    for image in (first, last):
        green = image[..., 1] > 1.5 * image[..., 0]
        rows, columns = np.nonzero(green)
        assert rows.mean() == pytest.approx(39.5, abs=1)
        assert columns.mean() == pytest.approx(59.5, abs=1)
        assert np.ptp(columns) + 1 == pytest.approx(0.4 / 3.0 * 120, abs=2)
    assert np.any(first[..., 0] > 1.5 * first[..., 1])
    assert not np.any(last[..., 0] > 1.5 * last[..., 1])


@pytest.mark.parametrize("followed", [0, 2, 4])
@pytest.mark.parametrize("dim", [2, 3])
def test_what_is_followed_at_one_end_leaves_the_other_end_in_the_picture(dim, followed):
    """Five letters in a row, of which one is followed: at the start all are shown."""
    points = np.zeros((5, dim))
    points[:, 0] = np.linspace(-4, 4, 5)
    frame = frame_at(0.0, points, dim=dim) if dim == 2 else frame_at(0.0, points)
    if dim == 3:
        camera = Tracker(frame, {"follow": followed}, ASPECT).at(frame)
        local = (points - camera.eye) @ camera.axes().T
        tall = np.tan(np.radians(camera.fov) / 2)
        assert np.all(np.abs(local[:, 0]) < ASPECT * tall * np.abs(local[:, 2]))
        assert camera.target == pytest.approx(points[followed])
        return
    with Renderer(frame, size=(120, 80), camera={"follow": followed}) as renderer:
        flat = renderer._painter.camera
        place = (points - flat.low) * flat.scale
        assert np.all((place > 0) & (place < [120, 80]))
        assert place[followed] == pytest.approx([60, 40], abs=0.5)


BAD = [
    ({"eyes": (0, 0, 1)}, r"camera\.eyes: is not a key of a camera in 3D; did you mean 'eye'\?"),
    ({"eye": (0, 1)}, r"camera\.eye: shape \(2,\)"),
    (
        {"eye": (0, 0, 1), "target": (0, 0, 1)},
        r"camera\.target: \[0\.0, 0\.0, 1\.0\] is not allowed; it must be another point than eye",
    ),
    ({"eye": (0, 0, 1), "distance": 2}, r"camera\.distance: does not go together with eye"),
    ({"path": KEYS, "orbit": 3}, r"camera\.orbit: does not go together with path"),
    ({"up": (0, 0, 0)}, r"camera\.up: .* it must be a vector that has a direction"),
    ({"fov": 190}, r"camera\.fov: 190\.0 is not allowed; it must be from 1 to 170"),
    ({"distance": 0}, r"camera\.distance: 0\.0 is not allowed; it must be greater than 0"),
    ({"follow": 3}, r"camera\.follow\[0\]: 3 is not allowed; it must name a ball, from 0 to 2"),
    (
        {"follow": "heap"},
        r"camera\.follow: 'heap' is not allowed; it must be the number of a ball, .*; names are for scene",
    ),
    ({"follow": []}, r"camera\.follow: \[\] is not allowed; it must be one ball or more"),
    ({"path": KEYS[:1]}, r"camera\.path: .* two keyframes or more"),
    ({"path": KEYS[::-1]}, r"camera\.path\[1\]\.time: 1\.5 is not allowed; it must be later than 4 s, the one before"),
    ({"path": [KEYS[0], KEYS[1] | {"fov": 3}]}, r"camera\.path\[1\]\.fov: give one to all keyframes or to none"),
    ({"path": [KEYS[0], {"time": 1.0}]}, r"camera\.path\[1\]\.eye: is missing"),
    ({"path": [KEYS[0], KEYS[1] | {"roll": 3}]}, r"camera\.path\[1\]\.roll: is not a known key"),
    ({"width": 3.0}, r"camera\.width: is not a key of a camera in 3D; there are eye, "),
]


@pytest.mark.parametrize(("given", "message"), BAD)
def test_refused(given, message):
    with pytest.raises(SceneError, match=message):
        CameraPath.of(given, 3, 3)
    scene = Scene(dim=3)
    scene.add_balls(START.position, radius=0.1)
    scene.output = {"camera": given}
    with pytest.raises(SceneError, match=rf"scene\.output\.{message}"):
        checked_output(scene)


TEXT = """format = 1
dim = 3
[[balls]]
position = [[0.0, 0.0, 0.0]]
radius = 0.1
[[balls]]
name = "pair"
position = [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
radius = 0.1
[output]
fps = 30
[output.camera]
azimuth = 10.0
follow = "pair"
"""


def test_kept_in_files(tmp_path):
    (tmp_path / "x.toml").write_text(TEXT)
    scene = load_scene(tmp_path / "x.toml")
    assert scene.output == {"fps": 30, "camera": {"azimuth": 10.0, "follow": [1, 2]}}
    assert checked_output(scene)["camera"]["follow"] == [1, 2]
    scene.output["camera"] = {"follow": np.array([1, 2]), "target": (0.0, 1.0, 0.0)}
    wanted = {"follow": [1, 2], "target": [0.0, 1.0, 0.0]}
    scene.save(tmp_path / "y.toml")
    again = load_scene(tmp_path / "y.toml").output["camera"]
    assert {key: list(value) for key, value in again.items()} == wanted
    with Simulation(scene) as sim:
        sim.save(tmp_path / "x.npz")
    with Simulation.restore(tmp_path / "x.npz") as sim:
        assert sim.scene.output["camera"] == wanted
        assert len(checked_output(sim.scene)["camera"]) == 2
    scene.output["camera"] = {"path": KEYS}
    scene.save(tmp_path / "z.toml")
    kept = load_scene(tmp_path / "z.toml").output["camera"]
    assert CameraPath.of(kept, 3, 3) == CameraPath.of({"path": KEYS}, 3, 3)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            '"pair"\n',
            '"pear"\n',
            r"line 14: output\.camera\.follow: 'pear' is not a name in this file; did you mean 'pair'",
        ),
        (
            "azimuth = 10.0",
            "azimut = 10.0",
            r"line 13: output\.camera\.azimut: is not a key of a camera in 3D; did you mean 'azimuth'",
        ),
        ("azimuth = 10.0", "distance = -1.0", r"line 13: output\.camera\.distance: -1\.0 is not allowed"),
        (
            'azimuth = 10.0\nfollow = "pair"',
            "path = [" + 2 * "\n  {time = 0.0, eye = [0, 0, 1], target = [0, 0, 0]}," + "\n]",
            r"line 15: output\.camera\.path\[1\]\.time: 0\.0 is not allowed; it must be later",
        ),
        (
            'azimuth = 10.0\nfollow = "pair"',
            "[[output.camera.path]]\ntime = 0.0\neye = [0, 0, 1]\ntarget = [0, 0, 0]\n"
            "[[output.camera.path]]\ntime = 0.0\neye = [0, 0, 1]\ntarget = [0, 0, 0]\n",
            r"line 18: output\.camera\.path\[1\]\.time: 0\.0 is not allowed; it must be later",
        ),
        ("fps = 30", "colour_range = [1.0, 0.0]", r"line 11: output\.colour_range: .* two numbers, the lower first"),
        ("fps = 30", "subdivide = 3", r"line 11: output\.subdivide: 3 is not allowed"),
    ],
)
def test_bad_files(tmp_path, old, new, message):
    assert old in TEXT
    (tmp_path / "x.toml").write_text(TEXT.replace(old, new) if old != '"pair"\n' else TEXT[:-7] + new)
    with pytest.raises(SceneError, match=message):
        load_scene(tmp_path / "x.toml")


def test_the_examples_of_the_docs():
    text = (Path(__file__).parents[2] / "docs" / "pictures.md").read_text()
    outputs = [tomllib.loads(block)["output"] for block in re.findall(r"```toml\n(.*?)```", text, re.DOTALL)]
    cameras = [output["camera"] for output in outputs if "camera" in output]
    assert len(cameras) >= 2
    for camera in cameras:
        CameraPath.of({key: 0 if key == "follow" else value for key, value in camera.items()}, 3, 1)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_camera_that_is_put_elsewhere_stays_there(dim):
    frames = [frame_at(k / 10, np.array([[0, 0, 0], [1.0 + k, 0, 0]])[:, :dim], dim=dim) for k in range(3)]
    with Renderer(frames[0], size=(64, 48), camera={"follow": 1}) as renderer:
        renderer.render(frames[0])
        first = renderer.camera
        renderer.render(frames[1])
        assert renderer.camera != first
        image = renderer.render(frames[1])
        renderer.camera = first
        assert not np.array_equal(renderer.render(frames[1]), image)
        renderer.render(frames[2])
        assert renderer.camera == first


# What flies off ------------------------------------------------------------------------------------------------------------


def scattering(loose, fast, springs=True):
    """Frames of a block of eight balls on springs, of two metres, and of loose balls of which some are flung away."""
    block = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    rng = np.random.default_rng(5)
    beside = rng.uniform(-1.5, 1.5, (loose, 3))
    speed = np.zeros((loose, 3))
    speed[:fast] = rng.normal(size=(fast, 3)) * [6, 1, 6] + [4, 0, 0]
    pairs = np.array([[k, k + 1] for k in range(7)], dtype=np.int32) if springs else np.zeros((0, 2), dtype=np.int32)
    for time in np.linspace(0, 1, 5):
        x = np.concatenate([block, beside + time * speed])
        yield Frame(time=time, position=x, velocity=0 * x, radius=np.full(len(x), 0.1), springs=pairs)


@pytest.mark.parametrize(("loose", "fast", "leaves"), [(60, 5, True), (60, 12, True), (20, 2, False), (60, 0, False)])
def test_few_balls_that_fly_off_are_left_out(loose, fast, leaves):
    """At most a tenth of loose balls, and none where there are few of them; the block is always shown."""
    frames = list(scattering(loose, fast))
    camera = Camera.fit(frames, ASPECT)
    reach = np.array([np.abs(on_screen(camera, frame)) for frame in frames]).max(axis=(0, 2))
    assert np.all(reach[:8] < 1)
    assert (reach > 1).any() == leaves
    assert np.count_nonzero(reach > 1) <= 6
    assert reach[reach < 1].max() > 0.75  # it fills the picture


def test_springs_keep_balls_in_the_picture():
    frames = list(scattering(60, 5))
    for frame in frames:
        frame.springs = np.array([[k, k + 1] for k in range(67)], dtype=np.int32)
    camera = Camera.fit(frames, ASPECT)
    assert max(np.abs(on_screen(camera, frame)).max() for frame in frames) < 1


# What hangs ----------------------------------------------------------------------------------------------------------------


def hanging(pole=False):
    """Frames of a banner that swings 0.7 m above the ground, on a pole if asked."""
    place = np.stack(np.meshgrid(np.linspace(0, 1.4, 8), np.linspace(0.7, 1.6, 6), [0.0], indexing="ij"), axis=-1)
    place = place.reshape(-1, 3)
    threads = np.stack([np.arange(len(place) - 1), np.arange(1, len(place))], axis=1)
    scene = Scene(dim=3)
    scene.add_collider(Capsule((-0.05, 0, 0), (-0.05, 1.7, 0), 0.03))
    stick = Placed(scene.colliders[0], np.array([-0.05, 0.85, 0]), np.eye(3))
    for time in np.linspace(0, 2, 7):
        x = place + np.sin(2 * time) * (1.6 - place[:, 1:2]) * (0.3, 0.0, 0.5)
        frame = Frame(time=time, position=x, velocity=0 * x, radius=np.full(len(x), 0.01), springs=threads)
        frame.walls = np.array([[0.0, 1.0, 0.0, 0.0]])
        frame.colliders = (stick,) if pole else ()
        yield frame


@pytest.mark.parametrize("pole", [False, True])
def test_what_hangs_fills_the_picture_of_a_run(pole):
    """The ground that it never reaches, and the foot of the pole, may lie outside."""
    frames = list(hanging(pole))
    camera = Camera.fit(frames, ASPECT)
    seen = np.concatenate([on_screen(camera, frame) for frame in frames])
    assert np.abs(seen).max() < 1
    assert np.ptp(seen[:, 1]) > 1.5  # of the 2 from edge to edge
    start = on_screen(Camera.fit(frames[0], ASPECT), frame_at(0, frames[0].position * (1, 0, 1)))
    assert np.abs(start).max() < 1  # where it may fall is not known yet


def strip(pinned, floor):
    """The first frame of a strip of cloth that is held by one side, or loose, above a floor, or above nothing."""
    scene = Scene(dim=3, gravity=(0, -5, 0))
    cloth(scene, size=(1.4, 0.8), resolution=(8, 5), position=(0, 2.0, 0), pinned=pinned)
    if floor:
        scene.add_wall((0, 1, 0))
    with Simulation(scene, contacts="off") as sim:
        return sim.frame()


@pytest.mark.parametrize("floor", [True, False])
def test_the_first_frame_leaves_room_for_what_swings_down_but_not_for_the_ground_below(floor):
    first = strip("left", floor)
    camera = Camera.fit(first, ASPECT)
    seen = [np.abs(on_screen(camera, first))]
    for angle in np.radians((30, 60, 90, 120, 180)):
        x = first.position.copy()
        x[:, 0], x[:, 1] = first.position[:, 0] * np.cos(angle), 2.0 - first.position[:, 0] * np.sin(angle)
        seen.append(np.abs(on_screen(camera, frame_at(0, x))))
    assert max(one.max() for one in seen) < 1
    assert max(one[:, 1].max() for one in seen) > 0.75
    loose = strip(False, floor)
    fallen = on_screen(Camera.fit(loose, ASPECT), frame_at(0, loose.position * (1, 0, 1)))
    assert (np.abs(fallen).max() < 1) == floor


def test_the_ground_that_a_run_reaches_is_in_its_picture():
    frames = list(hanging())
    frames[-1].position = frames[-1].position * (1, 0, 1)
    camera = Camera.fit(frames, ASPECT)
    assert max(np.abs(on_screen(camera, frame)).max() for frame in frames) < 1


@ti.kernel
def rays(matrix: ti.types.matrix(4, 4, ti.f32), pixel: ti.types.ndarray(ndim=2), ray: ti.types.ndarray(ndim=2)):
    for k in range(pixel.shape[0]):
        found = pixel_ray(matrix, pixel[k, 0], pixel[k, 1])
        for a in ti.static(range(3)):
            ray[k, a] = found[a]


def test_the_ray_of_a_pixel_goes_to_what_is_seen_there():
    """Light is worked out along it, wherever spheres and triangles are drawn: both have to be the same place."""
    rng = np.random.default_rng(6)
    axes, eye, scale, centre = np.linalg.qr(rng.normal(size=(3, 3)))[0], np.array([0.4, -1.0, 2.0]), 130.0, (64.0, 48.0)
    depth, aside = rng.uniform(1.0, 9.0, 20), rng.uniform(-0.5, 0.5, (20, 2))
    points = eye + depth[:, None] * (axes[2] + aside @ axes[:2])
    seen = (points - eye) @ axes.T
    pixel = np.stack([centre[0] + scale * seen[:, 0] / seen[:, 2], centre[1] - scale * seen[:, 1] / seen[:, 2]], axis=1)
    found = np.zeros((20, 3), dtype=np.float32)
    rays(ti.Matrix(view_matrix(axes, eye, scale, centre)), pixel.astype(np.float32), found)
    assert found * seen[:, 2:] == pytest.approx(points - eye, abs=1e-5)
