"""Measures: the numbers that a run is reduced to: of probes, of the run itself, or by a function of the user's."""

import hashlib
import importlib
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taichi_sim.analysis.probe_readings import quantity_of
from taichi_sim.common.errors import SceneError, did_you_mean, short, words_of
from taichi_sim.files.source import run_as_module
from taichi_sim.scene.scene import Scene
from taichi_sim.sweeps.design import RESERVED
from taichi_sim.sweeps.subject import described, source_of, sources_of

__all__ = ["Measures", "measures_of"]

STATISTICS = ("last", "min", "max", "mean")
FIGURES = {  # with their units
    **dict.fromkeys(("energy.kinetic", "energy.spring", "energy.gravity", "energy.total"), "J"),
    "contacts": "",
    "penetration": "m",
    "largest_speed": "m/s",
}
SINCE_READ = ("force", "flux")  # kinds of probes that give means since they were last read


@dataclass(frozen=True)
class Number:
    """A number that is read frame by frame, and what becomes of it: one of STATISTICS."""

    name: str
    source: str  # name of what is read
    statistic: str
    unit: str = ""

    def of(self, found: Sequence[float]) -> float:
        """Statistic of all readings; those that are nan are left out where it is not the last one."""
        if self.statistic == "last":
            return float(found[-1])
        known = [value for value in found if not math.isnan(value)]
        if not known:
            return math.nan
        if self.statistic == "mean":
            return sum(known) / len(known)
        return min(known) if self.statistic == "min" else max(known)


class Measures:
    """All measures of a sweep. functions: of the user's, by name, or `module:function`, or `file.py:function`."""

    def __init__(self, numbers: Sequence[Number], functions: Mapping[str, Any], every_frame: bool) -> None:
        self.numbers, self.functions, self.every_frame = tuple(numbers), dict(functions), every_frame

    @property
    def names(self) -> list[str]:
        """Names of the numbers; functions may give several of their own."""
        return [number.name for number in self.numbers]

    def unit(self, name: str) -> str:
        """The unit of a measure; numbers of the user's functions have none."""
        return next((number.unit for number in self.numbers if number.name == name), "")

    def with_unit(self, name: str) -> str:
        """`probes.load.y [N]`."""
        unit = self.unit(name)
        return f"{name} [{unit}]" if unit else name

    def identity(self) -> list[str]:
        """Names of the measures, and the source of those that are functions, by which they are told apart."""
        return [*self.names, *(f"{name} {_source(one)}" for name, one in self.functions.items())]

    def run(self, simulation: Any, duration: float, fps: float) -> dict[str, float]:
        """Run a simulation for `duration` seconds from its start, and measure."""
        found: dict[str, list[float]] = {number.source: [] for number in self.numbers}
        steps = round(duration / simulation.dt)
        frames = max(1, round(min(duration * fps, steps))) if self.every_frame else 1  # a frame a step at most
        done = 0
        for k in range(1, frames + 1):
            upto = round(steps * k / frames)
            simulation.step(upto - done)
            done = upto
            self._read(simulation, found)
        measured = {number.name: number.of(found[number.source]) for number in self.numbers}
        for name, function in self.functions.items():
            measured.update(_numbers(name, loaded(function)(simulation)))
        return measured

    def _read(self, simulation: Any, found: dict[str, list[float]]) -> None:
        now: dict[str, float] = {}
        if any(source.startswith("probes.") for source in found):
            now.update({f"probes.{name}": value for name, value in simulation.probes().items()})
        if any(source.startswith("energy.") for source in found):
            energy = simulation.energy()
            now.update({f"energy.{name}": value for name, value in energy._asdict().items()})
        if any(source in ("contacts", "penetration", "largest_speed") for source in found):
            contacts = simulation.contacts()
            now |= {"contacts": contacts.number, "penetration": contacts.penetration}
            now["largest_speed"] = contacts.largest_speed
        for source, values in found.items():
            values.append(float(now[source]))


