"""A live window through ti.GUI, which needs a display but no OpenGL and no Vulkan."""

import ctypes
import math
import os
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Any

import numpy as np

from taichi_sim.common.atomic_file import replacing
from taichi_sim.common.errors import BackendError
from taichi_sim.common.signals import heard
from taichi_sim.device.compiling import Expected, watched
from taichi_sim.forces.pointer import MOST_RATE_STEP, POINTER_RATE, Pointer
from taichi_sim.outputs.base import Image
from taichi_sim.viewer import overlay
from taichi_sim.viewer.orbit import pick, view_of
from taichi_sim.viewer.pace import Pace
from taichi_sim.viewer.recording import Recording, free_name

TITLE = "taichi_sim (h: help)"
HELP = (
    ("drag a ball", "pull it"),
    ("drag elsewhere", "turn the view; in 2D move it"),
    ("right drag, shift + drag", "move the view"),
    ("wheel, + and -", "nearer, farther"),
    ("space", "pause, go on"),
    ("s", "one time step"),
    ("right arrow", "one picture further"),
    ("r", "back to the start"),
    ("[ and ]", "half and twice the speed"),
    ("p", "save a picture"),
    ("v", "record a video, and stop"),
    ("h", "this list; nothing; the figures"),
    ("esc", "quit"),
)
USE = "use `taichi-sim run SCENE -o x.mp4` instead"
FIGURES, KEYS, NOTHING = range(3)  # what the overlay shows; h goes through them
MESSAGE_TIME = 3.0  # s that a message stays
SHARP = {"shutter": 0.0, "aperture": 0.0}  # of pictures: a window has no time for means of many
SLOW_PICTURE = 0.05  # s: where a picture takes longer, what moves is drawn less fine
COARSEST = 3  # times less wide and high than the window
PAN = ("RMB", "MMB")


def require_display() -> None:
    """Raise BackendError where a window would end the process: on Linux without a display, or with one that does not answer."""
    if not sys.platform.startswith("linux"):
        return
    if not os.environ.get("DISPLAY"):
        raise BackendError(f"there is no display for a window; {USE}")
    try:
        x11 = ctypes.CDLL("libX11.so.6")
    except OSError:
        return  # Taichi, which is linked to it, says so
    x11.XOpenDisplay.restype, x11.XCloseDisplay.argtypes = ctypes.c_void_p, [ctypes.c_void_p]
    display = x11.XOpenDisplay(None)
    if not display:
        raise BackendError(f"the display {os.environ['DISPLAY']!r} does not answer; {USE}")
    x11.XCloseDisplay(display)


def show(
    simulate: Callable[[list[Any]], Any],
    *,
    fps: float,
    size: tuple[int, int],
    until: float | None = None,
    style: Mapping[str, Any] | None = None,
    say: Callable[[str], None] = print,
) -> None:
    """Show a simulation until the window is closed or Ctrl-C; keys are in HELP.

    Args: simulate makes a `Simulation` with forces of the window's, or without: then balls cannot be dragged;
        fps: most pictures per second; size px; until: simulated seconds, or for ever; style: further arguments of
        `Renderer`; say: gets a line for what was written. Raises what the simulation raises, UnstableError among it.
    """
    from taichi_sim.render import Renderer

    pointer, screen = Pointer(), _Screen(size)
    with ExitStack() as stack:
        stack.callback(screen.gui.close)
        try:
            screen.say("reading the scene")
            simulation = stack.enter_context(simulate([pointer]))
            begin, expected = time.perf_counter(), Expected.of(simulation, pictures=True)

            def say_how_long() -> None:
                screen.say(expected.words(time.perf_counter() - begin))

            say_how_long()
            with watched(say_how_long):  # after each kernel
                frame = simulation.frame()
                renderer = stack.enter_context(Renderer(frame, size=size, **{**(style or {}), **SHARP}))
                screen.picture[:] = renderer.render(frame)
                simulation.step(0)
            say_how_long()
            expected.spent()
            window = _Window(screen, simulation, pointer, renderer, fps, until, say)
            stack.callback(window.close)
            window.run()
        except _ClosedError:
            return
        except KeyboardInterrupt:  # as good an end as the close button
            heard()


