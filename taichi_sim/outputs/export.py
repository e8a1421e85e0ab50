"""Export of a simulation to an output: the loop over frames, its progress bar and its summary."""

import time
import warnings
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from html import escape
from pathlib import Path
from typing import Any, Literal

import numpy as np

from taichi_sim.analysis import contact_loads, late_impacts, turning
from taichi_sim.analysis.coarse_meshes import beyond_bricks
from taichi_sim.analysis.diagnostics import inverted
from taichi_sim.analysis.frame import Contacts, Frame, frame_count
from taichi_sim.analysis.outcome import (
    MESH,
    Scales,
    left_out,
    not_included,
    of_approach,
    of_cells,
    of_depth,
    of_energy,
    untouched,
)
from taichi_sim.analysis.probe_readings import units_of
from taichi_sim.common import validation
from taichi_sim.common.atomic_file import naming
from taichi_sim.common.errors import SceneError, UnstableError
from taichi_sim.common.progress import Work, showing
from taichi_sim.common.quantities import ROUNDED, counted, measures, plain_number
from taichi_sim.common.signals import Patience, patiently
from taichi_sim.device import compiling
from taichi_sim.outputs import whole_run
from taichi_sim.outputs.background_writer import Behind
from taichi_sim.outputs.base import Image, Output, film_rate, require_alpha
from taichi_sim.outputs.checkpoints import Checkpoints, frames_from, restored, run_of, shared_checkpoint
from taichi_sim.outputs.companion import Companion, StepError
from taichi_sim.outputs.frame_log import CHECKPOINT, Checkpoint
from taichi_sim.outputs.kept_files import judged
from taichi_sim.scene.objects import ball_in_words

SHOWN = {".mp4": "video/mp4", ".webm": "video/webm", ".gif": "image/gif", ".webp": "image/webp"}  # by browsers
STEP = "step and rounding"  # the source of an uncertainty
WATCHED_CELLS = 200_000  # in each frame; more are counted at the end alone
WATCHED_TRIANGLES = 10_000  # half a second, at the end
KEEPS_APART = "surface_collision = true keeps surfaces apart"
MOST_SHOWN = 50_000_000  # bytes, a third more in a notebook


