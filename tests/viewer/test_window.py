"""The live window under a real X server, with real mouse and key events, in processes of its own."""

import os
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import av
import numpy as np
import pytest
from PIL import Image
from window_support import MISSING, Display, Window

from taichi_sim import Frame
from taichi_sim.device.engine import ENGINE
from taichi_sim.render import Renderer
from taichi_sim.viewer.window import _ClosedError, _Screen

pytestmark = pytest.mark.once

SIZE = (320, 240)
HELD, OTHER, PINNED = 0, 1, 2

needs_tools = pytest.mark.skipif(
    bool(MISSING) or ENGINE != "taichi",
    reason=f"{' and '.join(MISSING)} not installed" if MISSING else "the window needs ti.GUI, which only Taichi has",
)


@pytest.fixture(scope="module")
def display():
    display = Display()
    yield display
    display.close()


def opened(display, tmp_path_factory, scene: str):
    window = Window.of(display, tmp_path_factory.mktemp(scene), scene)
    yield window
    window.kill()


@pytest.fixture(scope="module")
def flat(display, tmp_path_factory):
    """A window with three balls in 2D that lie still, the last one pinned."""
    yield from opened(display, tmp_path_factory, "two")


def pixels(window: Window) -> np.ndarray:
    """Where its balls are, as the first view sees them."""
    _, start = window.frames()[0]
    _, now = window.frames()[-1]
    frame = Frame(0.0, start, 0 * start, np.full(len(start), 0.1))
    with Renderer(frame, size=SIZE) as renderer:
        return renderer.camera.see(now, SIZE).at


def saved(window: Window) -> np.ndarray:
    """The picture that p writes."""
    before = set(window.folder.glob("picture_*.png"))
    window.key("p")
    window.until(lambda: set(window.folder.glob("picture_*.png")) - before)
    (new,) = set(window.folder.glob("picture_*.png")) - before
    with Image.open(new) as picture:
        return np.array(picture)


@needs_tools
def test_dragging_moves_a_ball(flat):
    """The ball goes to where the mouse let it go, the others stay, and so does a pinned one that is dragged."""
    flat.moves_on()
    before = pixels(flat)
    there = before[HELD] + [60, -70]
    flat.drag(before[HELD], before[HELD] + [30, -30], there, hold=1.0)
    after = pixels(flat)
    assert after[HELD] == pytest.approx(there, abs=8)
    assert after[[OTHER, PINNED]] == pytest.approx(before[[OTHER, PINNED]], abs=1e-3)
    flat.key("r")
    flat.until(lambda: np.allclose(pixels(flat), before, atol=1e-3))
    # of a pinned ball there is nothing to drag: the view moves
    flat.drag(before[PINNED], before[PINNED] + [40, 30])
    assert pixels(flat) == pytest.approx(before, abs=1e-3)
    flat.drag(before[PINNED] + [40, 30], before[PINNED])
    flat.drag(before[OTHER], before[OTHER] + [10, 60], hold=1.0)  # a thousand times lighter, where it was before
    assert pixels(flat)[OTHER] == pytest.approx(before[OTHER] + [10, 60], abs=8)


@needs_tools
def test_pause_step_and_reset(flat):
    flat.moves_on()
    flat.key("space")
    time.sleep(0.5)
    stopped = flat.time
    time.sleep(0.5)
    assert flat.time == stopped
    flat.key("s")
    flat.until(lambda: flat.time == pytest.approx(stopped + 1e-3, abs=1e-9))
    flat.key("Right")
    flat.until(lambda: flat.time == pytest.approx(stopped + 1e-3 + 33e-3, abs=1e-9))
    flat.key("r")
    flat.until(lambda: flat.time == 0)
    flat.key("space")
    flat.moves_on()


@needs_tools
def test_slow_motion(flat):
    def speed() -> float:
        begin, at = time.monotonic(), flat.time
        time.sleep(1.0)
        return (flat.time - at) / (time.monotonic() - begin)

    flat.moves_on()
    flat.key(*["bracketleft"] * 4)
    time.sleep(0.3)
    slow = speed()
    flat.key(*["bracketright"] * 4)
    time.sleep(0.3)
    assert 0 < slow < 0.5 * speed()


@needs_tools
def test_a_picture_is_saved_as_it_is_seen(flat):
    flat.key("space")
    flat.until(lambda: saved(flat).shape == (240, 320, 3))
    first = saved(flat)
    assert first.std() > 3
    assert np.array_equal(saved(flat), first)  # it stands
    flat.display.do("click", 4)  # the wheel
    nearer = saved(flat)
    assert np.abs(nearer.astype(int) - first).mean() > 1
    flat.key("minus")
    assert np.abs(saved(flat).astype(int) - first).max() <= 2
    flat.drag((10, 10), (40, 30), button=3)
    assert np.abs(saved(flat).astype(int) - first).mean() > 1
    flat.drag((40, 30), (10, 10), button=2)
    assert np.abs(saved(flat).astype(int) - first).max() <= 2
    flat.key("space")


def decoded(path) -> list[np.ndarray]:
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


