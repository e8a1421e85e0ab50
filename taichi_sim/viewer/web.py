"""Live views in browsers: of a simulation that pages play with, and of a run that they look on at."""

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from html import escape
from typing import Any

from taichi_sim.analysis.frame import Frame
from taichi_sim.analysis.probe_readings import units_of
from taichi_sim.common.errors import UnstableError
from taichi_sim.common.progress import Work, current
from taichi_sim.common.signals import heard
from taichi_sim.device.compiling import Expected
from taichi_sim.forces.pointer import Pointer
from taichi_sim.outputs.export import DRAWN
from taichi_sim.viewer.pace import Share
from taichi_sim.viewer.player import Player, Rows
from taichi_sim.viewer.web_panel import WebPanel
from taichi_sim.viewer.web_server import HOST, PORT, WebServer
from taichi_sim.viewer.web_stage import COLOURS, WebStage
from taichi_sim.viewer.web_waiting import ENDED

__all__ = ["LiveView", "show"]

MOST_FPS = 30.0  # pictures per second that pages get
PART = 0.05  # of the time of a run that may be spent on those who look on
IDLE = 0.1  # s between looks at whether a page was opened
GOODBYE = 0.3  # s for the last words to reach pages
TOLD = 1.0  # s between two messages to those who wait
HEIGHT = 600  # px, of a page in a notebook


class LiveView:
    """A page on which one looks on while frames are made; nothing that is done there changes them.

        with ts.LiveView() as view:
            print(view.url)
            view.wait(simulation)
            ts.export(simulation, "x.mp4", watch=view.show)

    In a notebook a cell that ends with `view` shows the page.

    Args: host and port to listen on, 0 for any port that is free; title: of the panel; style: arguments of a Renderer, of which
    `colour`, `colour_range` and `camera` count. `url` holds a random token; who does not know it is refused. Raises BackendError
    where viser is missing, OSError where the port cannot be had.
    """

    def __init__(
        self, host: str = HOST, port: int = PORT, title: str = "taichi_sim", style: Mapping[str, Any] | None = None
    ) -> None:
        self._server, self._title, self._style = WebServer(host, port), title, style or {}
        self.url = self._server.url
        self._words = self._server.viser.gui.add_markdown("Please wait: the program is reading the scene.")
        self._share = Share(MOST_FPS, PART)
        self._stage: WebStage | None = None
        self._waiting, self._waits_at = ExitStack(), -math.inf
        self._begin = 0.0
        self._withheld: Frame | None = None  # the newest frame, where its picture would have taken too much of the time
        self._work: Work | None = None  # of the export whose frames are shown
        self._drawing = ExitStack()
        self._drawing.enter_context(_repeating(lambda _: self._tell_drawing()))

    def wait(self, simulation: Any, pictures: bool = False) -> None:
        """Show a simulation as it is now, and tell how long its kernels take, until `show` gets a frame of another time.
        May be called again, as before another run.

        pictures: True if pictures of it are drawn, whose kernels take time, too.
        """
        self._waiting.close()
        self._work = None
        self._words.visible, self._begin = True, 0.0
        frame = simulation.frame()
        self._waits_at = frame.time
        self.show(frame)
        self._waiting.enter_context(_telling(self._words, Expected.of(simulation, pictures).words))

    def show(self, frame: Frame) -> None:
        """Show a frame, unless that would take too much of the time; always those up to the first one at another time than
        `wait` showed, and the last one. Frames are of one scene."""
        self._work = current()
        if self._begin == 0.0:
            self._share = Share(MOST_FPS, PART)  # the wait is not charged to the run
            if frame.time != self._waits_at:  # else more kernels follow
                self._waiting.close()
                # removed, they were an error of pages that hear of it with a last change of them
                self._words.visible = False
                self._begin = time.perf_counter()
        self._show(frame, last=self._work is not None and self._work.done + 1 == self._work.total)

    def _show(self, frame: Frame, last: bool = False) -> None:
        begin = time.perf_counter()
        if self._stage is None:
            self._open(frame)
        elif not (self._server.watched and (last or self._share.due(begin))):
            self._panel.history.add(frame.time, frame.probes)
            self._withheld = frame
            return
        self._withheld = None
        self._server.work()
        assert self._stage is not None
        self._stage.show(frame, self._panel.colour)
        self._panel.show(frame.time, frame.probes, lambda: self._rows(frame, begin), last)
        self._share.spent(begin, time.perf_counter())

    def _tell_drawing(self) -> None:
        """Tell pages how many pictures are drawn of a run that is simulated already: nothing moves meanwhile."""
        work = self._work
        if work is not None and work.what == DRAWN:
            self._words.content = (
                f"Drawing pictures: {', '.join(filter(None, (f'{work.done} of {work.total}', work.remaining)))}."
            )
            self._words.visible = work.done != work.total

    def _open(self, first: Frame) -> None:
        self._stage = WebStage(self._server, first, self._style)
        scene = getattr(first, "scene", None)
        probes = {} if scene is None else units_of(scene)
        self._panel = WebPanel(self._server, self._title, probes, self._style.get("colour") or COLOURS[0])

    def _rows(self, frame: Frame, now: float) -> Rows:
        spent = now - self._begin if self._begin else 0.0
        speed = (("speed", f"{frame.time / spent:.2g} x real time"),) if spent > 0 else ()
        balls = ("balls", f"{len(frame.position):,}".replace(",", " "))
        assert self._stage is not None
        return (("time", f"{frame.time:.3f} s"), *speed, balls, *self._stage.legend(self._panel.colour))

    def _repr_html_(self) -> str:
        """The page, in a frame."""
        return f'<iframe src="{escape(self.url)}" width="100%" height="{HEIGHT}" style="border:0"></iframe>'

    def close(self) -> None:
        """Close the pages' connection. Calling it twice does no harm."""
        self._waiting.close()
        self._drawing.close()
        self._server.close()

    def __enter__(self) -> "LiveView":
        return self

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        if self._withheld is not None:
            self._show(self._withheld, last=True)
        self._tell_drawing()
        _take_leave(self._server, "The run has ended.", error)
        self.close()