@dataclass(slots=True)
class Summary:
    """Summary of a run. Energies in J (kinetic, spring, gravity, total), momentum in kg m/s, times in s."""

    frames: int = 0
    steady: int = 0  # of them, after what `starting` counts
    duration: float = 0.0  # simulated
    wall: float = 0.0  # all of it
    compiling: float = 0.0  # or loading what was compiled before
    loaded: bool = False  # most of it was
    starting: float = 0.0  # all else up to the end of the first frame, which no later one needs, in each process
    simulating: float = 0.0
    drawing: float = 0.0
    writing: float = 0.0  # where a thread writes, what was waited for it
    energy_start: tuple[float, ...] = ()
    energy_end: tuple[float, ...] = ()
    momentum: tuple[float, ...] = ()  # at the end
    contacts: Contacts | None = None  # at the end; None where the scene has none
    most_contacts: int = 0  # the largest values seen at a frame
    penetration: float = 0.0  # m
    relative_penetration: float = 0.0  # of the smaller radius
    residual: float = 0.0  # m/s
    unsolved: list[float] = field(default_factory=list, repr=False)  # m/s, see Contacts: of each frame with contacts
    scales: Scales | None = None  # what all this is judged by, at the end
    largest_speed: float = 0.0  # m/s
    fastest: str = ""  # the ball that had it, and when
    late: tuple[float, float] = (0.0, 0.0)  # the largest share at a frame, see late_impacts, and the substep then [s]
    probes: dict[str, tuple[float, float, float]] = field(default_factory=dict)  # at the end, least, largest at a frame
    units: dict[str, str] = field(default_factory=dict)  # of probes
    torn: tuple[int, int] | None = None  # springs at the end, and those that may tear; None where none may
    inverted: tuple[int, int] = (0, 0)  # cells at the end, and the most at a frame
    beyond: list[str] = field(default_factory=list)  # meshes that are drawn farther out than what moves them
    crossings: int | None = 0  # edges in triangles at the end, where those let things through; None: not counted
    error: Any = None  # see Simulation.error, at the end
    solver: Any = None  # see Simulation.solver
    step_error: StepError | None = None  # estimated by a second run, see Companion
    left_out: list[str] = field(default_factory=list)  # other errors, which that does not tell
    rotation: str = ""  # angular momentum that the method took, where that shows
    contact_load: str = ""  # that elements at contacts bear too much, where that shows
    decisions: list[str] = field(default_factory=list)  # on the way, see Simulation.decisions
    settled: str = ""  # how well the scene was at rest at the start, where that was asked for
    device: str = ""  # what computed it, in words
    checkpoints: int = 0
    checkpointing: float = 0.0
    stretched: tuple[float, ...] | None = None  # see Checkpoints
    resumed: int = 0  # the frame that a resumed run went on with; 0 where there was no checkpoint
    complete: list[str] = field(default_factory=list)  # outputs that were so before, where nothing was left to be done
    video: str = ""  # the file that `ts.video` wrote, for notebooks

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> "Summary":
        """Rebuild a summary from what `asdict` made, through JSON."""
        one = cls(**plain)
        one.contacts = None if one.contacts is None else Contacts(*one.contacts)
        one.energy_start = tuple(one.energy_start)
        one.torn = None if one.torn is None else tuple(one.torn)  # type: ignore[assignment]
        one.inverted = tuple(one.inverted)  # type: ignore[assignment]
        one.late = tuple(one.late)  # type: ignore[assignment]
        one.probes = {name: (last, least, most) for name, (last, least, most) in one.probes.items()}
        return one

    def _repr_html_(self) -> str:
        """HTML for notebooks: the video, if it is there and small enough to be kept in one, and the summary in words."""
        return f"{_shown(Path(self.video))}<pre>{escape(chr(10).join(self.lines()))}</pre>"

    def _seen(self, scales: Scales) -> Scales:
        """Scales that include the energies at the start and the end, which samples between steps may miss, and what takes energy
        by what frames showed."""
        ends = self.energy_start, self.energy_end
        motion = max(scales.motion, *(sum(energy[:2]) for energy in ends))
        elastic = max(energy[1] for energy in ends) / motion if motion > 0.0 else 1.0
        takers = scales.takers if self.most_contacts else untouched(scales.takers)
        return scales._replace(motion=motion, elastic=elastic, takers=takers)

    def lines(self) -> list[str]:
        """The summary in words, one line per subject."""
        if self.complete:
            return [f"complete     {name}, which is left as it is" for name in self.complete]
        lines = [f"frames       {self.frames}, {self.duration:.4g} s simulated"]
        if self.settled:
            lines.append(f"start        {self.settled}")
        if self.energy_start:
            kinetic, spring, gravity, total = self.energy_end
            off = None if self.step_error is None else self.step_error.energy
            lines.append(
                f"energy       {self.energy_start[3]:.6g} J at the start,"
                f" {_at_the_end(total, off, self._source())} at the end"
                f" (kinetic {kinetic:.4g}, spring {spring:.4g}, gravity {gravity:.4g})"
            )
            if self.scales is not None and (said := of_energy(self.energy_start[3], total, self._seen(self.scales))):
                lines.append(f"             {said}")
        lines.append(f"momentum     ({', '.join(f'{p:.4g}' for p in self.momentum)}) kg m/s at the end")
        if self.contacts is not None and self.most_contacts:
            now, scales = self.contacts, self.scales
            lines.append(
                f"contacts     {now.number} at the end, {self.most_contacts} at most; {now.iterations} iterations in each of"
                f" {now.substeps} substeps, {now.searches} searches; largest speed {self.largest_speed:.3g} m/s"
                f"{self.fastest and f', {self.fastest}'}"
            )
            squeezes, starts_deep = (False, False) if scales is None else (scales.squeezes, scales.starts_deep)
            depth = of_depth(self.relative_penetration, squeezes, starts_deep)
            lines.append(
                f"penetration  largest {self.penetration:.3g} m ({self.relative_penetration:.2g} of a radius),"
                f" mean at the end {now.mean_penetration:.3g} m: {depth}"
            )
            if scales is not None:
                left = float(np.median(self.unsolved))
                lines.append(
                    f"residual     approach speed left by the contact solver: {left:.3g} m/s typical,"
                    f" {max(self.unsolved):.3g} m/s worst: {of_approach(left, scales, self.largest_speed, now.iterations)}"
                )
            if wanted := late_impacts.cure(*self.late):
                lines.append(f"impacts      {late_impacts.sentence(self.late[0])}; {wanted}")
        if self.inverted[1]:
            lines.append(
                f"cells        {self.inverted[0]} inverted at the end, {self.inverted[1]} at most: {of_cells(*self.inverted)}"
            )
        lines += [f"mesh         {said}" for said in self.beyond]
        if self.crossings is None:
            lines.append(f"crossings    of surfaces not counted, there are too many triangles; {KEEPS_APART}")
        elif self.crossings:
            edges = counted(self.crossings, "edge of a surface goes", "edges of surfaces go")
            lines.append(f"crossings    {edges} through triangles at the end: look at it; {KEEPS_APART}")
        if self.torn is not None:
            lines.append(f"torn         {self.torn[0]} of the {self.torn[1]} springs that may tear")
        lines += self._readings()
        if self.error is not None:
            e = self.error
            lines.append(
                f"error        {e.estimate:.2g} of {e.size:.3g} m so far, {e.tolerance:g} a second asked;"
                f" {e.least} to {e.most} substeps"
                + (f", begun anew {e.repeated} times" if e.repeated else "")
                + (f"; no promise from t = {e.unsure:.4g} s on, many contacts at once" if e.unsure is not None else "")
                + (f"; not kept from t = {e.lost:.4g} s on" if e.lost is not None else "")
            )
        if self.rotation:
            lines.append(f"rotation     {self.rotation}")
        if self.contact_load:
            lines.append(f"load         {self.contact_load}")
        if self.solver is not None:
            s = self.solver
            lines.append(
                f"solver       {s.stages} stages in {s.passes} passes over the springs; {s.worst:.2g} left at most,"
                f" {s.misses} not solved: {'look at it; take shorter steps' if s.misses else 'good'}"
            )
        simulated = self.duration * self.steady / max(1, self.frames - 1)
        rate = (self.wall - self.compiling - self.starting) / simulated if simulated else 0.0
        per = f": {rate:.3g} s per simulated second without compiling and starting" if simulated else ""
        kernels = "loading kernels" if self.loaded else "compiling"
        parts = (
            f"{kernels} {self.compiling:.2f}, starting {self.starting:.2f}, simulation {self.simulating:.2f},"
            f" pictures {self.drawing:.2f}, writing {self.writing:.2f}"
        )
        if self.resumed:
            lines.append(f"resumed      at frame {self.resumed}, from a checkpoint")
        if self.checkpoints:
            share = self.checkpointing / self.wall
            lines.append(f"checkpoints  {self.checkpoints} in {self.checkpointing:.2g} s, {share:.1%} of the wall time")
        if self.stretched is not None:
            asked, taken, each = self.stretched
            lines.append(
                f"             one in {asked:.3g} s asked, one in {taken:.3g} s taken: a checkpoint takes {each:.2g} s"
            )
        lines += [f"{'' if k else 'decided':12} {words}" for k, words in enumerate(self.decisions)]
        lines.append(f"device       {self.device}")
        lines.append(f"wall time    {self.wall:.2f} s ({parts}){per}")
        return lines

    def _source(self) -> str:
        """Words on what a stated uncertainty is of."""
        return f"{STEP}; the mesh is not included" if MESH in self.left_out else STEP

    def _readings(self) -> Iterator[str]:
        """Lines on what probes read, and on how well that is known."""
        found = self.step_error
        off = {} if found is None else found.probes
        width = max([12, *map(len, self.probes)])
        for name, values in self.probes.items():
            unit, source = self.units.get(name, ""), f" ({self._source()})" if off else ""
            words = measures(values, off.get(name, (None,) * 3), unit)
            if all(one.endswith(ROUNDED) for one in words):
                words, source = measures(values, (None,) * 3, unit), f" ({ROUNDED})"
            last, least, most = (one.replace(f", {ROUNDED}", f" ({ROUNDED})") for one in words)
            each = f"{last} in the last frame; least {least}, peak {most} of all frames"
            yield f"{name:{width}} {f'{last} in all frames' if last == least == most else each}{source}"
        if found is None:
            if self.probes and self.error is None:
                yield f"{'uncertainty':12} not estimated; --error (in Python error=True) adds a second run at half the step"
            return
        by = f"a second run at a step of {plain_number(found.step)} s{' with other rounding' * found.rounded}"
        if found.runs > 2:
            by += " and a third at half of that"
        if found.why:
            yield f"{'uncertainty':12} not known: {by} failed: {found.why}"
            return
        if self.left_out:
            yield not_included(self.left_out)
        known = ""
        if not np.isnan(found.rms):
            rms, largest = measures([found.rms, found.largest], [None, None], "m")
            known = f": positions at the end +- {rms} rms, +- {largest} at most"
        yield f"{'uncertainty':12} of {self._source()}, from {by}{known}"
        if found.unseen:
            yield (
                f"{'':12} not known of {', '.join(found.unseen)}: the runs do not come nearer to each other as the step falls;"
                " take shorter steps"
            )
        if found.hidden:
            yield f"{'':12} not known of the extremes of probes: {found.hidden}"


