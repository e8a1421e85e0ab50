"""The pages: report.md and report.html, the same content; the plot beside the first and inside the second."""

from collections.abc import Callable, Iterator

from taichi_sim.common.quantities import measured
from taichi_sim.reports.speed_error import plot
from taichi_sim.reports.speed_error.findings import Findings, choice, in_unit
from taichi_sim.reports.speed_error.report_folder import ReportFolder
from taichi_sim.reports.speed_error.rows import MUCH_LONGER, UNSTABLE, Row
from taichi_sim.reports.speed_error.statistics import QUANTITIES
from taichi_sim.studies.figure import png, svg
from taichi_sim.studies.page_parts import Part, Table, as_html, as_markdown, made_with

NOTES = f"""h / safe: the step as a part of the one that is safe in every shape. Passes: over the forces, per simulated second.
Errors: of positions, rms over all balls that are not pinned, or of the quantity, at the worst of eight moments.
Drift: of the total energy from the reference's, as a part of the largest kinetic and spring energy. Times: of the
processor, all threads together (on a GPU: wall time), the least of repeated runs, without compiling; noise: by how much
a usual run takes longer. Bold: every stable run that is more accurate takes {MUCH_LONGER}.
Fastest: of the runs with steps that are safe in the long run, as `tune` takes them."""


def write_pages(findings: Findings, folder: ReportFolder) -> None:
    """Write both pages and both pictures, each complete when it appears."""
    figure = plot.draw(findings)
    files: dict[str, bytes] = {}
    picture = ""
    if figure is not None:
        picture = svg(figure)
        files = {"error.svg": picture.replace("currentColor", "#333333").encode(), "error.png": png(figure)}
    content = list(_content(findings, picture))
    for name, data in {**files, "report.html": as_html(content), "report.md": as_markdown(content)}.items():
        folder.write(name, data)


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


def _content(findings: Findings, picture: str) -> Iterator[Part]:
    """The parts of a page: what kind each is, and what it holds."""
    yield "title", f"Speed against error: {findings.plan.name}"
    yield "small", f"{made_with()}, {findings.rows[0].device if findings.rows else 'cpu'}"
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
