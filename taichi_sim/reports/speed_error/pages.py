"""The pages: report.md and report.html, the same content; the plot beside the first and inside the second."""

import html
import platform
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from taichi_sim.common.quantities import measured
from taichi_sim.common.version import __version__
from taichi_sim.reports.machine import processor
from taichi_sim.reports.speed_error import plot
from taichi_sim.reports.speed_error.findings import Findings, choice, in_unit
from taichi_sim.reports.speed_error.folder import Folder
from taichi_sim.reports.speed_error.rows import UNSTABLE, Row
from taichi_sim.reports.speed_error.statistics import QUANTITIES

Table = tuple[list[str], list[list[str]], list[str]]  # heads, rows of cells, and what each row is: front, bad or ""
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
table.numbers :is(th, td):not(:first-child) { text-align: right }
td.words { text-align: left; white-space: normal; min-width: 22rem } tr.front td { font-weight: 650 }
tr.bad td { color: var(--bad) }
"""
NOTES = """h / safe: the step as a part of the one that is safe in every shape. Passes: over the forces, per simulated second.
Errors: of positions, rms over all balls that are not pinned, or of the quantity, at the worst of eight moments.
Drift: of the total energy from the reference's, as a part of the largest kinetic and spring energy. Times: of the
processor, all threads together (on a GPU: wall time), the least of repeated runs, without compiling; noise: by how much
a usual run takes longer. Bold: no other run is both faster and more accurate."""


def write_pages(findings: Findings, folder: Folder) -> None:
    """Both pages and both pictures, each complete when it appears."""
    figure = plot.draw(findings)
    files: dict[str, bytes] = {}
    picture = ""
    if figure is not None:
        picture = plot.svg(figure)
        files = {"error.svg": picture.replace("currentColor", "#333333").encode(), "error.png": plot.png(figure)}
    content = list(_content(findings, picture))
    files["report.html"] = "".join(HTML[kind](value) for kind, value in content).encode() + b"</body></html>\n"
    files["report.md"] = "\n\n".join(MARKDOWN[kind](value) for kind, value in content).encode() + b"\n"
    for name, data in files.items():
        folder.write(name, data)


def _made(findings: Findings) -> str:
    device = findings.rows[0].device if findings.rows else "cpu"
    return f"taichi_sim {__version__}, Python {platform.python_version()}, {processor()}, {device}"


def _advice(findings: Findings) -> Table:
    rows = [[f"{tolerance:g}", choice(rows)] for tolerance, rows in findings.fastest()]
    return ["error below", "fastest"], rows, [""] * len(rows)


def _number(value: float | None, digits: int = 3) -> str:
    return "" if value is None else f"{value:.{digits}g}"


COLUMNS: dict[str, Callable[[Row], str]] = {
    "method": lambda row: row.method,
    "precision": lambda row: row.precision,
    "verdict": lambda row: row.verdict,
    "h [s]": lambda row: _number(row.step),
    "h / safe": lambda row: _number(row.part_of_safe_step, 2),
    "passes/s": lambda row: _number(row.passes),
    "s per s": lambda row: _number(row.seconds),
    "noise": lambda row: _number(row.noise, 1),
    "ns per ball-step": lambda row: _number(row.ns_per_ball_step),
    "rms error": lambda row: _number(row.rms_error, 2),
    "max error": lambda row: _number(row.max_error, 2),
    "relative": lambda row: _number(row.relative_error, 2),
    "order": lambda row: "" if row.order is None else f"{row.order:.2f}",
    "drift": lambda row: _number(row.energy_drift, 2),
}


def _runs(findings: Findings) -> Table:
    unit, front = findings.compared.unit, findings.front
    head = [in_unit(name, unit) if name.endswith(" error") else name for name in COLUMNS]
    kinds = ["front" if row in front else "bad" if row.verdict == UNSTABLE else "" for row in findings.rows]
    return head, [[cell(row) for cell in COLUMNS.values()] for row in findings.rows], kinds


def _reasons(findings: Findings) -> Iterator[str]:
    """Why rows are unstable or left out, and what was warned of."""
    for row in findings.rows:
        if row.reason:
            yield f"{row.method}, {row.precision}, {row.step:.3g} s: {row.verdict}: {row.reason}"


def _statistics(findings: Findings) -> Table:
    """Mean and half width; a star where the mean differs from that of the last, the scene's own at half its step."""
    rows = []
    for interval in findings.intervals:
        cells = [f"none: {interval.failed}", *[""] * (len(QUANTITIES) - 1)]
        if not interval.failed:
            stars = {name: " *" if name in interval.differs else "" for name in QUANTITIES}
            cells = [f"{measured(interval.mean[name], interval.half[name])}{star}" for name, star in stars.items()]
        rows.append([interval.method, interval.precision, _number(interval.step), *cells])
    return ["method", "precision", "h [s]", *QUANTITIES.values()], rows, [""] * len(rows)


