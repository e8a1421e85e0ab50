"""A table of energies, contacts and probes over time, as CSV."""

import csv
from contextlib import suppress
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from taichi_sim.analysis.frame import Frame
from taichi_sim.common.printable import no_formula
from taichi_sim.outputs.base import Image, Output
from taichi_sim.outputs.growing import Growing

CONTACTS = ("number", "penetration", "mean_penetration", "residual", "largest_speed")


class Table(Growing):
    """A row for each frame: frame, time [s], kinetic, spring, gravity and total energy [J], contacts, penetration and
    mean_penetration [m], residual and largest_speed [m/s], and each number of each probe under its name, `load.tension`, in SI
    units. nan where something is not known."""

    needs_arrays = False

    def begun(self, part: Path, frame: Frame) -> None:
        with open(part, "w", newline="", encoding="utf-8") as file:
            write_row(file, row_of(0, frame), names=True)

    def length(self) -> int:
        with open(self.path, "rb") as file:
            return max(0, sum(line.endswith(b"\n") for line in file) - 1)

    def opened(self) -> Any:
        return open(self.path, "a", newline="", encoding="utf-8")

    def more(self, index: int, frame: Frame) -> None:
        write_row(self._file, row_of(index, frame))
        self._file.flush()


class PipedTable(Output):
    """Rows of `Table` into a pipe that another program reads, from the first one on; the run waits for that program."""

    needs_image = False

    def __init__(self, path: str | PathLike[str]) -> None:
        self._place = Path(path)
        self._file: Any = None

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        """Raises OSError where nobody reads it any more."""
        try:
            if self._file is None:
                self._file = open(self._place, "w", newline="", encoding="utf-8")  # noqa: SIM115  # closed by finish
            write_row(self._file, row_of(index, frame), names=index == 0)
            self._file.flush()
        except BrokenPipeError:
            raise OSError(f"{self._place}: whoever read it has gone") from None

    def finish(self) -> None:
        if self._file is not None:
            with suppress(OSError):  # what nobody read
                self._file.close()

    def discard(self) -> None:
        self.finish()


def write_row(file: Any, row: dict[str, Any], names: bool = False) -> None:
    """A line of the table, and before it the names of its columns."""
    writer = csv.writer(file, lineterminator="\n")
    if names:
        writer.writerow(map(no_formula, row))
    writer.writerow([repr(value) for value in row.values()])


def row_of(index: int, frame: Frame) -> dict[str, Any]:
    """The values of a row by the names of their columns."""
    energy = (np.nan,) * 4 if frame.energy is None else frame.energy
    row = {"frame": index, "time": float(frame.time)}
    row |= {name: float(value) for name, value in zip(("kinetic", "spring", "gravity", "total"), energy)}
    for name in CONTACTS:
        value = np.nan if frame.contacts is None else getattr(frame.contacts, name)
        row["contacts" if name == "number" else name] = value if name == "number" else float(value)
    return row | {name: float(value) for name, value in frame.probes.items()}
