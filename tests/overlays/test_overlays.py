"""Text, curves and marks over pictures: where they lie, what they show after a resumed run, and what is refused."""

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import taichi_sim as ts
from taichi_sim.files.source import checked_output, open_scene
from taichi_sim.overlays import open_renderer
from taichi_sim.overlays.panel import LIGHT, Panel, nice_step, ticks
from taichi_sim.overlays.plot import Plot, labels_of, padded, written
from taichi_sim.scene.overlay import Overlay, ShownProbe
from taichi_sim.sweeps.pictures import draw

pytestmark = pytest.mark.once

SIZE = (400, 240)
BLUE = (0.0, 0.0, 1.0)


def frame_at(time, places, dim=2, **given):
    x = np.asarray(places, dtype=float).reshape(-1, dim)
    red = np.tile([1.0, 0.0, 0.0], (len(x), 1))
    return ts.Frame(time=time, position=x, velocity=np.zeros_like(x), radius=np.full(len(x), 0.1), colour=red, **given)


def middle(mask):
    """Mean place (x, y) of the pixels of a mask, and their number."""
    y, x = np.nonzero(mask)
    return np.array([x.mean(), y.mean()]), len(x)


@pytest.mark.slow_where(dim=3)
@pytest.mark.parametrize("dim", [2, 3])
def test_a_mark_lies_on_the_ball_that_is_where_it_is_expected(dim):
    corners = [[-1.0, -1.0, 0.3], [1.2, 0.8, -0.6]]
    place = [0.37, 0.23, 0.4]
    wide = frame_at(0.5, [one[:dim] for one in (*corners, place)], dim)
    style = {
        "camera": {"fit": "start"},
        "overlay": {"marks": [{"position": [[0, 0, 0][:dim], (2 * np.array(place))[:dim]]}]},
    }
    style["overlay"]["marks"][0]["times"] = [0.0, 1.0]  # at 0.5 s it is half-way
    with open_renderer(wide, SIZE, {"camera": {"fit": "start"}}) as renderer:
        plain = renderer.render(wide).astype(int)
    with open_renderer(wide, SIZE, style) as renderer:
        marked = renderer.render(wide).astype(int)
    ring, number = middle(np.abs(marked - plain).sum(axis=2) > 40)
    assert number > 60
    x, y = np.rint(ring).astype(int)
    red = (plain[:, :, 0] > 110) & (plain[:, :, 1] < 110) & (plain[:, :, 2] < 110)
    near = np.zeros_like(red)
    near[y - 24 : y + 24, x - 24 : x + 24] = True
    ball, number = middle(red & near)
    assert number > 20
    assert np.abs(ring - ball).max() < 2.5


def run_of_readings(number=21):
    """Frames of 2 s whose probe rises evenly from -3 to 5."""
    times = np.linspace(0.0, 2.0, number)
    probes = [{"ball.y": -3 + 4 * t, "ball.x": 7.0} for t in times]
    return [frame_at(t, [[0, 0], [1, 1]], probes=one) for t, one in zip(times, probes)]


STYLE = {
    "overlay": {
        "title": "A test",
        "clock": True,
        "scale_bar": True,
        "legend": True,
        "probes": [
            {"of": "ball.y", "colour": BLUE, "expected": [[0, -3], [2, 5]]},
            {"of": "ball.x", "label": "x", "curve": False},
        ],
        "plot": "bottom right",
        "plot_size": (0.5, 0.6),
    }
}


def blue(image):
    return (image[:, :, 2] > 180) & (image[:, :, 0] < 90) & (image[:, :, 1] < 90)


def test_a_curve_goes_on_evenly_within_axes_that_hold_the_whole_run():
    frames = run_of_readings()
    ends = []
    with open_renderer(frames[0], SIZE, STYLE) as renderer:
        renderer.fit(frames)
        for k, frame in enumerate(frames):
            if k in (5, 10, 20):
                image = renderer.render(frame)
                y, x = np.nonzero(blue(image))
                below = y > SIZE[1] * 0.4 + 20  # of the legend of the plot
                ends.append((x[below].max(), y[below].min()))
            else:
                renderer.skip(frame)
    (x1, y1), (x2, y2), (x3, y3) = ends
    assert abs((x3 - x2) - 2 * (x2 - x1)) <= 3  # 0.5, then 1 s
    assert abs((y2 - y3) - 2 * (y1 - y2)) <= 3
    assert SIZE[0] - 30 < x3 < SIZE[0] - 8  # the end of the run is the end of the axis
    assert x2 - x1 > 0.2 * (SIZE[0] / 2)