STATISTICS = """Eight starts, a millionth of the size apart, averaged over the second half of the time: mean and 95 % interval
(Student). A star: differs from the last row of its precision, which is the scene's own method at half its step, by Welch's test;
at most 5 % of the stars are chance (Benjamini and Hochberg)."""


def _content(findings: Findings, picture: str) -> Iterator[tuple[str, Any]]:
    """The parts of a page: what kind each is, and what it holds."""
    yield "title", f"Speed against error: {findings.plan.name}"
    yield "small", _made(findings)
    yield "list", list(findings.about())
    if picture:
        yield "picture", picture
    if any(row.rms_error is not None for row in findings.rows):
        yield "heading", "Fastest with a relative error below a limit"
        yield "table", _advice(findings)
    if findings.rows:
        yield "heading", "All runs"
        yield "table", _runs(findings)
        yield "small", NOTES
        if reasons := list(_reasons(findings)):
            yield "reasons", reasons
    if findings.intervals:
        yield "heading", "Statistics"
        yield "table", _statistics(findings)
        yield "small", STATISTICS


def _markdown_list(lines: Sequence[str]) -> str:
    return "\n".join(f"- {line}" for line in lines)


def _markdown_table(table: Table) -> str:
    head, rows, kinds = table
    marks = ["**" if kind == "front" else "" for kind in kinds]
    cells = [[f"{mark}{c}{mark}".replace("|", "\\|") if c else "" for c in row] for mark, row in zip(marks, rows)]
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *cells))


MARKDOWN: dict[str, Callable[[Any], str]] = {
    "title": lambda text: f"# {text}",
    "small": lambda text: " ".join(text.split()),
    "list": _markdown_list,
    "picture": lambda _: "![Error against wall time](error.png)",
    "heading": lambda text: f"## {text}",
    "table": _markdown_table,
    "reasons": _markdown_list,
}


def _html_list(lines: Sequence[str]) -> str:
    return "".join(f"<li>{html.escape(line)}</li>" for line in lines)


def html_table(table: Table, of: str = "") -> str:
    """of: the class of the table in HTML."""
    head, rows, kinds = table
    lines = [
        f"<div class=wide><table{of and f' class={of}'}><tr>",
        *(f"<th>{html.escape(name)}</th>" for name in head),
        "</tr>",
    ]
    for kind, row in zip(kinds, rows):
        cells = (f"<td{' class=words' if len(cell) > 40 else ''}>{html.escape(cell)}</td>" for cell in row)
        lines.append(f'<tr class="{kind}">{"".join(cells)}</tr>')
    return "".join([*lines, "</table></div>"])


HTML: dict[str, Callable[[Any], str]] = {
    "title": lambda text: (
        '<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(text)}</title><style>{STYLE}</style><body><h1>{html.escape(text)}</h1>"
    ),
    "small": lambda text: f"<p class=small>{html.escape(text)}</p>",
    "list": lambda lines: f"<ul>{_html_list(lines)}</ul>",
    "picture": lambda svg: svg,
    "heading": lambda text: f"<h2>{html.escape(text)}</h2>",
    "table": html_table,
    "reasons": lambda lines: f"<details open><summary>Why</summary><ul class=small>{_html_list(lines)}</ul></details>",
}
