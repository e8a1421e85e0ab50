"""Parts from outside the package: every Python block of docs/extending.md, and the examples in docstrings, run as they stand."""

import importlib.util
import re
import textwrap
from pathlib import Path

import numpy as np
import pytest

import taichi_sim.forces.element
import taichi_sim.forces.sum
import taichi_sim.integrators

PAGE = (Path(__file__).parent.parent / "docs" / "extending.md").read_text(encoding="utf-8")
BLOCKS = [
    (section.splitlines()[0], block)
    for section in PAGE.split("\n## ")[1:]
    for block in re.findall(r"```python\n(.*?)```", section, re.DOTALL)
]
DOORS = (
    *("A force", "An element", "An integrator", "A collider shape"),
    *("A contact rule", "A shape", "An output"),
)
PRINTED = {"A force": [np.exp(-1.0), 0.0], "An integrator": [0.0, 0.1, 0.0, 0.3]}  # what comments say
BEFORE = """
import taichi as ti
from taichi_sim import Element, Integrator, Method, Scene, Simulation, StabilityLimit

scene = Scene(dim=2)
scene.add_balls([[0.0, 0.0], [1.0, 0.1], [2.0, 0.0]], radius=0.1, velocity=[1.0, 0.0])
"""


def run(path, text):
    """A script as a module of its own: Taichi reads the source of functions from its file."""
    path.write_text(text, encoding="utf-8")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_door_has_a_section():
    assert tuple(section.splitlines()[0] for section in PAGE.split("\n## ")[1:]) == DOORS
    assert {"A force", "An element", "An integrator"} <= {name for name, _ in BLOCKS}


@pytest.mark.parametrize(("name", "block"), BLOCKS, ids=[name for name, _ in BLOCKS])
def test_example_of_the_page_runs(name, block, tmp_path, capsys):
    run(tmp_path / "example.py", block)
    said = capsys.readouterr().out
    assert said.strip()
    assert "nan" not in said
    if name in PRINTED:
        assert [float(n) for n in re.findall(r"-?\d\S*\d|\d", said)] == pytest.approx(PRINTED[name], abs=2e-3)


@pytest.mark.parametrize(
    "module", [taichi_sim.forces.sum, taichi_sim.forces.element, taichi_sim.integrators], ids=lambda m: m.__name__
)
def test_example_of_a_docstring_runs(module, tmp_path):
    indented = re.search(r"(?<=\n\n)    @ti\.data_oriented\n(?:(?:    .*)?\n)+", module.__doc__).group()
    *code, last = textwrap.dedent(indented).strip().splitlines()
    assert last.startswith("Simulation(scene, ")
    made = run(tmp_path / "example.py", BEFORE + "\n".join([*code, f"sim = {last}", ""]))
    with made.sim as sim:
        sim.step(3)
        assert np.isfinite(sim.position).all()
        assert not np.array_equal(sim.position, made.scene.position)
