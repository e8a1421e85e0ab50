"""Each law in docs/physics.md names the tests that hold it, and these exist."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

pytestmark = pytest.mark.once

ROOT = Path(__file__).resolve().parent.parent
PARTS = re.split(r"^##+ (.*)$", (ROOT / "docs" / "physics.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
SECTIONS = dict(zip(PARTS[1::2], PARTS[2::2]))
NO_LAW = {"Elastic bodies", "What was validated"}  # a heading of others, and measurements


@cache
def names_in(path):
    tree = ast.parse((ROOT / "tests" / path).read_text(encoding="utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_each_section_but_these_is_a_law():
    assert set(SECTIONS) >= NO_LAW
    assert len(SECTIONS) > 40


@pytest.mark.parametrize("name", sorted(set(SECTIONS) - NO_LAW))
def test_a_law_is_held_by_tests_that_exist(name):
    line = next((line for line in SECTIONS[name].splitlines() if line.startswith("*Held by* ")), "")
    held = re.findall(r"`tests/([\w/]+\.py)::(test_\w+)`", line)
    assert held
    for path, test in held:
        assert test in names_in(path), f"{path} has no {test}"
