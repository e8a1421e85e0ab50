"""Parts from outside the package: every Python block of docs/extending.md, and the examples in docstrings, run as they stand."""

import importlib.util
import inspect
import re
import textwrap
from pathlib import Path

import numpy as np
import pytest
import taichi as ti

import taichi_sim as ts
import taichi_sim.forces.element
import taichi_sim.forces.sum
import taichi_sim.integrators
import taichi_sim.outputs.base

pytestmark = pytest.mark.once

PAGE = (Path(__file__).parent.parent / "docs" / "extending.md").read_text(encoding="utf-8")
SECTIONS = dict(section.split("\n", 1) for section in PAGE.split("\n## ")[1:])
BLOCKS = {name: re.findall(r"```python\n(.*?)```", text, re.DOTALL) for name, text in SECTIONS.items()}
TABLES = "Tables of your own in scene files"
DOORS = {  # the part of each example without which it does nothing, and what stands there instead
    "A force": ("-= h", "-= 0.0"),
    "An element": ("return -row", "return 0.0 * row"),
    "An integrator": ("self.state.kick(i, self.forces.change(i, h))", "pass"),
    "A collider shape": ("* ti.min(side.norm()", "* 0.0 + 1.0 + ti.max(side.norm()"),
    "A contact rule": ("self.exchange(", "print("),
    "A shape": ("+ radius * np.stack", "+ 0.0 * np.stack"),
    "An output": ("*frame.position[:, 1], ", ""),
    TABLES: ("(2 * k + 1)", "0"),
}
NUMBER = r"-?\d+(?:\.\d*)?(?:e[-+]?\d+)?"


def run(path, text):
    """A script as a module of its own: Taichi reads the source of functions from its file."""
    path.write_text(text, encoding="utf-8")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def promised(script):
    """What the comments behind its calls of `print` say that it prints: up to the colon, without units."""
    comments = re.findall(r"^ *print\(.*\)  # ([^:\n]*)", script, re.MULTILINE)
    return [float(n) for comment in comments for n in re.findall(NUMBER, comment)]


def agree(script, said):
    """Whether the numbers that a script printed are those that it promised."""
    found = [float(n) for n in re.findall(NUMBER, said)]
    wanted = promised(script)
    return len(wanted) > 0 and len(found) == len(wanted) and np.allclose(found, wanted, rtol=5e-3, atol=2e-3)


def test_every_door_has_one_example_whose_result_is_stated():
    assert list(SECTIONS) == list(DOORS)
    assert agree("print(1)  # 1 m: one", "1.0")
    assert not agree("print(1)  # 1 m: one", "1.1")
    assert not agree("print(1)", "")
    for name, blocks in BLOCKS.items():
        assert len(blocks) == 1, name
        assert promised(blocks[0]), name
        assert "taichi_sim." not in blocks[0], f"{name}: the example takes a name that is not public"


@pytest.mark.slow_where(name=["An integrator", "An output", "A contact rule"])
@pytest.mark.parametrize("name", BLOCKS)
def test_example_of_the_page_runs(name, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for block in BLOCKS[name]:
        run(tmp_path / "example.py", block)
        assert agree(block, capsys.readouterr().out)


@pytest.mark.slow  # the others say enough where this has run once
@pytest.mark.parametrize("name", DOORS)
def test_example_that_does_nothing_is_noticed(name, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (block,) = BLOCKS[name]
    does, nothing = DOORS[name]
    assert block.count(does) == 1
    run(tmp_path / "example.py", block.replace(does, nothing))
    assert not agree(block, capsys.readouterr().out)


BEFORE = """
import taichi as ti
import numpy as np
import taichi_sim as ts

scene = ts.Scene(dim={dim}, gravity={gravity})
scene.add_balls({balls}, radius=0.1, velocity={velocity})
scene.settings = {settings}
sim = None
"""
ROW = [[0.0, 0.0], [1.0, 0.1], [2.0, 0.0]]
EXAMPLES = {  # a docstring, and balls that would fly on their parabolas if its example did nothing
    "force": (taichi_sim.forces.sum, ROW, [1.0, 0.0]),
    "element": (taichi_sim.forces.element, ROW, [1.0, 0.0]),
    "integrator": (taichi_sim.integrators, ROW, [1.0, 0.0]),
    "contact rule": (ts.ContactRule, ROW, [[3.0, 0.0], [0.0, 0.0], [0.0, 0.0]]),
    "collider shape": (ts.ColliderShape, [[0.3, 0.5, 0.1]], [0.0, 0.0, 0.0]),
    "shape": (ts.shapes.Shape, ROW, [0.0, 2.0]),
}


@pytest.mark.slow_where(kind=["integrator", "contact rule", "collider shape"])  # the page has these, too
@pytest.mark.parametrize("kind", EXAMPLES)
def test_example_of_a_docstring_runs(kind, tmp_path):
    thing, balls, velocity = EXAMPLES[kind]
    indented = re.search(
        r"(?<=\n\n)( {4}|)(?:@ti|def|class).*\n(?:(?:\1.*)?\n)+", inspect.cleandoc(thing.__doc__) + "\n"
    ).group()
    *code, last = textwrap.dedent(indented).strip().splitlines()
    dim = len(balls[0])
    settings = {"contacts": "off"} if kind in ("force", "element", "shape") else {}  # less to compile
    before = BEFORE.format(dim=dim, gravity=(0, -10, 0)[:dim], balls=balls, velocity=velocity, settings=settings)
    last = last if not last.startswith("ts.Simulation(") else f"sim = {last}"
    made = run(tmp_path / "example.py", "\n".join([before, *code, last, ""]))
    with made.sim or ts.Simulation(made.scene) as sim:
        sim.run(0.4)
        t, start = sim.time, made.scene
        flown = start.position + t * start.velocity + 0.5 * t**2 * np.asarray(start.gravity)
        off = np.linalg.norm(sim.position - flown, axis=1).max()
    if kind == "integrator":
        assert off < 5e-3  # of order 1
    else:
        assert off > 5e-3 or made.scene.n_balls > len(balls)


def test_a_rule_may_not_hide_a_field():
    class Hiding(ts.ContactRule):
        name = "hiding"

        @ti.func
        def solve(self, ball: ti.template(), time, iterations: ti.template(), impacts: ti.template()):
            pass

        def rate(self):
            pass

    scene = ts.Scene(dim=2)
    scene.add_balls(ROW, radius=0.1)
    with pytest.raises(TypeError, match=r"Hiding\.rate has the name of a field"):
        ts.Simulation(scene, contacts=Hiding())
