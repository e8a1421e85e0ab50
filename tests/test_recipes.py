"""What docs/recipes.md shows does what it says: its text, its commands, smaller or shorter where a test says so."""

import ast
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import run_shown

import taichi_sim as ts

pytestmark = pytest.mark.once

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "recipes.md").read_text()


def recipe(title: str) -> str:
    return PAGE.split(f"## {title}")[1].split("\n## ")[0]


def blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def other(text: str, *changes: tuple[str, str]) -> str:
    """With each of these replaced; each must be there."""
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    return text


def run(text: str, *more: str) -> None:
    """The recipe's command, with further arguments."""
    run_shown(text, "(run .*)", *more)


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.long
def test_letters_on_a_trampoline(capfd):
    text = recipe("HELLO")
    scene = other(blocks(text, "toml")[0], ("spacing = 0.07", "spacing = 0.25"), ("[49, 25]", "[13, 7]"))
    Path("hello.toml").write_text(scene)
    made = ts.load_scene("hello.toml")
    assert len(next(one for one in made.objects if one.name == "hello").balls) > 5 * 12
    assert 0.1 < made.pinned.mean() < 0.5
    run(text, "--size", "96x54", "--duration", "0.2", "--fps", "10")
    assert "written      hello.mp4" in capfd.readouterr().out
    assert Path("hello.mp4").stat().st_size > 500


@pytest.mark.slow
def test_cloth_over_a_mesh_of_ones_own(capfd):
    """On a ball for a statue; coarse, and until it has landed."""
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    statue = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    statue.apply_translation([0.0, 0.5, 0.0])
    statue.export("statue.obj")
    text = recipe("Cloth over your own mesh")
    changes = ("resolution = [49, 49]", "resolution = [21, 21]"), ("resolution = 96", "resolution = 32")
    Path("drape.toml").write_text(other(blocks(text, "toml")[0], *changes))
    run(text, "--size", "96x54", "--duration", "0.75")
    assert "written      drape.usdc" in capfd.readouterr().out
    assert Path("drape.mp4").stat().st_size > 500
    stage = usd.Stage.Open("drape.usdc")
    assert stage.GetFramesPerSecond() == 24
    sheet = stage.GetPrimAtPath("/World/dust_sheet/dust_sheet")
    points = np.array([sheet.GetAttribute("points").Get(k) for k in range(19)])
    assert points.shape == (19, 21 * 21, 3)
    assert np.allclose(points[0, :, 1], 1.05)
    assert points[-1, :, 1].min() < 0.7  # its corners hang
    assert points[-1, :, 1].max() > 1.0  # and its middle lies on the statue
    body = np.array(stage.GetPrimAtPath("/World/statue").GetAttribute("points").Get(0))
    assert np.allclose(body.min(axis=0), [-0.5, 0.0, -0.5], atol=1e-6)
    assert stage.GetPrimAtPath("/World/camera")


@pytest.mark.slow
def test_tablecloths_of_three_fabrics(capfd):
    """Coarse; silk is limper than denim, so that its rim hangs closer to the table at rest."""
    text = recipe("Tablecloths")
    scene = other(blocks(text, "toml")[0], ("[41, 41]", "[15, 15]"), ('precision = "f64"\n', ""))
    Path("tables.toml").write_text(scene)
    run(text, "--size", "96x54", "--fps", "10")
    assert Path("tables.mp4").stat().st_size > 500
    made, wide = ts.load_scene("tables.toml"), {}
    assert made.n_springs == 0
    with ts.Simulation(made, settle=True) as sim:
        rest = sim.position
    for one in made.objects:
        x = made.position[one.balls]
        rim = np.abs(x - x.mean(axis=0)).max(axis=1) > 0.29
        wide[one.name] = np.linalg.norm((rest[one.balls] - x.mean(axis=0))[rim][:, [0, 2]], axis=1).mean()
    assert len(wide) == 3
    assert wide["silk"] < wide["denim"], wide


@pytest.mark.long
def test_discharge_of_a_hopper(monkeypatch):
    """The video of fewer grains; the law as it stands there."""
    text = recipe("A hopper")
    program, plot, law = blocks(text, "python")
    Path("hopper.py").write_text(other(program, ("ROWS = 0.01, 0.7, 50", "ROWS = 0.01, 0.7, 8")))
    run(text, "--size", "96x72", "--duration", "1.0", "--fps", "20")
    assert Path("hopper.mp4").stat().st_size > 500
    names: dict = {}
    exec(compile(plot, "recipes.md", "exec"), names)
    out = names["table"]["out.count"]
    assert len(out) == 20
    assert out[0] == 0
    assert 50 < out[-1] <= 33 * 8
    assert Path("discharge.png").stat().st_size > 5000
    Path("hopper.py").write_text(program)
    monkeypatch.syspath_prepend(".")
    monkeypatch.delitem(sys.modules, "hopper", raising=False)
    exec(compile(law, "recipes.md", "exec"), names)
    monkeypatch.delitem(sys.modules, "hopper")
    rates = np.array(names["rates"])
    assert np.abs(rates / names["law"] - 1).max() < 0.08  # 0.04, the page says
    told = re.search(r"rates of ([\d, and]+) discs", text)[1]
    assert np.allclose(rates, [float(one) for one in re.findall(r"\d+", told)], rtol=0.1)


