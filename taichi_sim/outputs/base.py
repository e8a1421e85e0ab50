"""Interface of outputs.

A user-defined output is a class with these members, in any file; pass the object to `export`:

    class Heights(ts.Output):
        needs_image = False
        path = "heights.csv"

        def write(self, index, frame, image):
            with open(self.path, "a" if index else "w") as file:
                print(frame.time, *frame.position[:, 1], sep=",", file=file)

    ts.export(simulation, Heights(), fps=60, duration=2)

Without `needs_image = False` pictures are drawn, and `image` is that of the frame. An output needs no simulation: frames from
anywhere may be given to it, `with Heights() as output: output.write(0, frame, None)`.

With a `path` its run can be resumed: the frames so far are kept beside it until it is complete, and where `resume` is True given
to `write` once more, from the first one on (see `taichi_sim.outputs.frame_log`).
"""

import errno
from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.common import validation
from taichi_sim.common.atomic_file import naming, require_parent, require_place
from taichi_sim.common.errors import UnstableError
from taichi_sim.outputs.frame_log import FrameLog

# (height, width, 3) sRGB, row 0 at the top; with alpha (height, width, 4), colours not multiplied by it
Image = NDArray[np.uint8]
USUAL_FPS = 60.0  # of frames from elsewhere
LEAST_FPS, MOST_FPS = 1e-4, 1e9  # of films


def require_folder_place(path: Path, overwrite: bool = False) -> None:
    """Raises OSError where there can be no folder: without a parent, or where a file is; to overwrite, also where a link is, as a
    file never takes the place of what a link points to."""
    require_parent(path)
    if path.exists() and not path.is_dir():
        raise NotADirectoryError(f"{path}: is a file; give the name of a folder")
    if overwrite and path.is_symlink():
        says = "is a link; --overwrite deletes nothing behind one; give"
        raise FileExistsError(f"{path}: {says} {str(path.resolve())!r} itself, or another name")


def require_alpha(outputs: Sequence["Output"], style: Mapping[str, Any]) -> None:
    """Raises ValueError where pictures with alpha are asked for, by arguments of `Renderer`, and an output cannot hold them."""
    for one in outputs:
        if style.get("transparent") and one.needs_image and not one.alpha:
            name = getattr(one, "path", "this output")
            raise ValueError(f"transparent: {name} holds no transparency; write PNG frames, to a folder/")


def film_rate(fps: float) -> float:
    """Frames per second of a film, whose rate is a fraction of whole numbers. Raises SceneError, a ValueError, for others."""
    return validation.number("fps", fps, low=LEAST_FPS, high=MOST_FPS)


def require_there(files: Iterable[Path]) -> None:
    """Raises OSError, which names the first, where some of the files that were written are there no more."""
    missing = [file for file in files if not file.is_file()]
    if missing:
        more = f", as were {len(missing) - 1} more" if len(missing) > 1 else ""
        raise FileNotFoundError(errno.ENOENT, f"was removed before the run ended{more}", str(missing[0]))


