"""The folder of a sweep: rows as they come in, batch by batch, and the table of all of them. Whatever is killed, it is whole."""

import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from taichi_sim.common.atomic_file import replacing
from taichi_sim.common.own_folder import emptied, require_own
from taichi_sim.studies.records import lines_of, table_of
from taichi_sim.studies.study_folder import StudyFolder
from taichi_sim.sweeps.points import Point, Row

__all__ = ["SweepFolder", "columns_of"]

ROWS, BATCHES = "rows.jsonl", "batches"
BATCH_FILE = r"[0-9a-f]{16}_\d+\.jsonl"  # behind the mark of its sweep
MEND = "delete it to have its points run again"


class SweepFolder(StudyFolder):
    """`rows`: by key, what is there already. mark: how the names of this sweep's batches begin."""

    kind, record = "sweep", "sweep.json"
    own = (ROWS, "table.csv", "table.parquet", "report.html")

    def __init__(self, path: Path, about: Mapping[str, Any], overwrite: bool = False) -> None:
        super().__init__(path, about, overwrite)
        said = json.dumps(self.about, sort_keys=True).encode()
        self.mark = f"{hashlib.sha256(said).hexdigest()[:12]}_"  # a worker of another sweep may write here yet
        self.rows: dict[str, Row] = {}
        self._written: set[str] = set()  # keys of the file of all rows
        require_own(self.batches)
        if not overwrite:
            self.add(row for name in (ROWS, *self._batches()) for row in self.rows_in(name, Row, MEND))

    @property
    def batches(self) -> Path:
        """Folder into which workers put what they have done."""
        return self.path / BATCHES

    def _batches(self) -> list[str]:
        """Names of files that workers of this sweep have written."""
        return sorted(f"{BATCHES}/{file.name}" for file in self.batches.glob(f"{self.mark}*.jsonl"))

    def begin(self) -> None:
        super().begin()
        self._compact()

    def prepare(self) -> None:
        """Make the folder of batches, without those of another sweep."""
        self.batches.mkdir(exist_ok=True)
        require_own(self.batches)
        self._clear()

    def _clear(self) -> None:
        """Delete batches of another sweep, and what workers that were killed had begun to write."""
        emptied(self.batches, re.compile(rf"(?!{self.mark})[0-9a-f]{{12}}_{BATCH_FILE}"))

    def empty(self) -> None:
        if self.batches.is_dir():
            emptied(self.batches, re.compile(rf"[0-9a-f]{{12}}_{BATCH_FILE}"))
        super().empty()

    def _compact(self) -> None:
        """One file in place of many: it is complete before they go. A worker may have written some that have not come in."""
        found = self._batches()
        for row in [row for name in found for row in self.rows_in(name, Row, MEND)]:
            self.rows.setdefault(row.key, row)
        if found or self.rows.keys() - self._written:  # those of workers that were killed come without a file
            self.write(ROWS, lines_of(self.rows.values()))
            self._written = set(self.rows)
            for name in found:
                (self.path / name).unlink(missing_ok=True)

    def add(self, rows: Iterable[Row]) -> None:
        """Rows that have come in."""
        self.rows.update((row.key, row) for row in rows)

    def finish(self, points: Sequence[Point]) -> None:
        """Write the table of these points, in their order, those that are done; as Parquet, too, where pyarrow is installed.
        Nothing, while the folder is not this sweep's."""
        if not self.begun:
            return
        self._compact()
        self._clear()
        rows = [self.rows[key] for key in dict.fromkeys(point.key for point in points) if key in self.rows]
        columns = columns_of(rows)
        self.write("table.csv", table_of(columns))
        try:
            import pyarrow
            from pyarrow import parquet
        except ImportError:
            return
        whole = {name: _of_one_type(values) for name, values in columns.items()}
        with replacing(self.path / "table.parquet") as file:
            parquet.write_table(pyarrow.table(whole), file)


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
