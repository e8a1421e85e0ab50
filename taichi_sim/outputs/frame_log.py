"""FrameLog: what an unfinished output keeps beside itself, and is written from when its run is resumed.

    simulation --frame k--> renderer --picture k--> output.write(k, frame, picture)
         |                                               |
         | every minute                                  v
         v                              log: frames, pictures (record k of each is that of frame k)
    log: state_K.npz, checkpoint.json

A resumed run takes frames 0 to K - 1 out of the log and gives them to `write` as if they had just been made; then the simulation
goes on from the state. So an output is `write` and `finish`, and knows nothing of all this. Pictures after K - 1 that are in the
log are not drawn again. Record k is `frames`: time, energy, contacts, probes and, where the output needs them, arrays;
`pictures`: the picture without loss. What an output does not need is not kept. The folder is deleted when the output is complete.
"""

import itertools
import json
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.common import validation
from taichi_sim.common.atomic_file import lock, sweep
from taichi_sim.common.differences import differences, named
from taichi_sim.common.errors import SceneError
from taichi_sim.common.own_folder import LOCK, emptied, is_fresh, require_own
from taichi_sim.outputs.frame_records import FrameRecords, PicturePacker, unpacked_pictures
from taichi_sim.outputs.kept_files import checksum, is_kept, judged, read_kept, write_kept
from taichi_sim.outputs.records import Records

ABOUT, CHECKPOINT = "run.json", "checkpoint.json"
MOST_FRAMES = 10**9
STATE = re.compile(r"state_\d+(_\d+)?\.npz")  # of a checkpoint
# all that outputs and their log write into it
OURS = re.compile(rf"{STATE.pattern}|(run|checkpoint)\.json|pictures|frames|stage\.usd[ac]")
WHY = {"duration": ": the camera is fitted to the whole run"}  # what differs is no matter of course


@dataclass(frozen=True)
class Checkpoint:
    """State from which a run can go on. frame: the first that is to come. state: the file of the simulation at the one
    before. own: what else goes on, plain values."""

    frame: int
    state: Path
    own: Mapping[str, Any] = field(default_factory=dict)


