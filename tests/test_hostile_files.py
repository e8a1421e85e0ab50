"""Files and names made to do harm: they start no program, wait for nothing, take no more than a bound, and command nothing."""

import io
import json
import os

import matplotlib
import numpy as np
import pytest

import taichi_sim as ts
from taichi_sim.common.printable import no_formula
from taichi_sim.geometry import outlines
from taichi_sim.geometry.mesh import read_surface
from taichi_sim.geometry.outlines import drawing_outlines, text_outlines
from taichi_sim.outputs import open_output
from taichi_sim.outputs.records import Records
from taichi_sim.outputs.table import write_row
from taichi_sim.studies.figure import svg
from taichi_sim.sweeps import figures
from taichi_sim.sweeps.design import Axis
from taichi_sim.sweeps.effects import Group

pytestmark = [pytest.mark.once, pytest.mark.skipif(os.name != "posix", reason="pipes and programs")]

HEAD = "format = 1\ndim = 3\n"
BALL = "[[balls]]\nposition = [[0, 0, 0]]\nradius = 0.1\n"


def written(folder, text):
    (folder / "scene.toml").write_text(text)
    return folder / "scene.toml"


# Files that are not what their names say -----------------------------------------------------------------------------


@pytest.fixture
def trap(tmp_path, monkeypatch):
    """A program that others would start in place of Ghostscript, LaTeX, a viewer; the file that it leaves."""
    tools = tmp_path / "tools"
    tools.mkdir()
    for name in ("gs", "gswin64c", "latex", "pdflatex", "dvipng", "xdg-open", "convert", "inkscape"):
        (tools / name).write_text(f"#!/bin/sh\necho {name} >> {tmp_path / 'sprung'}\n")
        (tools / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tools), prepend=os.pathsep)
    yield
    assert not (tmp_path / "sprung").exists()


POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\n%%EndComments\nshowpage\n%%EOF\n"
LOOK = """format = 1
dim = 3
[[cloth]]
name = "sheet"
resolution = [3, 3]
[[output.looks]]
of = "sheet"
texture = "face.png"
"""


@pytest.mark.parametrize(
    "content", [POSTSCRIPT, b"P6 1 1 255 abc", b"SIMPLE  =                    T", b"%PDF-1.4\n", b""]
)
def test_a_texture_starts_no_program(tmp_path, trap, content):
    (tmp_path / "face.png").write_bytes(content)
    with pytest.raises(
        ts.SceneError, match=r"texture: .*face.png' is not an image that can be read: it is none of PNG"
    ):
        ts.load_scene(written(tmp_path, LOOK))


def test_a_picture_that_was_kept_starts_no_program(tmp_path, trap):
    """As in a folder `.x.gif.resume` that somebody sends."""
    out = open_output(tmp_path / "x.gif")
    frame = ts.Frame(time=0.0, position=np.zeros((1, 3)), velocity=np.zeros((1, 3)), radius=np.ones(1))
    out.write(0, frame, np.zeros((8, 8, 3), np.uint8))
    kept = Records(out.log.folder / "pictures", resume=False)
    kept.append(POSTSCRIPT)
    kept.close()
    with pytest.raises(ts.SceneError, match=r"pictures: is damaged"):
        out.finish()
    out.discard()


TABLES = [
    ("texture", LOOK),
    ("mesh", f'{HEAD}[[cloth]]\nmesh = "face.png"\n'),
    ("mesh", f'{HEAD}{BALL}[[colliders]]\nshape = "mesh"\nmesh = "face.png"\n'),
    ("file", f'{HEAD}[[balls]]\nfile = "face.png"\n'),
    ("file", f'{HEAD}[[svg]]\nfile = "face.png"\nheight = 1.0\n'),
    ("font", f'{HEAD}[[text]]\ntext = "a"\nheight = 1.0\nfont = "face.ttf"\n'),
]


@pytest.mark.parametrize(("key", "text"), TABLES)
def test_a_pipe_is_not_waited_for(tmp_path, key, text):
    os.mkfifo(tmp_path / "face.png")
    os.mkfifo(tmp_path / "face.ttf")
    with pytest.raises(ts.SceneError, match=rf"{key}: .* (is a pipe, and no file|it must be .*file)"):
        ts.load_scene(written(tmp_path, text))


def test_a_part_of_a_mesh_that_is_a_pipe(tmp_path):
    os.mkfifo(tmp_path / "a.bin")
    (tmp_path / "a.gltf").write_text(
        json.dumps({"asset": {"version": "2.0"}, "buffers": [{"uri": "a.bin", "byteLength": 9}]})
    )
    with pytest.raises(ts.SceneError, match="is a pipe, and no file"):
        read_surface(tmp_path / "a.gltf")


def test_a_damaged_font(tmp_path):
    for content in (b"", b"abc", b"\0\1\0\0" + bytes(1000), b"OTTO" + bytes(100)):
        (tmp_path / "a.ttf").write_bytes(content)
        with pytest.raises(ts.SceneError, match=r"font: .* cannot be read as a font"):
            text_outlines("text", "a", 1.0, str(tmp_path / "a.ttf"))


SVG = (
    '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" viewBox="0 0 100 100">{}</svg>'
)
SQUARE = '<rect width="1" height="1"/>'