def test_pictures_do_not_depend_on_which_frames_were_drawn_before():
    frames = run_of_readings()
    with open_renderer(frames[0], SIZE, STYLE) as renderer:
        renderer.fit(frames)
        for frame in frames[:-1]:
            renderer.render(frame)
        memory = renderer.memory()
        wanted = renderer.render(frames[-1])
        assert np.array_equal(renderer.render(frames[-1]), wanted)
    with open_renderer(frames[0], SIZE, STYLE) as renderer:
        renderer.fit(frames)
        renderer.recall(memory)
        assert np.array_equal(renderer.render(frames[-1]), wanted)
    with open_renderer(frames[0], SIZE, STYLE) as renderer:
        renderer.fit(frames)
        for frame in frames[:-1]:
            renderer.skip(frame)
        assert np.array_equal(renderer.render(frames[-1]), wanted)


def test_the_picture_beneath_is_left_as_it_is_and_alpha_too():
    frame = run_of_readings()[3]
    given = {"overlay": {"clock": True}, "transparent": True}
    with open_renderer(frame, SIZE, {"transparent": True}) as renderer:
        plain = renderer.render(frame)
    with open_renderer(frame, SIZE, given) as renderer:
        image = renderer.render(frame)
    assert image.shape == (*SIZE[::-1], 4)
    changed = (image != plain).any(axis=2)
    assert changed.any()
    rows, columns = np.nonzero(changed)
    assert rows.max() < 0.25 * SIZE[1]
    assert columns.max() < 0.4 * SIZE[0]
    assert image[changed][:, 3].max() > 200  # letters hide what is behind them


@pytest.mark.parametrize("colour", ["speed", "object"])
def test_axes_that_do_not_know_the_end_and_readings_that_are_none(colour):
    frames = run_of_readings(5)
    frames[0].probes = {}
    style = {"overlay": {"probes": [{"of": "ball.y"}], "legend": True}, "colour": colour, "background": (0.1, 0.1, 0.1)}
    with open_renderer(frames[0], (160, 100), style) as renderer:
        images = [renderer.render(frame) for frame in frames]
    assert len({image.tobytes() for image in images}) == 5


@pytest.mark.parametrize("text_size", [4.0, 400.0])
@pytest.mark.parametrize("size", [(16, 16), (300, 30)])
def test_pictures_that_are_too_small_and_numbers_that_are_too_large_do_no_harm(size, text_size):
    frame = run_of_readings(2)[0]
    overlay = {**STYLE["overlay"], "text_size": text_size, "plot_size": (0.1, 0.1), "title": "long " * 40}
    overlay["marks"] = [{"position": (1e50, 0.0)}, {"position": (0.0, 0.0), "label": "here"}]
    overlay["probes"] = [{"of": "ball.y", "expected": [[0.0, -1e50]]}, {"of": "none", "curve": False}]
    for value in (1e50, -1e300, float("inf"), float("nan"), 0.0):
        frame.probes = {"ball.y": value}
        with open_renderer(frame, size, {"overlay": overlay}) as renderer:
            renderer.fit([frame])
            assert renderer.render(frame).shape == (*size[::-1], 3)


def test_round_numbers():
    assert [nice_step(span, 5) for span in (1.0, 7.0, 11.0, 26.0, 0.003)] == [0.2, 2.0, 5.0, 10.0, 0.001]
    assert ticks(-0.3, 1.04, 4) == ([0.0, 0.5, 1.0], 1)
    assert [written(*one) for one in ((-0.25, 2), (1e6, 0), (float("nan"), 2))] == ["\u22120.25", "1.00e+06", "\u2013"]
    assert [written(*one) for one in ((-4e-4, 2), (-0.0, 8), (-3e-8, 9))] == ["0.00", "0.00e+00", "\u22123.00e\u221208"]
    assert ticks(0.04, 0.98, 2)[0] == pytest.approx([0.2, 0.4, 0.6, 0.8])
    assert labels_of([250_000.0, 250_020.0], 0, " J") == ["2.5000e+05", "2.5002e+05 J"]


@pytest.mark.parametrize(
    ("values", "reach"),
    [([0.0, 0.0], (-1, 1)), ([1e-200, 0.0], (-1, 1)), ([-2.5, -2.5 - 4e-15], (-5, 0)), ([1.0, 3.0], (0.88, 3.12))],
)
def test_the_range_of_values_that_are_alike(values, reach):
    assert padded(np.array(values)) == pytest.approx(reach)