class FrameLog:
    """The folder `.NAME.resume` beside an output, or `.resume` within one that is a folder. It is there from the first frame
    until the output is complete; one run at a time has it.

    resume: go on with what is there; frames, arrays, pictures: what is kept of each frame. Raises OSError where another run is
    writing it, or what lies there is not ours. checkpoint: the last one that was made, once it is begun, or that which the run
    goes on from; damaged: whether it could not be begun, for what is there is not what was written.
    """

    def __init__(self, output: Path, *, resume: bool, within: bool, frames: bool, arrays: bool, pictures: bool) -> None:
        self.output = output
        self.folder = output / ".resume" if within else output.with_name(f".{output.name}.resume")
        self._about: Any = {}
        self.checkpoint: Checkpoint | None = None
        self._kept: list[dict[str, Any]] = []  # checkpoints as plain values, the last one first
        self.damaged = False
        self.waits = False  # whether no picture is drawn before all is simulated
        self._lock: IO[bytes] | None = None
        self._is_left = False
        require_own(self.folder, _is_ours, OURS)
        self.resumes = resume and (self.folder / ABOUT).is_file()
        if self.resumes:
            self._take()
        self._frames = Records(self.folder / "frames", self.resumes) if frames else None
        self.pictures = Records(self.folder / "pictures", self.resumes) if pictures else None
        self._arrays, self._packer = arrays, PicturePacker()
        self.first: Frame | None = None
        self._unpacked: Iterator[tuple[int, NDArray[np.uint8]]] | None = None
        self._next: tuple[int, NDArray[np.uint8]] | None = None  # of them

    def prepare(self, first: Frame, waits: bool = False) -> None:
        """Be ready for a run that begins with a frame. waits: its pictures are drawn when all is simulated, and all its frames
        kept until then."""
        self.first, self.waits = first, waits
        if waits and self._frames is None:
            self._frames = Records(self.folder / "frames", self.resumes)
        self._records = FrameRecords(first, self._arrays or waits)

    def begin(self, about: Mapping[str, Any]) -> list[Checkpoint]:
        """The checkpoints of this run, which `about` describes: plain values by their names in groups. The last one first; none
        where there is none. Raises ValueError, which names what differs, where the folder is that of another run, and where
        the output was finished or discarded; SceneError, which names the file, where it is damaged."""
        self._require_open()
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
        """The run goes on from this one, or begins anew: frames after it are made again, pictures are kept."""
        self.checkpoint = checkpoint
        state = None if checkpoint is None else checkpoint.state.name
        self._kept = [one for one in self._kept if one["state"][0] == state]
        frame = 0 if checkpoint is None else checkpoint.frame
        if self._frames is not None and self._frames.number > frame:
            self._frames.cut(frame)

    def holds(self, count: int) -> bool:
        """True where all that an output needs of so many frames is there."""
        needed = [self._frames, None if self.waits else self.pictures]
        return all(one.number >= count for one in needed if one is not None)

    def append(self, index: int, frame: Frame, image: NDArray[np.uint8] | None) -> None:
        """Keep what is needed of a frame, where it is not there yet; frames that were left out before it have empty records."""
        if self.first is None:
            self.prepare(frame)
        self.open()
        self._add(self._frames, index, lambda: self._records.pack(frame))
        if image is not None:
            self._add(self.pictures, index, lambda: self._packer.pack(image))

    @staticmethod
    def _add(records: Records | None, index: int, pack: Callable[[], bytes]) -> None:
        if records is not None and index >= records.number:
            while records.number < index:
                records.append(b"")
            records.append(pack())

    def frames(self, count: int | None = None) -> Iterator[tuple[int, Frame]]:
        """The frames by their numbers, but for those that were left out; at most the first `count`. Raises SceneError where they
        are damaged."""
        for index, data in enumerate(itertools.islice(self._frames or (), count)):
            if data:
                with judged(self.folder / "frames"):
                    frame = self._records.unpack(data)
                yield index, frame

    def picture(self, index: int) -> NDArray[np.uint8] | None:
        """The picture of a frame, where it is there. Asked for in order; those that were added since the first time are not
        found."""
        if self._unpacked is None:
            self._unpacked = self.all_pictures() if self.pictures else iter(())
            self._next = next(self._unpacked, None)
        while self._next is not None and self._next[0] < index:
            self._next = next(self._unpacked, None)
        return self._next[1] if self._next is not None and self._next[0] == index else None

    def all_pictures(self) -> Iterator[tuple[int, NDArray[np.uint8]]]:
        """Pictures that are there by now, by the numbers of their frames. Raises SceneError where they are damaged."""
        with judged(self.folder / "pictures"):
            yield from unpacked_pictures(self.pictures or ())

    def hold(self, count: int) -> None:
        """Have all of the first `count` frames on the disk."""
        for one in (self._frames, None if self.waits else self.pictures):
            if one is not None:
                self._add(one, count - 1, bytes)
                one.hold()

    @property
    def holds_checkpoint(self) -> bool:
        """True where a checkpoint is there, of whatever run, and whole or not."""
        return (self.folder / CHECKPOINT).is_file()

    def _described(self) -> dict[str, dict[str, Any]]:
        """Description of the run that the folder is of."""
        found = read_kept(self.folder / ABOUT)
        with judged(self.folder / ABOUT):
            for group, values in found.items():
                if not isinstance(values, dict):
                    raise ValueError(f"{group} is no table")
        return found

    def _checkpoints(self) -> list[Checkpoint]:
        """Checkpoints whose states are there."""
        place = self.folder / CHECKPOINT
        if not place.is_file():
            return []
        kept = read_kept(place)
        with judged(place):
            read = [self._read(one) for one in kept["checkpoints"]]
            if not read:
                raise ValueError("it lists none")
        self._kept = kept["checkpoints"]
        there = [one for one, _ in read if one.state.is_file()]
        for one, check in read:
            with judged(one.state):
                if one in there and checksum(one.state) != check:
                    raise ValueError("its checksum does not fit")
        return there

    def _read(self, kept: Any) -> tuple[Checkpoint, int]:
        """A checkpoint from its plain values, and the checksum of its state."""
        frame = validation.whole("frame", kept["frame"], 0, MOST_FRAMES)
        name, check = kept["state"]
        if not isinstance(kept["own"], dict):
            raise ValueError("own is no table")
        if not STATE.fullmatch(name):
            raise ValueError("its state is not that of a checkpoint")
        return Checkpoint(frame, self.folder / name, kept["own"]), int(check)

    def _free(self, frame: int) -> Path:
        """Name of a state that is not there: the last checkpoint, which may be of the same frame, keeps its own until there is
        another."""
        names = (f"state_{frame:06d}{f'_{k}' if k else ''}.npz" for k in itertools.count())
        return next(self.folder / name for name in names if not (self.folder / name).exists())

    def open(self) -> Path:
        """The folder, made where it is not there; what another run left in it is dropped. Raises OSError, and ValueError where
        the output was finished or discarded."""
        self._require_open()
        if not self.resumes:
            self.folder.mkdir(exist_ok=True)
            require_own(self.folder, _is_ours, OURS)
            self._take()
            try:
                self._empty()
                write_kept(self.folder / ABOUT, self._about)
            except BaseException:  # as on a full disk: nothing is kept, so nothing is left
                self._remove()
                raise
            self.resumes = True
        return self.folder

    def _require_open(self) -> None:
        """Raise ValueError where the output was finished or discarded."""
        if self._is_left:
            raise ValueError(f"{self.output}: was finished or discarded, and takes no more frames; open it anew")

    def keep(self, frame: int, save: Callable[[Path], Any], own: Mapping[str, Any], settles: bool = True) -> None:
        """Make a checkpoint. save: writes the simulation to a file, whole before it appears. It takes the place of the last one,
        at once or, not `settles`, by `settle`. Whenever this is cut off, one of the two is there."""
        self.open()
        self.hold(frame)
        sweep(self.folder, "*.npz")
        state = self._free(frame)
        save(state)
        kept = {"frame": frame, "own": own, "state": (state.name, checksum(state))}
        self._list([kept, *([] if settles else self._kept[:1])])
        self.checkpoint = Checkpoint(frame, state, own)

    def settle(self) -> None:
        """The last checkpoint takes the place of the one before."""
        if len(self._kept) > 1:
            self._list(self._kept[:1])

    def _list(self, kept: list[dict[str, Any]]) -> None:
        """Write the list of checkpoints, and delete the states of others."""
        write_kept(self.folder / CHECKPOINT, {"checkpoints": kept})
        self._kept = kept
        needed = {one["state"][0] for one in kept}
        for old in self.folder.glob("state_*.npz"):
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
        self._close_records()
        with suppress(OSError):
            self._empty()
            (self.folder / LOCK).unlink(missing_ok=True)
            self.folder.rmdir()
        self.close()

    def close(self) -> None:
        """Leave it for another run. It takes no more frames."""
        self._is_left = True
        self._close_records()
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def _close_records(self) -> None:
        self._unpacked = None
        for one in (self._frames, self.pictures):
            if one is not None:
                one.close()

    def delete(self) -> None:
        """The output is complete, or nothing of it is worth keeping. It takes no more frames."""
        self._is_left = True
        with suppress(OSError):  # another run begins it
            if self.folder.is_dir() and is_fresh(self.folder):  # left by a run that was killed as it removed the folder
                self._take()
                self.resumes = True
        if self.resumes:
            self._remove()
            self.resumes = False


def _is_ours(folder: Path) -> bool:
    """True where one of the records is whole: one that a broken disk damaged is told by the other."""
    return any(is_kept(folder / name) for name in (ABOUT, CHECKPOINT))


def _differences(then: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    """Names and values that differ between two descriptions of runs, group by group."""
    for group in dict.fromkeys([*then, *now]):
        yield from differences(then.get(group, {}), now.get(group, {}), WHY)