def show(
    simulate: Callable[[list[Any]], Any],
    *,
    fps: float,
    host: str = HOST,
    port: int = PORT,
    until: float | None = None,
    title: str = "taichi_sim",
    style: Mapping[str, Any] | None = None,
    say: Callable[[str], None] = print,
) -> None:
    """Show a simulation on pages that play with it, until Ctrl-C. No time passes while no page is open.

    Args: simulate makes a `Simulation` with forces of the view's, or without: then balls cannot be dragged; fps: most pictures
        per second; until: simulated seconds, or for ever; say: gets the address. Raises what the simulation raises, and as
        `LiveView`.
    """
    pointer = Pointer()
    with ExitStack() as stack:
        server = stack.enter_context(WebServer(host, port))
        say(f"open         {server.url}")
        words = server.viser.gui.add_markdown("Please wait: the program is reading the scene.")
        try:
            simulation = stack.enter_context(simulate([pointer]))
            first = simulation.frame()
            WebStage(server, first, style or {}).show(first)  # in view until it can be played with
            expected = Expected.of(simulation, pictures=False)
            with _telling(words, expected.words), expected.told(lambda _: None):
                simulation.step(0)
                player = Player(simulation, pointer, min(fps, MOST_FPS), until)
            words.visible = False
            _Browsers(server, player, title, style or {}).run()
        except KeyboardInterrupt as error:  # as good an end as the close button of a window
            heard()
            _take_leave(server, "", error)
        except BaseException as error:
            _take_leave(server, "", error)
            raise


class _Browsers:
    """The pages of one player."""

    def __init__(self, server: WebServer, player: Player, title: str, style: Mapping[str, Any]) -> None:
        self.server, self.player = server, player
        scene = player.simulation.scene
        self.probes = units_of(scene)
        self.stage = WebStage(server, player.frame, style, None if player.pointer is None else self._drag)
        self.panel = WebPanel(server, title, self.probes, style.get("colour") or COLOURS[0], player)
        self.holder: int | None = None  # the page that drags
        self.shown: Any = None

    def run(self) -> None:
        """For ever."""
        last = 0.0
        share = Share(self.player.fps, 0.5)
        while True:
            self.server.work()
            if not self.server.watched:
                last = 0.0
                time.sleep(IDLE)
                continue
            now = time.perf_counter()
            wall, last = (now - last if last else 0.0), now
            self.player.advance(wall)
            begin = time.perf_counter()
            if share.due(begin):
                self._show()
                share.spent(begin, time.perf_counter())
            time.sleep(max(0.0, last + 1.0 / self.player.fps - time.perf_counter()))

    def _show(self) -> None:
        player = self.player
        held = player.held
        state = (player.frame, self.panel.colour, held)
        if self.shown is None or any(a is not b for a, b in zip(state, self.shown)):
            self.stage.show(*state)
            self.shown = state
        probes = player.simulation.probes() if self.probes else {}
        self.panel.show(player.frame.time, probes, self._rows)

    def _rows(self) -> Rows:
        return (*self.player.figures(), *self.stage.legend(self.panel.colour))

    def _drag(self, phase: str, page: int, ball: Any, to: Any) -> None:
        """Follow a drag of a page, the first of those that drag at one time."""
        player = self.player
        if phase == "start" and self.holder is None:
            self.holder = page if player.grab(ball(player.frame), to) else None
        elif page == self.holder:
            player.pull(to)
            if phase == "end":
                player.let_go()
                self.holder = None


def _telling(place: Any, words: Callable[[float], str]) -> Any:
    """Tell pages meanwhile, in a markdown of theirs, what `words` makes of the seconds that they have waited."""

    def tell(waited: float) -> None:
        place.content = f"Please wait: {words(waited)}. {waited:.0f} s have passed."

    return _repeating(tell)


@contextmanager
def _repeating(tell: Callable[[float], None]) -> Iterator[None]:
    """Call it meanwhile, now and every TOLD seconds, with the seconds that have passed."""
    begin, ended = time.monotonic(), threading.Event()

    def go_on() -> None:
        while not ended.wait(TOLD):
            tell(time.monotonic() - begin)

    tell(0.0)
    thread = threading.Thread(target=go_on, name="telling", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _take_leave(server: WebServer, words: str, error: BaseException | None) -> None:
    """Tell pages, if any is open, why nothing moves any more: `words`, or the error that ended it."""
    if not server.watched:
        return
    if isinstance(error, KeyboardInterrupt):
        words = "It was stopped by Ctrl-C."
    elif error is not None:
        words = str(error) if isinstance(error, UnstableError) else "An error, which the program printed, ended it."
    server.notify(ENDED, words)
    time.sleep(GOODBYE)
