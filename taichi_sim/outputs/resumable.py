"""Resumable: an output whose run can go on where it was cut off."""

import errno
from collections.abc import Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from taichi_sim.outputs.base import Output
from taichi_sim.outputs.kept_files import judged
from taichi_sim.outputs.records import Records
from taichi_sim.outputs.run_log import CHECKPOINT, Checkpoint, RunLog


class Resumable(Output):
    """What it needs for that waits in the folder of `log` until it is complete. `export` calls `begin`, `go_on` where there is
    a checkpoint, and `hold` before each that it makes."""

    resumable = True

    def __init__(self, path: str | PathLike[str], *, resume: bool, within: bool = False) -> None:
        self.path, self._resume = Path(path), resume
        self.log = RunLog(self.path, resume=resume, within=within)

    def begin(self, about: Mapping[str, Mapping[str, Any]], count: int, waits: bool) -> list[Checkpoint]:
        """Be ready for `count` frames in all: the checkpoints that it can go on from, the last one first; none where there is
        none. about: of the run, see RunLog.begin; what it says of pictures counts where there are some. waits: no frame is
        written before all are simulated."""
        parts = {group: values for group, values in about.items() if group != "pictures" or self.needs_image}
        found = self.log.begin({**parts, "format": self.options()})
        fitting = [one for one in found if one.frame <= count and waits == (one.frames is not None)]
        with judged(self.log.folder / CHECKPOINT):
            return [one for one in fitting if waits or self.has(one)]

    def is_finished(self, count: int) -> bool:
        """Whether it was opened to be resumed, but is complete already, with `count` frames: then it is left as it is."""
        return self._resume and not self.log.resumes and self.holds(count)

    def holds(self, count: int) -> bool:
        """Whether what lies under its name has so many frames, as far as that can be told without reading all of it."""
        return self.path.is_file()

    def options(self) -> Mapping[str, Any]:
        """Plain values that decide what its file looks like."""
        return {}

    def has(self, checkpoint: Checkpoint) -> bool:
        """Whether all frames before a checkpoint are there, still."""
        raise NotImplementedError

    def go_on(self, checkpoint: Checkpoint) -> None:
        """The next frame is that of a checkpoint."""
        raise NotImplementedError

    def hold(self) -> Mapping[str, Any]:
        """Have all that was written on the disk. Plain values for `go_on`, under "output" of a checkpoint's own."""
        raise NotImplementedError

    def kept(self) -> int:
        """Frames that another run need not write again: those before the last checkpoint."""
        last = self.log.checkpoint
        return 0 if last is None else last.frame

    def leave(self) -> None:
        """Leave for another run what is worth it."""
        there = self.log.resumes and self.log.folder.is_dir() and not self.log.damaged
        self.frames = self.kept() if there else 0
        last = self.log.checkpoint if there else None
        self.simulated = 0 if last is None or last.frames is None else last.frame
        if not self.frames and not self.log.holds_checkpoint:
            self.log.delete()
        self.log.close()


def abandon(outputs: Iterable[Output]) -> None:
    """Give up outputs, and what they keep for a run that resumes them: there is none. Files that are whole stay."""
    for one in outputs:
        one.discard()
        if isinstance(one, Resumable):
            one.log.delete()
            one.frames = one.simulated = 0


class Recorded(Resumable):
    """One whose frames wait as records, one each, in the file `name` of the log's folder, until it is complete."""

    def __init__(self, path: str | PathLike[str], name: str, *, resume: bool) -> None:
        super().__init__(path, resume=resume)
        self._records = Records(self.log.folder / name, self.log.resumes)
        self._kept = self._records.number  # by an earlier run

    def has(self, checkpoint: Checkpoint) -> bool:
        return self._kept >= checkpoint.frame

    def go_on(self, checkpoint: Checkpoint) -> None:
        self.frames = checkpoint.frame

    def hold(self) -> Mapping[str, Any]:
        self._records.hold()
        return {}

    def kept(self) -> int:
        return self._records.number if self._records.path.is_file() else 0

    def wants(self, index: int) -> bool:
        """Whether the frame is not kept already."""
        if index < self._kept:
            self.frames = index + 1
        return index >= self._kept


def require_there(files: Iterable[Path]) -> None:
    """Raises OSError, which names the first, where some of the files that were written are there no more."""
    missing = [file for file in files if not file.is_file()]
    if missing:
        more = f", as were {len(missing) - 1} more" if len(missing) > 1 else ""
        raise FileNotFoundError(errno.ENOENT, f"was removed before the run ended{more}", str(missing[0]))
