"""What those who wait are told, and what is counted as compiling."""

import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from physics_support import simulate

import taichi_sim as ts
from taichi_sim.common import remembered
from taichi_sim.device import compiling
from taichi_sim.device.engine import ENGINE
from taichi_sim.outputs.export import _Frames, export

pytestmark = [pytest.mark.once, pytest.mark.skipif(ENGINE != "taichi", reason="only Taichi's time is counted")]


@pytest.fixture(autouse=True)
def folder(monkeypatch, tmp_path):
    monkeypatch.setattr(remembered, "user_cache_path", lambda name: tmp_path / name)
    monkeypatch.setattr(compiling, "AT_FIRST", {"": 4.0, "pictures": 3.0, "more pictures": 1.0})
    monkeypatch.setattr(compiling, "_drawn", False)
    return tmp_path / "taichi_sim"


def expected(*names, settings=3, pictures=False):
    return compiling.Expected(names, settings, pictures)


def falling(mass=1.0):
    scene = ts.Scene(dim=2, gravity=(0, -9))
    scene.add_balls([[0, 1], [0, 2]], radius=0.1, mass=mass)
    return scene


def test_a_scene_is_known_by_what_it_is_compiled_from():
    assert expected("a", "b").words().startswith("compiling kernels (about ")
    expected("a", "b").remember(20.4, False)
    assert expected("b", "a", "a").words() == "loading kernels (about 8 s)"  # which takes less than to compile them
    expected("a", "b").remember(7.4, True)
    assert expected("b", "a", "a").words() == "loading kernels (about 7 s)"
    for other in (expected("a"), expected("a", "b", settings=2), expected("a", "b", pictures=True)):
        assert other.words().startswith("compiling")
    expected("a", "b").remember(0.4, True)
    assert expected("a", "b").words() == "starting"


def test_an_estimate_that_has_passed_says_so(monkeypatch):
    monkeypatch.setattr(compiling, "_inside", True)
    assert expected("a").words(3.9) == "compiling kernels (about 4 s, less where they are cached)"
    assert expected("a").words(4.1) == "compiling kernels (longer than the 4 s expected, and goes on; no new estimate)"
    expected("a").remember(50.0, False)
    assert expected("a").words(19.9) == "loading kernels (about 20 s)"
    assert (
        expected("a").words(20.1) == "loading kernels (longer than the 20 s of last time, and goes on; no new estimate)"
    )


def test_a_long_step_is_not_taken_for_a_kernel(monkeypatch):
    """A million balls take minutes to the next frame, long after the last kernel was there."""
    monkeypatch.setattr(compiling, "_ended", time.perf_counter() - 2 * compiling.QUIET)
    unknown = expected("a")
    expected("b").remember(50.0, False)
    known, again = expected("b"), expected("b")
    again._again = True
    for one, wait in ((unknown, 51.0), (known, 21.0), (again, 6.0)):
        assert one.words(wait) == "no estimate yet"
        assert one.words(3.0) != "no estimate yet"
    monkeypatch.setattr(compiling, "_ended", time.perf_counter())  # the next one is loaded soon
    assert unknown.words(51.0).startswith("compiling kernels (longer")


def test_estimates_learn_how_fast_the_machine_is():
    """Kernels that took twice as long as they do elsewhere; the next scene's are expected to do so, too."""
    expected("a").remember(8.0, False)
    assert expected("b").words() == "compiling kernels (about 8 s, less where they are cached)"
    expected("b").remember(4.5, False)  # between the last two, in the logarithm
    assert expected("c").words() == "compiling kernels (about 6 s, less where they are cached)"
    expected("c").remember(2.5, True)  # another process had compiled it
    assert expected("d").words() == "compiling kernels (about 6 s, less where they are cached)"


