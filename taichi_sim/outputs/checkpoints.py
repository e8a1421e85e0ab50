"""Checkpoints of an export: when they are made, what they hold, and how a run goes on from one."""

import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from taichi_sim.analysis.frame import Frame, frame_count
from taichi_sim.common.atomic_file import naming
from taichi_sim.common.warn import warn
from taichi_sim.device.engine import ENGINE, VERSION
from taichi_sim.outputs.base import Output
from taichi_sim.outputs.frame_log import Checkpoint
from taichi_sim.outputs.kept_files import copied
from taichi_sim.scene.contents import contents_of, described

EVERY, FIRST = 60.0, 120.0  # s of wall time: between two, and before the first
SHARE = 0.02  # of the wall time, at most, that they take
SAME_BITS = ("threads", "precision", "arch")  # settings that change nothing, or are known from the backend


class Checkpoints:
    """Makes them, one for each output, while a run goes on. interval [s] of wall time, "auto" for EVERY and FIRST, None for none.

    number, seconds: how many were made, and what they took. stretched: s between two that were asked for and that are taken, and
    what one takes, where that is more; None where what was asked for is kept.
    """

    def __init__(self, outputs: Sequence[Output], interval: float | Literal["auto"] | None) -> None:
        self._outputs = outputs
        self._interval, first = (EVERY, FIRST) if interval == "auto" else (interval, interval)
        self._begin = time.perf_counter()
        self._next = float("inf") if first is None else self._begin + first
        self._asked = interval != "auto"
        self._last = 0  # frame before which the last one was made
        self.number, self.seconds = 0, 0.0
        self._at_first = 0.0  # s that the first one took: imports and kernels, which no later one needs, among them
        self.stretched: tuple[float, float, float] | None = None

    @property
    def due(self) -> bool:
        """True if it is time for a checkpoint."""
        return time.perf_counter() >= self._next

    def is_wanted(self, frame: int) -> bool:
        """True if what was simulated since the last checkpoint is worth one before `frame`, though none may be due."""
        began = time.perf_counter() - self._begin
        return self._next < float("inf") and self._last < frame and (self.number > 0 or began > (self._interval or 0.0))

    def make(self, frame: int, simulation: Any, own: Mapping[str, Any]) -> bool:
        """Keep all that goes on with `frame`, before which the simulation stands; own: plain values. Where the simulation cannot
        be written to a file there is a warning, False, and none from then on."""
        start = time.perf_counter()
        save: Callable[[Path], Any] = simulation.save
        logs = [output.log for output in self._outputs]
        try:
            for log in logs:
                with naming(log.output):
                    log.keep(frame, save, own, settles=len(logs) == 1)
                assert log.checkpoint is not None  # just made
                save = partial(copied, log.checkpoint.state)
            for log in logs:  # cut off before, all have the last one; within this, both or the new one
                log.settle()
        except ValueError as error:
            warn(f"no checkpoints: {str(error).removeprefix('save: ')}; a resumed run begins anew")
            self._next = float("inf")
            return False
        now, interval = time.perf_counter(), self._interval or 0.0
        self.number += 1
        self._last = frame
        self.seconds += now - start
        self._next = now + interval
        if self.number == 1:
            self._at_first = self.seconds
            return True
        # so late that with one more, as long as the mean, they take no more than their share
        known, usual = self.number - 1, self.seconds - self._at_first
        cheap = self._begin + usual * (1.0 + 1.0 / known) / SHARE
        if cheap > self._next:
            self._next = cheap
            self.stretched = (interval, cheap - now, usual / known) if self._asked else None
        return True


def shared_checkpoint(
    outputs: Sequence[Output], about: Any, first: Frame, count: int, waits: bool
) -> Checkpoint | None:
    """Be ready for `count` frames of a run in all, and go on from the last checkpoint that all outputs have; None: begin at the
    first frame. about: of the run, see `run_of`; what it says of pictures counts where there are some. waits: pictures are drawn
    when all is simulated."""
    found = []
    for output in outputs:
        output.log.prepare(first, waits and output.needs_image)
        parts = {group: values for group, values in about.items() if group != "pictures" or output.needs_image}
        kept = output.log.begin({**parts, "format": output.options()})
        fitting = [one for one in kept if one.frame <= count and output.log.holds(one.frame)]
        has_files = output.log.waits or not output.keeps_frames
        found.append([one for one in fitting if has_files or output.contains(one.frame)])
    last = max(set.intersection(*({one.frame for one in each} for each in found)), default=None)
    chosen = [next((one for one in each if one.frame == last), None) for each in found]
    for output, one in zip(outputs, chosen):
        output.log.go_on(one)
    return chosen[0]


def run_of(
    simulation: Any, first: Frame, fps: float, size: tuple[int, int], style: Mapping[str, Any], fitted: float | None
) -> Any:
    """Settings that decide the frames of a run, as plain values by their names in groups; first: the frame that it begins
    with; fitted: the duration [s] that the camera is fitted to, where it is."""
    settings = {one.name: getattr(simulation.settings, one.name) for one in fields(simulation.settings)}
    settings = {name: value for name, value in settings.items() if name not in SAME_BITS}
    backend, package = simulation.backend, import_module("taichi_sim")  # by name: it imports this
    forces = {f"forces[{k}]": force for k, force in enumerate(simulation.parts.arguments[-1])}
    return {
        "version": {"taichi_sim": package.__version__, ENGINE: VERSION},
        "scene": contents_of(simulation.scene),
        "settings": described({"arch": backend.arch, "precision": backend.precision, **settings, **forces}),
        "output": {"fps": fps},
        "pictures": described({"size": list(size), "duration": fitted, **style}),
        "start": described(
            {"start.time": first.time, "start.position": first.position, "start.velocity": first.velocity}
        ),
    }


@contextmanager
def restored(simulation: Any, checkpoint: Checkpoint) -> Iterator[Any]:
    """The simulation at a checkpoint. The one given is closed: it would take memory, and be of no use."""
    kind, settings = type(simulation), simulation.settings
    simulation.close()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # they were said when the one given was made
        again = kind.restore(checkpoint.state, arch=settings.arch, threads=settings.threads)
    again.settings = replace(again.settings, chosen=settings.chosen)  # a state holds only what was chosen
    with again:
        yield again


def frames_from(first: int, simulation: Any, fps: float, duration: float) -> Iterator[Frame]:
    """Yield the frames that `Simulation.frames` gives, from frame `first` on, of a simulation that is at the one before."""
    for k in range(first, frame_count(fps, duration)):
        simulation.step(round(k / fps / simulation.dt) - round((k - 1) / fps / simulation.dt))
        yield simulation.frame()