def test_a_lone_moment_has_an_axis_of_a_second():
    frame = run_of_readings(2)[1]
    images = []
    for frames in ([], [frame]):
        with open_renderer(frame, SIZE, STYLE) as renderer:
            renderer.fit(frames)
            images.append(renderer.render(frame))
    assert np.array_equal(*images)


@pytest.mark.parametrize("title", ["a title of more than forty letters that goes on", "onewordoffortyletters" * 2])
def test_a_long_title_leaves_the_curves_free(title):
    frame = run_of_readings()[-1]
    images = []
    for words in ("t", title):
        style = {"overlay": {"title": words, "probes": [{"of": "ball.y"}], "plot_size": (0.6, 0.5)}}
        with open_renderer(frame, SIZE, style) as renderer:
            images.append(renderer.render(frame))
    changed = (images[0] != images[1]).any(axis=(0, 2))
    assert 0.2 * SIZE[0] < np.flatnonzero(changed).max() < 0.4 * SIZE[0]


@pytest.mark.parametrize("values", [(-1e-7, 3e-7), (0.03, 0.97), (99_950.0, 100_020.0)])
@pytest.mark.parametrize("side", [60.0, 150.0, 400.0])
def test_labels_of_axes_do_not_touch(values, side, monkeypatch):
    written_at = []
    kept = Panel.text

    def noted(panel, place, words, colour, anchor="la"):
        written_at.append((place, words, anchor))
        kept(panel, place, words, colour, anchor)

    monkeypatch.setattr(Panel, "text", noted)
    curve = ShownProbe("a.energy", label="energy of the first of all shapes")
    plot = Plot((side, 0.7 * side), 9.0, LIGHT, [curve], [(0, 0, 0)], "", (0.0, 0.013), values)
    along = [(x, Panel.length(words, 9.0) / 2) for (x, _), words, anchor in written_at if anchor == "ma"]
    up = [y for (_, y), _, anchor in written_at if anchor == "rm"]
    assert len(along) > 1 or side == 60.0
    assert all(x + half < other - more for (x, half), (other, more) in pairwise(along))
    assert along[-1][0] + along[-1][1] <= side
    assert len(up) > 1 or side == 60.0
    assert all(one - other > 9.0 for one, other in pairwise(up))
    written_at.clear()
    plot.at([0.0], np.array([[values[0]]]))
    ((x, _), name, _), ((right, _), value, _) = written_at
    assert x + Panel.length(name, 9.0) < right - Panel.length(value, 9.0) or side == 60.0


def test_a_plot_as_large_as_the_picture_stays_within_it():
    frame = run_of_readings()[-1]
    widths = []
    for share in (0.88, 0.91, 0.96, 1.0):
        overlay = {"probes": [{"of": "ball.y"}], "plot_size": (share, share)}
        with open_renderer(frame, SIZE, {"overlay": overlay, "transparent": True}) as renderer:
            renderer.fit([frame])
            changed = renderer.render(frame)[:, :, 3].any(axis=0)
        widths.append(int(changed.sum()))
    assert widths == sorted(widths)
    assert widths[-1] < SIZE[0] - 4


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"clok": True}, "overlay.clok: is not a key of overlay; did you mean 'clock'?"),
        ({"clock": 1}, "overlay.clock: 1 is not allowed; it must be true or false"),
        ({"title": 3}, "overlay.title: 3 is not allowed; it must be a text of one line"),
        ({"plot": "middle"}, "overlay.plot: 'middle' is not allowed; it must be one of 'top left'"),
        ({"plot_size": (0.5, 1.5)}, "overlay.plot_size[1]: 1.5 is not allowed; it must be from 0.1 to 1"),
        ({"plot_range": (2, 1)}, "overlay.plot_range: (2, 1) is not allowed; it must be two numbers, the lower first"),
        (
            {"probes": {"of": "a.x"}},
            "overlay.probes: {'of': 'a.x'} is not allowed; it must be a list of at most 20 tables",
        ),
        (
            {"probes": [{"label": "a"}]},
            "overlay.probes[0]: {'label': 'a'} is not allowed; it must be a table with the key of,",
        ),
        (
            {"probes": [{"of": "b.x"}]},
            "overlay.probes[0].of: 'b.x' is no number of a probe of this scene; did you mean",
        ),
        (
            {"probes": [{"of": "a"}]},
            "overlay.probes[0].of: 'a' is no number of a probe of this scene; there are a.x, a.y",
        ),
        (
            {"probes": [{"of": "load", "expected": [[1, 0], [0, 0]]}]},
            "overlay.probes[0].expected: needs 1 to 100000 times",
        ),
        ({"marks": [{"position": [0, 0, 0]}]}, "overlay.marks[0].position: shape (3,) does not fit; it must be (2,)"),
        ({"marks": [{"position": [0, 0], "times": [1, 0]}]}, "overlay.marks[0].times: needs 1 to 100000 times"),
        ({"title": "a\nb"}, r"overlay.title: 'a\nb' is not allowed; it must be a text of one line and at most 200"),
        ({"marks": [{"position": [0, 0]}] * 21}, "overlay.marks: [{'position': [0, 0]}"),
        ("clock", "overlay: 'clock' is not allowed; it must be a table with keys among title, clock,"),
    ],
)
def test_refused(given, message):
    with pytest.raises(ts.SceneError) as error:
        Overlay.of(given, 2, ("a.x", "a.y", "load.tension"))
    assert str(error.value).startswith(message)


