"""The folder of a report: what it holds is added row by row, so that an interrupted report goes on where it stopped."""

import csv
import io
import json
import zlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, TypeVar
from zipfile import BadZipFile

import numpy as np

from taichi_sim.common.atomic_file import lock, replacing
from taichi_sim.common.errors import SceneError
from taichi_sim.common.npz import read_npz
from taichi_sim.common.own_folder import LOCK, is_fresh
from taichi_sim.outputs.base import require_folder_place
from taichi_sim.reports.speed_error.budget import Budget
from taichi_sim.reports.speed_error.kept_outcomes import KeptOutcomes
from taichi_sim.reports.speed_error.reference import Reference
from taichi_sim.reports.speed_error.rows import Row

MARK = "report.json"  # what makes a folder one of ours, with the key of its rows
OURS = (
    MARK,
    "rows.csv",
    "seeds.csv",
    "reference.npz",
    "budget.json",
    "report.md",
    "report.html",
    "error.svg",
    "error.png",
)
DAMAGE = (
    ValueError,
    RecursionError,
    KeyError,
    TypeError,
    EOFError,
    BadZipFile,
    zlib.error,
    csv.Error,
)  # what reading such a file raises
Entry = TypeVar("Entry")


class Folder:
    """rows.csv, reference.npz, and beside them the pages. `rows`: those that are there already."""

    def __init__(self, path: Path, key: str, overwrite: bool = False) -> None:
        """Raises OSError or ValueError before anything is written where the folder cannot be used."""
        self.path, self.key = path, key
        self._lock: Any = None
        self.outcomes = KeptOutcomes(path, self._read, self.write)
        require_folder_place(path)
        if path.is_dir() and not is_fresh(path):
            if not (path / MARK).is_file():
                raise FileExistsError(f"{path}: the folder is not empty and holds no report; use another name")
            if not overwrite and self._read(MARK, lambda file: str(json.loads(file.read_text("utf-8"))["key"])) != key:
                raise FileExistsError(
                    f"{path}: holds a report of another scene or with other settings; use --overwrite or another --out"
                )
        if path.is_dir():
            self._take()
        try:
            if path.is_dir() and overwrite:
                for name in OURS:
                    (path / name).unlink(missing_ok=True)
                self.outcomes.forget()
            self.rows = self.table("rows.csv", Row)
        except BaseException:
            self.close()
            raise

    def _take(self) -> None:
        """Keep other reports out."""
        if self._lock is None:
            says = f"{self.path}: another report is writing it; wait for it, or give another --out"
            self._lock = lock(self.path / LOCK, says)

    def close(self) -> None:
        """Let others in."""
        if self._lock is not None:
            self._lock.close()
            (self.path / LOCK).unlink(missing_ok=True)
            self._lock = None

    def _read(self, name: str, parse: Callable[[Path], Entry]) -> Entry | None:
        """What a file holds, None where there is none. Raises SceneError for one that is not whole."""
        path = self.path / name
        if not path.exists():
            return None
        try:
            return parse(path)
        except DAMAGE as error:
            raise SceneError(f"{path}: is damaged, use --overwrite or another --out ({error})") from None

    def write(self, name: str, data: bytes) -> None:
        """Replace a file, whole; the folder is made once there is something to keep."""
        if name != MARK and not (self.path / MARK).is_file():
            self.path.mkdir(exist_ok=True)
            self._take()
            self.write(MARK, json.dumps({"key": self.key}).encode())
        with replacing(self.path / name) as file:
            file.write(data)

    def table(self, name: str, kind: type[Entry]) -> list[Entry]:
        """The rows of a table, objects of the dataclass `kind`; none where there is no such file."""
        return self._read(name, lambda path: parsed(path.read_bytes().decode(), kind)) or []

    def keep_table(self, name: str, kind: Any, rows: Sequence[Any]) -> None:
        """All rows, a column for each field; None becomes an empty cell."""
        text = io.StringIO()
        table = csv.DictWriter(text, [field.name for field in fields(kind)], lineterminator="\n")
        table.writeheader()
        table.writerows(map(asdict, rows))
        self.write(name, text.getvalue().encode())

    def add(self, row: Row) -> None:
        """Keep a row, on disk at once."""
        self.rows.append(row)
        self.keep_table("rows.csv", Row, self.rows)

    def complete(self, found: list[Row]) -> None:
        """Write the rows once more, those found with their orders; what was not asked for this time stays as it was."""
        by_key = {row.key: row for row in found}
        self.rows = [by_key.get(row.key, row) for row in self.rows]
        self.keep_table("rows.csv", Row, self.rows)

    def reference(self) -> Reference | None:
        """The one that an interrupted report has made."""

        def parse(path: Path) -> Reference:
            arrays: dict[str, Any] = read_npz(path)
            values: dict[str, Any] = {field.name: arrays[field.name] for field in fields(Reference)}
            return Reference(**{name: value.item() if value.ndim == 0 else value for name, value in values.items()})

        return self._read("reference.npz", parse)

    def keep_reference(self, reference: Reference) -> None:
        """As an .npz."""
        data = io.BytesIO()
        np.savez(data, **{name: np.asarray(value) for name, value in asdict(reference).items()})  # type: ignore[arg-type]
        self.write("reference.npz", data.getvalue())

    def budget(self) -> Budget | None:
        """Where the error comes from, as an earlier run found."""
        return self._read("budget.json", lambda path: Budget(**json.loads(path.read_text("utf-8"))))

    def keep_budget(self, budget: Budget) -> None:
        """As JSON."""
        self.write("budget.json", json.dumps(asdict(budget)).encode())


def parsed(text: str, kind: type[Entry]) -> list[Entry]:
    """The rows of a CSV file. Raises ValueError or csv.Error where it is not complete."""
    kinds: dict[str, Any] = {field.name: field.type for field in fields(kind)}  # type: ignore[arg-type]
    table = csv.DictReader(io.StringIO(text, newline=""), strict=True)
    lines = list(table)
    if table.fieldnames != list(kinds) or not text.endswith("\n"):
        raise ValueError("its first or its last line is not complete")
    for number, line in enumerate(lines, 1):
        if None in line or None in line.values():
            raise ValueError(f"row {number} is not complete")
    return [kind(**{name: _value(kinds[name], cell) for name, cell in line.items()}) for line in lines]


def _value(kind: Any, cell: str) -> str | float | int | None:
    if kind == float | None:
        return float(cell) if cell else None
    return kind(cell)  # type: ignore[no-any-return]
