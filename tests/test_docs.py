"""The site: its reference has all that the program has, its snippets are run by some test, and it builds without a warning."""

import ast
import dataclasses
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import taichi_sim as ts
from taichi_sim.cli import command
from taichi_sim.files.source import open_scene
from tests.support import command_page

pytestmark = pytest.mark.once

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = {page.relative_to(DOCS).as_posix(): page.read_text(encoding="utf-8") for page in sorted(DOCS.rglob("*.md"))}
SHOWN_BY = {  # pages with Python, and the test that runs it
    "web.md": "viewer/test_web.py",
    "extending.md": "test_extending.py",
    "files.md": "outputs/test_interchange.py",
    "python.md": "test_readme.py",
    "recipes.md": "test_recipes.py",
    "scenes.md": "test_recipes.py",
    "start.md": "test_docs.py",
    "sweeps.md": "test_readme.py",
}
ROOMS_OF_STUDIES = {"benchmark"}  # what these say is about a developer's machine


def test_every_page_is_in_the_contents():
    listed = {"index"}
    for page in ("index.md", "course/index.md"):
        for names in re.findall(r"```\{toctree\}\n(.*?)```", PAGES[page], re.DOTALL):
            folder = page.rpartition("/")[0]
            found = [line for line in names.split() if not line.startswith(":")]
            listed |= {f"{folder}/{name}".lstrip("/") for name in found}
    assert {page.removesuffix(".md") for page in PAGES} <= listed


def test_every_public_name_is_in_the_reference_and_documented():
    listed = set(re.findall(r"auto(?:class|function):: (\w+)", PAGES["api.md"]))
    assert listed == set(ts.__all__) - {"shapes", "__version__"}
    assert "automodule:: taichi_sim.shapes" in PAGES["api.md"]
    everything = [getattr(ts, name) for name in listed] + [getattr(ts.shapes, name) for name in ts.shapes.__all__]
    assert [thing.__name__ for thing in everything if not thing.__doc__] == []
    methods = [
        f"{owner.__name__}.{name}"
        for owner in everything
        if inspect.isclass(owner)
        for name, thing in vars(owner).items()
        if not name.startswith("_")
        and (inspect.isroutine(thing) or isinstance(thing, property))
        and not inspect.getdoc(thing)
    ]
    assert methods == []


def test_the_page_of_commands_is_what_the_command_says():
    assert PAGES["command.md"] == command_page.markdown(), "run `make docs`"