SCENE = """format = 1
gravity = [0.0, -10.0]
[[balls]]
name = "stone"
position = [0.0, 1.0]
radius = 0.1
[[probes]]
name = "stone"
kind = "position"
balls = [0]
[output.overlay]
clock = true
[[output.overlay.probes]]
of = "stone.y"
"""


def test_a_scene_file_has_it_by_key(tmp_path):
    file = tmp_path / "x.toml"
    file.write_text(SCENE)
    scene = open_scene(file, parameters={"output.overlay.title": "Falls", "output.overlay.probes[0].label": "y"})
    assert scene.output["overlay"]["title"] == "Falls"
    scene.save(tmp_path / "saved.toml")
    again = ts.load_scene(tmp_path / "saved.toml")
    assert Overlay.of(again.output["overlay"], 2, None).probes[0].label == "y"
    file.write_text(file.read_text().replace('"stone.y"', '"stone.z"'))
    with pytest.raises(ts.SceneError, match=r"line 14: output\.overlay\.probes\[0\]\.of: 'stone\.z' is no number"):
        ts.load_scene(file)
    scene.output["overlay"]["clock"] = "yes"
    with pytest.raises(ts.SceneError, match=r"^scene\.output\.overlay\.clock: 'yes' is not allowed"):
        checked_output(scene)


def test_the_example_of_the_docs():
    text = (Path(__file__).parents[2] / "docs" / "pictures.md").read_text()
    import tomlkit

    tables = [tomlkit.parse(one).unwrap() for one in re.findall(r"```toml\n(.*?)```", text, re.DOTALL)]
    overlays = [one["output"]["overlay"] for one in tables if "overlay" in one.get("output", {})]
    assert overlays
    for one in overlays:
        Overlay.of(one, 2, None)


@pytest.mark.slow
def test_a_recording_is_drawn_as_its_run_was(tmp_path):
    scene = ts.Scene(gravity=(0, -10))
    ball = scene.add_balls([0.0, 1.0], radius=0.1)
    scene.add_wall((0, 1), 0.0)
    scene.add_probe("ball", "position", balls=ball)
    scene.output = {"overlay": {"clock": True, "probes": [{"of": "ball.y"}], "scale_bar": True}, "size": (160, 90)}
    with ts.Simulation(scene, dt=0.01) as sim:
        outputs = [ts.open_output(tmp_path / "x.npz"), ts.open_output(f"{tmp_path}/frames/")]
        options = {"fps": 20, "duration": 0.5, "size": (160, 90), "style": {"overlay": scene.output["overlay"]}}
        ts.export(sim, outputs, **options)
    draw(tmp_path / "x.npz", [f"{tmp_path}/again/"], workers=0)
    names = sorted(one.name for one in (tmp_path / "frames").glob("*.png"))
    assert len(names) == 11
    for name in names:
        assert (tmp_path / "frames" / name).read_bytes() == (tmp_path / "again" / name).read_bytes()
    assert ts.picture(scene, size=(160, 90)).size == (160, 90)
    for size, says in (
        ("a", "size: 'a' is not a vector of 2 numbers"),
        ((9, 0), "size: (9, 0) is not allowed; it must be a"),
    ):
        with pytest.raises(ts.SceneError, match=re.escape(says)):
            ts.picture(scene, size=size)
