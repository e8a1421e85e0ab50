"""Pictures of a sweep: a curve for one parameter, a map for two, parallel coordinates for more, a histogram for seeds alone."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from taichi_sim.studies.figure import INK, dress, literal, styled
from taichi_sim.studies.intervals import half_width
from taichi_sim.sweeps.design import Axis
from taichi_sim.sweeps.effects import Group

__all__ = ["draw", "is_logarithmic"]

COLOUR = "#3d85c6"
BANDS = ((0.05, 0.95, 0.15), (0.25, 0.75, 0.25))  # quantiles, and how dense
MOST_LINES = 400  # of parallel coordinates
MAP = "viridis"

MOST_TICKS = 9  # one at each value


@styled
def draw(groups: Sequence[Group], axes: Sequence[Axis], measure: str) -> Any:
    """The figure of a measure, or None where nothing is known of it. Axes with one value are left out."""
    from matplotlib.figure import Figure

    known = [group for group in groups if len(group.values)]
    varied = [axis for axis in axes if len({repr(group.parameters[axis.path]) for group in known}) > 1]
    if not known or (not varied and len(known[0].values) < 2):
        return None
    measure = literal(measure)
    figure = Figure(figsize=(7.4 if len(varied) < 3 else 1.9 * len(varied) + 3.2, 4.2), layout="constrained")
    axis = figure.subplots()
    if not varied:
        _histogram(axis, known[0], measure)
    elif len(varied) == 1:
        _curve(axis, known, varied[0], measure)
    elif len(varied) == 2:
        _map(figure, axis, known, varied, measure)
    else:
        _parallel(figure, axis, known, varied, measure)
    return figure


def _histogram(axis: Any, group: Group, measure: str) -> None:
    """All seeds, their mean and its interval."""
    values = group.values
    axis.hist(values, bins="auto", color=COLOUR, alpha=0.55)
    axis.axvline(group.mean, color=INK, lw=1.2)
    half = half_width(values)
    axis.axvspan(group.mean - half, group.mean + half, color=INK, alpha=0.15, lw=0)
    axis.set_xlabel(measure, color=INK)
    axis.set_ylabel("seeds", color=INK)
    axis.set_title(f"{group.in_words()}", color=INK, fontsize=11)
    dress(axis)


def _places(axis: Axis, groups: Sequence[Group]) -> tuple[np.ndarray, list[Any] | None]:
    """Places of the groups along an axis, and the words that are written there where values are no numbers."""
    values = [group.parameters[axis.path] for group in groups]
    if all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in values):
        return np.array(values, dtype=float), None
    words = list(dict.fromkeys(map(str, values)))
    return np.array([words.index(str(value)) for value in values], dtype=float), words


def _curve(axis: Any, groups: Sequence[Group], along: Axis, measure: str) -> None:
    """The median of all seeds, quantiles as bands, each run a dot."""
    x, words = _places(along, groups)
    order = np.argsort(x, kind="stable")
    x, ordered = x[order], [groups[k] for k in order]
    if max(len(group.values) for group in ordered) > 1:
        for low, high, alpha in BANDS:
            lower, upper = ([np.quantile(group.values, q) for group in ordered] for q in (low, high))
            label = f"{low:.0%} to {high:.0%} of the seeds"
            axis.fill_between(x, lower, upper, color=COLOUR, alpha=alpha, lw=0, label=label)
    middle = [np.median(group.values) for group in ordered]
    axis.plot(x, middle, color=COLOUR, lw=1.6, marker="o", ms=4, label="median" if len(axis.collections) else None)
    for place, group in zip(x, ordered):
        if len(group.values) > 1:
            axis.plot(np.full(len(group.values), place), group.values, color=INK, lw=0, marker=".", ms=2.5, alpha=0.5)
    _ticks(axis, along, words, x)
    axis.set_xlabel(literal(along.path), color=INK)
    axis.set_ylabel(measure, color=INK)
    if len(axis.collections):
        for text in axis.legend(frameon=False, fontsize=9).get_texts():
            text.set_color(INK)
    dress(axis)


def is_logarithmic(along: Axis, x: np.ndarray) -> bool:
    """True if the axis was said to be logarithmic, or its values were named one by one and lie far apart."""
    different = np.unique(x)
    if different[0] <= 0.0 or len(different) < 2:
        return False
    steps = np.diff(different)
    named = bool(along.values) and not np.allclose(steps, steps[0], rtol=1e-6, atol=0.0)
    return along.log or (named and different[-1] > 30.0 * different[0])


def _ticks(axis: Any, along: Axis, words: list[Any] | None, x: np.ndarray, side: str = "x") -> None:
    """Words, or a logarithmic scale, where values need them."""
    if words is not None:
        getattr(axis, f"set_{side}ticks")(range(len(words)), [literal(str(word)) for word in words])
    elif is_logarithmic(along, x):
        from matplotlib.ticker import LogFormatter

        getattr(axis, f"set_{side}scale")("log")
        numbers = getattr(axis, f"{side}axis")
        numbers.set_major_formatter(LogFormatter())
        numbers.set_minor_formatter(LogFormatter(labelOnlyBase=False, minor_thresholds=(2.0, 0.4)))
    elif along.values and len(np.unique(x)) <= MOST_TICKS:
        getattr(axis, f"set_{side}ticks")(np.unique(x), [f"{value:.4g}" for value in np.unique(x)])


def _map(figure: Any, axis: Any, groups: Sequence[Group], axes: Sequence[Axis], measure: str) -> None:
    """The mean over seeds in colours: cells of a product, dots of a sample."""
    (x, x_words), (y, y_words) = (_places(one, groups) for one in axes)
    means = np.array([group.mean for group in groups])
    columns, rows = np.unique(x), np.unique(y)
    if len(columns) * len(rows) == len(groups):
        cells = np.full((len(rows), len(columns)), np.nan)
        cells[np.searchsorted(rows, y), np.searchsorted(columns, x)] = means
        shown = axis.pcolormesh(columns, rows, cells, cmap=MAP, shading="nearest", rasterized=cells.size > 2000)
    else:
        shown = axis.scatter(x, y, c=means, cmap=MAP, s=28, lw=0)
    _ticks(axis, axes[0], x_words, x)
    _ticks(axis, axes[1], y_words, y, "y")
    axis.set_xlabel(literal(axes[0].path), color=INK)
    axis.set_ylabel(literal(axes[1].path), color=INK)
    dress(axis, grid=False)
    _bar(figure, axis, shown, measure)


def _bar(figure: Any, axis: Any, shown: Any, measure: str) -> None:
    bar = figure.colorbar(shown, ax=axis)
    bar.set_label(measure, color=INK)
    bar.ax.tick_params(colors=INK, labelcolor=INK)
    bar.outline.set_edgecolor(INK)


def _parallel(figure: Any, axis: Any, groups: Sequence[Group], axes: Sequence[Axis], measure: str) -> None:
    """A line for each combination, from parameter to parameter to the measure, whose value is its colour."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    step = -(-len(groups) // MOST_LINES)
    some = sorted(groups[::step], key=lambda group: group.mean)
    means = np.array([group.mean for group in some])
    scale = ScalarMappable(Normalize(means.min(), means.max()), MAP)
    heights, ends, logs = [], [], []
    for one in axes:
        x, words = _places(one, some)
        logs.append(words is None and is_logarithmic(one, x))
        if logs[-1]:
            heights.append(np.log(x / x.min()) / np.log(x.max() / x.min()))
        else:
            heights.append((x - x.min()) / max(np.ptp(x), 1e-300))
        ends.append(
            (literal(str(words[0])), literal(str(words[-1]))) if words else (f"{x.min():.4g}", f"{x.max():.4g}")
        )
    heights.append((means - means.min()) / max(np.ptp(means), 1e-300))
    ends.append((f"{means.min():.4g}", f"{means.max():.4g}"))
    names = [f"{literal(one.path)} (log)" if log else literal(one.path) for one, log in zip(axes, logs)] + [measure]
    for line, mean in zip(np.array(heights).T, means):
        axis.plot(range(len(names)), line, color=scale.to_rgba(mean), lw=0.9, alpha=0.7)
    for k, (low, high) in enumerate(ends):
        axis.axvline(k, color=INK, lw=0.8)
        axis.text(k, -0.04, low, ha="center", va="top", color=INK, fontsize=9)
        axis.text(k, 1.04, high, ha="center", va="bottom", color=INK, fontsize=9)
    axis.set_ylim(-0.02, 1.02)
    axis.set_yticks([])
    axis.set_xticks(range(len(names)), names)
    axis.tick_params(axis="x", length=0, pad=18)
    _bar(figure, axis, scale, measure)
    dress(axis, grid=False)
    for spine in axis.spines.values():
        spine.set_visible(False)
