"""Rows: what was measured of one method with one step, the file that holds them, and what they say together."""

import csv
import io
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from taichi_sim.common.atomic_file import replacing
from taichi_sim.common.errors import SceneError
from taichi_sim.reports.speed_error.plan import METHODS

__all__ = [
    "Row",
    "as_fast",
    "cheapest",
    "lines_of",
    "pareto",
    "read",
    "stuck",
    "tells",
    "whole",
    "with_orders",
    "write",
]

STABLE, UNSTABLE, LEFT_OUT = "stable", "unstable", "left out"
TOLD = 1.9  # times longer a step must be for that
FALLS = 0.7  # of the error at the step before, above which a shorter step did not lessen it
CLEAR = 10.0  # times what the reference is known to, below which an error says more of the reference than of the method


@dataclass(frozen=True)
class Row:
    """One method with one step. None: not known, or not a number that means anything. Errors are of positions, over all balls
    that are not pinned, or of the quantity asked for."""

    scene: str
    balls: int
    springs: int
    precision: str
    device: str
    method: str
    step: float  # s
    part_of_safe_step: float | None  # None where nothing limits the step, or no step is safe
    passes: float | None  # over the forces, per simulated second
    seconds: float | None  # of wall time, per simulated second
    noise: float | None  # of that: times that differ by less are the same
    ns_per_ball_step: float | None
    rms_error: float | None  # m, or in the quantity's unit: over balls, at the moment where it is largest
    max_error: float | None  # the same of one ball
    relative_error: float | None  # the rms as a part of the motion
    order: float | None  # observed, from the step twice as long
    energy_drift: float | None  # from the reference, as a part of its largest kinetic and spring energy
    verdict: str  # stable, unstable, left out
    reason: str  # of the verdict, or a warning

    @property
    def key(self) -> tuple[str, str, float]:
        """What tells rows of one report apart."""
        return self.precision, self.method, self.step


NUMBERS = {field.name for field in fields(Row) if "float" in str(field.type)}
WHOLE = {field.name for field in fields(Row) if field.type is int}


def write(path: Path, rows: Sequence[Row]) -> None:
    """All rows as CSV, the old file replaced when the new one is complete."""
    text = io.StringIO()
    table = csv.DictWriter(text, [field.name for field in fields(Row)], lineterminator="\n")
    table.writeheader()
    for row in rows:
        table.writerow({name: "" if value is None else value for name, value in asdict(row).items()})
    with replacing(path) as file:
        file.write(text.getvalue().encode())


@contextmanager
def whole(path: Path, *kinds: type[Exception]) -> Iterator[None]:
    """What goes wrong in reading a file of a report, as one SceneError: ValueError, and the kinds given."""
    expected: tuple[type[Exception], ...] = (ValueError, *kinds)
    try:
        yield
    except expected as error:
        raise SceneError(f"{path}: is damaged, use --overwrite or another --out ({error})") from None


def read(path: Path) -> list[Row]:
    """The rows that `write` wrote; none where there is no such file."""
    with whole(path, csv.Error):
        return [_row(line) for line in lines_of(path, [field.name for field in fields(Row)])]


def lines_of(path: Path, names: list[str]) -> list[dict[str, str]]:
    """The lines of a table with these columns. Raises ValueError where one is not complete."""
    if not path.exists():
        return []
    text = path.read_bytes().decode()
    table = csv.DictReader(io.StringIO(text, newline=""), strict=True)
    lines = list(table)
    if table.fieldnames != names or not text.endswith("\n"):
        raise ValueError("its first or its last line is not complete")
    for number, line in enumerate(lines, 1):
        if None in line or None in line.values():
            raise ValueError(f"row {number} is not complete")
    return lines


def _row(line: dict[str, str]) -> Row:
    values: dict[str, Any] = {name: _value(name, text) for name, text in line.items()}
    if values["verdict"] not in (STABLE, UNSTABLE, LEFT_OUT) or values["method"] not in METHODS:
        raise ValueError(f"{values['method']!r} with {values['verdict']!r} is no row")
    return Row(**values)


def _value(name: str, text: str) -> str | float | int | None:
    if name in NUMBERS:
        return float(text) if text else None
    return int(text) if name in WHOLE else text


def tells(row: Row, known: float) -> bool:
    """Whether the row's error is one of the method's: it is stable and clear of what the reference is known to [m]."""
    return row.verdict == STABLE and row.rms_error is not None and row.rms_error > CLEAR * known


def with_orders(rows: Sequence[Row], known: float) -> list[Row]:
    """The rows, sorted by precision and method, steps falling, with the order from each pair of steps that tell."""
    found = sorted(rows, key=lambda row: (row.precision != "f64", METHODS.index(row.method), -row.step))
    for k in range(1, len(found)):
        coarse, fine = found[k - 1], found[k]
        order = None
        if (
            (coarse.precision, coarse.method) == (fine.precision, fine.method)
            and tells(coarse, known)
            and tells(fine, known)
        ):
            assert coarse.rms_error is not None
            assert fine.rms_error is not None
            order = math.log(coarse.rms_error / fine.rms_error) / math.log(coarse.step / fine.step)
        found[k] = replace(fine, order=order)
    return found


def stuck(rows: Sequence[Row], known: float) -> list[str]:
    """Methods, in the best precision that there is, whose errors do not fall with the step any more. Rows: sorted."""
    found = []
    for method in dict.fromkeys(row.method for row in rows):
        own = [row for row in rows if (row.precision, row.method) == (rows[0].precision, method) and tells(row, known)]
        longer = [row for row in own if row.step > TOLD * own[-1].step]
        if longer and (own[-1].rms_error or 0.0) > FALLS * (longer[-1].rms_error or 0.0):
            found.append(method)
    return found


def as_fast(row: Row, other: Row) -> bool:
    """Whether one row takes no longer than another, as far as their times can be told apart."""
    return (row.seconds or 0.0) - (other.seconds or 0.0) <= math.hypot(row.noise or 0.0, other.noise or 0.0)


def pareto(rows: Sequence[Row], known: float) -> list[Row]:
    """The rows that none beats in both speed and error, the fastest first: none that is as fast has a smaller error."""
    telling = [row for row in rows if tells(row, known) and row.seconds is not None]
    front: list[Row] = []
    for row in sorted(telling, key=lambda row: (row.seconds, row.rms_error)):
        better = [other for other in telling if other.rms_error < row.rms_error]  # type: ignore[operator]
        same = any(other.rms_error == row.rms_error for other in front)
        if not same and not any(as_fast(other, row) for other in better):
            front.append(row)
    return front


def cheapest(rows: Sequence[Row], tolerance: float, motion: float, known: float) -> list[Row]:
    """The rows whose error, and what the reference may be off, are together within the tolerance, a part of the motion, and which
    none of those beats in speed by more than noise: equally fast, the one of the smallest error first."""
    good = [
        row
        for row in rows
        if row.verdict == STABLE
        and row.seconds is not None
        and row.rms_error is not None
        and row.rms_error + known <= tolerance * motion
    ]
    fastest = min(good, key=lambda row: row.seconds or 0.0, default=None)
    equal = [] if fastest is None else [row for row in good if as_fast(row, fastest)]
    return sorted(equal, key=lambda row: row.rms_error or 0.0)
