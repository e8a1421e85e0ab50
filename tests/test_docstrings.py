"""Docstrings are read alone, by help(), editors and the docs: the first line is true without the line above it."""

import ast
from pathlib import Path

import pytest

pytestmark = pytest.mark.once

ROOT = Path(__file__).resolve().parent.parent
UNCLEAR = ("What", "Which", "Whether", "Where", "How", "As", "The same", "The reverse")


def docstrings():
    """Place, and words on one line, of every docstring of the package, the kernels and the demos."""
    for folder in ("taichi_sim", "kernels", "demos"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
                    if doc := ast.get_docstring(node):
                        place = f"{path.relative_to(ROOT).as_posix()}:{getattr(node, 'lineno', 1)}"
                        yield place, " ".join(doc.split())


def is_unclear(doc):
    """True if a docstring begins with a word that points at the line above it."""
    return any(doc == begin or doc.startswith((f"{begin} ", f"{begin}.", f"{begin},")) for begin in UNCLEAR)


def test_docstrings_begin_with_what_they_describe():
    found = [f"{place}: {doc[:60]}" for place, doc in docstrings() if is_unclear(doc)]
    assert not found, f"{len(found)} docstrings begin with one of {', '.join(UNCLEAR)}:\n" + "\n".join(found)
