"""The course: every program of it runs and prints what the page says; pictures, laws and tests that it names exist."""

import ast
import re
import warnings
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.once

ROOT = Path(__file__).parent.parent
COURSE = ROOT / "docs" / "course"
CHAPTERS = {page.stem: page.read_text(encoding="utf-8") for page in sorted(COURSE.glob("[0-9]*.md"))}
NUMBER = r"-?\d+(?:\.\d*)?(?:e[-+]?\d+)?"
PARTS = ("The law", "Type this", "Change it", "What goes wrong", "Exercises", "Further")


def programs(text):
    """Programs of a page, which run one after another."""
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


def promised(program):
    """Numbers that the comments behind `print` promise, up to a colon or semicolon."""
    comments = re.findall(r"^ *print\(.*\)  # ([^:;\n]*)", program, re.MULTILINE)
    return [[float(n) for n in re.findall(NUMBER, comment)] for comment in comments]


@pytest.mark.parametrize("name", CHAPTERS)
def test_programs_print_what_the_page_says(name, capsys):
    names: dict = {}
    for program in programs(CHAPTERS[name]):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what goes wrong is warned of
            exec(compile(program, f"{name}.md", "exec"), names)
        said = [float(n) for n in re.findall(rf"(?<![\w.]){NUMBER}", capsys.readouterr().out)]
        wanted = [n for numbers in promised(program) for n in numbers]
        assert wanted
        assert len(said) == len(wanted), program
        np.testing.assert_allclose(said, wanted, rtol=1e-3, atol=2e-6, err_msg=program)


@pytest.mark.parametrize("name", CHAPTERS)
def test_a_chapter_is_whole(name):
    text = CHAPTERS[name]
    titles = re.findall(r"^## (.*)$", text, re.MULTILINE)
    assert tuple(titles) == PARTS
    assert re.search(r"^\*\*[^*]+\?\*\*$", text, re.MULTILINE), "a chapter begins with a question"
    assert "$$" in text
    assert text.count("<details>") == text.count("</details>") >= 4
    assert f"({name}.webp)" in text
    held = re.findall(r"`tests/([\w/]+\.py)::(test_\w+)`", text)
    assert held
    for path, test in held:
        tree = ast.parse((ROOT / "tests" / path).read_text(encoding="utf-8"))
        assert test in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, (path, test)
    for demo in re.findall(r"`(?:taichi-sim view )?(thread/\w+)`", text):
        assert (ROOT / "demos" / f"{demo}.py").exists(), demo


def test_the_command_writes_pages_that_load_nothing_from_elsewhere(tmp_path, monkeypatch, capsys):
    from taichi_sim.cli.main import main

    shown = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("webbrowser.open", shown.append)
    folder = tmp_path / "course"
    for _ in range(2):  # its own folder is written anew
        with pytest.raises(SystemExit) as ended:
            main(["course", "-o", str(folder)])
        assert ended.value.code == 0
    assert f"written      {folder / 'index.html'}" in capsys.readouterr().out
    assert shown == [(folder / "index.html").as_uri()] * 2
    assert {page.stem for page in folder.glob("*.html")} == {"index", *CHAPTERS}
    for page in folder.glob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert "$$" not in text
        assert "{toctree}" not in text
        for place in re.findall(r'(?:src|href)="([^"#]+)', text):
            assert (folder / place).is_file(), (page.name, place)
    assert (folder / "05_springs.html").read_text(encoding="utf-8").count('class="formula"') == 2
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "file").touch()
    with pytest.raises(SystemExit) as ended:
        main(["course", "-o", str(tmp_path / "mine")])
    assert ended.value.code == 2