@needs_tools
def test_a_recording_plays(flat):
    flat.moves_on()
    flat.key("v")
    time.sleep(1.0)
    assert not (flat.folder / "recording_000.mp4").exists()  # it appears when it is complete
    flat.key("v")
    flat.until((flat.folder / "recording_000.mp4").exists)
    frames = decoded(flat.folder / "recording_000.mp4")
    assert 3 <= len(frames) <= 60
    assert frames[0].shape == (240, 320, 3)
    assert frames[0].std() > 3


@needs_tools
def test_escape_ends_it(flat):
    """Last of those that share the window. A recording that still runs is finished."""
    flat.key("v")
    flat.until(lambda: list(flat.folder.glob(".recording_001.mp4.*")))
    time.sleep(0.5)
    flat.key("Escape")
    assert flat.ended() == 0
    assert len(decoded(flat.folder / "recording_001.mp4")) >= 1
    assert flat.errors == ""
    assert '"written      recording_001.mp4"' in flat.log.read_text()


@pytest.mark.slow
@needs_tools
def test_turning_and_dragging_in_3d(display, tmp_path_factory):
    """A drag beside the cloth turns the view; one on it moves it; shift moves the view. Closed as by a window manager."""
    for window in opened(display, tmp_path_factory, "three"):
        window.moves_on()
        begin = window.frames()[0][1]
        first = saved(window)
        window.drag((8, 230), (60, 210))
        turned = saved(window)
        assert np.abs(turned.astype(int) - first).mean() > 2
        display.do("keydown", "shift")
        window.drag((8, 230), (30, 200))
        display.do("keyup", "shift")
        assert np.abs(saved(window).astype(int) - turned).mean() > 2
        assert window.frames()[-1][1] == pytest.approx(begin, abs=1e-3)
        window.drag((160, 120), (200, 90), hold=0.5)
        moved = np.linalg.norm((window.frames()[-1][1] - begin).mean(axis=0))
        assert moved > 0.05
        window.close()
        assert window.ended() == 0
        assert window.errors == ""


class Waiting:
    """A ti.GUI in which events wait, and pressed keys are Escape, or others."""

    PRESS, ESCAPE = "press", "Escape"

    def __init__(self, *keys):
        self.events, self.running, self.shown = [SimpleNamespace(key=key) for key in keys], True, 0

    def get_events(self, kind):
        while self.events:
            yield self.events.pop(0)

    def show(self):
        self.shown += 1


def test_keys_do_nothing_while_there_is_nothing_to_see_but_escape():
    screen = object.__new__(_Screen)
    screen.picture = np.zeros((40, 200, 3), dtype=np.uint8)
    screen.gui = Waiting("space", "v", "r")
    screen.say("compiling")
    assert not screen.gui.events  # none is left for later
    assert screen.gui.shown == 1
    screen.gui = Waiting("space", "Escape", "v")
    with pytest.raises(_ClosedError):
        screen.say("compiling")
    screen.gui = Waiting()
    screen.gui.running = False
    with pytest.raises(_ClosedError):
        screen.say("compiling")


FALLING = """format = 1
dim = 2
gravity = [0.0, -10.0]
[simulation]
contacts = "off"
dt = DT
[[balls]]
position = [[0.0, 1.0], [1.0, 1.0]]
radius = 0.1
[output]
size = [320, 240]
"""  # DT: a step


def view(display, folder, text: str, dt: str = "1e-3") -> Window:
    (folder / "ball.toml").write_text(text.replace("DT", dt))
    return Window(display, folder, "-m", "taichi_sim", "view", "ball.toml")


@needs_tools
def test_control_c_ends_it(display, tmp_path):
    """With exit status 0, and a recording finished."""
    window = view(display, tmp_path, FALLING)
    window.until(lambda: window.key("p") or list(tmp_path.glob("picture_*.png")))  # before, keys do nothing
    window.key("v")
    window.until(lambda: list(tmp_path.glob(".recording_000.mp4.*")))
    time.sleep(0.5)
    window.process.send_signal(signal.SIGINT)
    assert window.ended() == 0
    assert window.errors == ""
    assert len(decoded(tmp_path / "recording_000.mp4")) >= 1
    assert "written      recording_000.mp4" in window.log.read_text()


@pytest.mark.slow
@needs_tools
def test_what_becomes_unstable_says_so(display, tmp_path):
    springs = "[[springs]]\npairs = [[0, 1]]\nstiffness = 1e6\nrest_length = 0.9\n"
    window = view(display, tmp_path, FALLING + springs, "0.1")
    assert window.ended() == 3
    last = window.errors.strip().splitlines()[-1]
    assert last.startswith("taichi-sim: ball ")
    assert "is not finite or left the world" in last


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems always have a display")
@pytest.mark.parametrize(
    ("name", "says"), [(None, "there is no display"), (":9999", "the display ':9999' does not answer")]
)
def test_without_a_display_one_sentence(tmp_path, name, says):
    (tmp_path / "ball.toml").write_text(FALLING)
    environment = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}
    environment |= {} if name is None else {"DISPLAY": name}
    command = [sys.executable, "-m", "taichi_sim", "view", "ball.toml"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert done.stderr.startswith(f"taichi-sim: {says}")
    assert done.stderr.endswith("use `taichi-sim view SCENE --web` or `taichi-sim run SCENE -o x.mp4` instead\n")
    assert done.stderr.count("\n") == 1
