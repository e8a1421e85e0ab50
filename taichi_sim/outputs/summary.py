"""Summary of a run: what is noted frame by frame and at its end, and the words for it."""

from base64 import b64encode
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from taichi_sim.analysis import late_impacts
from taichi_sim.analysis.frame import Contacts
from taichi_sim.analysis.outcome import (
    MESH,
    Scales,
    gained_in_steps,
    not_included,
    of_approach,
    of_cells,
    of_depth,
    of_energy,
    untouched,
)
from taichi_sim.common.quantities import ROUNDED, counted, measured, plain_number
from taichi_sim.device import compiling
from taichi_sim.outputs.companion import StepError

__all__ = ["Summary"]

SHOWN = {".mp4": "video/mp4", ".webm": "video/webm", ".gif": "image/gif", ".webp": "image/webp"}  # by browsers
STEP = "step and rounding"  # the source of an uncertainty
KEEPS_APART = "surface_collision = true keeps surfaces apart"
MOST_SHOWN = 50_000_000  # bytes, a third more in a notebook


@dataclass(slots=True)
class Summary:
    """Summary of a run. Energies in J (kinetic, spring, gravity, total), momentum in kg m/s, times in s."""

    frames: int = 0
    steady: int = 0  # of them, after what `starting` counts
    duration: float = 0.0  # simulated, up to the last frame
    asked: float = 0.0  # the duration asked for, where that is no whole number of frames
    wall: float = 0.0  # all of it, from a simulation that is ready on
    reading: float = 0.0  # before that: reading the scene and making the simulation, where a command did so
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
    cells: int = 0  # how many there are
    beyond: list[str] = field(default_factory=list)  # meshes that are drawn farther out than what moves them
    crossings: int | None = 0  # edges in triangles at the end, where those let things through; None: not counted
    error: Any = None  # see Simulation.error, at the end
    solver: Any = None  # see Simulation.solver
    step_error: StepError | None = None  # estimated by a second run, see Companion
    left_out: list[str] = field(default_factory=list)  # other errors, which that does not tell
    between: str = ""  # that extremes between readings make most of an uncertainty, where they do
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
        broken = f": {self.asked:.4g} s is no whole number of frames" if self.asked else ""
        lines = [f"frames       {self.frames}, {self.duration:.4g} s simulated{broken}"]
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
                f"contacts     {now.number} at the end, {self.most_contacts} at most;"
                f" {counted(now.iterations, 'iteration', 'iterations')} in {_each(now.substeps)},"
                f" {counted(now.searches, 'search', 'searches')}; largest speed {self.largest_speed:.3g} m/s"
                f" at a frame{self.fastest and f', {self.fastest}'}"
            )
            squeezes, starts_deep = (False, False) if scales is None else (scales.squeezes, scales.starts_deep)
            depth = of_depth(self.relative_penetration, squeezes, starts_deep)
            lines.append(
                f"penetration  largest {self.penetration:.3g} m ({self.relative_penetration:.2g} of a radius),"
                f" mean at the end {now.mean_penetration:.3g} m: {depth}"
            )
            if scales is not None:
                left, worst = float(np.median(self.unsolved)), max(self.unsolved)
                lines.append(
                    f"residual     approach speed left by the contact solver{' with balls, walls and colliders' * scales.rows}:"
                    f" {left:.3g} m/s typical,"
                    f" {of_approach(left, scales, self.largest_speed, now.iterations)};"
                    f" {worst:.3g} m/s worst{', which a new impact may leave for a moment' * (worst > left)}"
                )
            if wanted := late_impacts.cure(*self.late):
                lines.append(f"impacts      {late_impacts.sentence(self.late[0])}; {wanted}")
        if self.inverted[1]:
            lines.append(
                f"cells        {self.inverted[0]} inverted at the end, {self.inverted[1]} of {self.cells} at most:"
                f" {of_cells(*self.inverted, self.cells)}"
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
                f"solver       {s.stages} stages in {s.passes} passes over the forces; {s.worst:.2g} left at most,"
                f" {s.misses} not solved: {'look at it; take shorter steps' if s.misses else 'good'}"
            )
            if self.scales is not None and (self.scales.gained or self.scales.climbed):
                one = self.scales
                lines.append(f"             {gained_in_steps(one.gained, one.climbed, one.gains, one.cure)}")
        simulated = self.duration * self.steady / max(1, self.frames - 1)
        rate = (self.wall - self.compiling - self.starting) / simulated if simulated else 0.0
        per = f": {rate:.3g} s per simulated second without compiling and starting" if simulated else ""
        kernels = compiling.word(self.loaded)
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
        if self.reading:
            lines.append(f"             {self.reading:.2f} s before that: reading the scene")
        return lines

    def _source(self) -> str:
        """Words on what a stated uncertainty is of."""
        settled = self.step_error is not None and self.step_error.settled
        source = "step, rounding and settling" if settled else STEP
        return f"{source}; the mesh is not included" if MESH in self.left_out else source

    def _readings(self) -> Iterator[str]:
        """Lines on what probes read, and on how well that is known."""
        found = self.step_error
        off = {} if found is None else found.probes
        width = max([12, *map(len, self.probes)])
        for name, values in self.probes.items():
            unit, source = self.units.get(name, ""), f" ({self._source()})" if off else ""
            words = [measured(*one, unit) for one in zip(values, off.get(name, (None,) * 3))]
            if all(one.endswith(ROUNDED) for one in words):
                words, source = [measured(value, unit=unit) for value in values], f" ({ROUNDED})"
            last, least, most = (one.replace(f", {ROUNDED}", f" ({ROUNDED})") for one in words)
            seen = "of all frames" if not off or source.endswith(f"({ROUNDED})") else "at and between frames"
            each = f"{last} in the last frame; least {least}, peak {most} {seen}"
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
            rms, largest = (measured(value, unit="m") for value in (found.rms, found.largest))
            known = f": positions at the end +- {rms} rms, +- {largest} at most"
        yield f"{'uncertainty':12} of {self._source()}, from {by}{known}"
        if self.between:
            yield f"{'':12} {self.between}"
        if found.unseen:
            yield (
                f"{'':12} not known of {', '.join(found.unseen)}: the runs do not come nearer to each other as the step falls;"
                " take shorter steps"
            )
        if found.hidden:
            yield f"{'':12} not known of the extremes of probes: {found.hidden}"


def _each(substeps: int) -> str:
    return f"each of {substeps} substeps" if substeps > 1 else "each step"


def _shown(video: Path) -> str:
    """A video or an animated picture as HTML that holds all of it; nothing where it is none, has gone or is large."""
    kind = SHOWN.get(video.suffix.lower())
    if kind is None or not video.is_file() or video.stat().st_size > MOST_SHOWN:
        return ""
    data = f"data:{kind};base64,{b64encode(video.read_bytes()).decode()}"
    return f'<img alt="" src="{data}">' if kind.startswith("image") else f'<video controls loop src="{data}"></video>'


def _at_the_end(energy: float, off: float | None, source: str = STEP) -> str:
    """An energy without a prefix, as those beside it; off: the uncertainty by `source` [J], where it is known."""
    if off is None or np.isnan(off):
        return f"{energy:.6g} J"
    value, _, said = measured(energy, off).partition(", ")
    return f"{value} J ({said or source})"
