"""The course: every program of it runs and prints what the page says; pictures, laws and tests that it names exist."""

import ast
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from commands import status

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


@pytest.mark.slow_where(name=[name for name in CHAPTERS if name != "05_springs"])
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
    shown = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("webbrowser.open", shown.append)
    folder = tmp_path / "course"
    for _ in range(2):  # its own folder is written anew
        assert status("course", "-o", folder) == 0
    assert f"written      {folder / 'index.html'}" in capsys.readouterr().out
    assert shown == [(folder / "index.html").as_uri()] * 2
    assert {page.stem for page in folder.glob("*.html")} == {"index", *CHAPTERS}
    for page in folder.glob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert "$$" not in text
        assert "{toctree}" not in text
        for place in re.findall(r'(?:src|href)="([^"#]+)', text):
            assert (folder / place).is_file(), (page.name, place)
    springs = (folder / "05_springs.html").read_text(encoding="utf-8")
    assert springs.count('class="formula"') == 2
    assert "Springs (docs/physics.md)" in springs
    for name, title in (("04_restitution", "4. Restitution"), ("index", "Course"), ("06_damping", "6. Damping")):
        assert re.search(f'<a href="{name}.html"[^>]*>{title}', springs)
    pages = {page.stem: page.read_text(encoding="utf-8") for page in folder.glob("*.html")}
    assert 'rel="prev"' not in pages["01_motion"]
    assert 'rel="next"' not in pages["13_error"]
    assert 'rel="' not in pages["index"]
    assert not list(folder.glob(".*"))


@pytest.mark.parametrize("file", ["file", "index.html", "course.txt"])
def test_the_course_leaves_the_folders_of_others_alone(tmp_path, file):
    from taichi_sim.reports.course import write

    (tmp_path / file).write_text("mine")
    with pytest.raises(FileExistsError, match="did not make"):
        write(str(tmp_path))
    assert [(kept.name, kept.read_text()) for kept in tmp_path.iterdir()] == [(file, "mine")]
    with pytest.raises(FileNotFoundError, match=r"there is no folder .*make it first"):
        write(str(tmp_path / "none" / "course"))


def test_the_course_goes_on_in_a_folder_that_a_killed_run_left(tmp_path, monkeypatch):
    from taichi_sim.reports import course

    with monkeypatch.context() as killed:
        pages = iter(["page"])
        killed.setattr(course, "_page", lambda *_: next(pages))  # ends before the second
        with pytest.raises(StopIteration):
            course.write(str(tmp_path))
    assert not (tmp_path / "index.html").exists()
    monkeypatch.setattr(course, "_page", lambda *_: "page")
    assert course.write(str(tmp_path)).read_text() == "page"


def end(places):
    """The last of a list of places, as plain numbers."""
    return np.asarray(places[-1], dtype=float)


CHANGES = [  # chapter, its program, what is changed, what then holds
    ("01_motion", 1, [("dt=0.1", "dt=0.5"), ("fps=10", "fps=2")], lambda n: end(n["positions"]), [2, 4, 6]),
    (
        "02_gravity",
        1,
        [("dt=0.2", "dt=0.1"), ("fps=5", "fps=10")],
        lambda n: [h[-1] for h in n["heights"].values()],
        [1, -1, 0],
    ),
    (
        "02_gravity",
        1,
        [("(3, 10)", "(3, 20)"), ("duration=2", "duration=4")],
        lambda n: [h[-1] for h in n["heights"].values()],
        [4, -4, 0],
    ),
    ("03_walls", 0, [("dt=0.01", "dt=0.05"), ("fps=50", "fps=20")], lambda n: n["heights"][-1][0], 1.25),
    (
        "03_walls",
        0,
        [
            ("radius=0.1,", "radius=0.1, velocity=[[0, 0], [2, 0]], body=1,"),
            ("with ts", 'scene.add_wall(normal=(-1, 0), offset=-3.0, material="elastic")\nwith ts'),
        ],
        lambda n: [
            2.85 < max(f.position[1, 0] for f in n["frames"]) < 2.9001,
            *np.max(n["heights"][300:], axis=0),
            n["heights"][-1][0],
        ],
        [True, 1.25, 0.625, 1.25],
    ),
    (
        "04_restitution",
        0,
        [("offset=0.0", 'offset=0.0, material="rubber 2"')],
        lambda n: np.ptp(np.array(n["heights"])[:300], axis=1).max(),
        0,
    ),
    ("04_restitution", 0, [("1.35]", "5.1]")], lambda n: n["rest"][0], 2.98),  # the last frame before 3 s
    ("05_springs", 0, [("radius=0.1", "radius=0.1, mass=4")], lambda n: n["lengths"]["verlet"][63], 1.5),  # 1.26 s
    ("05_springs", 0, [("radius=0.1", "radius=0.1, pinned=[0]")], lambda n: n["lengths"]["verlet"][44], 1.5),  # 0.89 s
    ("06_damping", 0, [("radius=0.1", "radius=0.1, velocity=(2, 0)")], lambda n: n["lengths"][10.0][25], 1.02),
    ("07_friction", 0, [(", spin=False", "")], lambda n: 50 * (end(n["ways"]) - n["ways"][-2]), [8 / 3] * 3),
    ("07_friction", 0, [("radius=0.1", "radius=0.1, mass=5")], lambda n: end(n["ways"]), [8, 4, 2]),
    (
        "08_collisions",
        0,
        [('"3 on 1 kg, e = 1": (3, 1, 1)', '"a": (1, 3, 1)')],
        lambda n: n["places"]["a"][-1],
        [-0.9, 0.7],
    ),
    (
        "09_sticks",
        0,
        [("radius=0.06,", "radius=0.06, mass=100,")],
        lambda n: 50 * (n["heights"][-1] - n["heights"][-2]),
        [1 - 1 / 100.5, 1 - 1 / 80.5, 1 - 2 / 101],
    ),
    ("10_stacks", 0, [("radius=0.1)", "radius=0.1, mass=[1, 1, 1, 5])")], lambda n: n["taken"][-1], 96),
    ("11_cloth_and_jelly", 0, [("0.01, 8  #", "0.01, 16  #")], lambda n: max(n["stretches"], key=sum), [9.99, 9.88]),
    ("11_cloth_and_jelly", 0, [("= 1e5,", "= 4e5,")], lambda n: max(n["stretches"], key=sum), [2.5, 2.49]),
    ("12_implicit", 1, [("=1e6", "=1e4")], lambda n: [max(one[-100:]) for one in n["angles"].values()], [0.73, 1.0]),
    (
        "12_implicit",
        1,
        [("0.01,", "0.0025,")],
        lambda n: [max(one[-100:]) for one in n["angles"].values()],
        [0.92, 1.0],
    ),
    (
        "13_error",
        0,
        [("dt=h,", 'dt=h, integrator="symplectic_euler",')],
        lambda n: n["errors"][2] / n["errors"][3],
        2.41,
    ),
]


@pytest.mark.long
@pytest.mark.parametrize(("name", "program", "changes", "found", "wanted"), CHANGES)
def test_what_a_reader_is_asked_to_change_does_what_the_page_says(name, program, changes, found, wanted):
    text = programs(CHAPTERS[name])[program]
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    names: dict = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exec(compile(text, f"{name}.md", "exec"), names)
        value = found(names)
    np.testing.assert_allclose(value, wanted, atol=0.015)
