"""The plot: error against wall time, one curve for each method over its steps, a panel for each precision."""

from typing import Any

from taichi_sim.reports.speed_error.findings import Findings
from taichi_sim.reports.speed_error.plan import METHODS
from taichi_sim.reports.speed_error.rows import CLEAR_OF_REFERENCE, MUCH_LONGER, STABLE, UNSTABLE, Row
from taichi_sim.studies.figure import INK, dress, literal, styled

COLOURS = ("#3d85c6", "#d99a1c", "#2a9d78", "#8c8c8c", "#c5689c", "#d4623a", "#8a6fd6")  # seen on white and on black
MARKERS = ("o", "s", "D", "x", "^", "v", "P")
READ = "Each mark is a run with one step. Further left is more accurate, further down is faster."
FRONT = f"what is more accurate\ntakes {MUCH_LONGER}"
BAND = "these of all precisions,\njoined"
BROKEN = "unstable, error unknown"
FLOOR = "least error in\nsingle precision"
UNTOLD = "too near to the reference\nto tell the error"
NAMES = {"f64": "double precision (f64)", "f32": "single precision (f32)"}


@styled
def draw(findings: Findings) -> Any:
    """The figure, or None where no row has an error and a time."""
    from matplotlib.figure import Figure

    known = [row for row in findings.rows if row.verdict == STABLE and row.relative_error and row.seconds]
    if not known:
        return None
    panels = [p for p in findings.plan.precisions if any(row.precision == p for row in findings.rows)]
    figure = Figure(figsize=(5.2 * len(panels) + 1.9, 4.9), layout="constrained")
    axes = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    motion = findings.reference.motion
    errors = [row.relative_error for row in known if row.relative_error]
    low, high = min(errors) / 2.0, max(errors) * 2.0
    margin = high * (high / low) ** 0.06  # where unstable rows are shown
    for axis, precision in zip(axes, panels):
        _frame(axis, NAMES[precision], findings.compared.name)
        axis.set_xlim(low, margin * (high / low) ** 0.04)
        for method in findings.plan.methods:
            _curve(axis, [r for r in findings.rows if (r.method, r.precision) == (method, precision)], margin)
        _front(axis, findings, precision)
        if any(row.verdict == UNSTABLE for row in findings.rows):
            axis.axvline(high, color=INK, lw=0.5, ls=":")
        if findings.reference.parts and findings.reference.known:
            near = CLEAR_OF_REFERENCE * findings.reference.known / motion
            axis.axvspan(0.1 * low, near, color=INK, alpha=0.08, lw=0, label=UNTOLD)
        if precision == "f32" and findings.floor is not None:
            axis.axvline(findings.floor, color=INK, lw=0.9, ls="--", label=FLOOR)
    figure.supxlabel(READ, color=INK, fontsize=9)  # a heading would meet the legend
    axes[0].set_ylabel(f"{known[0].clock} per simulated second [s]", color=INK)
    marks = {label: mark for axis in axes for mark, label in zip(*axis.get_legend_handles_labels())}
    order = {name: k for k, name in enumerate(METHODS)}
    labels = sorted(marks, key=lambda label: order.get(label, len(order)))
    legend = figure.legend(
        [marks[label] for label in labels], labels, loc="outside right upper", frameon=False, fontsize=9
    )
    for text in legend.get_texts():
        text.set_color(INK)
    return figure


def _frame(axis: Any, title: str, name: str) -> None:
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_title(title, color=INK, fontsize=11)
    axis.set_xlabel(f"relative error of {literal(name)}", color=INK)
    dress(axis)


def _curve(axis: Any, rows: list[Row], margin: float) -> None:
    """The stable rows of one method joined, the unstable ones as crosses at the right margin."""
    if not rows:
        return
    index = METHODS.index(rows[0].method)
    colour, marker = COLOURS[index], MARKERS[index]
    good = [row for row in rows if row.verdict == STABLE and row.relative_error and row.seconds]
    if good:
        points = [(row.relative_error, row.seconds) for row in good]
        axis.plot(*zip(*points), color=colour, marker=marker, ms=5, lw=1.6, label=rows[0].method)
    bad = [row.seconds for row in rows if row.verdict == UNSTABLE and row.seconds]
    if bad:
        axis.plot([margin] * len(bad), bad, color=colour, marker="$\\times$", ms=9, lw=0, label=BROKEN)


def _front(axis: Any, findings: Findings, precision: str) -> None:
    """The front of both precisions as a band in each panel, circles where its rows belong."""
    front = findings.front
    if front:
        points = [(row.relative_error, row.seconds) for row in front]
        own = [(row.relative_error, row.seconds) for row in front if row.precision == precision] or [(None, None)]
        axis.plot(*zip(*own), color=INK, lw=0, marker="o", ms=11, mfc="none", mew=0.9, label=FRONT, zorder=0)
        axis.plot(*zip(*points), color=INK, lw=7, alpha=0.13, solid_capstyle="round", label=BAND, zorder=0)
