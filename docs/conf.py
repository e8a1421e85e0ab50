"""Settings of the site: `make docs` builds it with Sphinx from these pages, strictly, into out/docs."""

import dataclasses
import inspect
import re

from docutils.nodes import SkipNode, literal

import taichi_sim
from taichi_sim.common.docstrings import described
from taichi_sim.common.version import __version__
from taichi_sim.reports.course import formula

for name in taichi_sim.__all__:  # autodoc would import them as for a type checker, which NumPy's types do not bear
    getattr(taichi_sim, name)

project, author, release = "taichi_sim", "taichi_sim developers", __version__
copyright = author
extensions = ["myst_nb", "sphinx.ext.autodoc"]  # which brings myst_parser
nb_execution_mode = "off"  # notebooks show the results that are stored in them
exclude_patterns = ["course/__init__.py"]
html_theme = "furo"
html_title = f"taichi_sim {__version__}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_copy_source = False
html_show_sphinx = False
html_show_search_summary = False  # it is fetched, which browsers refuse for files
html_math_renderer = "paths"
smartquotes_action = "qe"  # no dashes: `--out` keeps its hyphens outside of code, too
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]
nitpicky = True
nitpick_ignore_regex = [
    ("py:.*", ".*")
]  # types of NumPy and the like have no pages here; links between pages are checked by MyST
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # units stand in the text
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 80
highlight_language = "none"
LONGEST_WORD = 30  # letters of inline code that stay on one line
pygments_style, pygments_dark_style = "friendly", "monokai"


def as_markup(text: str) -> str:
    """reStructuredText of a block of a docstring: `x` is code, indented lines are a program, and nothing else is marked."""
    if text.startswith((" ", "\t")):
        return "::\n\n" + "\n".join(f"    {line}" for line in text.splitlines())
    parts = enumerate(re.split(r"`([^`]+)`", text))
    return "".join(f"``{part}``" if k % 2 else re.sub(r"([\\*_|])", r"\\\1", part) for k, part in parts)


def attributes(thing) -> list[str]:
    """Fields of a dataclass, each with the comment behind it."""
    if not (inspect.isclass(thing) and dataclasses.is_dataclass(thing)):
        return []
    source = inspect.getsource(thing)
    said = {
        one.name: re.search(rf"^    {one.name}: .*?  # (.*)$", source, re.MULTILINE)
        for one in dataclasses.fields(thing)
    }
    return [f":ivar {name}: {as_markup(found[1])}" for name, found in said.items() if found]


def docstring(app, kind, name, thing, options, lines) -> None:
    """Write a docstring as reStructuredText, with its arguments as a list."""
    own = thing if inspect.isroutine(thing) else getattr(thing, "__init__", None)
    blocks = []
    for block in re.split(r"\n\s*\n", inspect.cleandoc("\n".join(lines))):
        found = described(block, inspect.signature(own).parameters) if own and block.startswith("Args") else {}
        listed = [f":param {one}: {' '.join(as_markup(text).split())}" for one, text in found.items()]
        if block.startswith("Args") and not found:  # of a module
            listed = [f"- {' '.join(as_markup(entry).split())}" for entry in re.split(r"\n {4}(?! )", block)[1:]]
        blocks.append("\n".join(listed) or as_markup(block))
    blocks.append("\n".join(attributes(thing)))
    lines[:] = "\n\n".join(blocks).splitlines()


def visit_inline(self, node) -> None:
    self.body.append(formula(node.astext()))
    raise SkipNode


def visit_block(self, node) -> None:
    self.body.append(f'<div class="formula">{formula(node.astext())}</div>')
    raise SkipNode


def mark_long_code(app, page) -> None:
    """Give inline code with a word that is too long for a line of a phone the class `long`: site.css lets it break."""
    for code in page.findall(literal):
        if max(map(len, code.astext().split()), default=0) > LONGEST_WORD:
            code["classes"].append("long")


def setup(app) -> None:
    app.connect("doctree-read", mark_long_code)
    app.connect("autodoc-process-docstring", docstring)
    app.add_html_math_renderer("paths", (visit_inline, None), (visit_block, None))
