"""Kept outcomes: what single trials of an unfinished report came to, a file each, so that it goes on from them."""

import hashlib
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from taichi_sim.common.npz import read_npz
from taichi_sim.reports.speed_error.worker import Outcome, Trial

START = "run_"  # of the names of the files


class KeptOutcomes:
    """Outcomes in a folder. read(name, parse), write(name, data): the folder's own."""

    def __init__(
        self, path: Path, read: Callable[[str, Callable[[Path], Any]], Any], write: Callable[[str, bytes], None]
    ) -> None:
        self._path, self._read, self._write = path, read, write

    def find(self, precision: str, trial: Trial) -> Outcome | None:
        """What the trial came to; None where it is not kept."""
        found: Outcome | None = self._read(_name(precision, trial), _parsed)
        return found

    def keep(self, precision: str, trial: Trial, outcome: Outcome) -> None:
        """Keep what a trial came to until the report is complete."""
        data = io.BytesIO()
        np.savez(data, **{k: np.asarray(v) for k, v in outcome._asdict().items() if v is not None})  # type: ignore[arg-type]
        self._write(_name(precision, trial), data.getvalue())

    def forget(self) -> None:
        """Remove all of them."""
        for path in self._path.glob(f"{START}*.npz"):
            path.unlink(missing_ok=True)


def _parsed(path: Path) -> Outcome:
    arrays: dict[str, Any] = read_npz(path)
    values: Any = {k: value.item() if value.ndim == 0 else list(value) for k, value in arrays.items()}
    values["energy"] = [tuple(map(float, energy)) for energy in values["energy"]]
    values["contacts"] = [(int(n), float(depth)) for n, depth in values["contacts"]]
    values["begin"] = arrays.get("begin")
    return Outcome(**values)


def _name(precision: str, trial: Trial) -> str:
    start = "" if trial.start is None else hashlib.sha256(np.ascontiguousarray(trial.start).tobytes()).hexdigest()
    about = repr((precision, trial.method, trial.step, trial.most, trial.contacts, start))
    return f"{START}{hashlib.sha256(about.encode()).hexdigest()[:16]}.npz"
