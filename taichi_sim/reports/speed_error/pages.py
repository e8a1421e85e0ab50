"""The pages: report.md and report.html, the same content; the plot beside the first and inside the second."""

import html
import platform
from collections.abc import Iterator, Sequence
from pathlib import Path

from taichi_sim import __version__
from taichi_sim.common.atomic_file import replacing
from taichi_sim.reports.bench.main import processor
from taichi_sim.reports.speed_error import plot
from taichi_sim.reports.speed_error.findings import Findings, agrees, choice, in_unit
from taichi_sim.reports.speed_error.rows import Row
from taichi_sim.reports.speed_error.statistics import QUANTITIES

__all__ = ["write_pages"]

Table = tuple[list[str], list[list[str]]]
STYLE = """
:root { color-scheme: light dark; --ink: #1d2126; --paper: #ffffff; --line: #d9dde2; --soft: #f4f6f8; --bad: #b3261e }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e7eb; --paper: #14171a; --line: #363c43; --soft: #1d2125; --bad: #ff8a80 } }
body { font: 16px/1.55 system-ui, sans-serif; color: var(--ink); background: var(--paper); margin: 0 auto; padding: 2rem 1.5rem;
  max-width: 84rem }
h1 { font-size: 1.7rem; margin: 0 0 .3rem } h2 { font-size: 1.15rem; margin: 2.2rem 0 .6rem }
p, ul { max-width: 52rem } details { margin: 1rem 0 } summary { cursor: pointer } .small { font-size: .85rem; opacity: .75 }
svg { width: 100%; height: auto } svg text { font-family: inherit }
.wide { overflow-x: auto; border: 1px solid var(--line); border-radius: 8px }
table { border-collapse: collapse; font-size: .82rem; font-variant-numeric: tabular-nums; min-width: 100% }
th, td { padding: .3rem .7rem; text-align: right; white-space: nowrap; border-bottom: 1px solid var(--line) }
th { background: var(--soft); font-weight: 600 } tr:last-child td { border-bottom: 0 }
th:nth-child(-n+3), td:nth-child(-n+3) { text-align: left }
td.words { text-align: left; white-space: normal; min-width: 22rem } tr.front td { font-weight: 650 }
tr.bad td { color: var(--bad) }
"""
NOTES = """h / safe: the step as a part of the one that is safe in every shape. Passes: over the forces, per simulated second.
Errors: of positions, rms over all balls that are not pinned, or of the quantity, at the worst of eight moments.
Drift: of the total energy from the reference's, as a part of the largest kinetic and spring energy. Times: medians
of runs repeated for a quarter of a second or more, or of the eighths of a long one, without compiling; noise: to
what they are known. Bold: on the Pareto front."""


def write_pages(findings: Findings, folder: Path) -> None:
    """Both pages and both pictures, each complete when it appears."""
    figure = plot.draw(findings)
    picture = ""
    if figure is not None:
        picture = plot.svg(figure)
        _write(folder / "error.svg", picture.replace("currentColor", "#333333").encode())
        _write(folder / "error.png", plot.png(figure))
    _write(folder / "report.html", _html(findings, picture).encode())
    _write(folder / "report.md", _markdown(findings, figure is not None).encode())


def _write(path: Path, data: bytes) -> None:
    with replacing(path) as file:
        file.write(data)


def _title(findings: Findings) -> str:
    return f"Speed against error: {findings.plan.name}"


def _made(findings: Findings) -> str:
    device = findings.rows[0].device if findings.rows else "cpu"
    return f"taichi_sim {__version__}, Python {platform.python_version()}, {processor()}, {device}"


def _advice(findings: Findings) -> Table:
    rows = [[f"{tolerance:g}", choice(rows)] for tolerance, rows in findings.fastest()]
    return ["error", "fastest"], rows


def _number(value: float | None, digits: int = 3) -> str:
    return "" if value is None else f"{value:.{digits}g}"


def _cells(row: Row) -> list[str]:
    return [
        row.method,
        row.precision,
        row.verdict,
        _number(row.step),
        _number(row.part_of_safe_step, 2),
        _number(row.passes),
        _number(row.seconds),
        _number(row.noise, 1),
        _number(row.ns_per_ball_step),
        _number(row.rms_error, 2),
        _number(row.max_error, 2),
        _number(row.relative_error, 2),
        "" if row.order is None else f"{row.order:.2f}",
        _number(row.energy_drift, 2),
    ]


def _head(findings: Findings) -> list[str]:
    errors = [in_unit(word, findings.compared.unit) for word in ("rms error", "max error")]
    before = [
        "method",
        "precision",
        "verdict",
        "h [s]",
        "h / safe",
        "passes/s",
        "wall s per s",
        "noise",
        "ns per ball-step",
    ]
    return [*before, *errors, "relative", "order", "drift"]


