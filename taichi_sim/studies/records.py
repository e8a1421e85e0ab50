"""Records of a study as files: rows as lines of JSON with a checksum, arrays as an .npz, columns as a CSV table."""

import csv
import io
import json
import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from taichi_sim.common.npz import read_npz
from taichi_sim.common.printable import no_formula

__all__ = ["arrays_of", "lines_of", "packed", "rows_of", "table_of"]

CHECK = "crc32"  # beside the fields of a row
Entry = TypeVar("Entry")


def lines_of(rows: Iterable[Any]) -> bytes:
    """A line of JSON for each row, an object of a dataclass whose fields are plain values."""
    return "".join(json.dumps({**vars(row), CHECK: _check(vars(row))}) + "\n" for row in rows).encode()


def _check(values: Mapping[str, Any]) -> int:
    """CRC-32 of a row, by which `rows_of` knows a damaged one."""
    return zlib.crc32(json.dumps(values).encode())


def rows_of(data: bytes, kind: type[Entry]) -> list[Entry]:
    """Rows of the dataclass `kind` from what `lines_of` made. Raises ValueError, TypeError or RecursionError for damage."""
    rows = []
    if not data.endswith(b"\n"):
        raise ValueError("the last line is not complete")
    for number, line in enumerate(data.decode().splitlines(), 1):
        values = json.loads(line)
        if not isinstance(values, dict):
            raise ValueError(f"line {number} is no table")
        if values.pop(CHECK, None) != _check(values):
            raise ValueError(f"the checksum of line {number} does not fit")
        rows.append(kind(**values))
    return rows


def packed(record: Mapping[str, Any]) -> bytes:
    """Numbers, texts and arrays by their names as an .npz; None is left out."""
    data = io.BytesIO()
    np.savez(data, **{name: np.asarray(value) for name, value in record.items() if value is not None})  # type: ignore[arg-type]
    return data.getvalue()


def arrays_of(path: Path) -> dict[str, Any]:
    """Values by their names from what `packed` made."""
    return {name: value.item() if value.ndim == 0 else value for name, value in read_npz(path).items()}


def table_of(columns: Mapping[str, Sequence[Any]]) -> bytes:
    """Columns as CSV; None becomes an empty cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(map(no_formula, columns))
    writer.writerows(map(no_formula, row) for row in zip(*columns.values()))
    return text.getvalue().encode(errors="backslashreplace")
