"""RunLog: what an unfinished output keeps beside itself: which run it is of, its frames so far, and the last checkpoint."""

import json
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np

from taichi_sim.common.atomic_file import lock, replacing
from taichi_sim.common.errors import short

ABOUT, CHECKPOINT, LOCK = "run.json", "checkpoint.json", "lock"
NAMED = 4  # things that differ, before the others are only counted
READABLE = 40  # characters of a value that a message shows


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

    resume: go on with what is there. Raises OSError where another run is writing it.
    """

    def __init__(self, output: Path, *, resume: bool, within: bool = False) -> None:
        self.output = output
        self.folder = output / ".resume" if within else output.with_name(f".{output.name}.resume")
        self._about: Any = {}
        self._lock: IO[bytes] | None = None
        self.resumes = resume and (self.folder / ABOUT).is_file()
        if self.resumes:
            self._take()

    def begin(self, about: Mapping[str, Any]) -> Checkpoint | None:
        """The last checkpoint of this run, which `about` describes: plain values by their names in groups. None where there is
        none. Raises ValueError, which names what differs, where the folder is that of another run."""
        self._about = json.loads(json.dumps(about))
        if not self.resumes:
            return None
        differences = list(_differences(_read(self.folder / ABOUT), self._about))
        if differences:
            more = f" and {len(differences) - NAMED} more" if len(differences) > NAMED else ""
            raise ValueError(
                f"{self.output}: what is kept of it is of another run, which differs in {', '.join(differences[:NAMED])}{more};"
                f" resume it as it was begun, or delete {self.folder} to begin anew"
            )
        return self.checkpoint

    @property
    def checkpoint(self) -> Checkpoint | None:
        """The last one that was made."""
        if not (self.folder / CHECKPOINT).is_file():
            return None
        found = _read(self.folder / CHECKPOINT)
        state = self.folder / found["state"]
        frames = None if found.get("frames") is None else self.folder / found["frames"]
        there = state.is_file() and (frames is None or frames.is_file())
        return Checkpoint(found["frame"], state, found["own"], frames) if there else None

    def open(self) -> Path:
        """The folder, made where it is not there; what another run left in it is dropped. Raises OSError."""
        if not self.resumes:
            self.folder.mkdir(exist_ok=True)
            self._take()
            self._empty()
            with replacing(self.folder / ABOUT) as file:
                file.write(json.dumps(self._about, indent=1).encode())
            self.resumes = True
        return self.folder

    def keep(self, frame: int, files: Mapping[str, Callable[[Path], None]], own: Mapping[str, Any]) -> None:
        """Put a checkpoint in the place of the last one. files: what writes the simulation's "state" to a file, and "frames" that
        are still to be drawn. Whenever this is cut off, one of the two is there."""
        self.open()
        names = {kind: f"{kind}_{frame:06d}.npz" for kind in files}
        for kind, save in files.items():
            save(self.folder / names[kind])
        with replacing(self.folder / CHECKPOINT) as file:
            file.write(json.dumps({"frame": frame, "own": own, **names}, default=np.generic.item).encode())
        for old in [*self.folder.glob("state_*.npz"), *self.folder.glob("frames_*.npz")]:
            if old.name not in names.values():
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
            if entry.name != LOCK:
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


def _read(path: Path) -> Any:
    try:
        return json.loads(path.read_bytes())
    except ValueError as error:
        raise ValueError(f"{path}: is damaged; delete {path.parent} to begin anew ({error})") from None


def _differences(then: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    """What differs between two descriptions of runs, in words."""
    for group in dict.fromkeys([*then, *now]):
        before, after = then.get(group, {}), now.get(group, {})
        for name in dict.fromkeys([*before, *after]):
            old, new = before.get(name), after.get(name)
            if json.dumps(old, sort_keys=True) != json.dumps(new, sort_keys=True):  # nan is nan here
                said = all(len(short(value)) <= READABLE for value in (old, new))
                yield f"{name} ({_word(old)} then, {_word(new)} now)" if said else name


def _word(value: Any) -> str:
    return "none" if value is None else short(value)