def test_the_smaller_kernels_of_pictures_are_compiled_once_in_a_process(monkeypatch):
    assert expected("a", pictures=True).words() == "compiling kernels (about 7 s, less where they are cached)"
    monkeypatch.setattr(compiling, "_spent", 100.0)
    one = expected("a", pictures=True)
    monkeypatch.setattr(compiling, "_spent", 107.0)
    monkeypatch.setattr(compiling, "_in_compiler", 5.0)
    one.spent()
    assert expected("b", pictures=True).words() == "compiling kernels (about 5 s, less where they are cached)"


def test_who_waits_is_told_at_once_and_after_each_kernel(monkeypatch):
    said = []
    with expected("a").told(said.append):
        assert said == ["compiling kernels (about 4 s, less where they are cached)"]
        with simulate(falling()) as sim:
            sim.step(1)
        number = len(said)
        assert number > 1
    assert len(said) == number
    assert expected("a").words().startswith(("loading", "starting"))  # it is remembered


MEASURE = """
import sys, time, warnings
from types import SimpleNamespace
warnings.simplefilter("ignore")
import taichi_sim as ts
from taichi_sim.device import compiling
from tests.support.instructions import SCENES
compiling.time = SimpleNamespace(perf_counter=time.process_time)  # other programs do not count
for name, driver in (("box", "fused"), ("jelly", "fused"), ("cloth", "fused"), ("jelly", "parallel"), ("surfaces", "fused")):
    scene, settings = SCENES[name]()
    with ts.Simulation(scene, arch="cpu", precision="f32", **{**settings, "driver": driver}) as sim:
        one, before = compiling.Expected.of(sim, False), compiling.seconds()
        said = one.words()
        sim.step(2)
        one.spent()
    print(said.split("about ")[1].split()[0], compiling.seconds() - before)
"""


@pytest.mark.long
def test_estimates_of_the_next_structures_of_a_process_are_right_within_a_third(tmp_path):
    environment = {**os.environ, "TI_OFFLINE_CACHE_FILE_PATH": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "times")}
    root = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", MEASURE], env=environment, cwd=root, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for line in done.stdout.splitlines()[1:]:
        said, took = map(float, line.split())
        assert abs(said - took) < 0.3 * took + 0.5, done.stdout  # whole seconds are said


def test_a_second_scene_of_its_kind_in_a_process_tells_nothing_of_the_next_process(monkeypatch):
    monkeypatch.setattr(compiling, "_met", set())
    monkeypatch.setattr(compiling, "_spent", 100.0)
    monkeypatch.setattr(compiling, "_in_compiler", 50.0)
    parts = SimpleNamespace(fields=SimpleNamespace(layout=(5,)), kernels="key")
    kind = SimpleNamespace(kernels=lambda: ["a"], scene=SimpleNamespace(dim=2), backend="cpu", parts=parts)
    for spent, words in ((20.0, "compiling kernels (about 4 s, less where they are cached)"), (0.0, "starting")):
        one = compiling.Expected.of(kind, False)
        assert one.words() == words
        compiling._spent += spent
        compiling._in_compiler += spent
        one.spent()
    monkeypatch.setattr(compiling, "_met", set())
    assert compiling.Expected.of(kind, False).words() == "loading kernels (about 8 s)"
    parts.kernels = ""  # as with user-defined parts
    assert compiling.Expected.of(kind, False).words() == "loading kernels (about 8 s)"
    parts.fields.layout = (6,)
    assert compiling.Expected.of(kind, False).words().startswith("compiling")


