"""report.html of a sweep: pictures, effects, means over seeds, and what failed."""

from collections.abc import Iterator
from datetime import date
from pathlib import Path
from statistics import median
from typing import Any

from taichi_sim.common.atomic_file import replacing
from taichi_sim.common.quantities import measured
from taichi_sim.studies.figure import svg
from taichi_sim.studies.intervals import half_width
from taichi_sim.studies.page_parts import Part, Table, as_html, made_with
from taichi_sim.sweeps import figures
from taichi_sim.sweeps.effects import Group, grouped, main_effects, parameters_in_words, sobol

__all__ = ["write_page"]

MOST_MEASURES, MOST_ROWS, MOST_REASONS = 12, 60, 20
NOTE = """Share: of the variance between points that the means at the values of a parameter explain; the rest is due to others
and to their interplay. First: the part of the variance that goes when a parameter is known; total: that which stays while only
it is unknown (Sobol; Saltelli's estimator): of few points it is off by so much that it may leave 0 to 1."""

SPREAD = (
    "95 % interval: the mean over many more seeds lies within +- of the mean shown, in 95 of 100 sweeps (Student's t)."
)


def write_page(sweep: Any, name: str) -> Path:
    """Write the page, whole when it appears, and return its path."""
    path: Path = sweep.folder / "report.html"
    with replacing(path) as file:
        file.write(as_html(_content(sweep, name)))
    return path


def _content(sweep: Any, name: str) -> Iterator[Part]:
    yield "title", f"Sweep of {name}"
    yield "small", f"{date.today().isoformat()}, {made_with()}"
    yield "list", list(_about(sweep))
    rows = {row.key: row for row in sweep.rows}
    paths = [axis.path for axis in sweep.axes]
    for measure in sweep.measures[:MOST_MEASURES]:
        groups = grouped(sweep.rows, measure)
        shown = sweep.with_unit(measure)
        yield "heading", shown
        figure = figures.draw(groups, sweep.axes, shown)
        if figure is not None:
            yield "picture", svg(figure)
        if len(paths) > 1 and len(groups) > 2:
            yield "small", "What each parameter does, the strongest first."
            yield "numbers", _effects(groups, paths, sobol(sweep.design, sweep.points, rows, measure))
        if any(len(group.values) > 1 for group in groups):
            yield "small", "Each combination, over its seeds."
            yield "numbers", _means(groups, paths)
    if len(sweep.measures) > MOST_MEASURES:
        yield "small", f"{len(sweep.measures) - MOST_MEASURES} more measures are in table.csv."
    if len(paths) > 1:
        yield "small", NOTE
    if len({row.seed for row in sweep.rows}) > 1:
        yield "small", SPREAD
    if sweep.failed:
        yield "heading", f"{len(sweep.failed)} points failed"
        said = []
        for row in sweep.failed[:MOST_REASONS]:
            at = [f"{key} {value}" for key, value in row.parameters.items()]
            at += [] if row.seed is None else [f"seed {row.seed}"]
            said.append(f"{', '.join(at)}: {row.error}")
        yield "reasons", said
    warned = list(dict.fromkeys(row.warning for row in sweep.rows if row.warning))
    if warned:
        yield "heading", "Warnings"
        yield "reasons", warned[:MOST_REASONS]


def _about(sweep: Any) -> Iterator[str]:
    seeds = len({row.seed for row in sweep.rows})
    done = f"{len(sweep.rows)} of {len({point.key for point in sweep.points})} points, {len(sweep.failed)} failed"
    yield f"{done}; design {sweep.design.kind}" + (f", {seeds} seeds" if seeds > 1 else "")
    for axis in sweep.axes:
        few = ", ".join(f"{value:.6g}" if isinstance(value, float) else str(value) for value in axis.values[:12])
        more = f", ... ({len(axis.values)} values)" if len(axis.values) > 12 else ""
        scale = ", logarithmic" if axis.log else ""
        yield f"{axis.path}: {few}{more}" if axis.values else f"{axis.path}: {axis.low:g} to {axis.high:g}{scale}"
    wall = sum(row.wall for row in sweep.rows)
    quick = [
        row.wall for row in sweep.rows if not row.compiled
    ]  # the median: the first reset of a process loads kernels, too
    usual = f"{median(quick):.3g} s a point of what was compiled before" if quick else "compiling included"
    yield f"{wall:.4g} s of work in all, {usual}"


def _effects(groups: list[Group], paths: list[str], indices: dict[str, tuple[float, float]] | None) -> Table:
    """Table of the effect of each parameter, the strongest first."""
    head = ["parameter", "share", "lowest mean", "highest mean", *(["first", "total"] if indices else [])]
    cells = []
    for effect in main_effects(groups, paths):
        cells.append([effect.path, f"{effect.share:.1%}", f"{effect.low:.5g}", f"{effect.high:.5g}"])
        if indices:
            cells[-1] += [f"{index:.2f}".replace("-0.00", "0.00") for index in indices[effect.path]]
    return head, cells, [""] * len(cells)


def _means(groups: list[Group], paths: list[str]) -> Table:
    """Mean, interval and spread of each combination."""
    head = [*paths, "seeds", "failed", "mean, 95 % interval", "standard deviation", "least", "largest"]
    cells = []
    for group in groups[:MOST_ROWS]:
        values = group.values
        numbers = ["", "", "", ""]
        if len(values):
            spread = f"{values.std(ddof=1):.3g}" if len(values) > 1 else ""
            numbers = [
                measured(group.mean, half_width(values)),
                spread,
                f"{values.min():.5g}",
                f"{values.max():.5g}",
            ]
        words = parameters_in_words(group.parameters)
        cells.append([*words, str(len(values)), str(group.failed), *numbers])
    return head, cells, [""] * len(cells)
