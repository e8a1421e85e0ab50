"""RunLog: what an unfinished output keeps beside itself: which run it is of, its frames so far, and the last checkpoint."""

import itertools
import json
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from taichi_sim.common import validation
from taichi_sim.common.atomic_file import lock, sweep
from taichi_sim.common.differences import differences, named
from taichi_sim.common.errors import SceneError
from taichi_sim.outputs.kept_files import checksum, judged, read_kept, write_kept

ABOUT, CHECKPOINT, LOCK = "run.json", "checkpoint.json", "lock"
MOST_FRAMES = 10**9
FILE = re.compile(r"(state|frames)_\d+(_\d+)?\.npz")  # of a checkpoint
WHY = {"duration": ": the camera is fitted to the whole run"}  # what differs is no matter of course


@dataclass(frozen=True)
class Checkpoint:
    """Where a run can go on. frame: the first that is to come. state: the file of the simulation at the one before. own: what
    else goes on, plain values. frames: the file of the frames before that are still to be drawn, where there is one."""

    frame: int
    state: Path
    own: Mapping[str, Any] = field(default_factory=dict)
    frames: Path | None = None


class RunLog:
    """The folder `.NAME.resume` beside an output, or `.resume` within one that is a folder. It is there from the first frame
    until the output is complete; one run at a time has it.

    resume: go on with what is there. Raises OSError where another run is writing it. checkpoint: the last one that was made, once
    it is begun; damaged: whether it could not be begun, for what is there is not what was written.
    """

    def __init__(self, output: Path, *, resume: bool, within: bool = False) -> None:
        self.output = output
        self.folder = output / ".resume" if within else output.with_name(f".{output.name}.resume")
        self._about: Any = {}
        self.checkpoint: Checkpoint | None = None
        self.damaged = False
        self._lock: IO[bytes] | None = None
        self.resumes = resume and (self.folder / ABOUT).is_file()
        if self.resumes:
            self._take()

    def begin(self, about: Mapping[str, Any]) -> Checkpoint | None:
        """The last checkpoint of this run, which `about` describes: plain values by their names in groups. None where there is
        none. Raises ValueError, which names what differs, where the folder is that of another run, and SceneError, which names
        the file, where it is damaged."""
        self._about = json.loads(json.dumps(about))
        if not self.resumes:
            return None
        try:
            differing = list(_differences(self._described(), self._about))
            self.checkpoint = None if differing else self._last()
        except SceneError:
            self.damaged = True
            raise
        if differing:
            raise ValueError(
                f"{self.output}: what is kept of it is of another run, which differs in {named(differing)};"
                f" resume it as it was begun, or delete {self.folder} to begin anew"
            )
        return self.checkpoint

    @property
    def holds_checkpoint(self) -> bool:
        """Whether one is there, of whatever run, and whole or not."""
        return (self.folder / CHECKPOINT).is_file()

    def _described(self) -> dict[str, dict[str, Any]]:
        """The run that the folder is of."""
        found = read_kept(self.folder / ABOUT)
        with judged(self.folder / ABOUT):
            for group, values in found.items():
                if not isinstance(values, dict):
                    raise ValueError(f"{group} is no table")
        return found

    def _last(self) -> Checkpoint | None:
        """The last checkpoint, where all its files are there."""
        place = self.folder / CHECKPOINT
        if not place.is_file():
            return None
        found = read_kept(place)
        with judged(place):
            frame = validation.whole("frame", found["frame"], 0, MOST_FRAMES)
            own, named = found["own"], found["files"]
            if not isinstance(own, dict) or not isinstance(own.get("output"), dict):
                raise ValueError("own is no table")
            files = {kind: (self.folder / name, int(check)) for kind, (name, check) in named.items()}
            if "state" not in files or not all(FILE.fullmatch(file.name) for file, _ in files.values()):
                raise ValueError("files are not those of a checkpoint")
        if not all(file.is_file() for file, _ in files.values()):
            return None
        for file, check in files.values():
            with judged(file):
                if checksum(file) != check:
                    raise ValueError("its checksum does not fit")
        return Checkpoint(frame, files["state"][0], own, files["frames"][0] if "frames" in files else None)

    def _free(self, kind: str, frame: int) -> Path:
        """A file that is not there: the last checkpoint, which may be of the same frame, needs its own until there is another."""
        names = (f"{kind}_{frame:06d}{f'_{k}' if k else ''}.npz" for k in itertools.count())
        return next(self.folder / name for name in names if not (self.folder / name).exists())

    def open(self) -> Path:
        """The folder, made where it is not there; what another run left in it is dropped. Raises OSError."""
        if not self.resumes:
            self.folder.mkdir(exist_ok=True)
            self._take()
            try:
                self._empty()
                write_kept(self.folder / ABOUT, self._about)
            except BaseException:  # as on a full disk: nothing is kept, so nothing is left
                self.close()
                shutil.rmtree(self.folder, ignore_errors=True)
                raise
            self.resumes = True
        return self.folder

    def keep(self, frame: int, files: Mapping[str, Callable[[Path], None]], own: Mapping[str, Any]) -> None:
        """Put a checkpoint in the place of the last one. files: what writes the simulation's "state" to a file, and "frames" that
        are still to be drawn, whole before they appear. Whenever this is cut off, one of the two is there."""
        self.open()
        sweep(self.folder, "*.npz")
        paths = {kind: self._free(kind, frame) for kind in files}
        for kind, save in files.items():
            save(paths[kind])
        named = {kind: (path.name, checksum(path)) for kind, path in paths.items()}
        write_kept(self.folder / CHECKPOINT, {"frame": frame, "own": own, "files": named})
        self.checkpoint = Checkpoint(frame, paths["state"], own, paths.get("frames"))
        for old in [*self.folder.glob("state_*.npz"), *self.folder.glob("frames_*.npz")]:
            if old not in paths.values():
                old.unlink(missing_ok=True)

    def _take(self) -> None:
        """Keep other runs out."""
        if self._lock is None:
            says = f"{self.output}: another run is writing it; wait for it, or give another name"
            self._lock = lock(self.folder / LOCK, says)

    def _empty(self) -> None:
        """Remove what is in the folder: what points to others before these, and last what says whose it is."""
        last = {LOCK: 2, ABOUT: 1, CHECKPOINT: -1}
        for entry in sorted(self.folder.iterdir(), key=lambda entry: last.get(entry.name, 0)):
            if entry.is_dir() and not entry.is_symlink():  # none of ours
                shutil.rmtree(entry)
            elif entry.name != LOCK:
                entry.unlink(missing_ok=True)

    def close(self) -> None:
        """Leave it for another run."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def delete(self) -> None:
        """The output is complete, or nothing of it is worth keeping."""
        if self.resumes:
            with suppress(FileNotFoundError):
                self._empty()
            self.close()
            self.resumes = False
            shutil.rmtree(self.folder, ignore_errors=True)


def _differences(then: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    """What differs between two descriptions of runs, group by group."""
    for group in dict.fromkeys([*then, *now]):
        yield from differences(then.get(group, {}), now.get(group, {}), WHY)
