"""What those who wait are told, and what is counted as compiling."""

import pytest
from physics_support import simulate

import taichi_sim as ts
from taichi_sim.common import remembered
from taichi_sim.device import compiling
from taichi_sim.device.engine import ENGINE
from taichi_sim.outputs.export import export

pytestmark = [pytest.mark.once, pytest.mark.skipif(ENGINE != "taichi", reason="only Taichi's time is counted")]


@pytest.fixture(autouse=True)
def folder(monkeypatch, tmp_path):
    monkeypatch.setattr(remembered, "user_cache_path", lambda name: tmp_path / name)
    return tmp_path / "taichi_sim"


def expected(*names, settings=3, pictures=False):
    return compiling.Expected(names, settings, pictures)


def falling(mass=1.0):
    scene = ts.Scene(dim=2, gravity=(0, -9))
    scene.add_balls([[0, 1], [0, 2]], radius=0.1, mass=mass)
    return scene


def test_a_scene_is_known_by_what_it_is_compiled_from():
    assert expected("a", "b").words.startswith("compiling (first run, about ")
    expected("a", "b").remember(7.4)
    assert expected("b", "a", "a").words == "loading kernels (about 7 s)"
    for other in (expected("a"), expected("a", "b", settings=2), expected("a", "b", pictures=True)):
        assert other.words.startswith("compiling")
    expected("a", "b").remember(0.4)
    assert expected("a", "b").words == "starting"


def test_old_scenes_are_forgotten(monkeypatch):
    monkeypatch.setattr(compiling, "MOST_REMEMBERED", 2)
    for name in ("a", "b", "a", "c"):
        expected(name).remember(3.0)
    assert [expected(name).words.split()[0] for name in "abc"] == ["loading", "compiling", "loading"]


@pytest.mark.parametrize("text", ["[1]", "{", '{"x": "y"}'])
def test_what_is_no_table_is_written_anew(folder, text):
    folder.mkdir()
    (folder / "compile_times.json").write_text(text)
    assert expected("a").words.startswith("compiling")
    expected("a").remember(2.0)
    assert expected("a").words == "loading kernels (about 2 s)"


def test_a_folder_that_cannot_be_written_costs_nothing_else(folder):
    folder.write_text("a file")
    expected("a").remember(2.0)
    assert expected("a").words.startswith("compiling")


def test_the_bar_says_what_is_waited_for_and_the_summary_how_long_it_took(monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    with simulate(falling(2.0), dt=1e-3) as sim:
        summary = export(sim, None, fps=50, duration=0.1, progress=True)
    said = capsys.readouterr().err
    assert "compiling (first run, about" in said
    assert "x real time" in said
    assert summary.compiling > 0.0
    parts = summary.compiling + summary.simulating + summary.drawing + summary.writing
    assert parts == pytest.approx(summary.wall)
    assert summary.lines()[-1].count("compiling") == 2
    with simulate(falling(3.0), dt=1e-3) as sim:
        export(sim, None, fps=50, duration=0.1, progress=True)
    assert "first run" not in capsys.readouterr().err