def words(node):
    """Text of a message as a page shows it: `...` stands where a name or a number is put in."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(part.value if isinstance(part, ast.Constant) else "..." for part in node.values)
    if isinstance(node, ast.BinOp):
        return words(node.left) + words(node.right)
    return "..."


def messages():
    """Texts of all BackendErrors, UnstableErrors and warnings that are written where they are raised."""
    for path in sorted((ROOT / "taichi_sim").rglob("*.py")):
        if path.relative_to(ROOT / "taichi_sim").parts[0] not in ROOMS_OF_STUDIES:
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Call) and node.args:
                    if ast.unparse(node.func) in (
                        "BackendError",
                        "UnstableError",
                        "warn",
                        "self._end",
                    ):  # of Retry
                        text = re.sub(r"(\.\.\.)+", "...", words(node.args[0]))
                        if re.search("[a-z]{3}", text.replace("report: ...: ...", "")):
                            yield text


def test_every_message_has_a_cause_and_a_cure():
    rows = re.findall(r"^\| `([^`]+)` \|[^|]+\|[^|]+\|$", PAGES["messages.md"], re.MULTILINE)
    patterns = [re.compile(".*".join(map(re.escape, row.split("...")))) for row in rows]
    said = list(messages())
    assert len(said) > 30
    assert [text for text in said if not any(one.search(text) for one in patterns)] == []
    general = {row for row in rows if row.startswith("is ")}  # of SceneError
    assert [row for row, one in zip(rows, patterns) if row not in general and not any(map(one.search, said))] == []
    for name in ("SceneError", "UnstableError", "BackendError"):
        assert f"## {name}" in PAGES["messages.md"]
    for status in (command.FAILED, command.BAD_INPUT, command.UNSTABLE):
        assert f"\n| {status} | " in PAGES["messages.md"]


def test_every_page_with_python_is_run_by_a_test():
    for page, text in PAGES.items():
        if "```python" in text:
            test = SHOWN_BY.get(page, "test_course.py" if page.startswith("course/") else None)
            assert test, f"{page}: no test runs its Python"
            assert page.partition("/")[0] in (ROOT / "tests" / test).read_text(encoding="utf-8")


@pytest.fixture
def ring_folder(tmp_path, monkeypatch):
    """The folder of the test, with the mesh that the first page makes."""
    program = re.search(r"```python\n(.*?)```", PAGES["start.md"], re.DOTALL)[1]
    monkeypatch.chdir(tmp_path)
    exec(compile(program, "start.md", "exec"), {})
    return tmp_path


def test_scene_files_of_the_first_page_load(ring_folder):
    first, mesh = re.findall(r"```toml\n(.*?)```", PAGES["start.md"], re.DOTALL)
    (path, value) = re.search(r"--set (\S+)=(\S+)", PAGES["start.md"]).groups()
    (ring_folder / "drop.toml").write_text(first)
    stiffer = open_scene(ring_folder / "drop.toml", parameters={path: float(value)})
    softer = ts.load_scene(ring_folder / "drop.toml")
    assert stiffer.brick_modulus.max() > 2 * softer.brick_modulus.max()
    (ring_folder / "ring.toml").write_text(mesh)
    assert 50 < ts.load_scene(ring_folder / "ring.toml").n_balls < 2000


@pytest.mark.slow
def test_the_ring_of_the_first_page_is_not_crushed(ring_folder):
    _, mesh = re.findall(r"```toml\n(.*?)```", PAGES["start.md"], re.DOTALL)
    (ring_folder / "ring.toml").write_text(mesh)
    scene = ts.load_scene(ring_folder / "ring.toml")
    with ts.Simulation(scene, arch="cpu") as sim:
        summary = ts.export(sim, None, fps=60, duration=1.0)
    assert summary.inverted == (0, 0)
    assert summary.crossings == 0
    assert summary.most_contacts > 0


def methods(of):
    """Public methods of a class, its bases' among them."""
    return [name for name in dir(of) if name[0] != "_" and callable(getattr(of, name))]


@pytest.mark.slow
def test_the_site_is_built_without_a_warning_and_loads_nothing_from_elsewhere(tmp_path):
    pytest.importorskip("sphinx", reason="sphinx is not installed")
    build = [sys.executable, "-m", "sphinx", "-q", "-W", "-n", "--keep-going", "-d", str(tmp_path / "trees")]
    done = subprocess.run([*build, str(DOCS), str(tmp_path / "site")], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for page in (tmp_path / "site").rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert not re.findall(r"""<(?:script|img|link)[^>]*(?:src|href)=["']?(?:https?:)?//[^>]*>""", text), page.name
    commands = (tmp_path / "site" / "command.html").read_text(encoding="utf-8")
    assert not re.findall(r"\s\u2013[a-z]+", commands)  # `--out` in plain words is no dash
    reference = (tmp_path / "site" / "api.html").read_text(encoding="utf-8")
    members = [f"{one.__name__}.{name}" for one in (ts.Scene, ts.Simulation) for name in methods(one)]
    assert "Scene.add_membranes" in members  # of a base class
    for name in ("shapes.cloth", *members):
        assert f'id="taichi_sim.{name}"' in reference, name
    for one in dataclasses.fields(ts.Frame):  # attributes, of which a comment says the unit
        assert f"<strong>{one.name}</strong>" in reference
