"""Pictures of a recording, drawn by many processes: each draws frames that follow each other, and one puts them together."""

import os
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import ExitStack, closing
from functools import partial
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.errors import BackendError, SceneError
from taichi_sim.common.progress import Counted, showing
from taichi_sim.outputs import Output, open_outputs
from taichi_sim.outputs.base import abandon, require_alpha
from taichi_sim.outputs.frame_records import picture_of, png_of
from taichi_sim.outputs.recording import Recording
from taichi_sim.outputs.whole_run import is_drawn_last
from taichi_sim.studies.workers import MOST_ENDS, connected, forget, kept, place

__all__ = ["draw"]

MOST_IN_CHUNK = 16  # frames
READINGS = (".csv", ".npz", ".gsd")  # outputs that hold what probes read
NAMED = 3  # of these, before the others are left out
CHUNKS = 4  # for each process, at least: so that all draw until the end
AHEAD = 3  # chunks of each process that are drawn, or wait, before they are asked for

Images = list[NDArray[np.uint8]]


def draw(
    recording: str | PathLike[str],
    paths: Sequence[str | PathLike[str]],
    *,
    size: tuple[int, int] | None = None,
    style: Mapping[str, Any] | None = None,
    fps: float | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    overwrite: bool = False,
    codec: str | None = None,
    precision: str | None = None,
    progress: bool = False,
    say: Callable[[str], None] = lambda line: None,
) -> int:
    """Draw the frames of an .npz of `ts.export` into videos, pictures and files, the same to the last pixel as the run that wrote
    it would have done, or in another style. Returns how many frames there are.

    Args:
        recording: the .npz. Workers elsewhere must see it under the same name.
        paths: of the outputs, as of `ts.open_output`; overwrite, codec: the same.
        size (width, height) [px], style (arguments of `Renderer`; of a camera some keys will do): over those of the scene.
        fps [1/s]: of the film; as recorded by default.
        workers: processes on this machine that draw, one for each core by default; 0: this one. scheduler: address of Dask's.
        precision: "f32" or "f64", as of the run, which in the last digit pictures may show; that of this process, else "f32".
        progress: a bar on standard error. say: what is told on the way.
    """
    from taichi_sim.outputs.quick import output_options

    where = place(scheduler, workers)
    frames = Recording(recording)
    for path in paths:
        if os.path.realpath(path) == os.path.realpath(recording):
            raise ValueError(f"{os.fspath(path)}: is the recording itself; give another name")
        if frames.lacks and Path(path).suffix.lower() in READINGS:
            says = f"holds no {', '.join(frames.lacks[:NAMED])}, which {os.fspath(path)} would lack; write pictures or meshes"
            raise SceneError((), says=says, file=recording)
    old = frames.scene.output
    for key, value in (style or {}).items():
        both = isinstance(value, Mapping) and isinstance(old.get(key), Mapping)
        old[key] = {**old[key], **value} if both else value
    options = output_options(frames.scene, {"size": size})
    try:
        outputs = open_outputs(paths, fps=fps or frames.fps, overwrite=overwrite, codec=codec)
    except SceneError as error:
        if fps is None and error.path == ("fps",):
            error.file = recording
        raise
    try:
        return _drawn(frames, outputs, options["size"], options["style"], where, precision, progress, say)
    except BaseException:
        abandon(outputs)
        raise


def _drawn(
    frames: Recording,
    outputs: Sequence[Output],
    size: tuple[int, int],
    style: Mapping[str, Any],
    where: tuple[str | None, int | None],
    precision: str | None,
    progress: bool,
    say: Callable[[str], None],
) -> int:
    require_alpha(outputs, style)
    needed = any(one.needs_image for one in outputs)
    with ExitStack() as stack:
        for one in outputs:
            stack.enter_context(one)
            one.prepare(frames[0], size, style)
        images: Generator[NDArray[np.uint8]] | None = None
        if needed:
            engine = stack.enter_context(connected(*where, say))
            images = _images(engine, (str(frames.path.resolve()), size, dict(style), precision), len(frames))
            stack.callback(images.close)
        work = Counted(len(frames), "frames drawn")
        stack.enter_context(showing(work, progress))
        for index, frame in enumerate(frames):
            image = next(images) if images is not None else None
            for one in [one for one in outputs if one.wants(index)]:
                one.write(index, frame, image if one.needs_image else None)
                one.frames += 1
            work.done += 1
    return len(frames)