def _reasons(findings: Findings) -> Iterator[str]:
    """Why rows are unstable or left out, and what was warned of."""
    for row in findings.rows:
        if row.reason:
            yield f"{row.method}, {row.precision}, {row.step:.3g} s: {row.verdict}: {row.reason}"


def _statistics(findings: Findings) -> Table:
    """Mean and half width; a star where the mean differs from that of the last, the scene's own at half its step."""
    rows = []
    judge = {interval.precision: interval for interval in findings.intervals}
    for interval in findings.intervals:
        cells = []
        for name in QUANTITIES:
            star = "" if agrees(interval, judge[interval.precision], name) else " *"
            cells.append(f"{interval.mean[name]:.4g} ± {interval.half[name]:.2g}{star}")
        if interval.failed:
            cells = [f"none: {interval.failed}", *[""] * (len(QUANTITIES) - 1)]
        rows.append([interval.method, interval.precision, _number(interval.step), *cells])
    return ["method", "precision", "h [s]", *QUANTITIES.values()], rows


STATISTICS = """Eight starts, a millionth of the size apart, averaged over the second half of the time: mean and 95 % interval.
A star: differs from the last row of its precision, which is the scene's own method at half its step, by more than
both intervals."""


# Markdown ----------------------------------------------------------------------------------------------------------


def _markdown(findings: Findings, pictured: bool) -> str:
    parts = [f"# {_title(findings)}", _made(findings), "\n".join(f"- {line}" for line in findings.about())]
    if pictured:
        parts.append("![Error against wall time](error.png)")
    if any(row.rms_error is not None for row in findings.rows):
        parts += ["## Fastest for a relative error", "\n".join(_rows(_advice(findings)))]
    if findings.rows:
        front = findings.front
        cells = [[f"**{c}**" if row in front and c else c for c in _cells(row)] for row in findings.rows]
        parts += ["## All runs", "\n".join(_rows((_head(findings), cells))), " ".join(NOTES.split())]
        parts.append("\n".join(f"- {line}" for line in _reasons(findings)))
    if findings.intervals:
        parts += ["## Statistics", "\n".join(_rows(_statistics(findings))), " ".join(STATISTICS.split())]
    return "\n\n".join(parts) + "\n"


def _rows(table: Table) -> Iterator[str]:
    head, rows = table
    yield f"| {' | '.join(head)} |"
    yield "|" + "---|" * len(head)
    for row in rows:
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"


# HTML --------------------------------------------------------------------------------------------------------------


def _html(findings: Findings, picture: str) -> str:
    title = html.escape(_title(findings))
    parts = [f"<h1>{title}</h1><p class=small>{html.escape(_made(findings))}</p>"]
    parts.append("<ul>" + "".join(f"<li>{html.escape(line)}</li>" for line in findings.about()) + "</ul>")
    if picture:
        parts.append(picture)
    if any(row.rms_error is not None for row in findings.rows):
        parts.append("<h2>Fastest for a relative error</h2>" + _html_table(_advice(findings)))
    if findings.rows:
        front = findings.front
        kinds = ["front" if row in front else "bad" if row.verdict == "unstable" else "" for row in findings.rows]
        cells = [_cells(row) for row in findings.rows]
        parts.append(
            f"<h2>All runs</h2>{_html_table((_head(findings), cells), kinds)}<p class=small>{html.escape(NOTES)}</p>"
        )
        reasons = "".join(f"<li>{html.escape(line)}</li>" for line in _reasons(findings))
        if reasons:
            parts.append(f"<details open><summary>Why</summary><ul class=small>{reasons}</ul></details>")
    if findings.intervals:
        parts.append(
            f"<h2>Statistics</h2>{_html_table(_statistics(findings))}<p class=small>{html.escape(STATISTICS)}</p>"
        )
    return (
        f'<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{STYLE}</style><body>{''.join(parts)}</body></html>\n"
    )


def _html_table(table: Table, kinds: Sequence[str] = ()) -> str:
    head, rows = table
    lines = ["<div class=wide><table><tr>", *(f"<th>{html.escape(name)}</th>" for name in head), "</tr>"]
    for k, row in enumerate(rows):
        cells = (f"<td{' class=words' if len(cell) > 40 else ''}>{html.escape(cell)}</td>" for cell in row)
        lines.append(f'<tr class="{kinds[k] if kinds else ""}">{"".join(cells)}</tr>')
    return "".join([*lines, "</table></div>"])
