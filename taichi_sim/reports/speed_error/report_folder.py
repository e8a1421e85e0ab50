"""The folder of a report: what it holds is added run by run, so that an interrupted report goes on where it stopped."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from taichi_sim.reports.speed_error.rows import Row
from taichi_sim.studies.records import lines_of, table_of
from taichi_sim.studies.study_folder import StudyFolder

RUN = "run_"  # how the names of files begin that hold single runs of an unfinished report


class ReportFolder(StudyFolder):
    """Rows and what else is found, and beside them the pages. `rows`: those that are there already."""

    kind, record, another = "report", "report.json", "another --out"
    own = (
        *("rows.jsonl", "rows.csv", "seeds.jsonl", "seeds.csv", "reference.npz", "budget.npz"),
        *("report.md", "report.html", "error.svg", "error.png", f"{RUN}*.npz"),
    )

    def __init__(self, path: Path, about: Mapping[str, Any], overwrite: bool = False) -> None:
        super().__init__(path, about, overwrite)
        try:
            if path.is_dir():
                self.begin()
            self.rows = self.rows_in("rows.jsonl", Row)
        except BaseException:
            self.close()
            raise

    def write(self, name: str, data: bytes) -> None:
        """Replace a file, whole; the folder is made once there is something to keep."""
        if self._lock is None:
            self.begin()
        super().write(name, data)

    def keep_table(self, name: str, rows: Sequence[Any]) -> None:
        """Keep all rows of a table, and write them as CSV, a column for each field."""
        self.write(f"{name}.jsonl", lines_of(rows))
        columns = {field.name: [getattr(row, field.name) for row in rows] for field in fields(rows[0])}
        self.write(f"{name}.csv", table_of(columns))

    def add(self, row: Row) -> None:
        """Keep a row, on disk at once."""
        self.rows.append(row)
        self.keep_table("rows", self.rows)

    def complete(self, found: list[Row]) -> None:
        """Write the rows once more, those found with their orders; what was not asked for this time stays as it was."""
        if self.rows:
            by_key = {row.key: row for row in found}
            self.rows = [by_key.get(row.key, row) for row in self.rows]
            self.keep_table("rows", self.rows)
        self.forget_runs()

    def forget_runs(self) -> None:
        """Remove what single runs came to."""
        self.remove(f"{RUN}*.npz")