def _images(engine: Any, task: tuple[Any, ...], count: int) -> Generator[NDArray[np.uint8]]:
    """All pictures, in order."""
    length = max(1, min(MOST_IN_CHUNK, -(-count // (CHUNKS * engine.number))))
    chunks = ((begin, min(count, begin + length)) for begin in range(0, count, length))
    waiting = deque(islice(chunks, AHEAD * engine.number))
    drawn: dict[int, Images] = {}  # what cannot be asked for yet, by its first frame
    following = 0
    work = partial(_packed_chunk, task, engine.number > 1) if engine.apart else partial(_draw_chunk, task)
    try:
        with closing(engine.run(work, waiting, "pictures")) as results:
            for (begin, end), images in results:
                if images is None:
                    raise BackendError(f"pictures {begin} to {end - 1}: their workers ended {MOST_ENDS} times")
                drawn[begin] = images
                while following in drawn:
                    ready = drawn.pop(following)
                    following += len(ready)
                    waiting.extend(islice(chunks, 1))
                    yield from (picture_of(one) if isinstance(one, bytes) else one for one in ready)
    finally:
        forget()


class _Painter:
    """Draws frames of one recording in order; those between are passed over, as if they had been drawn."""

    def __init__(self, path: str, size: tuple[int, int], style: Mapping[str, Any], precision: str | None) -> None:
        from taichi_sim.device import backend
        from taichi_sim.overlays import open_renderer

        backend.start(precision=precision)
        self.frames = Recording(path)
        self.renderer = open_renderer(self.frames[0], size, style)
        if is_drawn_last(self.frames.scene, len(self.frames), style):
            self.renderer.fit(self.frames)
        self.start, self.next = self.renderer.memory(), 0
        self.close = self.renderer.close

    def draw(self, begin: int, end: int) -> Images:
        if begin < self.next:
            self.renderer.recall(self.start)
            self.next = 0
        for k in range(self.next, begin):
            self.renderer.skip(self.frames[k])
        images = [self.renderer.render(self.frames[k]) for k in range(begin, end)]
        self.next = end
        return images


def _draw_chunk(task: tuple[Any, ...], chunk: tuple[int, int], make: Callable[[str], _Painter] | None = None) -> Images:
    """Draw a chunk. make: makes a painter, given the key of the recording as it is now."""
    status = Path(task[0]).stat()
    key = repr((task, status.st_mtime_ns, status.st_size))
    return kept(key, lambda: make(key) if make else _Painter(*task)).draw(*chunk)


def _packed_chunk(task: tuple[Any, ...], shared: bool, chunk: tuple[int, int]) -> list[bytes]:
    """Draw a chunk, packed without loss for the way to another process. A worker has one thread, as in a sweep. shared: by
    several workers."""
    return [png_of(image) for image in _draw_chunk(task, chunk, partial(_painter_of_worker, task, shared))]


def _painter_of_worker(task: tuple[Any, ...], shared: bool, key: str) -> _Painter:
    from taichi_sim.device import backend
    from taichi_sim.device.compile_once import compile_once

    def make() -> _Painter:
        backend.start("cpu", task[-1] or "f32", 1)
        return _Painter(*task)

    def rehearse() -> None:
        with closing(make()) as painter:
            painter.draw(0, 1)

    backend.stop()  # it may have been another task's
    if shared:
        compile_once("pictures", key, rehearse)
    return make()