class _ClosedError(Exception):
    """The window was closed, or esc was pressed, before there was anything to see."""


class _Screen:
    """Window of ti.GUI, which is open from the start, so that those who wait see what for."""

    def __init__(self, size: tuple[int, int]) -> None:
        from taichi_sim.device.engine import ENGINE, ti

        self.size = width, height = size
        if not hasattr(ti, "GUI"):
            raise BackendError(
                f"the window needs ti.GUI, which Taichi has and {ENGINE} has not: leave TAICHI_SIM_ENGINE out"
            )
        try:
            self.gui = ti.GUI(TITLE, res=size, fast_gui=True)
        except RuntimeError as error:
            raise BackendError(f"the window cannot be opened; {USE}") from error
        self.gui.fps_limit = None
        pixels = self.gui.img.view(np.uint8).reshape(height, width, 4)  # as Taichi's vector_to_fast_image fills it
        mac = sys.platform == "darwin"
        pixels[:, :, 3] = 255 if mac else 0
        self.picture: Image = pixels[:, :, :3] if mac else pixels[:, :, 2::-1]
        self.picture[:] = overlay.PANEL

    def say(self, words: str) -> None:
        """Show a line over what is shown, while there is nothing that keys could do. Raises _ClosedError for esc."""
        overlay.draw_table(self.picture, (("", words),))
        self.gui.show()
        for event in self.gui.get_events(self.gui.PRESS):
            if event.key == self.gui.ESCAPE:
                raise _ClosedError
        if not self.gui.running:
            raise _ClosedError


