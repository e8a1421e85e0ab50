"""The folder of a sweep: rows as they come in, batch by batch, and the table of all of them. Whatever is killed, it is whole."""

import csv
import hashlib
import io
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from taichi_sim.common.atomic_file import lock, replacing
from taichi_sim.common.differences import differences, named
from taichi_sim.common.errors import SceneError
from taichi_sim.common.own_folder import LOCK, emptied, is_fresh, require_own
from taichi_sim.common.printable import no_formula
from taichi_sim.outputs.base import require_folder_place
from taichi_sim.sweeps.points import Point, Row, lines_of, rows_of

__all__ = ["Folder", "columns_of"]

MARK, ROWS, BATCHES = "sweep.json", "rows.jsonl", "batches"
BATCH_FILE = r"[0-9a-f]{16}_\d+\.jsonl"  # behind the mark of its sweep
TABLE = "table.csv"
OURS = (ROWS, TABLE, "table.parquet", "report.html")
AGAIN = "use --overwrite or another folder"


class Folder:
    """`rows`: by key, what is there already. about: plain values that say which sweep it is.

    Raises OSError or ValueError before anything is written where it cannot be used."""

    def __init__(self, path: Path, about: Mapping[str, Any], overwrite: bool = False) -> None:
        self.path, self.about = path, json.loads(json.dumps(about))
        said = json.dumps(self.about, sort_keys=True).encode()
        self.mark = f"{hashlib.sha256(said).hexdigest()[:12]}_"  # a worker of another sweep may write here yet
        self.rows: dict[str, Row] = {}
        self._written: set[str] = set()  # keys of the file of all rows
        require_folder_place(path)
        self._lock: Any = None
        self._overwrite, self._is_ours = overwrite, False
        if path.is_dir() and not is_fresh(path):
            if not (path / MARK).is_file():
                raise FileExistsError(f"{path}: the folder is not empty and holds no sweep; use another name")
            require_own(self.batches)
            if not overwrite:
                self._require_same()
                self._load()

    @property
    def batches(self) -> Path:
        """Where workers put what they have done."""
        return self.path / BATCHES

    def begin(self) -> None:
        """Make it, where it is not there. Raises OSError."""
        self.path.mkdir(exist_ok=True)
        if not os.access(self.path, os.W_OK):
            raise PermissionError(f"{self.path}: cannot be written")
        says = f"{self.path}: another sweep is writing it; wait for it, or give another folder"
        self._lock = lock(self.path / LOCK, says)
        if self._overwrite:
            self._empty()
        self.batches.mkdir(exist_ok=True)
        require_own(self.batches)
        emptied(self.batches, re.compile(rf"(?!{self.mark})[0-9a-f]{{12}}_{BATCH_FILE}"))
        with replacing(self.path / MARK) as file:
            file.write(json.dumps(self.about, indent=1).encode())
        self._is_ours = True
        self._compact()

    def close(self) -> None:
        """Let others in."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def _require_same(self) -> None:
        if differing := list(differences(about_of(self.path), self.about)):
            raise FileExistsError(
                f"{self.path}: holds another sweep, which differs in {named(differing)}; use --overwrite or another folder"
            )

    def _load(self) -> None:
        files = [self.path / ROWS] if (self.path / ROWS).is_file() else []
        files += sorted(self.batches.glob(f"{self.mark}*.jsonl")) if self.batches.is_dir() else []
        for file in files:
            try:
                self.rows.update((row.key, row) for row in rows_of(file.read_bytes()))
            except (ValueError, TypeError, RecursionError) as error:
                raise SceneError(
                    (), says=f"is damaged; delete it to have its points run again ({error})", file=file
                ) from None

    def _compact(self) -> None:
        """One file in place of many: it is complete before they go. A worker may have written some that have not come in."""
        found = list(self.batches.glob(f"{self.mark}*.jsonl"))
        for one in found:
            for row in rows_of(one.read_bytes()):
                self.rows.setdefault(row.key, row)
        if found or self.rows.keys() - self._written:  # those of workers that were killed come without a file
            with replacing(self.path / ROWS) as file:
                file.write(lines_of(self.rows.values()))
            self._written = set(self.rows)
            for one in found:
                one.unlink(missing_ok=True)

    def _empty(self) -> None:
        if self.batches.is_dir():
            emptied(self.batches, re.compile(rf"[0-9a-f]{{12}}_{BATCH_FILE}"))
        for name in (*OURS, MARK):
            (self.path / name).unlink(missing_ok=True)

    def add(self, rows: Iterable[Row]) -> None:
        """Rows that have come in."""
        self.rows.update((row.key, row) for row in rows)

    def finish(self, points: Sequence[Point]) -> None:
        """Write the table of these points, in their order, those that are done; as Parquet, too, where pyarrow is installed.
        Nothing, while the folder is not this sweep's."""
        if not self._is_ours:
            return
        self._compact()
        rows = [self.rows[key] for key in dict.fromkeys(point.key for point in points) if key in self.rows]
        columns = columns_of(rows)
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(map(no_formula, columns))
        writer.writerows(map(no_formula, row) for row in zip(*columns.values()))
        with replacing(self.path / TABLE) as file:
            file.write(text.getvalue().encode(errors="backslashreplace"))
        try:
            import pyarrow
            from pyarrow import parquet
        except ImportError:
            return
        whole = {name: _of_one_type(values) for name, values in columns.items()}
        with replacing(self.path / "table.parquet") as file:
            parquet.write_table(pyarrow.table(whole), file)


def about_of(path: Path) -> dict[str, Any]:
    """What a folder says of its sweep. Raises SceneError where it is none."""
    try:
        found = json.loads((path / MARK).read_bytes())
    except FileNotFoundError:
        raise SceneError((), says="holds no sweep", file=path) from None
    except (ValueError, RecursionError) as error:
        raise SceneError((), says=f"is damaged ({error}); {AGAIN}", file=path / MARK) from None
    if not isinstance(found, dict):
        raise SceneError((), says=f"is damaged (it holds no table); {AGAIN}", file=path / MARK)
    return found


def columns_of(rows: Sequence[Row]) -> dict[str, list[Any]]:
    """The table: parameters, seed, measures, error, warning, version, wall [s]; None where there is none."""
    parameters = dict.fromkeys(name for row in rows for name in row.parameters)
    measures = dict.fromkeys(name for row in rows for name in row.measures)
    columns: dict[str, list[Any]] = {name: [row.parameters.get(name) for row in rows] for name in parameters}
    if any(row.seed is not None for row in rows):
        columns["seed"] = [row.seed for row in rows]
    columns |= {name: [row.measures.get(name) for row in rows] for name in measures}
    columns |= {name: [getattr(row, name) for row in rows] for name in ("error", "warning", "version", "wall")}
    return columns


def _of_one_type(values: list[Any]) -> list[Any]:
    """Texts, where not all are numbers: a column has one type."""
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {int, float} or len(kinds) < 2:
        if any(isinstance(v, int) and abs(v) >= 1 << 63 for v in values):
            kinds = {int, float}
        return [float(v) if v is not None and kinds == {int, float} else v for v in values]
    return [None if value is None else str(value) for value in values]