@pytest.mark.slow
def test_an_eel_swims():
    """A third of a second of video; two seconds without, in which it reaches the speed that the page tells."""
    text = recipe("An eel")
    (program,) = blocks(text, "python")
    Path("eel.py").write_text(program)
    run(text, "--size", "96x54", "--duration", "0.3", "--fps", "10")
    assert Path("eel.mp4").stat().st_size > 500
    names: dict = {}
    exec(compile(program, "eel.py", "exec"), names)
    assert (ROOT / "demos" / "eel.py").read_text().startswith(program)
    told = float(re.search(r"reaches ([\d.]+) m/s", text)[1])
    with ts.Simulation(names["scene"]()) as sim:
        sim.run(1.0)
        before = sim.position.mean(axis=0)
        sim.run(1.0)  # a whole beat
        speed = sim.position.mean(axis=0) - before
    assert speed[0] == pytest.approx(told, rel=0.1)
    assert abs(speed[2]) < 0.2 * speed[0]


@pytest.mark.long
def test_a_mesh_that_changes_shape():
    """A plate bulges under a ball, which goes up with it; another slides, and takes its ball along by friction."""
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "scenes.md").read_text(), re.DOTALL)
    names: dict = {}
    exec(compile(code, "scenes.md", "exec"), names)
    x, z = (part.ravel() for part in np.meshgrid([-0.4, 0.0, 0.4], [-0.4, 0.0, 0.4], indexing="ij"))
    corner = np.array([0, 1, 3, 4])
    triangles = np.concatenate([[[a, a + 1, a + 4], [a, a + 4, a + 3]] for a in corner])
    plate = np.stack([x, np.zeros(9), z], axis=1)
    bulge, slide = np.zeros((9, 3)), np.full((9, 3), [0.2, 0.0, 0.0])
    bulge[4, 1] = 0.4
    scene = ts.Scene(dim=3, gravity=(0.0, -9.81, 0.0))
    scene.add_material("rough", friction=1.0)
    for change, place in ((bulge, 0.0), (slide, 3.0)):
        at = plate + np.array([place, 0.0, 0.0])
        meshes = [(at + part * change, triangles) for part in (0.0, 0.25, 0.5, 1.0)]  # over 0.3 s, faster at the end
        names["add_animated"](scene, meshes, 10, 0.01, "rough")
        on = [place, 0.11, 0.0]
        scene.add_balls([on], radius=0.1, mass=0.1, material="rough")
    up, along = 9, 19
    with ts.Simulation(scene, spin=False, dt=1e-3) as sim:
        for until, part in ((0.19, 2.5), (0.29, 5.0)):  # 1/s
            sim.run(until - sim.time)
            assert sim.velocity[up, 1] == pytest.approx(0.4 * part, rel=1e-3)
            assert sim.velocity[along, 0] == pytest.approx(0.2 * part, rel=1e-3)
        sim.run(0.2)
        assert abs(sim.velocity[along, 0]) < 1e-3  # it stands still, and so does what lies on it
        assert sim.position[up, 1] > 0.3


def shown(cell: str, names: dict):
    """What a notebook gets to show: the value of the last expression."""
    *first, last = ast.parse(cell).body
    exec(compile(ast.Module(first, []), "cell", "exec"), names)
    return eval(compile(ast.Expression(last.value), "cell", "eval"), names)


@pytest.mark.long
def test_video_in_a_notebook():
    scene, look, video = blocks(recipe("A video in a notebook"), "python")
    names: dict = {}
    assert "<th>balls</th><td>584</td>" in shown(scene, names)._repr_html_()
    assert shown(look, names)._repr_png_()
    page = shown(other(video, ("duration=2", "duration=0.2"), ("(640, 360)", "(96, 54)")), names)._repr_html_()
    assert '<video controls loop src="data:video/mp4;base64,' in page
    assert "<pre>frames       6, 0.2 s simulated" in page
    Path("drop.mp4").unlink()
    assert names["ts"].video(names["scene"], "x.npz", duration=0.0)._repr_html_().startswith("<pre>frames       0")
