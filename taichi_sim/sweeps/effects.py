"""Effects in a sweep: means over seeds, how much each parameter explains, and Sobol's indices. Plain NumPy and SciPy."""

import warnings
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.quantities import measured
from taichi_sim.studies.intervals import CONFIDENCE, half_width
from taichi_sim.sweeps.design import Design
from taichi_sim.sweeps.points import Point, Row

__all__ = ["Effect", "Group", "grouped", "main_effects", "parameters_in_words", "sobol"]

LARGEST_VALUE = 1e100  # of a measure: beyond it sums of squares overflow; such a value is counted as failed
BINS = 8  # of a parameter that was sampled
Floats = NDArray[np.float64]


class Group(NamedTuple):
    """All seeds of one combination of parameters. values: of a measure, those that are known."""

    parameters: Mapping[str, Any]
    values: Floats
    failed: int

    @property
    def mean(self) -> float:
        """nan where there is none."""
        return float(self.values.mean()) if len(self.values) else float("nan")

    def in_words(self, unit: str = "") -> str:
        """The mean with its 95 % interval: `3.20 +- 0.04 N (mean of 8 seeds, 95 %)`; of one run the value alone."""
        number = len(self.values)
        if number < 2:
            return measured(self.mean, unit=unit)
        return measured(self.mean, half_width(self.values), unit, f"mean of {number} seeds, {CONFIDENCE:.0%} interval")


def grouped(rows: Sequence[Row], measure: str) -> list[Group]:
    """Rows by their parameters, in the order in which these come first."""
    found: dict[str, tuple[Mapping[str, Any], list[float], list[int]]] = {}
    for row in rows:
        _, values, failed = found.setdefault(repr(sorted(row.parameters.items())), (row.parameters, [], []))
        value = row.measures.get(measure, float("nan"))
        (values if abs(value) <= LARGEST_VALUE else failed).append(value)  # type: ignore[arg-type]
    return [Group(parameters, np.array(values), len(failed)) for parameters, values, failed in found.values()]


def parameters_in_words(parameters: Mapping[str, Any]) -> list[str]:
    """Values of parameters as texts."""
    return [f"{value:.6g}" if isinstance(value, float) else str(value) for value in parameters.values()]


class Effect(NamedTuple):
    """Effect of a parameter on a measure. share: of the variance between points that its means explain (eta squared); low,
    high: the least and largest of these means."""

    path: str
    share: float
    low: float
    high: float


def main_effects(groups: Sequence[Group], paths: Sequence[str]) -> list[Effect]:
    """The largest first. Values that were sampled are taken together, an eighth of them at a time."""
    known = [group for group in groups if not np.isnan(group.mean)]
    means = np.array([group.mean for group in known])
    total = float(means.var()) if len(means) else 0.0
    effects = []
    for path in paths:
        parts = _parts([group.parameters[path] for group in known])
        each = [means[part] for part in parts]
        middles = [float(part.mean()) for part in each]
        between = sum(len(part) * (middle - means.mean()) ** 2 for part, middle in zip(each, middles)) / max(
            1, len(means)
        )
        if middles:
            effects.append(Effect(path, float(between / total) if total > 0 else 0.0, min(middles), max(middles)))
    return sorted(effects, key=lambda effect: -effect.share)


def _parts(values: Sequence[Any]) -> list[NDArray[np.intp]]:
    """Numbers of points with the same value, or with neighbouring ones."""
    values = [
        value if isinstance(value, (str, int, float)) else str(value) for value in values
    ]  # a list is a word, too
    different = list(dict.fromkeys(values))
    if len(different) <= max(BINS, len(values) // 4) or any(isinstance(value, str) for value in different):
        places = np.array([different.index(value) for value in values])
        return [np.flatnonzero(places == k) for k in range(len(different))]
    order = np.argsort(np.array(values, dtype=float), kind="stable")
    return [part for part in np.array_split(order, BINS) if len(part)]


def sobol(
    design: Design, points: Sequence[Point], rows: Mapping[str, Row], measure: str
) -> dict[str, tuple[float, float]] | None:
    """First-order and total index of each parameter, Saltelli's estimator of scipy.stats.sobol_indices; None where the design has
    none, or not every point has a value. Several seeds of a point: of their mean."""
    from scipy.stats import sobol_indices

    d, n = len(design.axes), design.points or 0
    if design.kind != "sobol":
        return None
    by_place: list[list[float]] = []
    before: Any = None
    for point in points:  # seeds of a point follow each other
        if before is not point.parameters:
            by_place.append([])
            before = point.parameters
        row = rows.get(point.key)
        by_place[-1].append(float("nan") if row is None else row.measures.get(measure, float("nan")))
    found = np.array([np.mean(values) for values in by_place])
    if len(found) != n * (d + 2) or np.isnan(found).any() or found.std() == 0.0:
        return None
    parts = found.reshape(d + 2, 1, n)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        indices = sobol_indices(func={"f_A": parts[0], "f_B": parts[1], "f_AB": parts[2:]}, n=n)
    first, whole = np.ravel(indices.first_order), np.ravel(indices.total_order)
    return {axis.path: (float(a), float(b)) for axis, a, b in zip(design.axes, first, whole)}
