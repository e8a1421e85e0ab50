"""A live window through ti.GUI, which needs a display but no OpenGL and no Vulkan."""

import ctypes
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
from taichi_sim.device.compiling import Expected
from taichi_sim.forces.pointer import Pointer
from taichi_sim.outputs.base import Image
from taichi_sim.overlays.panel import DARK
from taichi_sim.viewer import overlay
from taichi_sim.viewer.orbit import pick, view_of
from taichi_sim.viewer.player import COMMANDS, Player
from taichi_sim.viewer.recording import Recording, free_name

TITLE = "taichi_sim (h: help)"
HELP = (
    ("drag a ball", "pull it"),
    ("drag elsewhere", "turn the view; in 2D move it"),
    ("right drag, shift + drag", "move the view"),
    ("wheel, + and -", "nearer, farther"),
    *((one.key, one.words) for one in COMMANDS),
    ("p", "save a picture"),
    ("v", "record a video, and stop"),
    ("h", "this list; nothing; the figures"),
    ("esc", "quit"),
)
USE = "use `taichi-sim view SCENE --web` or `taichi-sim run SCENE -o x.mp4` instead"
FIGURES, KEYS, NOTHING = range(3)  # what the overlay shows; h goes through them
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
            with Expected.of(simulation, pictures=True).told(screen.say):
                frame = simulation.frame()
                renderer = stack.enter_context(Renderer(frame, size=size, **{**(style or {}), **SHARP}))
                screen.picture[:] = renderer.render(frame)
                simulation.step(0)
            window = _Window(screen, Player(simulation, pointer, fps, until), renderer, say)
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
        self.picture[:] = DARK.ground[:3]

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
    """The window of one player, its mouse and keys."""

    def __init__(self, screen: _Screen, player: Player, renderer: Any, say: Callable[[str], None]) -> None:
        self.player, self.renderer, self.say = player, renderer, say
        width, height = self.size = screen.size
        self.gui, self.screen = screen.gui, screen.picture
        names = {"space": self.gui.SPACE, "right arrow": self.gui.RIGHT}
        self.commands = {names.get(one.key, one.key): one.act for one in COMMANDS}
        self.view = view_of(renderer.camera, self.size)
        self.moved = False  # by hand
        self.open, self.level = True, FIGURES
        self.mode = ""  # of a drag: "turn", "pan" or "pull"
        self.cursor = (0.0, 0.0)  # px
        self.recording: Recording | None = None
        self.drawn: Any = None  # the frame of the picture
        self.stale = True  # the picture is not that of the present view
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
            self._draw(wall, self.player.advance(wall))
            self.gui.show()
            time.sleep(max(0.0, last + 1.0 / self.player.fps - time.perf_counter()))

    def close(self) -> None:
        """Finish a recording."""
        self._stop_recording()

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
        if self.mode == "pull":
            self.player.pull(self.view.point(self.cursor, self.depth))
        else:
            self.moved = True
            getattr(self.view, self.mode)(dx, dy)

    def _press(self, pan: bool) -> None:
        self._let_go()
        self.mode = "pan" if pan else "turn"
        ball = None if pan or self.player.pointer is None else pick(self.view, self.player.frame, self.cursor)
        if ball is None:
            return
        self.depth = float(self.view.camera.see(self.player.frame.position[[ball]], self.size).depth[0])
        if self.player.grab(ball, self.view.point(self.cursor, self.depth)):
            self.mode = "pull"

    def _let_go(self) -> None:
        if self.mode == "pull":
            self.player.let_go()
            self.stale = True
        self.mode = ""

    def _zoom(self, notches: float) -> None:
        self.view.zoom(notches, self.cursor)
        self.moved = self.stale = True

    def _key(self, key: str) -> None:
        if key in self.commands:
            self.commands[key](self.player)
        elif key == self.gui.ESCAPE:
            self.open = False
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
            self._add(wall if self.player.stands else simulated / self.player.pace.speed)
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
        frame = self.player.frame
        is_stale = self.stale or frame is not self.drawn
        if not is_stale and self.coarse == 1:
            return
        self.coarse = 1 if sharp or not is_stale or self.recording is not None else self.moving
        begin = time.perf_counter()
        if self.moved:
            self.renderer.camera = self.view.camera
        picture = self.renderer.render(frame, self.coarse)
        self.view.camera = self.renderer.camera  # which may move by itself until it is moved by hand
        self._judge(time.perf_counter() - begin)
        self.picture = picture if picture.shape[1] == self.size[0] else _enlarged(picture, self.size)
        if self.player.held is not None:
            ends = self.view.camera.see(np.stack(self.player.held), self.size).at
            if np.all(np.isfinite(ends)):
                overlay.draw_line(self.picture, *map(tuple, ends.tolist()))
        self.drawn, self.stale = frame, False

    def _judge(self, seconds: float) -> None:
        """Draw what moves finer or coarser from now on, where its picture took so long; 2D is never coarse."""
        if self.player.frame.dim == 3 and self.coarse == self.moving:
            wanted = self.coarse + (seconds > SLOW_PICTURE) - (seconds < SLOW_PICTURE / 4)
            self.moving = min(max(wanted, 1), COARSEST)

    def _rows(self) -> tuple[tuple[str, str], ...]:
        """The figures that the overlay shows."""
        figures = () if self.level == NOTHING else self.player.figures()
        return (*figures, *self.player.message)

    def _save(self) -> None:
        """Write picture_000.png, picture_001.png, ..., without the overlay."""
        from PIL import Image as Pictures

        self._render(sharp=True)
        path = free_name("picture", ".png")
        try:
            with replacing(path) as file:
                Pictures.fromarray(self.picture).save(file, "PNG")
        except OSError as error:
            self.player.tell(str(error))
            return
        self.player.tell(f"saved {path}")
        self.say(f"written      {path}")

    def _record(self) -> None:
        """Begin recording_000.mp4, recording_001.mp4, ..., without the overlay."""
        self._render(sharp=True)
        try:
            self.recording = Recording(free_name("recording", ".mp4"), self.player.fps)
        except OSError as error:
            self.player.tell(str(error))
        else:
            self._add(0.0)
            self.player.tell(f"recording {self.recording.path}")

    def _add(self, seconds: float) -> None:
        """Give the picture to the recording."""
        assert self.recording is not None
        try:
            self.recording.add(self.player.frame, self.picture, seconds)
        except Exception:  # a full disk, or what an encoder raises
            self._stop_recording()  # which says why

    def _stop_recording(self) -> None:
        if self.recording is None:
            return
        recording, self.recording = self.recording, None
        try:
            recording.finish()
        except Exception as error:
            self.player.tell(f"{recording.path}: cannot be written: {error}")
            return
        self.player.tell(f"saved {recording.path}")
        self.say(f"written      {recording.path}")


def _enlarged(image: Image, size: tuple[int, int]) -> Image:
    from PIL import Image as Pictures

    return np.array(Pictures.fromarray(image).resize(size, Pictures.Resampling.BILINEAR))