class _Window:
    """The window of one simulation, its mouse and keys."""

    def __init__(
        self,
        screen: _Screen,
        simulation: Any,
        pointer: Pointer,
        renderer: Any,
        fps: float,
        until: float | None,
        say: Callable,
    ) -> None:
        self.simulation, self.renderer, self.fps, self.until, self.say = simulation, renderer, fps, until, say
        self.pointer = pointer if pointer.ready else None
        self.start = simulation.snapshot()
        width, height = self.size = screen.size
        self.gui, self.screen = screen.gui, screen.picture
        self.view = view_of(renderer.camera, self.size)
        self.moved = False  # by hand
        self.pace = Pace()
        self.open, self.paused, self.level = True, False, FIGURES
        self.single = 0  # steps asked for by key
        self.mode = ""  # of a drag: "turn", "pan" or "pull"
        self.cursor = (0.0, 0.0)  # px
        self.message, self.message_until = "", 0.0
        self.recording: Recording | None = None
        self.frame = simulation.frame()
        self.stale = True  # the picture is not that of the present frame and view
        self.shown: Any = None
        self.picture: Image = np.zeros((height, width, 3), dtype=np.uint8)
        self.moving, self.coarse = 1, 1  # how coarse what moves is drawn, and the present picture

    def run(self) -> None:
        """Until it is closed."""
        last = 0.0
        while self.open and self.gui.running:
            self._listen()
            now = time.perf_counter()
            wall, last = (now - last if last else 0.0), now  # before the first picture no time passes
            simulated = self._advance(wall)
            self.pace.note(wall, simulated)
            self._draw(wall, simulated)
            self.gui.show()
            time.sleep(max(0.0, last + 1.0 / self.fps - time.perf_counter()))

    def close(self) -> None:
        """Finish a recording."""
        self._stop_recording()

    # Time ----------------------------------------------------------------------------------------------------------

    def _advance(self, wall: float) -> float:
        """Simulate what is due after `wall` seconds; the seconds that were simulated."""
        sim = self.simulation
        due, self.single = self.single, 0
        if not due and not self.paused:
            due = self.pace.steps(wall, sim.dt)
        due = int(min(due, self._left()))
        if not due:
            return 0.0
        before, begin = sim.time, time.perf_counter()
        sim.step(due)
        self.pace.made(due, time.perf_counter() - begin)
        self.frame, self.stale = sim.frame(), True
        return float(sim.time - before)

    def _left(self) -> float:
        """Steps until the time that ends it."""
        sim = self.simulation
        return math.inf if self.until is None else max(0, round((self.until - sim.time) / sim.dt))

    @property
    def ended(self) -> bool:
        """True if time has come to its end."""
        return self._left() == 0

    def _reset(self) -> None:
        self._let_go()
        self.simulation.resume(self.start)
        self.frame, self.stale = self.simulation.frame(), True

    # Mouse and keys ------------------------------------------------------------------------------------------------

    def _listen(self) -> None:
        for event in self.gui.get_events():
            self._move(event.pos)
            if event.key == self.gui.WHEEL:
                self._zoom(float(np.sign(event.delta[1])))
            elif event.type == self.gui.PRESS and event.key in ("LMB", *PAN):
                self._press(event.key in PAN or "Shift" in event.modifier)
            elif event.type == self.gui.RELEASE and event.key in ("LMB", *PAN):
                self._let_go()
            elif event.type == self.gui.PRESS:
                self._key(event.key)

    def _move(self, place: tuple[float, float]) -> None:
        """The pointer is at a place from (0, 0), bottom left, to (1, 1)."""
        x, y = place[0] * self.size[0] + 0.5, self.size[1] - 0.5 - place[1] * self.size[1]
        dx, dy = x - self.cursor[0], y - self.cursor[1]
        self.cursor = (x, y)
        if not self.mode or not (dx or dy):
            return
        self.stale = True
        if self.mode == "pull" and self.pointer is not None:
            self.pointer.move(self.view.point(self.cursor, self.depth) + self.hold)
        else:
            self.moved = True
            getattr(self.view, self.mode)(dx, dy)

    def _press(self, pan: bool) -> None:
        self._let_go()
        ball = None if pan or self.pointer is None else pick(self.view, self.frame, self.cursor)
        self.mode = "pan" if pan else "turn"
        if ball is not None and self.pointer is not None:
            self.mode = "pull"
            sim = self.simulation
            self.depth = float(self.view.see(self.frame.position[[ball]]).depth[0])
            self.hold = self.frame.position[ball] - self.view.point(self.cursor, self.depth)  # where on it
            self.pointer.rate = min(POINTER_RATE, MOST_RATE_STEP * sim.substeps / sim.dt)
            self.pointer.grab(ball, self.frame.position[ball])

    def _let_go(self) -> None:
        if self.mode == "pull" and self.pointer is not None:
            self.pointer.release()
            self.stale = True
        self.mode = ""

    def _zoom(self, notches: float) -> None:
        self.view.zoom(notches, self.cursor)
        self.moved = self.stale = True

    def _key(self, key: str) -> None:
        sim = self.simulation
        if key == self.gui.ESCAPE:
            self.open = False
        elif key == self.gui.SPACE:
            self.paused = not self.paused
        elif key in ("s", self.gui.RIGHT):
            self.paused, self.single = True, self.single + (1 if key == "s" else max(1, round(1 / self.fps / sim.dt)))
        elif key == "r":
            self._reset()
        elif key in ("[", "]"):
            self.pace.scale(0.5 if key == "[" else 2.0)
        elif key in ("+", "=", "KP_Add", "-", "KP_Subtract"):
            self._zoom(-1.0 if key in ("-", "KP_Subtract") else 1.0)
        elif key == "h":
            self.level = (self.level + 1) % 3
        elif key == "p":
            self._save()
        elif key == "v" and self.recording is not None:
            self._stop_recording()
        elif key == "v":
            self._record()

    # Pictures ------------------------------------------------------------------------------------------------------

    def _draw(self, wall: float, simulated: float) -> None:
        """Show the present; a picture that would be the same is not made again."""
        self._render()
        if self.recording is not None:
            # as fast as was asked for, also where steps are slower; a pause is a pause
            self._add(wall if self.paused or self.ended else simulated / self.pace.speed)
        rows = self._rows()
        state = (self.picture, rows, self.level, self.recording is not None)
        if self.shown is not None and self.shown[0] is self.picture and self.shown[1:] == state[1:]:
            return
        self.shown = state
        self.screen[:] = self.picture
        overlay.draw_table(self.screen, rows)
        if self.level == KEYS:
            overlay.draw_table(self.screen, HELP, bottom=True)
        if self.recording is not None:
            overlay.draw_recording(self.screen)

    def _render(self, sharp: bool = False) -> None:
        """The picture of the present; coarse where it moves and drawing is slow, sharp once it stands or is written."""
        if not self.stale and self.coarse == 1:
            return
        self.coarse = 1 if sharp or not self.stale or self.recording is not None else self.moving
        begin = time.perf_counter()
        if self.moved:
            self.renderer.camera = self.view.camera
        picture = self.renderer.render(self.frame, self.coarse)
        self.view.camera = self.renderer.camera  # which may move by itself until it is moved by hand
        self._judge(time.perf_counter() - begin)
        self.picture = picture if picture.shape[1] == self.size[0] else _enlarged(picture, self.size)
        pointer = self.pointer
        if pointer is not None and pointer.ball is not None and pointer.target is not None:
            ends = self.view.see(np.stack([self.frame.position[pointer.ball], pointer.target])).at
            if np.all(np.isfinite(ends)):
                overlay.draw_line(self.picture, *map(tuple, ends.tolist()))
        self.stale = False

    def _judge(self, seconds: float) -> None:
        """Draw what moves finer or coarser from now on, where its picture took so long; 2D is never coarse."""
        if self.frame.dim == 3 and self.coarse == self.moving:
            wanted = self.coarse + (seconds > SLOW_PICTURE) - (seconds < SLOW_PICTURE / 4)
            self.moving = min(max(wanted, 1), COARSEST)

    def _rows(self) -> tuple[tuple[str, str], ...]:
        """The figures that the overlay shows."""
        message = (("", self.message),) if time.perf_counter() < self.message_until else ()
        if self.level == NOTHING:
            return message
        frame, pace = self.frame, self.pace
        asked = "" if pace.speed == 1 else f" ({pace.speed:g} x asked for)"
        speed = "paused" if self.paused else "at its end" if self.ended else f"{pace.reached:.2g} x real time"
        rate = () if self.paused or self.ended or not pace.rate else (("pictures", f"{pace.rate:.0f} per second"),)
        energy = () if frame.energy is None else (("energy", f"{frame.energy[3]:.4g} J"),)
        balls = ("balls", f"{len(frame.position):,}".replace(",", " "))
        return (("time", f"{frame.time:.3f} s"), ("speed", speed + asked), *rate, *energy, balls, *message)

    def _tell(self, message: str) -> None:
        self.message, self.message_until = message, time.perf_counter() + MESSAGE_TIME

    def _save(self) -> None:
        """Write picture_000.png, picture_001.png, ..., without the overlay."""
        from PIL import Image as Pictures

        self._render(sharp=True)
        path = free_name("picture", ".png")
        try:
            with replacing(path) as file:
                Pictures.fromarray(self.picture).save(file, "PNG")
        except OSError as error:
            self._tell(str(error))
            return
        self._tell(f"saved {path}")
        self.say(f"written      {path}")

    def _record(self) -> None:
        """Begin recording_000.mp4, recording_001.mp4, ..., without the overlay."""
        self._render(sharp=True)
        try:
            self.recording = Recording(free_name("recording", ".mp4"), self.fps)
        except OSError as error:
            self._tell(str(error))
        else:
            self._add(0.0)
            self._tell(f"recording {self.recording.path}")

    def _add(self, seconds: float) -> None:
        """Give the picture to the recording."""
        assert self.recording is not None
        try:
            self.recording.add(self.frame, self.picture, seconds)
        except Exception:  # a full disk, or what an encoder raises
            self._stop_recording()  # which says why

    def _stop_recording(self) -> None:
        if self.recording is None:
            return
        recording, self.recording = self.recording, None
        try:
            recording.finish()
        except Exception as error:
            self._tell(f"{recording.path}: cannot be written: {error}")
            return
        self._tell(f"saved {recording.path}")
        self.say(f"written      {recording.path}")


def _enlarged(image: Image, size: tuple[int, int]) -> Image:
    from PIL import Image as Pictures

    return np.array(Pictures.fromarray(image).resize(size, Pictures.Resampling.BILINEAR))
