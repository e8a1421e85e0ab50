"""RunLog: what an unfinished output keeps beside itself: which run it is of, its frames so far, and the last checkpoint; for a
moment the one before it, too, until all outputs of the run have the new one."""

import itertools
import json
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from taichi_sim.common import validation
from taichi_sim.common.atomic_file import lock, sweep
from taichi_sim.common.differences import differences, named
from taichi_sim.common.errors import SceneError
from taichi_sim.common.own_folder import LOCK, emptied, require_own
from taichi_sim.outputs.kept_files import checksum, judged, read_kept, write_kept

ABOUT, CHECKPOINT = "run.json", "checkpoint.json"
MOST_FRAMES = 10**9
FILE = re.compile(r"(state|frames)_\d+(_\d+)?\.npz")  # of a checkpoint
# all that outputs and their log write into it
OURS = re.compile(rf"{FILE.pattern}|(run|checkpoint)\.json|column_\d{{3,}}|pictures|frames|stage\.usd[ac]")
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

    resume: go on with what is there. Raises OSError where another run is writing it, or what lies there is not ours. checkpoint:
    the last one that was made, once it is begun, or that which the run goes on from; damaged: whether it could not be begun, for
    what is there is not what was written.
    """

    def __init__(self, output: Path, *, resume: bool, within: bool = False) -> None:
        self.output = output
        self.folder = output / ".resume" if within else output.with_name(f".{output.name}.resume")
        self._about: Any = {}
        self.checkpoint: Checkpoint | None = None
        self._kept: list[dict[str, Any]] = []  # checkpoints as plain values, the last one first
        self.damaged = False
        self._lock: IO[bytes] | None = None
        require_own(self.folder, ABOUT)
        self.resumes = resume and (self.folder / ABOUT).is_file()
        if self.resumes:
            self._take()

    def begin(self, about: Mapping[str, Any]) -> list[Checkpoint]:
        """The checkpoints of this run, which `about` describes: plain values by their names in groups. The last one first; none
        where there is none. Raises ValueError, which names what differs, where the folder is that of another run, and SceneError,
        which names the file, where it is damaged."""
        self._about = json.loads(json.dumps(about))
        if not self.resumes:
            return []
        try:
            differing = list(_differences(self._described(), self._about))
            found = [] if differing else self._checkpoints()
        except SceneError:
            self.damaged = True
            raise
        if differing:
            raise ValueError(
                f"{self.output}: what is kept of it is of another run, which differs in {named(differing)};"
                f" resume it as it was begun, or delete {self.folder} to begin anew"
            )
        self.checkpoint = next(iter(found), None)
        return found

    def go_on(self, checkpoint: Checkpoint | None) -> None:
        """The run goes on from this one, or begins anew."""
        self.checkpoint = checkpoint
        state = None if checkpoint is None else checkpoint.state.name
        self._kept = [one for one in self._kept if one["files"]["state"][0] == state]

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

    def _checkpoints(self) -> list[Checkpoint]:
        """Those whose files are all there."""
        place = self.folder / CHECKPOINT
        if not place.is_file():
            return []
        kept = read_kept(place)
        with judged(place):
            read = [self._read(one) for one in kept["checkpoints"]]
            if not read:
                raise ValueError("it lists none")
        self._kept = kept["checkpoints"]
        for _, sums in read:
            for file, check in sums.items():
                with judged(file):
                    if file.is_file() and checksum(file) != check:
                        raise ValueError("its checksum does not fit")
        return [one for one, sums in read if all(file.is_file() for file in sums)]

    def _read(self, kept: Any) -> tuple[Checkpoint, dict[Path, int]]:
        """One from its plain values, and the checksums of its files."""
        frame = validation.whole("frame", kept["frame"], 0, MOST_FRAMES)
        own = kept["own"]
        if not isinstance(own, dict) or not isinstance(own.get("output"), dict):
            raise ValueError("own is no table")
        files = {kind: self.folder / name for kind, (name, _) in kept["files"].items()}
        if "state" not in files or not all(FILE.fullmatch(name) for name, _ in kept["files"].values()):
            raise ValueError("files are not those of a checkpoint")
        sums = {self.folder / name: int(check) for name, check in kept["files"].values()}
        return Checkpoint(frame, files["state"], own, files.get("frames")), sums

    def _free(self, kind: str, frame: int) -> Path:
        """A file that is not there: the last checkpoint, which may be of the same frame, needs its own until there is another."""
        names = (f"{kind}_{frame:06d}{f'_{k}' if k else ''}.npz" for k in itertools.count())
        return next(self.folder / name for name in names if not (self.folder / name).exists())

    def open(self) -> Path:
        """The folder, made where it is not there; what another run left in it is dropped. Raises OSError."""
        if not self.resumes:
            self.folder.mkdir(exist_ok=True)
            require_own(self.folder, ABOUT)
            self._take()
            try:
                self._empty()
                write_kept(self.folder / ABOUT, self._about)
            except BaseException:  # as on a full disk: nothing is kept, so nothing is left
                self._remove()
                raise
            self.resumes = True
        return self.folder

    def keep(
        self, frame: int, files: Mapping[str, Callable[[Path], None]], own: Mapping[str, Any], settles: bool = True
    ) -> None:
        """Make a checkpoint. files: what writes the simulation's "state" to a file, and "frames" that are still to be drawn,
        whole before they appear. It takes the place of the last one, at once or, not `settles`, by `settle`. Whenever this is cut
        off, one of the two is there."""
        self.open()
        sweep(self.folder, "*.npz")
        paths = {kind: self._free(kind, frame) for kind in files}
        for kind, save in files.items():
            save(paths[kind])
        named = {kind: (path.name, checksum(path)) for kind, path in paths.items()}
        self._list([{"frame": frame, "own": own, "files": named}, *([] if settles else self._kept[:1])])
        self.checkpoint = Checkpoint(frame, paths["state"], own, paths.get("frames"))

    def settle(self) -> None:
        """The last checkpoint takes the place of the one before."""
        if len(self._kept) > 1:
            self._list(self._kept[:1])

    def _list(self, kept: list[dict[str, Any]]) -> None:
        """These are the checkpoints; files of others go."""
        write_kept(self.folder / CHECKPOINT, {"checkpoints": kept})
        self._kept = kept
        needed = {name for one in kept for name, _ in one["files"].values()}
        for old in [*self.folder.glob("state_*.npz"), *self.folder.glob("frames_*.npz")]:
            if old.name not in needed:
                old.unlink(missing_ok=True)

    def _take(self) -> None:
        """Keep other runs out."""
        if self._lock is None:
            says = f"{self.output}: another run is writing it; wait for it, or give another name"
            self._lock = lock(self.folder / LOCK, says)

    def _empty(self) -> None:
        """Remove what is ours in the folder: what points to others before these, and last what says whose it is."""
        emptied(self.folder, OURS, {ABOUT: 1, CHECKPOINT: -1})

    def _remove(self) -> None:
        """The folder goes, with what is ours in it; with what others put into it, it stays."""
        with suppress(OSError):
            self._empty()
            (self.folder / LOCK).unlink(missing_ok=True)
            self.folder.rmdir()
        self.close()

    def close(self) -> None:
        """Leave it for another run."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def delete(self) -> None:
        """The output is complete, or nothing of it is worth keeping."""
        if self.resumes:
            self._remove()
            self.resumes = False


def _differences(then: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    """What differs between two descriptions of runs, group by group."""
    for group in dict.fromkeys([*then, *now]):
        yield from differences(then.get(group, {}), now.get(group, {}), WHY)