def _shown(video: Path) -> str:
    """A video or an animated picture as HTML that holds all of it; nothing where it is none, has gone or is large."""
    kind = SHOWN.get(video.suffix.lower())
    if kind is None or not video.is_file() or video.stat().st_size > MOST_SHOWN:
        return ""
    data = f"data:{kind};base64,{b64encode(video.read_bytes()).decode()}"
    return f'<img alt="" src="{data}">' if kind.startswith("image") else f'<video controls loop src="{data}"></video>'


def _check_output(output: Any) -> None:
    if not isinstance(output, Output):
        raise SceneError("output", output, "a ts.Output, as ts.open_output(path) gives for a file, or None")
    if type(output).write is Output.write:
        raise SceneError("output", says=f"{type(output).__name__} has no function write(index, frame, image)")


def _at_the_end(energy: float, off: float | None, source: str = STEP) -> str:
    """An energy without a prefix, as those beside it; off: the uncertainty by `source` [J], where it is known."""
    if off is None or np.isnan(off):
        return f"{energy:.6g} J"
    value, _, said = measures([energy], [off])[0].partition(", ")
    return f"{value} J ({said or source})"


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
        simulation: a `Simulation`; round(fps x duration) + 1 frames are made of it, the first where it is, the last `duration`
            [s] later, where it is left.
        size: of the pictures, (width, height) px. style: further arguments of `Renderer`, and `overlay`, keys of an `Overlay`.
        progress: a bar on standard error with the time left and the speed against real time.
        checkpoint: seconds of wall time between two checkpoints, from which a resumed run goes on, of a built-in output; more
            where they would take over a fiftieth of it. "auto": 60 s, from the second minute on. None: none.
        error: run the scene a second time at half the step, and give what is read with the error of step and rounding.
        watch: called with each frame that is simulated, like `LiveView.show`.
    Outputs are finished here, also when the simulation becomes unstable, and discarded on any other error.

    Outputs that were opened with `resume` must be given the simulation, and the arguments, that their run began with (`duration`
    and `checkpoint` may be others): ValueError otherwise. Where all have the same checkpoint the simulation is closed, and
    another goes on from there. Otherwise it runs from the start, but frames that are kept are not drawn again. An output that is
    complete already is left as it is, with a warning; where all are, nothing is simulated.

    Where a camera is to show all of the run (see `CameraPath.fit`), it is simulated to its end before the first picture is drawn;
    outputs that need no pictures get their frames meanwhile.
    """
    outputs: Sequence[Any] = () if output is None else output if isinstance(output, (list, tuple)) else [output]
    for k, one in enumerate(outputs):
        _check_output(one)
        if any(one is other for other in outputs[:k]):
            raise SceneError(f"output[{k}]", says="is given twice; give each output once")
    fps, duration = validation.number("fps", fps, positive=True), validation.number("duration", duration, low=0)
    if checkpoint not in ("auto", None):
        checkpoint = validation.number("checkpoint", checkpoint, positive=True)
    count = frame_count(fps, duration)
    finished = [one for one in outputs if one.path is not None and one.is_finished(count)]
    for one in finished:
        one.leave_as_it_is()
        warnings.warn(
            f"{one.path}: is complete, and is left as it is; without resume it is made anew", UserWarning, stacklevel=2
        )
    if finished and len(finished) == len(outputs):
        return Summary(complete=[str(one.path) for one in finished])
    outputs = [one for one in outputs if one not in finished]
    summary = Summary()
    clock = _Clock(summary)
    style = style or {}
    with ExitStack() as stack:
        writers = [_Writer(one, stack) for one in outputs]
        require_alpha(outputs, style)
        is_drawn = any(one.needs_image for one in outputs)
        expected = compiling.Expected.of(simulation, is_drawn)
        bar = _Frames(count)
        stack.enter_context(showing(bar, progress))
        first = simulation.frame()
        for one in outputs:
            if one.fps is None:
                one.fps = film_rate(fps) if one.is_film else fps
        drawn_last = is_drawn and whole_run.is_drawn_last(simulation.scene, count, style)
        for one in outputs:
            one.prepare(first, size, style)
        log, last = None, None
        if logged := [one for one in outputs if one.path is not None]:
            about = run_of(simulation, first, fps, size, style, duration if drawn_last else None)
            last = shared_checkpoint(logged, about, first, count if len(logged) == len(outputs) else 0, drawn_last)
            log = Checkpoints(logged, checkpoint) if len(logged) == len(outputs) else None
        if last is not None:
            if error:
                raise SceneError("error", says="cannot be estimated in a run that is resumed; begin it anew")
            simulation = stack.enter_context(restored(simulation, last))
        companion = Companion(simulation) if error else None
        renderer: Any = None
        if is_drawn:
            renderer = stack.enter_context(_renderer(first, size, style))
        begin, frames, drawing = 0, simulation.frames(fps=fps, duration=duration), writers
        if last is not None:
            begin, frames = last.frame, frames_from(last.frame, simulation, fps, duration)
            summary = clock.summary = _recall(last, None if drawn_last else renderer)
            for writer in writers:
                if not (drawn_last and writer.output.needs_image):
                    writer.replay(begin)
            clock.charge("writing")
        frame, since = None, simulation.time
        frames = _observed(simulation, frames, summary, clock, companion, watch)
        bar.phase(expected.words, "frames simulated" if drawn_last else "frames")

        def write(index: int, frame: Frame, image: Image | None, wanting: Sequence[_Writer]) -> None:
            for writer in wanting:
                writer.write(index, frame, image)
            clock.charge("writing")

        def keep(index: int) -> None:
            for writer in writers:
                writer.settle()
            clock.charge("writing")
            assert log is not None
            own = _own(summary, None if drawn_last else renderer)
            summary.checkpoints += log.make(index + 1, simulation, own)
            summary.stretched = log.stretched
            clock.charge("checkpointing")

        def between(index: int, needs: bool = True) -> None:
            """Make a checkpoint after a frame where one is due and needed, or the run is to end, as it does then."""
            ends = patience.taken()
            if log is not None and (ends or (needs and log.due)):
                keep(index)
            if ends:
                patience.end()

        simulating, patience = stack.enter_context(ExitStack()), Patience(bar.is_to_end)
        if log is not None and checkpoint is not None:
            patience = simulating.enter_context(patiently(bar.is_to_end))
        if drawn_last:
            drawing = [one for one in writers if one.output.needs_image]
            kept: list[Frame] = []
            if begin and drawing[0].log is not None:
                kept = [frame for _, frame in drawing[0].log.frames(begin)]
            end: UnstableError | None = None
            try:
                for index, frame in enumerate(frames, begin):
                    kept.append(frame)
                    clock.starts = False
                    for writer in drawing:
                        writer.keep(index, frame, None)
                    ready = [one for one in writers if not one.output.needs_image]
                    write(index, frame, None, [one for one in ready if one.output.wants(index)])
                    bar.advance(index + 1, frame.time - since)
                    between(index)
            except UnstableError as unstable:
                end = unstable
            simulating.close()
            begin, frames, since, log = 0, whole_run.played(kept, end), first.time, None
            renderer.fit(kept)
            clock.charge("drawing")
            clock.starts = True  # until the first picture is there
            bar.phase(lambda _: "drawing", "frames drawn")
        for index, frame in enumerate(frames, begin):
            wanting = [one for one in drawing if one.output.wants(index)]
            image = next((found for one in wanting if (found := one.picture(index)) is not None), None)
            if renderer is not None:
                if image is None and any(one.output.needs_image for one in wanting):
                    image = renderer.render(frame)
                else:
                    renderer.skip(frame)
                clock.charge("drawing")
            write(index, frame, image, wanting)
            clock.starts = False
            bar.advance(index + 1, frame.time - since)
            if index == begin + 1:  # as a rule nothing is compiled later
                expected.spent()
            between(index, needs=index + 1 < count)
        simulating.close()
        summary.loaded = compiling.loaded()
        summary.duration, summary.units = duration, units_of(simulation.scene)
        summary.settled = str(getattr(simulation, "settled", None) or summary.settled)
        summary.device, summary.decisions = str(simulation.backend), simulation.decisions()
        torn = simulation.torn
        if torn is not None:
            summary.torn = int(np.count_nonzero(torn)), int(np.isfinite(simulation.scene.break_strain).sum())
        summary.beyond = ["; ".join(one) for one in beyond_bricks(simulation.scene)]
        if simulation.scene.n_volumes():
            _count_inverted(summary, simulation.inverted())
        if simulation.scene.dim == 3 and not simulation.scene.solid.all():
            few = len(simulation.scene.triangles) <= WATCHED_TRIANGLES
            summary.crossings = simulation.crossings() if few else None
            clock.charge("simulating")
        if frame is None and last is not None:
            frame = simulation.frame()
        if frame is not None and frame.energy is not None:
            summary.energy_end = tuple(frame.energy)
        summary.error, summary.solver, summary.scales = simulation.error(), simulation.solver(), simulation.scales()
        summary.rotation = _rotation(simulation, frame)
        summary.contact_load = _contact_load(simulation) if summary.unsolved else ""
        summary.momentum = tuple(np.atleast_1d(simulation.momentum()).tolist())
        if companion is not None:
            summary.step_error = companion.compare(
                simulation, bar.advance, lambda what: bar.phase(lambda _: "compiling", what)
            )
            at_touch = simulation.setup.at_touch
            others = left_out(simulation.scene, simulation.settled, simulation.dt, simulation.velocity, at_touch)
            summary.left_out = [*others, *companion.between_frames(summary.step_error, summary.units)]
            clock.charge("simulating")
    clock.charge("writing")
    return summary


def _rotation(simulation: Any, frame: Frame | None) -> str:
    """Loss of angular momentum by the method, at the start or at the end, whichever is more; empty where it does not show."""
    method, scene, h = simulation.settings.integrator.method, simulation.scene, simulation.dt / simulation.substeps
    if method.turning_loss(1.0, h) == 0.0:
        return ""
    states = [(scene.position, scene.velocity)] + ([] if frame is None else [(frame.position, frame.velocity)])
    turns = [turn for state in states if (turn := turning.fastest_turn(scene, *state)) is not None]
    turn = max(turns, key=lambda one: one.speed, default=None)
    if turn is None or not turn.shows(method, h):
        return ""
    return f"{turning.sentence(turn, method, h, simulation.time or 1.0)}; {turning.cure(turn, method, h)}"


def _contact_load(simulation: Any) -> str:
    """Load that elements at contacts bear too much by the method; empty where it does not show."""
    method, h = simulation.settings.integrator.method, simulation.dt / simulation.substeps
    excess = contact_loads.at_contacts(simulation.scene, method, h)
    if excess is None or not excess.shows(method, h):
        return ""
    return f"{contact_loads.sentence(excess, method, h)}; {contact_loads.cure(excess, method, h)}"


def _own(summary: Summary, renderer: Any) -> dict[str, Any]:
    """State from which an export goes on, beside the simulation and what is written, as plain values."""
    drawn = None if renderer is None else renderer.memory()
    return {"summary": asdict(summary), "renderer": drawn}


def _recall(last: Checkpoint, renderer: Any) -> Summary:
    """Restore the renderer from the state that `_own` gave, and return the summary. Raises SceneError where it is damaged."""
    if renderer is not None:
        with judged(last.state.with_name(CHECKPOINT)):
            renderer.recall(last.own["renderer"])
    with judged(last.state.with_name(CHECKPOINT)):
        summary = Summary.of(last.own["summary"])
    summary.resumed, summary.checkpoints = last.frame, summary.checkpoints + 1
    return summary


def _observed(
    simulation: Any,
    frames: Iterator[Frame],
    summary: Summary,
    clock: _Clock,
    companion: Companion | None,
    watch: Callable[[Frame], None] | None,
) -> Iterator[Frame]:
    """Frames with what the simulation says of contacts and probes at each, which the summary takes note of."""
    for frame in frames:
        clock.charge("simulating")
        summary.steady += not clock.starts
        frame.contacts, frame.probes = simulation.contacts(), simulation.probes()
        if simulation.scene.n_volumes() <= WATCHED_CELLS:
            _count_inverted(summary, inverted(simulation.scene, frame.position, frame.torn_springs))
        _observe(summary, frame)
        if frame.contacts.number:
            h = simulation.dt / frame.contacts.substeps
            at_touch = simulation.setup.at_touch
            late = late_impacts.late_share(simulation.scene, frame.velocity, h, at_touch)
            summary.late = max(summary.late, (late, h))
        if companion is not None:
            companion.note(frame)
        if watch is not None:
            clock.charge("simulating")
            watch(frame)
            clock.charge("writing")
        yield frame


def _count_inverted(summary: Summary, now: int) -> None:
    summary.inverted = now, max(summary.inverted[1], now)


def _observe(summary: Summary, frame: Frame) -> None:
    summary.frames += 1
    now = frame.contacts
    if now is not None and now.iterations:
        summary.contacts = now
        summary.most_contacts = max(summary.most_contacts, now.number)
        if now.number:
            summary.unsolved.append(now.unsolved)
        if now.largest_speed > summary.largest_speed:
            ball = int(np.argmax(np.linalg.norm(frame.velocity, axis=1)))
            summary.fastest = f"{ball_in_words(frame.objects, ball)} at {frame.time:.4g} s"
        for name in ("penetration", "relative_penetration", "residual", "largest_speed"):
            setattr(summary, name, max(getattr(summary, name), getattr(now, name)))
    for name, value in frame.probes.items():
        _, least, most = summary.probes.get(name, (value, value, value))
        # a mean has none at first
        summary.probes[name] = (value, float(np.fmin(least, value)), float(np.fmax(most, value)))
    if summary.frames == 1 and frame.energy is not None:  # of the first and the last: it takes long
        summary.energy_start = tuple(frame.energy)


def _renderer(frame: Any, size: tuple[int, int], style: Mapping[str, Any]) -> Any:
    from taichi_sim.overlays import open_renderer

    return open_renderer(frame, size, style)


class _Frames(Work):
    """Frames that are done, in one phase or two."""

    def phase(self, waiting: Callable[[float], str], what: str) -> None:
        """Begin to count what it names; what `waiting` makes of the seconds since then is said until the second frame."""
        self.done = 0
        self._before: float | None = None  # seconds simulated by the first frame
        self.begin(what)
        start = time.monotonic()
        self.words = lambda: waiting(time.monotonic() - start)

    def is_to_end(self) -> None:
        """Say that the run ends with the frame that is being made."""
        self.words = lambda: "interrupted: ends with a checkpoint after this frame; once more: at once"

    def advance(self, done: int, simulated: float) -> None:
        """Note that so many frames are done, and so many seconds simulated since the beginning. The first one tells no pace."""
        self.done = done
        if self._before is None:
            self.begin(self.what)
            self._before = simulated
            return
        before = self._before
        self.words = lambda: (
            f"{self.remaining}, {(simulated - before) / max(1e-9, self.elapsed):.3g} x real time, t = {simulated:.4g} s,"
            f" {self.pace:.3g} frames/s"
        )
