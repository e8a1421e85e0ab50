"""The records of a log: the same frames and pictures come out of them, and nothing but these."""

import json

import numpy as np
import pytest
from test_resume import _as_often_as_asked, cut_off, files, run

import taichi_sim as ts
from taichi_sim import SceneError
from taichi_sim.analysis.frame import Placed
from taichi_sim.analysis.lazy_frame import MomentsOf
from taichi_sim.outputs.frame_records import LENGTH, FrameRecords, PicturePacker, unpacked_pictures
from taichi_sim.outputs.records import Records

pytestmark = pytest.mark.once
__all__ = ["_as_often_as_asked"]
NAMES = (
    "time",
    "position",
    "velocity",
    "springs",
    "sticks",
    "triangles",
    "torn_springs",
    "torn_triangles",
    "strain",
    "energy",
)


def torn_scene():
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.add_balls([[0, 0, 0], [1, 0, 0], [0.3, 1, 0]], radius=0.1)
    scene.add_springs([[0, 1], [1, 2], [2, 0]], stiffness=100, break_strain=0.5)
    scene.add_collider(ts.Box((0, 0, 0), (2, 1, 1), rotation_rate=(0, 90, 0)))
    return scene


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_moments_are_the_same_from_records(kind):
    scene, rng = torn_scene(), np.random.default_rng(1)
    moments = MomentsOf(scene)
    given = []
    for k in range(3):
        x, v, spin = (rng.normal(size=(3, 3)).astype(kind).astype(float) * (k > 0 or n < 2) for n in range(3))
        given.append(moments.at(k / 7, x, v, spin, np.arange(3) < k))
        given[-1].contacts = ts.analysis.frame.Contacts(k, *(float("nan"), 0.1) * 3, 2, 3, 0.5, 9) if k else None
        given[-1].probes = {"load.tension": float("nan"), "load.x": k / 3}
    records = FrameRecords(given[0], arrays=True)
    packed = [records.pack(one) for one in given]
    assert len(packed[0]) + 24 * 3 * (1 if kind is np.float32 else 2) // 2 < len(packed[1])  # spins of 0 are left out
    for one, data in zip(given, packed):
        other = records.unpack(data)
        assert other.known_energy is None  # it was not known
        for name in NAMES:
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        np.testing.assert_array_equal(one.spin, other.spin)
        np.testing.assert_array_equal(one.colliders[0].rotation, other.colliders[0].rotation)
        assert repr(one.contacts) == repr(other.contacts)
        assert repr(one.probes) == repr(other.probes)


def test_frames_from_anywhere_are_the_same_from_records():
    scene, x = torn_scene(), np.zeros((3, 3))
    box = scene.colliders[0]
    first = ts.Frame(
        0.0, x, x, np.ones(3), springs=np.array([[0, 1]], dtype=np.int64), colliders=(Placed(box, x[0], np.eye(3)),)
    )
    later = ts.Frame(
        1.0, x + 0.1, x, first.radius, springs=first.springs[:0], colliders=(Placed(box, x[0] + 1, -np.eye(3)),)
    )
    later.energy = (1.0, 2.0, 3.0, float("nan"))
    records = FrameRecords(first, arrays=True)
    other = records.unpack(records.pack(later))
    for name in NAMES:
        np.testing.assert_array_equal(getattr(later, name), getattr(other, name))
    assert other.radius is first.radius
    np.testing.assert_array_equal(other.colliders[0].centre, x[0] + 1)
    np.testing.assert_array_equal(other.colliders[0].rotation, -np.eye(3))


@pytest.mark.parametrize("shape", [(48, 64, 3), (37, 51, 3), (2, 2, 3), (36, 40, 4)])
def test_pictures_are_the_same_from_records(shape):
    """To the last bit, of any size, also where another process went on, and where some were left out."""
    rng = np.random.default_rng(2)
    given = [rng.integers(0, 256, shape, dtype=np.uint8) for _ in range(6)]
    first, second = PicturePacker(), PicturePacker()
    records = [b"", *(first.pack(one) for one in given[:3]), b"", *(second.pack(one) for one in given[3:])]
    found = list(unpacked_pictures(records))
    assert [number for number, _ in found] == [1, 2, 3, 5, 6, 7]
    for one, (_, other) in zip(given, found, strict=True):
        np.testing.assert_array_equal(one, other)


def edited(change):
    """Of the text of a record."""

    def way(data):
        begin = LENGTH + int.from_bytes(data[:LENGTH], "little")
        text = change(json.loads(data[LENGTH:begin]))
        text = (text if isinstance(text, str) else json.dumps(text)).encode()
        return len(text).to_bytes(LENGTH, "little") + text + data[begin:]

    return way


def listed(*one):
    return edited(lambda about: about | {"arrays": [one, *about["arrays"][1:]]})


DAMAGES = {
    "nothing": lambda data: b"x",
    "short": lambda data: data[:-1],
    "long": lambda data: data + b"x",
    "text": lambda data: (10**9).to_bytes(LENGTH, "little") + data[LENGTH:],
    "list": edited(lambda about: [1]),
    "deep": edited(lambda about: "[" * 50_000),
    "no probes": edited(lambda about: {name: value for name, value in about.items() if name != "probes"}),
    "time": edited(lambda about: about | {"time": "noon"}),
    "energy": edited(lambda about: about | {"energy": ["much"]}),
    "contacts": edited(lambda about: about | {"contacts": [1]}),
    "kind": listed("position", "|O", [2, 2]),
    "shape": listed("position", "<f4", [4, 1]),
    "below 0": listed("position", "<f4", [-2, -2]),
    "huge": listed("position", "<f4", [10**9, 10**9]),
    "flags": listed("position", "|b1", [2, 8]),
    "name": listed("wings", "<f4", [2, 2]),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_frame_that_is_none_is_said(tmp_path, damage):
    """Though its checksum was made to fit: in one sentence, and what is there stays."""
    cut_off(tmp_path, "x.npz", 13)
    place = tmp_path / ".x.npz.resume" / "frames"
    records = list(Records(place, resume=True))
    other = Records(place, resume=False)
    for k, data in enumerate(records):
        other.append(DAMAGES[damage](data) if k == 5 else data)
    other.close()
    before = files(tmp_path)
    with pytest.raises(SceneError, match=r"/frames: is damaged \(.+\); delete .*x\.npz\.resume, or leave --resume out"):
        run(tmp_path, "x.npz", resume=True)
    assert files(tmp_path) == before
