"""The folder of a report: what it holds is added row by row, so that an interrupted report goes on where it stopped."""

import json
from pathlib import Path

from taichi_sim.common.atomic_file import replacing
from taichi_sim.reports.speed_error import budget as budgets
from taichi_sim.reports.speed_error import csv_table
from taichi_sim.reports.speed_error import reference as references
from taichi_sim.reports.speed_error.budget import Budget
from taichi_sim.reports.speed_error.csv_table import whole
from taichi_sim.reports.speed_error.reference import Reference
from taichi_sim.reports.speed_error.rows import Row

__all__ = ["Folder"]

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


def _key(mark: Path) -> str:
    with whole(mark, KeyError, TypeError):
        return str(json.loads(mark.read_text(encoding="utf-8"))["key"])


class Folder:
    """rows.csv, reference.npz, and beside them the pages. `rows`: those that are there already."""

    def __init__(self, path: Path, key: str, overwrite: bool = False) -> None:
        """Raises OSError or ValueError before anything is written where the folder cannot be used."""
        self.path = path
        if not path.parent.is_dir():
            raise FileNotFoundError(f"{path}: there is no folder {str(path.parent)!r}; make it first")
        if path.exists() and not path.is_dir():
            raise NotADirectoryError(f"{path}: is a file; give the name of a folder")
        mark = path / MARK
        if path.is_dir() and any(path.iterdir()):
            if not mark.is_file():
                raise FileExistsError(f"{path}: the folder is not empty and holds no report; use another name")
            if not overwrite and _key(mark) != key:
                raise FileExistsError(
                    f"{path}: holds a report of another scene or with other settings; use --overwrite or another --out"
                )
        self.key = key
        if path.is_dir() and overwrite:
            for name in OURS:
                (path / name).unlink(missing_ok=True)
        self.rows = csv_table.read(path / "rows.csv", Row)

    def open(self) -> Path:
        """Make the folder, once there is something to keep."""
        if not (self.path / MARK).is_file():
            self.path.mkdir(exist_ok=True)
            with replacing(self.path / MARK) as file:
                file.write(json.dumps({"key": self.key}).encode())
        return self.path

    def add(self, row: Row) -> None:
        """Keep a row, on disk at once."""
        self.rows.append(row)
        csv_table.write(self.open() / "rows.csv", Row, self.rows)

    def complete(self, found: list[Row]) -> None:
        """Write the rows once more, those found with their orders; what was not asked for this time stays as it was."""
        by_key = {row.key: row for row in found}
        self.rows = [by_key.get(row.key, row) for row in self.rows]
        csv_table.write(self.path / "rows.csv", Row, self.rows)

    def reference(self) -> Reference | None:
        """The one that an interrupted report has made."""
        return references.load(self.path / "reference.npz")

    def budget(self) -> Budget | None:
        """Where the error comes from, as an earlier run found."""
        return budgets.load(self.path / "budget.json")

    def keep_budget(self, budget: Budget) -> None:
        """Save it."""
        budgets.save(self.open() / "budget.json", budget)

    def keep(self, reference: Reference) -> None:
        """Save it."""
        references.save(self.open() / "reference.npz", reference)