def test_what_was_only_loaded_is_not_called_compiled(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(compiling.time, "perf_counter", lambda: clock[0])
    for took, is_loaded in ((0.1, True), (9.0, False)):
        monkeypatch.setattr(compiling, "_spent", 0.0)
        monkeypatch.setattr(compiling, "_in_compiler", 0.0)

        def prepare(took=took):  # 2 s to trace, and the compiler
            clock[0] += 2.0
            compiling._compiler(lambda: clock.__setitem__(0, clock[0] + took))()

        compiling._timed(prepare)()
        assert compiling.seconds() == pytest.approx(2.0 + took)
        assert compiling.loaded() == is_loaded


class Kernel:
    """One of the engine's, on a clock: 2 s to prepare, 5 s for its first launch, which makes machine code, 1 s for others."""

    def __init__(self, clock):
        self.clock, self.compiled_kernels, self.launches = clock, {}, 0

    def materialize(self, key):
        if key not in self.compiled_kernels:
            self.clock[0] += 2.0
            self.compiled_kernels[key] = SimpleNamespace(launched=0)

    def launch(self, compiled, *args):
        self.clock[0] += 1.0 if compiled.launched else 5.0
        compiled.launched += 1
        return args


def test_the_first_launch_of_a_kernel_counts(monkeypatch):
    clock, heard = [0.0], []
    monkeypatch.setattr(compiling.time, "perf_counter", lambda: clock[0])
    monkeypatch.setattr(compiling, "_spent", 0.0)
    prepare, launch = compiling._until_launched(compiling._timed(Kernel.materialize), Kernel.launch)
    kernel, spent = Kernel(clock), []
    with compiling.watched(lambda: heard.append(clock[0])):
        for key in "aaba":
            prepare(kernel, key)
            assert launch(kernel, kernel.compiled_kernels[key], 1, 2) == (1, 2)
            spent.append(compiling.seconds())
        kernel.compiled_kernels = {}  # as the engine does where memory is given back
        prepare(kernel, "a")
        launch(kernel, kernel.compiled_kernels["a"])
    prepare(kernel, "c")
    launch(kernel, kernel.compiled_kernels["c"])
    assert spent == [7.0, 7.0, 14.0, 14.0]
    assert compiling.seconds() == 28.0
    assert heard == [7.0, 15.0, 23.0]


def test_old_scenes_are_forgotten(monkeypatch):
    monkeypatch.setattr(compiling, "MOST_REMEMBERED", 2)
    for name in ("a", "b", "a", "c"):
        expected(name).remember(3.0, False)
    assert [expected(name).words().split()[0] for name in "abc"] == ["loading", "compiling", "loading"]


@pytest.mark.parametrize("text", ["[1]", "{", '{"x": "y"}'])
def test_what_is_no_table_is_written_anew(folder, text):
    folder.mkdir()
    (folder / "compile_times.json").write_text(text)
    assert expected("a").words().startswith("compiling")
    expected("a").remember(5.0, False)
    assert expected("a").words() == "loading kernels (about 2 s)"


def test_a_folder_that_cannot_be_written_costs_nothing_else(folder):
    folder.write_text("a file")
    expected("a").remember(2.0, False)
    assert expected("a").words().startswith("compiling")


@pytest.mark.slow
def test_the_bar_says_what_is_waited_for_and_the_summary_how_long_it_took(monkeypatch, capsys):
    """Each line as it is made: which of them a thread draws is up to the machine."""
    said = []

    def noted(name):
        plain = getattr(_Frames, name)

        def note(frames, *given):
            plain(frames, *given)
            said.append(frames.line())

        monkeypatch.setattr(_Frames, name, note)

    noted("phase")
    noted("advance")
    monkeypatch.setenv("FORCE_COLOR", "1")
    with simulate(falling(2.0), dt=1e-3) as sim:
        summary = export(sim, None, fps=50, duration=0.1, progress=True)
    assert "compiling kernels (about" in said[0]
    assert "x real time" in said[-1]
    assert " frames" in capsys.readouterr().err
    assert summary.compiling > 0.0
    parts = summary.compiling + summary.starting + summary.simulating + summary.drawing + summary.writing
    assert parts == pytest.approx(summary.wall)
    assert ("(loading kernels" if summary.loaded else "(compiling") in summary.lines()[-1]
    said.clear()
    with simulate(falling(3.0), dt=1e-3) as sim:
        export(sim, None, fps=50, duration=0.1, progress=True)
    assert said
    assert not any("compiling kernels" in line for line in said)
