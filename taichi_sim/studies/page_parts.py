"""Page of a study: parts of a few kinds, written as HTML in one file that loads nothing, or as Markdown."""

import html
import platform
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

from taichi_sim.common.machine import processor
from taichi_sim.common.version import __version__

__all__ = ["Part", "Table", "as_html", "as_markdown", "made_with"]

Part = tuple[str, Any]  # the kind of a part of a page, one of the keys of HTML, and what it holds
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


def as_html(content: Iterable[Part]) -> bytes:
    """A whole page of these parts."""
    return "".join(HTML[kind](value) for kind, value in content).encode() + b"</body></html>\n"


def as_markdown(content: Iterable[Part]) -> bytes:
    """Page of these parts as Markdown, for a reader of text; the picture is the file error.png."""
    return "\n\n".join(MARKDOWN[kind](value) for kind, value in content).encode() + b"\n"


def made_with() -> str:
    """Versions and processor that a study was made with."""
    return f"taichi_sim {__version__}, Python {platform.python_version()}, {processor()}"


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


def _html_table(table: Table, of: str = "") -> str:
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
    "table": _html_table,
    "numbers": partial(_html_table, of="numbers"),  # a table of which all columns but the first are numbers
    "reasons": lambda lines: f"<details open><summary>Why</summary><ul class=small>{_html_list(lines)}</ul></details>",
}
