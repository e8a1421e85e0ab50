"""Tables of a report on disk: a CSV file with a column for each field of a dataclass; what is damaged is said in one sentence."""

import csv
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, TypeVar

from taichi_sim.common.atomic_file import replacing
from taichi_sim.common.errors import SceneError

__all__ = ["read", "whole", "write"]

Entry = TypeVar("Entry")


@contextmanager
def whole(path: Path, *kinds: type[Exception]) -> Iterator[None]:
    """What goes wrong in reading a file of a report, as one SceneError: ValueError, and the kinds given."""
    expected: tuple[type[Exception], ...] = (ValueError, *kinds)
    try:
        yield
    except expected as error:
        raise SceneError(f"{path}: is damaged, use --overwrite or another --out ({error})") from None


def write(path: Path, kind: Any, rows: Sequence[Any]) -> None:
    """All rows, objects of the dataclass `kind`; the old file is replaced when the new one is complete."""
    text = io.StringIO()
    table = csv.DictWriter(text, [field.name for field in fields(kind)], lineterminator="\n")
    table.writeheader()
    table.writerows(asdict(row) for row in rows)  # None becomes an empty cell
    with replacing(path) as file:
        file.write(text.getvalue().encode())


def read(path: Path, kind: type[Entry]) -> list[Entry]:
    """The rows that `write` wrote; none where there is no such file. Raises SceneError where one is not complete."""
    if not path.exists():
        return []
    kinds: dict[str, Any] = {field.name: field.type for field in fields(kind)}  # type: ignore[arg-type]
    with whole(path, csv.Error):
        text = path.read_bytes().decode()
        table = csv.DictReader(io.StringIO(text, newline=""), strict=True)
        lines = list(table)
        if table.fieldnames != list(kinds) or not text.endswith("\n"):
            raise ValueError("its first or its last line is not complete")
        for number, line in enumerate(lines, 1):
            if None in line or None in line.values():
                raise ValueError(f"row {number} is not complete")
        return [kind(**{name: _value(kinds[name], text) for name, text in line.items()}) for line in lines]


def _value(kind: Any, text: str) -> str | float | int | None:
    if kind == float | None:
        return float(text) if text else None
    return kind(text)  # type: ignore[no-any-return]
