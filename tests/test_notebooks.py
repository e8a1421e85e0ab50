"""The notebooks of the docs run from top to bottom, and come to the results that are stored in them."""

import re
from pathlib import Path

import numpy as np
import pytest

pytestmark = [pytest.mark.once, pytest.mark.slow]

FOLDER = Path(__file__).parent.parent / "docs" / "notebooks"
BOOKS = sorted(FOLDER.glob("*.ipynb"))
LISTED = (FOLDER / "index.md").read_text(encoding="utf-8")


def numbers(book):
    """Numbers that the cells of a notebook print, in order."""
    outputs = [one for cell in book.cells if cell.cell_type == "code" for one in cell.outputs]
    text = " ".join(one.text for one in outputs if one.output_type == "stream" and one.name == "stdout")
    return [float(one) for one in re.findall(r"(?<![\w.])-?\d+\.\d+(?:e[-+]\d+)?", text)]


@pytest.mark.parametrize(
    "path",
    [one if one.stem == "first_steps" else pytest.param(one, marks=pytest.mark.long) for one in BOOKS],
    ids=lambda path: path.stem,
)
def test_a_notebook_comes_to_the_results_that_are_stored_in_it(path, tmp_path):
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    book = nbformat.read(path, as_version=4)
    nbformat.validate(book)
    assert f"({path.name})" in LISTED
    stored = numbers(book)
    assert stored
    assert "[Taichi]" not in path.read_text(encoding="utf-8")
    nbclient.NotebookClient(book, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    found = numbers(book)
    assert len(found) == len(stored)
    np.testing.assert_allclose(found, stored, rtol=0.05)


def test_there_are_three():
    assert len(BOOKS) == 3