def nested_uses(depth):
    """Each of five uses of the one before."""
    use = '<use xlink:href="#a{}" x="1"/>'
    groups = "".join(f'<g id="a{k + 1}">{5 * use.format(k)}</g>' for k in range(depth))
    return f'<defs><g id="a0">{SQUARE}</g>{groups}</defs>{use.format(depth)}'


def zigzag(corners):
    x = np.random.default_rng(0).uniform(0, 100, (corners, 2))
    return f'<polygon points="{" ".join(f"{a:.2f},{b:.2f}" for a, b in x)}"/>'


@pytest.mark.parametrize(
    ("drawing", "message"),
    [
        (nested_uses(60), r"has 1.37e\+38 MB, uses of its parts included; a drawing may have 2 MB at most"),
        (f'<g id="a"><use xlink:href="#a"/>{SQUARE}</g>', "the element 'a' uses itself"),
        (zigzag(600), "has edges that cross each other too often"),
        ('<path d="M0 0' + " c3 9 -9 3 9 1" * 300 + ' Z"/>', "the drawing has more than 1000 corners"),
        (
            "".join(f'<path d="M0 {y}h200v1h-200Z"/><path d="M{y} 0v200h1v-200Z"/>' for y in range(0, 200, 2)),
            "cross each other",
        ),
        ("".join(f'<rect x="{2 * x}" width="1" height="1"/>' for x in range(301)), "has more than 300 filled paths"),
        ("<g>" * 20_000 + SQUARE + "</g>" * 20_000, "cannot be read as SVG: its groups are too deep"),
        ('<path d="M0 0 A 0 1 0 1 1 5 5 z"/>', "shows nothing that has an area"),
    ],
    ids=["uses", "circle", "zigzag", "curves", "stripes", "paths", "deep", "a line as an area"],
)
def test_a_drawing_is_bounded_before_it_is_made(tmp_path, monkeypatch, drawing, message):
    monkeypatch.setattr(outlines, "MOST_PATHS", 300)
    monkeypatch.setattr(outlines, "MOST_CORNERS", 1000 if " c3" in drawing else 100_000)
    (tmp_path / "a.svg").write_text(SVG.format(drawing))
    with pytest.raises(ts.SceneError, match=message):
        drawing_outlines("svg", tmp_path / "a.svg", 1.0)


def test_a_drawing_of_many_parts_is_drawn(tmp_path):
    tiles = "".join(f'<rect x="{k % 20}" y="{k // 20}" width="1" height="1"/>' for k in range(400))
    (tmp_path / "a.svg").write_text(SVG.format(tiles))
    assert len(drawing_outlines("svg", tmp_path / "a.svg", 1.0)) == 400
    (tmp_path / "a.svg").write_text(SVG.format(nested_uses(3)))
    assert len(drawing_outlines("svg", tmp_path / "a.svg", 1.0)) == 1


# Names -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["a\nend_header\n", "a\tb", "\x1b[2J", "a\u202eb", "\ud800", 5000 * "a"])
def test_a_name_is_one_line_without_control_characters(name):
    """It stands in the heads of PLY, OBJ and VTK files, and in messages."""
    scene = ts.Scene(dim=3)
    balls = scene.add_balls([[0.0, 0.0, 0.0]], radius=0.1)
    for give in (
        lambda: scene.set_name(balls, name),
        lambda: scene.add_material(name),
        lambda: scene.add_collider(ts.Sphere((0.0, 0.0, 0.0), 1.0, name=name)),
    ):
        with pytest.raises(
            ts.SceneError, match=r"name: .* is not allowed; it must be a text (in one|of at most)"
        ) as caught:
            give()
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 250
    scene.set_name(balls, 200 * "a")
    scene.set_name(balls, "Bälle ☃\u202f1 <b>&")


def test_a_key_of_any_length_is_cut_off_in_its_message(tmp_path):
    with pytest.raises(ts.SceneError, match=r"kkk\.\.\.: is not a known key") as caught:
        ts.load_scene(written(tmp_path, HEAD + f'"{"k" * 100_000}" = 1\n'))
    assert len(str(caught.value)) < 600


@pytest.mark.parametrize("name", ["$x_{$", "a$", r"$\$x^{$", "${", "$$"])
def test_a_name_is_no_formula_in_a_figure(tmp_path, monkeypatch, trap, name):
    """Neither does a file of the working folder have it set by LaTeX."""
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\n")
    monkeypatch.chdir(tmp_path)
    matplotlib.rcParams.update(matplotlib.rc_params_from_file("matplotlibrc"))
    try:
        groups = [Group({name: x, "b": y}, np.array([x, x + 1.0]), 0) for x in (1.0, 2.0) for y in (1.0, 3.0)]
        for paths in ((name,), (name, "b")):
            axes = [Axis(path, (1.0, 2.0, 3.0)) for path in paths]
            assert name.replace("&", "&amp;") in svg(figures.draw(groups, axes, name))
    finally:
        matplotlib.rcdefaults()


def test_a_table_holds_no_formulas():
    for text in ("=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1"):
        assert no_formula(text) == f"'{text}"
    for value in (-1.0, None, "a=1", "", "nan", 3):
        assert no_formula(value) is value
    file = io.StringIO()
    write_row(file, {"frame": 0, "=cmd|' /c calc'!A0.force": -1.5}, names=True)
    assert file.getvalue().splitlines() == ["frame,'=cmd|' /c calc'!A0.force", "0,-1.5"]