class Output:
    """Takes frames in order of time. As a context manager it is finished on leaving the block.

    It is finished, too, when the simulation became unstable: the frames so far are kept. Any other exception, Ctrl-C
    among them, discards it, and whatever lay under its name before is still there. With a `path` the log keeps its frames for
    another run.
    """

    needs_image = True  # False: write is called with image None
    needs_arrays = (
        True  # False: a frame that is given again by a resumed run has only time, energy, contacts and probes
    )
    apart = False  # True: write may be called in a thread of its own, while the simulation goes on and `wants` is asked
    is_film = False  # whether fps has the bounds that films have
    alpha = False  # whether it takes pictures with alpha
    path: str | PathLike[str] | None = None  # of what it writes, where a run that was cut off can be resumed
    resume = False  # True: go on with the run that the log beside `path` is of
    within = False  # True: `path` is a folder, and the log lies in it
    keeps_frames = False  # True: each frame is a file of its own, which `contains` looks for; the log has none
    fps: float | None = None  # at which what it writes is shown [1/s]; None: `export` sets that of its frames
    pattern = ""  # of the names that it writes, where they are not the one it was given
    frames = 0  # how many it holds so far; `export` counts
    simulated = 0  # how many are kept to be drawn by a run that resumes it, where it was given up
    _log: FrameLog | None = None

    @property
    def log(self) -> FrameLog:
        """The log beside `path`, which is there until the output is complete. Raises OSError, see FrameLog."""
        if self._log is None:
            assert self.path is not None
            logged = not self.keeps_frames
            self._log = FrameLog(
                Path(self.path), resume=self.resume, within=self.within, frames=logged, arrays=self.needs_arrays,
                pictures=logged and self.needs_image,
            )  # fmt: skip
        return self._log

    def prepare(self, first: Frame, size: tuple[int, int], style: Mapping[str, Any]) -> None:
        """Be ready. `export` calls it before anything else. first: the frame that the run begins with, also where it is resumed
        later on; style: the arguments of `Renderer`."""

    def options(self) -> Mapping[str, Any]:
        """Plain values that decide what it writes: a run that resumes it has the same."""
        return {}

    def wants(self, index: int) -> bool:
        """True where frame `index` is still to be written; when it is not, it is neither drawn nor passed."""
        return True

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        """Take frame `index`, counted from 0, and its picture where needs_image. Where a resumed run gives frame 0 again, what
        was written before is made anew."""
        raise NotImplementedError

    def finish(self) -> None:
        """Complete the output: it now lies under its final name."""
        self._leave(is_complete=True)

    def discard(self) -> None:
        """Give it up: no trace of it is left, but for what the log keeps."""
        self._leave(is_complete=False)

    def leave_as_it_is(self) -> None:
        """Let go of an output that was complete before anything was written. `export` calls it in place of `discard`."""
        self._leave(is_complete=False)

    def is_finished(self, count: int) -> bool:
        """True where it was opened to be resumed, but is complete already, with `count` frames: then it is left as it is."""
        return self.resume and not self.log.resumes and self.holds(count)

    def holds(self, count: int) -> bool:
        """True where what lies under its name has so many frames, as far as that can be told without reading all of it."""
        return self.path is not None and Path(self.path).is_file()

    def contains(self, count: int) -> bool:
        """True where the files of the first `count` frames are there, of one that `keeps_frames`."""
        return False

    def kept(self) -> int:
        """Frames that another run need not make again: pictures, or those before the last checkpoint."""
        if self.log.pictures is not None and self.log.pictures.number:
            return self.log.pictures.number
        last = self.log.checkpoint
        return 0 if last is None or self.log.waits else last.frame

    def _leave(self, is_complete: bool) -> None:
        """Delete the log, or leave it for another run where that is worth it. Done before, this changes nothing."""
        if self.path is None:
            return
        log = self.log
        if is_complete:
            log.delete()
            return
        there = log.resumes and log.folder.is_dir() and not log.damaged
        self.frames = self.kept() if there else 0
        self.simulated = log.checkpoint.frame if there and log.waits and log.checkpoint is not None else 0
        if not self.frames and not log.holds_checkpoint:
            log.delete()
        log.close()

    def __enter__(self) -> "Output":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        keep = kind is None or (issubclass(kind, UnstableError) and self.frames > 0)
        try:
            if keep:
                self.finish()
        except BaseException:
            keep = False
            raise
        finally:
            if not keep:
                self.discard()
            self._leave(keep)  # of one that has its own `finish` and `discard`


class FileOutput(Output):
    """One that writes a file of the name `path`. fps [1/s]: at which it is shown; resume: go on with a run into the same name
    that was cut off. Raises OSError where it cannot be written, or another run is writing it."""

    path: Path

    def __init__(self, path: str | PathLike[str], fps: float | None = None, resume: bool = False) -> None:
        self.path, self.fps, self.resume = Path(path), fps, resume
        self.log  # noqa: B018  # it locks what is there, or refuses it
        require_place(self.path)


class Deferred(FileOutput):
    """One that is written when all its frames are there: they wait in the log."""

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        with naming(self.path):
            self.log.append(index, frame, image)


def abandon(outputs: Iterable[Output]) -> None:
    """Give up outputs, and what they keep for a run that resumes them: there is none. Files that are whole stay."""
    for one in outputs:
        one.discard()
        if one.path is not None:
            one.log.delete()
            one.frames = one.simulated = 0
