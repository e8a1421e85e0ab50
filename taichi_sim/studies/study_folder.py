"""Folder of a study: it says of which, keeps other processes out, and replaces files whole, so that any kill leaves it whole."""

import json
import os
import zlib
from collections.abc import Callable, Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, TypeVar
from zipfile import BadZipFile

from taichi_sim.common.atomic_file import lock, replacing
from taichi_sim.common.differences import differences, named
from taichi_sim.common.errors import SceneError
from taichi_sim.common.own_folder import LOCK, is_fresh, require_own_file
from taichi_sim.outputs.base import require_folder_place
from taichi_sim.studies.records import arrays_of, rows_of

__all__ = ["StudyFolder"]

# what reading a damaged file raises
DAMAGE = (ValueError, RecursionError, KeyError, TypeError, EOFError, BadZipFile, zlib.error)
Entry = TypeVar("Entry")


class StudyFolder:
    """Files of one study. about: plain values that tell it from others.

    Raises OSError or ValueError before anything is written where the folder cannot be used.
    """

    kind = "study"
    record = "study.json"  # the file that says which study it is
    own: tuple[str, ...] = ()  # names of the other files, which `overwrite` removes; `*` stands for anything
    another = "another folder"  # what a user may give instead

    def __init__(self, path: Path, about: Mapping[str, Any], overwrite: bool = False) -> None:
        self.path = path
        self.about = {"program": f"taichi_sim {self.kind}"} | json.loads(json.dumps(about, default=str))
        self.begun = False  # whether the folder is this study's
        self._overwrite = overwrite
        self._lock: Any = None
        require_folder_place(path, overwrite)
        for file in self._files(*self.own, self.record):
            require_own_file(file)
        if path.is_dir() and not is_fresh(path):
            if not (path / self.record).is_file():
                raise FileExistsError(f"{path}: the folder is not empty and holds no {self.kind}; use another name")
            then = self._recorded()
            if not overwrite:
                self._require_same(then)

    def _files(self, *names: str) -> list[Path]:
        """Files of these names that are there, those of the first name first."""
        entries = sorted(self.path.iterdir()) if self.path.is_dir() else []
        return [entry for name in names for entry in entries if fnmatchcase(entry.name, name)]

    def _recorded(self) -> dict[str, Any]:
        """Contents of the record. Raises OSError where this program did not write it: then the other files are not its own."""
        try:
            found = json.loads((self.path / self.record).read_bytes())
        except (ValueError, RecursionError):
            found = None
        if isinstance(found, dict) and found.get("program") == self.about["program"]:
            return found
        says = f"is not as this program writes it; remove the folder, or give {self.another}"
        raise FileExistsError(f"{self.path / self.record}: {says}")

    def _require_same(self, then: Mapping[str, Any]) -> None:
        if differing := list(differences(then, self.about)):
            raise FileExistsError(
                f"{self.path}: holds another {self.kind}, which differs in {named(differing)}; use --overwrite or"
                f" {self.another}"
            )

    def begin(self) -> None:
        """Make the folder, where it is not there, and keep other processes out. Raises OSError."""
        self.path.mkdir(exist_ok=True)
        if not os.access(self.path, os.W_OK):
            raise PermissionError(f"{self.path}: cannot be written")
        says = f"{self.path}: another {self.kind} is writing it; wait for it, or give {self.another}"
        self._lock = lock(self.path / LOCK, says)
        if self._overwrite:
            self.empty()
        self.prepare()
        self.write(self.record, json.dumps(self.about, indent=1).encode())
        self.begun = True

    def prepare(self) -> None:
        """Do what else must be done before the folder is this study's."""

    def empty(self) -> None:
        """Remove all files of the study."""
        self.remove(*self.own, self.record)

    def remove(self, *names: str) -> None:
        """Remove files of these names."""
        for file in self._files(*names):
            file.unlink(missing_ok=True)

    def close(self) -> None:
        """Let others in."""
        if self._lock is not None:
            self._lock.close()
            (self.path / LOCK).unlink(missing_ok=True)
            self._lock = None

    def read(self, name: str, parse: Callable[[Path], Entry], mend: str = "") -> Entry | None:
        """Contents of a file; None where there is none. Raises SceneError, which says how to `mend` it, for a damaged one."""
        path = self.path / name
        if not path.exists():
            return None
        try:
            return parse(path)
        except DAMAGE as error:
            mend = mend or f"use --overwrite or {self.another}"
            raise SceneError((), says=f"is damaged; {mend} ({error})", file=path) from None

    def write(self, name: str, data: bytes) -> None:
        """Replace a file, whole."""
        with replacing(self.path / name) as file:
            file.write(data)

    def rows_in(self, name: str, kind: type[Entry], mend: str = "") -> list[Entry]:
        """Rows of the dataclass `kind` in a file; none where there is no such file."""
        return self.read(name, lambda path: rows_of(path.read_bytes(), kind), mend) or []

    def record_in(self, name: str, kind: Callable[..., Entry]) -> Entry | None:
        """A record of numbers, texts and arrays in a file; None where there is no such file."""
        return self.read(name, lambda path: kind(**arrays_of(path)))
