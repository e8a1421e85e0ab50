"""Where the error of a scene comes from at its own settings: the step, the mesh, single precision."""

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from taichi_sim.common.atomic_file import replacing
from taichi_sim.reports.speed_error.compared import Compared, worst
from taichi_sim.reports.speed_error.csv_table import whole
from taichi_sim.reports.speed_error.plan import PARTS, Plan
from taichi_sim.reports.speed_error.reference import Reference
from taichi_sim.reports.speed_error.worker import Outcome
from taichi_sim.scene.scene import Scene

__all__ = ["Budget", "load", "made", "mesh_error", "save"]

ASSUMED = 1.0  # order where there is one difference only
LARGER = 10.0  # times the error of the step: that of the mesh hides it
LEAST = 0.3  # order below which differences do not add up to an error
PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}


@dataclass(frozen=True)
class Budget:
    """In the unit of what is compared; None: not looked at, or not known. Each is the largest at the moments compared.

    value: of the quantity, the largest at these moments, or how far it has gone; of positions, the largest rms displacement.
    time: of the last moment. order: of the mesh, as observed.
    """

    name: str
    unit: str
    value: float
    time: float  # s
    method: str
    step_length: float  # s
    step: float | None
    mesh: float | None = None
    order: float | None = None
    single: float | None = None
    why: str = ""  # the mesh's error is not known

    def lines(self) -> Iterator[str]:
        """In words: `12.3 mm, of which step 0.1, mesh 0.4, single precision 0.001`."""
        largest = max(abs(value) for value in (self.value, self.step, self.mesh, self.single) if value is not None)
        power = 0
        if self.unit and largest > 0 and self.unit != "kg":
            power = int(np.clip(3 * math.floor(math.log10(largest) / 3 + 1e-12), min(PREFIXES), max(PREFIXES)))
        parts = {"step": self.step, "mesh": self.mesh, "single precision": self.single}
        words = ", ".join(f"{name} {_short(value, power)}" for name, value in parts.items())
        value = f"{self.value / 10.0**power:.4g} {PREFIXES[power]}{self.unit}".rstrip()
        yield (
            f"{self.name} with {self.method} at {self.step_length:.3g} s, the scene's own settings, at most until"
            f" {self.time:.3g} s: {value}, of which {words}."
        )
        if self.mesh is not None and self.step is not None and self.mesh > LARGER * self.step:
            yield (
                "The mesh is by far the largest part: a finer resolution gains what no step and no method does. The fastest"
                " settings below are for the motion of this mesh."
            )
        if self.why:
            yield f"The error of the mesh: {self.why}."
        elif self.order is not None:
            yield f"The error of the mesh falls with the order {self.order:.2f} of the spacing, as observed."
        elif self.mesh is None:
            yield "The error of the mesh was not looked at; --resolutions does."


def _short(value: float | None, power: int) -> str:
    return "not known" if value is None else f"{value / 10.0**power:.2g}"


def made(
    scene: Scene, plan: Plan, reference: Reference, method: str, step: float, double: Outcome, single: Outcome | None
) -> Budget | None:
    """The error of the step, and of single precision, from runs with the scene's own settings; None without a reference."""
    parts = reference.parts
    if not parts or not reference.motion:
        return None
    compared = Compared.of(scene, plan)
    whole_run = _reached(double)
    off = worst(compared.errors(double, reference)[:parts]) if whole_run else None
    rounded = None
    if single is not None and whole_run and _reached(single):
        rounded = worst(compared.errors(single, double)[:parts])
    value = reference.motion
    name = "rms displacement"
    if compared.quantity is not None:
        value, name = float(np.linalg.norm(reference.quantity[:parts], axis=1).max()), compared.name
        if compared.quantity.from_start:  # where it is says nothing
            value, name = float(np.max(reference.displacement[:parts])), f"motion of {name}"
    return Budget(name, compared.unit, value, plan.duration * parts / PARTS, method, step, off, single=rounded)


def _reached(outcome: Outcome) -> bool:
    return not outcome.left_out and not outcome.unstable and len(outcome.position) == PARTS


def mesh_error(differences: Sequence[float]) -> tuple[float | None, float | None, str]:
    """Error of the coarsest mesh, the order observed, and why one of them is not known.

    Richardson: where the error is C h^p, the differences between h, h/2 and h/4 are in the ratio 2^p, and the error at h is
    the first of them times 2^p / (2^p - 1). With one difference the order is taken to be 1.
    """
    first = differences[0]
    if len(differences) == 1:
        ratio = 2.0**ASSUMED
        return first * ratio / (ratio - 1.0), None, f"from two meshes alone, its order taken to be {ASSUMED:g}"
    if first == 0.0 or differences[1] == 0.0:
        return first, None, "the meshes give the same"
    order = math.log2(first / differences[1])
    if order < LEAST:
        return (
            None,
            order,
            (
                f"not known, at least {first:.2g}: it does not fall yet with the spacing; the differences between h, h/2 and h/4"
                f" are {first:.2g} and {differences[1]:.2g}"
            ),
        )
    return first * 2.0**order / (2.0**order - 1.0), order, ""


def save(path: Path, budget: Budget) -> None:
    """As JSON, replaced whole."""
    with replacing(path) as file:
        file.write(json.dumps(asdict(budget)).encode())


def load(path: Path) -> Budget | None:
    """What `save` wrote, or None where there is no such file."""
    if not path.exists():
        return None
    with whole(path, BadZipFile, KeyError, TypeError):
        return Budget(**json.loads(path.read_text(encoding="utf-8")))
