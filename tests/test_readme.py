"""What the README shows does what it says."""

import re
from pathlib import Path

import numpy as np
import pytest
from commands import run_shown

import taichi_sim as ts
from taichi_sim.files.source import demos

pytestmark = pytest.mark.once

README = (Path(__file__).parent.parent / "README.md").read_text()


def block(language: str) -> str:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)[0]


def test_five_lines_make_a_video(tmp_path, monkeypatch):
    code = block("python")
    assert len(code.split("\n\n")[1].strip().splitlines()) == 5
    assert "duration=3" in code
    monkeypatch.chdir(tmp_path)
    exec(compile(code.replace("duration=3", "duration=0.05, size=(96, 54)"), "README.md", "exec"), {})
    assert (tmp_path / "drape.mp4").stat().st_size > 500


def test_scene_file_is_the_same_scene(tmp_path):
    (tmp_path / "drape.toml").write_text(block("toml"))
    from_file = ts.load_scene(tmp_path / "drape.toml")
    names: dict = {}
    exec(compile(block("python").split("ts.video")[0], "README.md", "exec"), names)
    made = names["scene"]
    assert np.array_equal(from_file.position, made.position)
    assert np.array_equal(from_file.pairs, made.pairs)
    assert from_file.materials == made.materials
    assert from_file.walls == made.walls
    assert repr(from_file.colliders) == repr(made.colliders)  # arrays have no one truth value


def test_the_example_of_scene_files_loads(tmp_path):
    docs = (Path(__file__).parent.parent / "docs" / "scenes.md").read_text()
    (tmp_path / "scene.toml").write_text(re.findall(r"```toml\n(format.*?)```", docs, re.DOTALL)[0])
    scene = ts.load_scene(tmp_path / "scene.toml")
    assert scene.wind is not None
    assert len(scene.moving_pins[0].balls) == 5
    gap = scene.position[scene.pairs[-1]]
    assert np.linalg.norm(gap[1] - gap[0]) < 0.15  # the flag's corner and the weight's top
    for table in re.findall(r"\[\[(\w+)\]\]", docs):
        from taichi_sim.files.toml_schema import TABLES

        assert table in TABLES


def test_it_counts_the_demos():
    assert f"Two of the {len(demos())} built-in demos" in README


@pytest.mark.slow
def test_the_page_on_python_runs(tmp_path, monkeypatch, capsys):
    page = (Path(__file__).parent.parent / "docs" / "python.md").read_text()
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for code in re.findall(r"```python\n(.*?)```", page, re.DOTALL):
        exec(compile(code, "python.md", "exec"), names)
    said = capsys.readouterr().out
    assert "<Scene in 3D: 64 balls" in said
    assert "wall time" in said
    assert (tmp_path / "falls.mp4").stat().st_size > 1000
    assert names["image"].size == (320, 180)
    assert len(names["scene"].colliders) == 1


SWEEPS = (Path(__file__).parent.parent / "docs" / "sweeps.md").read_text()


@pytest.mark.long
def test_the_page_on_sweeps_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("heap.toml").write_text(re.findall(r"```toml\n(.*?)```", SWEEPS, re.DOTALL)[0])
    names: dict = {}
    exec(compile(re.findall(r"```python\n(.*?)```", SWEEPS, re.DOTALL)[0], "sweeps.md", "exec"), names)
    assert len(names["found"]) == 12
    assert not names["found"].failed
    assert float(capsys.readouterr().out) > 0.0
    run_shown(SWEEPS, r"(sweep .* -o \w+)", "--workers", "0", "--duration", "0.1", "--quiet")
    assert len(Path("heap_sweep/table.csv").read_text().splitlines()) == 41


@pytest.mark.slow
@pytest.mark.once
def test_the_cloth_of_the_page_on_sweeps_is_found(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    Path("sheet.toml").write_text(re.findall(r"```toml\n(.*?)```", SWEEPS, re.DOTALL)[1])
    run_shown(SWEEPS, r"(fit .*)", "--workers", "0")
    said = capfd.readouterr().out
    found, told = (
        float(re.search(r"stretch_stiffness = (\S+)", text)[1]) for text in (said, SWEEPS.split("which says")[1])
    )
    assert found == pytest.approx(told, rel=5e-3)
    assert found == pytest.approx(3 * 0.228 * 9.81 * 0.5**4 / (64 * 0.025**3), rel=0.02)  # a flat strip


def anchors(page: Path) -> set[str]:
    """What headings of a page are called in links."""
    titles = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def test_links_of_all_pages_lead_somewhere():
    root = Path(__file__).parent.parent
    for page in (root / "README.md", root / "CHANGELOG.md", *(root / "docs").glob("*.md")):
        for target, anchor in re.findall(r"\]\(([^)#:]*)(?:#([^)]*))?\)", page.read_text()):
            file = page.parent / target if target else page
            assert file.exists(), (page.name, target)
            assert not anchor or anchor in anchors(file), (page.name, target, anchor)
