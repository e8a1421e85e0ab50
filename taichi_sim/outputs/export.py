"""Export of a simulation to an output: the loop over frames, its progress bar and its summary."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from functools import partial
from typing import Any, Literal

from taichi_sim.analysis.frame import NEARLY, Frame, frame_count
from taichi_sim.analysis.keyframes_in_steps import inside_steps
from taichi_sim.analysis.outcome import left_out
from taichi_sim.common import validation
from taichi_sim.common.atomic_file import naming
from taichi_sim.common.errors import SceneError, UnstableError
from taichi_sim.common.progress import Work, showing
from taichi_sim.common.signals import Patience, patiently
from taichi_sim.common.warn import warn
from taichi_sim.device import compiling
from taichi_sim.outputs import whole_run
from taichi_sim.outputs.background_writer import Behind
from taichi_sim.outputs.base import Image, Output, film_rate, require_alpha
from taichi_sim.outputs.checkpoints import Checkpoints, frames_from, restored, run_of, shared_checkpoint
from taichi_sim.outputs.companion import Companion
from taichi_sim.outputs.frame_log import CHECKPOINT, Checkpoint
from taichi_sim.outputs.kept_files import judged
from taichi_sim.outputs.observer import Observer
from taichi_sim.outputs.summary import Summary
from taichi_sim.scene.looks import Look, Subjects

__all__ = ["DRAWN", "export"]

DRAWN = "frames drawn"  # what the progress counts while pictures of a run are drawn that is simulated already


def export(
    simulation: Any,
    output: Output | Sequence[Output] | None,
    *,
    fps: float = 60.0,
    duration: float = 5.0,
    size: tuple[int, int] = (1280, 720),
    progress: bool = False,
    style: Mapping[str, Any] | None = None,
    checkpoint: float | Literal["auto"] | None = "auto",
    error: bool = False,
    watch: Callable[[Frame], None] | None = None,
) -> Summary:
    """Run a simulation and give its frames to an output, to each of several, or to none for the summary alone.

    Args:
        simulation: a `Simulation`; frames are made of it as by `Simulation.frames`, and it is left at the last one.
        size: of the pictures, (width, height) px. style: further arguments of `Renderer`, and `overlay`, keys of an `Overlay`.
        progress: a bar on standard error with the time left and the speed against real time.
        checkpoint: seconds of wall time between two checkpoints, from which a resumed run goes on, of a built-in output; more
            where they would take over a fiftieth of it. "auto": 60 s, from the second minute on. None: none.
        error: run the scene a second time at half the step, and give what is read with the error of step and rounding.
        watch: called with each frame that is simulated, like `LiveView.show`. `step`, `reset` and `export` are refused there.
    Outputs are finished here, also when the simulation becomes unstable, and discarded on any other error.

    Outputs that were opened with `resume` must be given the simulation, and the arguments, that their run began with (`duration`
    and `checkpoint` may be others): ValueError otherwise. Where all have the same checkpoint the simulation is closed, and
    another goes on from there. Otherwise it runs from the start, but frames that are kept are not drawn again. An output that is
    complete already is left as it is, with a warning; where all are, nothing is simulated.

    Where a camera is to show all of the run (see `CameraPath.fit`), it is simulated to its end before the first picture is drawn;
    outputs that need no pictures get their frames meanwhile.
    """
    outputs = _checked(output)
    fps, duration = validation.number("fps", fps, positive=True), validation.number("duration", duration, low=0)
    if checkpoint not in ("auto", None):
        checkpoint = validation.number("checkpoint", checkpoint, positive=True)
    count = frame_count(fps, duration)
    finished = [one for one in outputs if one.path is not None and one.is_finished(count)]
    for one in finished:
        one.leave_as_it_is()
        warn(f"{one.path}: is complete, and is left as it is; without resume it is made anew")
    if finished and len(finished) == len(outputs):
        return Summary(complete=[str(one.path) for one in finished])
    outputs = [one for one in outputs if one not in finished]
    clock, style = _Clock(Summary()), style or {}
    with ExitStack() as stack:
        stack.enter_context(simulation.exported())
        writers = [_Writer(one, stack) for one in outputs]
        require_alpha(outputs, style)
        is_drawn = any(one.needs_image for one in outputs)
        expected = compiling.Expected.of(simulation, is_drawn)
        bar = _Frames(count)
        stack.enter_context(showing(bar, progress))
        first = simulation.frame()
        if style.get("looks") is not None:
            Look.listed(style["looks"], Subjects.of_scene(simulation.scene), read=False)
        drawn_last = is_drawn and whole_run.is_drawn_last(simulation.scene, count, style)
        for one in outputs:
            if one.fps is None:
                one.fps = film_rate(fps) if one.is_film else fps
            one.prepare(first, size, style)
        log, last = None, None
        if logged := [one for one in outputs if one.path is not None]:
            all_logged = len(logged) == len(outputs)
            about = run_of(simulation, first, fps, size, style, duration if drawn_last else None)
            last = shared_checkpoint(logged, about, first, count if all_logged else 0, drawn_last)
            log = Checkpoints(logged, checkpoint) if all_logged else None
        if last is not None:
            if error:
                raise SceneError("error", says="cannot be estimated in a run that is resumed; begin it anew")
            simulation = stack.enter_context(restored(simulation, last))
        companion = Companion(simulation, duration) if error else None
        if companion is not None:
            stack.enter_context(simulation.pausing(companion.every, partial(companion.look, simulation)))
        renderer: Any = stack.enter_context(_renderer(first, size, style)) if is_drawn else None
        run = _Run(simulation, writers, clock, bar, log, None if drawn_last else renderer)
        begin, frames = 0, simulation.frames(fps=fps, duration=duration)
        if last is not None:
            begin, frames = last.frame, frames_from(last.frame, simulation, fps, duration)
            clock.summary = _recall(last, run.renderer)
            for writer in writers:
                if not (drawn_last and writer.output.needs_image):
                    writer.replay(begin)
            clock.charge("writing")
        summary = clock.summary
        observer = Observer(simulation, summary)
        frames = _observed(_moving(simulation, frames), observer, clock, companion, watch)
        bar.phase(expected.words, "frames simulated" if drawn_last else "frames")
        waiting = stack.enter_context(ExitStack())
        if log is not None and checkpoint is not None:
            run.patience = waiting.enter_context(patiently(bar.is_to_end))
        drawing = writers
        if drawn_last:
            drawing = [one for one in writers if one.output.needs_image]
            kept, end = run.simulate(frames, begin, drawing)
            waiting.close()
            begin, frames, run.log = 0, whole_run.played(kept, end), None
            renderer.fit(kept)
            clock.charge("drawing")
            clock.starts = True  # until the first picture is there
            bar.phase(lambda _: "drawing", DRAWN)
        frame: Frame | None = None
        for index, frame in enumerate(frames, begin):
            wanting = [one for one in drawing if one.output.wants(index)]
            image = next((found for one in wanting if (found := one.picture(index)) is not None), None)
            if renderer is not None:
                if image is None and any(one.output.needs_image for one in wanting):
                    image = renderer.render(frame)
                else:
                    renderer.skip(frame)
                clock.charge("drawing")
            run.write(index, frame, image, wanting)
            if index == begin + 1:  # as a rule nothing is compiled later
                expected.spent()
            run.between(index, needs=index + 1 < count)
        waiting.close()
        summary.loaded = compiling.loaded()
        if frame is None and last is not None:
            frame = simulation.frame()
        summary.duration = 0.0 if frame is None else frame.time - first.time
        summary.asked = duration if fps * duration > count - 1 + NEARLY else 0.0
        observer.conclude(frame)
        if companion is not None:
            summary.probes = companion.extremes()
            summary.step_error = companion.compare(
                simulation, bar.advance, lambda what: bar.phase(lambda _: compiling.word(), what)
            )
            at_touch = simulation.setup.at_touch
            settled = None if summary.step_error.settled else simulation.settled
            others = left_out(simulation.scene, settled, simulation.dt, simulation.velocity, at_touch)
            h = simulation.dt / simulation.substeps
            kinks = inside_steps(simulation.scene, h, simulation.time) if simulation.parts.contacts.active else ()
            summary.left_out = [*others, *kinks]
            summary.between = companion.between_readings(summary.step_error, summary.units)
        clock.charge("simulating")
    clock.charge("writing")
    return summary


def _checked(output: Output | Sequence[Output] | None) -> Sequence[Any]:
    """The outputs, none or several. Raises SceneError for what is none, and for one that is given twice."""
    outputs: Sequence[Any] = () if output is None else output if isinstance(output, (list, tuple)) else [output]
    for k, one in enumerate(outputs):
        if not isinstance(one, Output):
            raise SceneError("output", one, "a ts.Output, as ts.open_output(path) gives for a file, or None")
        if type(one).write is Output.write:
            raise SceneError("output", says=f"{type(one).__name__} has no function write(index, frame, image)")
        if any(one is other for other in outputs[:k]):
            raise SceneError(f"output[{k}]", says="is given twice; give each output once")
    return outputs


class _Writer:
    """Gives frames to one output and to its log, through a thread where the output allows that."""

    def __init__(self, output: Output, stack: ExitStack) -> None:
        self.output = output
        stack.enter_context(output)
        self.log = None if output.path is None else output.log
        self.behind = stack.enter_context(Behind(self._take)) if output.apart else None

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        image = image if self.output.needs_image else None
        if self.behind is not None:
            self.behind.write(index, frame, image)
        else:
            self._take(index, frame, image)

    def _take(self, index: int, frame: Frame, image: Image | None) -> None:
        if self.log is not None:
            self.log.open()  # refused where another run writes it
        self.output.write(index, frame, image)
        self.output.frames += 1
        self.keep(index, frame, image)

    def keep(self, index: int, frame: Frame, image: Image | None) -> None:
        """Leave a frame in the log."""
        if self.log is not None:
            with naming(self.log.output):
                self.log.append(index, frame, image)

    def picture(self, index: int) -> Image | None:
        """The picture of a frame that an earlier run left in the log; asked for in order."""
        return None if self.log is None or not self.output.needs_image else self.log.picture(index)

    def replay(self, count: int) -> None:
        """Write the first `count` frames from the log, where the output does not hold them in files of their own."""
        if self.output.keeps_frames:
            self.output.frames = max(self.output.frames, count)
            return
        assert self.log is not None
        for index, frame in self.log.frames(count):
            if self.output.wants(index):
                self.write(index, frame, self.picture(index))

    def settle(self) -> None:
        """Wait until all is written."""
        if self.behind is not None:
            self.behind.settle()


class _Clock:
    """Adds the time since the last call to one of the summary's fields, less what was spent on compiling. starts: whether all of
    it is `starting`, up to the end of the first frame: imports, openings, first pictures."""

    def __init__(self, summary: Summary) -> None:
        self.summary, self.starts = summary, True
        self._last, self._compiled = time.perf_counter(), compiling.seconds()

    def charge(self, field: str) -> None:
        now, compiled = time.perf_counter(), compiling.seconds()
        spent, here = now - self._last, compiled - self._compiled
        field = "starting" if self.starts else field
        setattr(self.summary, field, getattr(self.summary, field) + spent - here)
        self.summary.compiling += here
        self.summary.wall += spent
        self._last, self._compiled = now, compiled


class _Run:
    """Frames on their way from a simulation to outputs, with checkpoints between them. renderer: one whose state a checkpoint
    holds, or None; log: None where there are none, or no more; patience: with a signal that asks the run to end."""

    def __init__(
        self,
        simulation: Any,
        writers: Sequence[_Writer],
        clock: _Clock,
        bar: "_Frames",
        log: Checkpoints | None,
        renderer: Any,
    ) -> None:
        self.simulation, self.writers, self.clock, self.bar = simulation, writers, clock, bar
        self.log, self.renderer, self.patience = log, renderer, Patience(bar.is_to_end)

    def write(self, index: int, frame: Frame, image: Image | None, wanting: Sequence[_Writer]) -> None:
        """Give a frame to those who want it."""
        for writer in wanting:
            writer.write(index, frame, image)
        self.clock.charge("writing")
        self.clock.starts = False
        self.bar.advance(index + 1, frame.time)

    def simulate(
        self, frames: Iterator[Frame], begin: int, drawing: Sequence[_Writer]
    ) -> tuple[list[Frame], UnstableError | None]:
        """Simulate to the end; the frames for the writers that draw them later, and the error that ended them. Others get theirs
        at once."""
        kept = [] if drawing[0].log is None else [frame for _, frame in drawing[0].log.frames(begin)]
        ready = [one for one in self.writers if not one.output.needs_image]
        try:
            for index, frame in enumerate(frames, begin):
                kept.append(frame)
                for writer in drawing:
                    writer.keep(index, frame, None)
                self.write(index, frame, None, [one for one in ready if one.output.wants(index)])
                self.between(index)
        except UnstableError as unstable:
            return kept, unstable
        if len(kept) > begin and self.log is not None and self.log.is_wanted(len(kept)):  # to draw may take long
            self._keep(len(kept) - 1, self.log)
        return kept, None

    def between(self, index: int, needs: bool = True) -> None:
        """Make a checkpoint after a frame where one is due and needed, or the run is to end, as it does then."""
        ends = self.patience.taken()
        if self.log is not None and (ends or (needs and self.log.due)):
            self._keep(index, self.log)
        if ends:
            self.patience.end()

    def _keep(self, index: int, log: Checkpoints) -> None:
        clock, summary = self.clock, self.clock.summary
        for writer in self.writers:
            writer.settle()
        clock.charge("writing")
        drawn = None if self.renderer is None else self.renderer.memory()
        own = {"summary": asdict(summary), "renderer": drawn}  # plain values from which `_recall` goes on
        summary.checkpoints += log.make(index + 1, self.simulation, own)
        summary.stretched = log.stretched
        clock.charge("checkpointing")


def _recall(last: Checkpoint, renderer: Any) -> Summary:
    """Restore the renderer from the state that `_Run` kept, and return the summary. Raises SceneError where it is damaged."""
    if renderer is not None:
        with judged(last.state.with_name(CHECKPOINT)):
            renderer.recall(last.own["renderer"])
    with judged(last.state.with_name(CHECKPOINT)):
        summary = Summary.of(last.own["summary"])
    summary.resumed, summary.checkpoints = last.frame, summary.checkpoints + 1
    return summary


def _moving(simulation: Any, frames: Iterator[Frame]) -> Iterator[Frame]:
    """Frames for which this export moves the simulation, as whoever gets them may not."""
    while True:
        with simulation.exported(False):
            frame = next(frames, None)
        if frame is None:
            return
        yield frame


def _observed(
    frames: Iterator[Frame],
    observer: Observer,
    clock: _Clock,
    companion: Companion | None,
    watch: Callable[[Frame], None] | None,
) -> Iterator[Frame]:
    """Frames, of each of which the observer, the companion and who watches take note."""
    for frame in frames:
        clock.charge("simulating")
        clock.summary.steady += not clock.starts
        observer.note(frame)
        if companion is not None:
            companion.note(frame)
        if watch is not None:
            clock.charge("simulating")
            watch(frame)
            clock.charge("writing")
        yield frame


def _renderer(frame: Any, size: tuple[int, int], style: Mapping[str, Any]) -> Any:
    from taichi_sim.overlays import open_renderer

    return open_renderer(frame, size, style)


class _Frames(Work):
    """Frames that are done, in one phase or two."""

    def begin(self, what: str) -> None:
        self._compiled = compiling.seconds()
        super().begin(what)

    @property
    def elapsed(self) -> float:
        """Seconds since the phase began, without compiling, which later frames do not need."""
        return max(0.0, super().elapsed - (compiling.seconds() - self._compiled))

    def phase(self, waiting: Callable[[float], str], what: str) -> None:
        """Begin to count what it names; what `waiting` makes of the seconds since then is said until the second frame."""
        self.done = 0
        self._before: float | None = None  # s, simulated time of the first frame
        self.begin(what)
        start = time.monotonic()
        self.words = lambda: waiting(time.monotonic() - start)

    def is_to_end(self) -> None:
        """Say that the run ends with the frame that is being made."""
        self.words = lambda: "interrupted: ends with a checkpoint after this frame; once more: at once"

    def advance(self, done: int, now: float) -> None:
        """Note that so many frames are done, the last of them at a simulated time [s]. The first one tells no pace."""
        self.done = done
        if self._before is None:
            self.begin(self.what)
            self._before = now
            return
        before = self._before
        self.words = lambda: (
            f"{self.remaining}, {(now - before) / max(1e-9, self.elapsed):.3g} x real time, t = {now:.4g} s,"
            f" {self.pace:.3g} frames/s"
        )