def measures_of(given: Any, scene: Scene) -> Measures:
    """Measures of names and functions, one or several; None: each number of each probe at the end, or, without any, the energy.

    Names: `probes.load`, `probes.load.tension`, `energy.total` and its parts, `contacts`, `penetration`, `largest_speed`, each
    with `.max`, `.min` or `.mean` for that of all frames; or `module:function`. A function gets the Simulation at the end, and
    returns a number, or a mapping of names to numbers. Raises SceneError, which says what there is.
    """
    if given is None:
        given = [
            f"probes.{one.name}.{number}"
            for one in scene.probes
            for number in one.numbers(scene.dim)
            if number != "interval"  # of a mean force: as long as frames are apart
        ]
        given = given or ["energy.total"]
    if isinstance(given, str) or not isinstance(given, Sequence):
        given = [given]
    numbers: list[Number] = []
    functions: dict[str, Any] = {}
    for one in given:
        if callable(one):
            name = described(one, "measure").split(":")[1]
            functions[name] = one
        elif not isinstance(one, str):
            raise SceneError("measure", one, "a name or a function")
        elif ":" in one:
            file, _, name = one.rpartition(":")
            if file.endswith(".py"):
                one = f"{Path(file).resolve()}:{name}"  # for workers in another folder
            loaded(one)
            if functions.get(name, one) != one:
                raise SceneError("measure", says=f"two functions are named {name!r}; rename one")
            functions[name] = one
        else:
            numbers.append(_number(one, scene))
    since = {probe.name for probe in scene.probes if probe.kind in SINCE_READ}
    every = any(number.statistic != "last" or since & set(number.source.split(".")) for number in numbers)
    return Measures(numbers, functions, every)


def _number(name: str, scene: Scene) -> Number:
    start, _, end = name.rpartition(".")
    choices = [(name, "last")] + ([(start, end)] if end in STATISTICS else [])
    first: SceneError | None = None
    for base, statistic in choices:
        if base in FIGURES:
            return Number(name, base, statistic, FIGURES[base])
        if base.startswith("probes."):
            try:
                quantity = quantity_of(scene, base.removeprefix("probes."))
            except SceneError as error:
                first = first or error
                continue
            if len(quantity.numbers) > 1:
                raise SceneError("measure", name, says=f"is a vector; name one of its numbers, {name}.x or the like")
            return Number(name, f"probes.{quantity.numbers[0]}", statistic, quantity.unit)
    if first is not None:
        raise SceneError("measure", says=f"{name}: {first}")
    known = [*FIGURES, *(f"probes.{probe.name}" for probe in scene.probes)]
    says = f"is no measure; {did_you_mean(name, known, 'there are ' + ', '.join(known) + ', and module:function')}"
    raise SceneError("measure", name, says=says)


def _source(function: Any) -> str:
    file = str(function).rpartition(":")[0] if isinstance(function, str) else ""
    return sources_of(Path(file)) if file.endswith(".py") else source_of(loaded(function))


def _module(file: Path) -> Any:
    """A module of a file, by a name of its own: others may be called as it is."""
    if not file.is_file():
        raise FileNotFoundError(f"there is no file {file}")
    if str(file.parent) not in sys.path:
        sys.path.append(str(file.parent))  # what it imports
    return run_as_module(file, f"_measures_of_{hashlib.sha256(str(file).encode()).hexdigest()[:16]}")


def loaded(function: Any) -> Callable[[Any], Any]:
    """A function, or that which `module:name` or `file.py:name` means. Raises SceneError where there is none."""
    if not isinstance(function, str):
        return function  # type: ignore[no-any-return]
    module, _, name = function.rpartition(":")
    try:
        if module.endswith(".py"):
            found = getattr(_module(Path(module).resolve()), name)
        else:
            found = getattr(importlib.import_module(module), name)
    except Exception as error:  # whatever the user's file raises
        raise SceneError("measure", function, says=f"cannot be imported: {words_of(error)}") from None
    if not callable(found):
        raise SceneError("measure", function, says="is no function")
    return found  # type: ignore[no-any-return]


def _numbers(name: str, value: Any) -> dict[str, float]:
    """Numbers that a function returned, by name. Raises SceneError where there are others, or a name is reserved."""
    pairs = list(value.items()) if isinstance(value, Mapping) else [(name, value)]
    if taken := [str(key) for key, _ in pairs if str(key) in RESERVED]:
        raise SceneError("measure", says=f"{name}() returned {taken[0]!r}, a column of every table; name it otherwise")
    try:
        return {str(key): float(one) for key, one in pairs}
    except (TypeError, ValueError):
        raise SceneError("measure", says=f"{name}() returned {short(value)}; it must return numbers") from None
