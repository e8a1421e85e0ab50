"""Text and drawings: outlines, their triangles, and the bodies that are made of them."""

import re
import sys

import numpy as np
import pytest
from scene_files import assert_unchanged

import taichi_sim as ts
from taichi_sim.geometry import mesh as meshes
from taichi_sim.geometry.outlines import drawing_outlines, text_outlines
from taichi_sim.geometry.polygon_mesh import extruded, filled, outer_edges
from taichi_sim.scene.cells import cell_volumes
from taichi_sim.scene.presets import PRESETS

shapely = pytest.importorskip("shapely")
pytestmark = pytest.mark.once

DRAWING = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 100 50">
<g transform="translate(10 0) scale(2)">
<path id="frame" d="M0 0 H20 V20 H0 Z M5 5 V15 H15 V5 Z" fill="#ff0000"/>
</g>
<circle cx="70" cy="20" r="20" fill="blue"/>
<path d="M0 0 L9 9" fill="none" stroke="black"/>
</svg>"""


def angles(points, triangles):
    corner = points[triangles]
    side = [np.linalg.norm(corner[:, k] - corner[:, (k + 1) % 3], axis=1) for k in range(3)]
    cosine = [
        (side[k] ** 2 + side[k - 2] ** 2 - side[k - 1] ** 2) / (2 * side[k] * side[k - 2]) for k in range(3)
    ]  # fmt: skip
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def holes(triangles):
    """Of a connected mesh in the plane, by Euler: n - e + t = 1 - holes."""
    edges = np.unique(np.sort(np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1), axis=0)
    return 1 - (len(np.unique(triangles)) - len(edges) + len(triangles))


# Triangles ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("spacing", [0.15, 0.05])
def test_letters_are_filled_with_good_triangles(spacing):
    letters = text_outlines("text", "HELO8&g", 1.0)
    assert [len(one.polygon.interiors) for one in letters] == [0, 0, 0, 1, 2, 1, 1]
    for one in letters:
        points, triangles, border = filled("text.spacing", one.polygon, spacing)
        a, b, c = (points[triangles[:, k]] for k in range(3))
        area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
        assert area.min() > 0
        assert area.sum() == pytest.approx(one.polygon.area, rel=0.02 if spacing > 0.1 else 0.002)
        assert angles(points, triangles).min() > 20
        assert holes(triangles) == len(one.polygon.interiors)
        edges = outer_edges(triangles)
        assert set(np.unique(edges)) == set(range(border))
        assert np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1).max() <= spacing * (1 + 1e-9)


def test_corners_are_kept():
    (letter,) = text_outlines("text", "H", 1.0)
    corners = np.asarray(letter.polygon.exterior.coords)[:-1]
    assert len(corners) == 12
    points, _, _ = filled("text.spacing", letter.polygon, 0.2)
    apart = np.linalg.norm(points[:, None] - corners, axis=2).min(axis=0)
    assert apart.max() < 1e-12
    assert (corners[:, 1].min(), corners[:, 1].max()) == pytest.approx((0.0, 1.0))
    assert corners[:, 0].min() == pytest.approx(-corners[:, 0].max())


def test_a_prism_of_tetrahedra_is_whole():
    (letter,) = text_outlines("text", "O", 1.0)
    points, triangles, _ = filled("text.spacing", letter.polygon, 0.15)
    x, cells = extruded(points, triangles, 0.3, 2)
    volume = cell_volumes(x, cells)
    assert volume.min() > 0
    assert volume.sum() == pytest.approx(0.3 * letter.polygon.area, rel=0.01)
    from taichi_sim.shapes.jelly_material import surface_of

    surface = meshes.Surface(x, surface_of(cells).astype(np.int32))
    assert not len(meshes.holes(surface.triangles))
    assert meshes.volume(surface) == pytest.approx(volume.sum())


def test_lines_and_parts():
    found = text_outlines("text", "Hi\nL", 0.5)
    assert len(found) == 4  # an i has two parts
    low = [one.polygon.bounds[1] for one in found]
    assert low[0] == pytest.approx(0.0)
    assert low[3] == pytest.approx(-0.65)
    assert [one.polygon.bounds[0] for one in found[:3]] == sorted(one.polygon.bounds[0] for one in found[:3])


def test_a_drawing(tmp_path):
    file = tmp_path / "a.svg"
    file.write_text(DRAWING)
    frame, disc = drawing_outlines("svg", file, 2.0)
    assert (len(frame.polygon.interiors), frame.colour) == (1, (1.0, 0.0, 0.0))
    assert (len(disc.polygon.interiors), disc.colour) == (0, (0.0, 0.0, 1.0))
    assert disc.polygon.area == pytest.approx(np.pi, rel=0.001)  # the lowest 40 of 40 units are 2 m
    assert frame.polygon.area == pytest.approx(4.0 - 1.0)
    both = shapely.union_all([frame.polygon, disc.polygon]).bounds
    assert both == pytest.approx((-2.0, 0.0, 2.0, 2.0))
    points, triangles, _ = filled("svg.spacing", frame.polygon, 0.2)
    assert holes(triangles) == 1
    assert len(points) > 50


# Bodies -------------------------------------------------------------------------------------------------------------


def test_jelly_in_3d():
    scene = ts.Scene(dim=3)
    word = ts.shapes.text(
        scene, "HO", 0.5, spacing=0.1, depth=0.2, density=100.0, position=(1, 2, 3), rotation=(90, 0, 0)
    )
    x = scene.position[word.balls]
    assert np.ptp(x, axis=0) == pytest.approx([np.ptp(x[:, 0]), 0.2, 0.5 * 1.03], abs=0.02)
    assert x.mean(axis=0) == pytest.approx([1, 2, 3.25], abs=0.1)
    area = sum(one.polygon.area for one in text_outlines("text", "HO", 0.5))
    assert scene.mass.sum() == pytest.approx(100.0 * 0.2 * area, rel=0.02)
    assert len(np.unique(scene.body)) == 2
    assert [one.name for one in scene.objects] == ["text_0", "text_1"]
    assert not len(meshes.holes(word.triangles))
    assert len(scene.solids) == len(word.solids) > 0
    assert not len(scene.pairs)


def test_jelly_in_2d_falls_as_a_whole():
    scene = ts.Scene(dim=2)
    word = ts.shapes.text(scene, "E", 1.0, spacing=0.15, velocity=(1, 0), pinned="bottom", poisson_ratio=0.4)
    x = scene.position[word.balls]
    held = scene.pinned[word.balls]
    assert held.tolist() == (x[:, 1] < 1e-9).tolist()
    assert held.sum() >= 4
    assert scene.velocity[~held].tolist() == [[1, 0]] * int((~held).sum())
    assert len(scene.solids) == len(word.solids) > 0
    border = ts.shapes.text(scene, "O", 1.0, spacing=0.15, position=(5, 0), pinned="border")
    assert 0.3 < scene.pinned[border.balls].mean() < 1.0


def test_cloth_of_a_preset():
    scene = ts.Scene(dim=3)
    word = ts.shapes.text(scene, "L", 1.0, kind="cloth", material="cotton", pinned="border", surface_collision=True)
    area = text_outlines("text", "L", 1.0)[0].polygon.area
    assert scene.mass.sum() == pytest.approx(PRESETS["cotton"].mass_per_area * area, rel=0.01)
    assert np.ptp(scene.position[word.balls][:, 2]) == 0
    assert scene.solid.all()
    assert 0 < scene.pinned.sum() < scene.n_balls


def test_colliders_are_solid_in_3d_and_outlines_in_2d():
    scene = ts.Scene(dim=3)
    ts.shapes.text(scene, "OI", 1.0, kind="collider", depth=0.4, position=(0, 0, 1), material="wood", colour=(1, 0, 0))
    assert [one.colour for one in scene.colliders] == [(1.0, 0.0, 0.0)] * 2
    assert [one.label for one in scene.colliders] == ["text_0", "text_1"]
    letter = scene.colliders[0]
    middle = np.asarray(text_outlines("text", "OI", 1.0)[0].polygon.centroid.coords)[0]
    across = np.array([[*middle, 1.0], [middle[0], 0.05, 1.0], [middle[0], 0.05, 1.3]])
    assert (letter.distance(across, 0.0) > 0).tolist() == [True, False, True]  # its hole, within, in front of it
    flat = ts.Scene(dim=2)
    word = ts.shapes.text(flat, "O", 1.0, kind="collider")
    assert flat.pinned.all()
    assert flat.collides.all()
    assert len(word.springs) == len(word.balls)  # closed rings


def test_a_drawing_in_a_file(tmp_path):
    (tmp_path / "a.svg").write_text(DRAWING)
    file = tmp_path / "a.toml"
    file.write_text('format = 1\n[[svg]]\nname = "logo"\nfile = "a.svg"\nspacing = 0.2\n')
    scene = ts.load_scene(file)
    assert {tuple(c) for c in scene.colour.tolist()} == {(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)}
    assert scene.objects[-1].name == "logo"
    scene.save(tmp_path / "b.toml")
    assert np.array_equal(ts.load_scene(tmp_path / "b.toml").position, scene.position)
    file.write_text('format = 1\n[[svg]]\nfile = "../a.svg"\n')
    with pytest.raises(ts.SceneError, match=r"svg\[0\].file: '../a.svg' lies outside the folder of the scene"):
        ts.load_scene(file)


# Refused ------------------------------------------------------------------------------------------------------------

BELOW = "which SVG has from 0 on"
ARC = '<svg xmlns="http://www.w3.org/2000/svg"><path d="M0 0A{} 0 0 1 3 3L0 3Z"/></svg>'
HUGE = '<svg xmlns="http://www.w3.org/2000/svg"><circle cx="{0}" cy="0" r="{0}"/></svg>'
OPEN = DRAWING.replace("H0 Z M5", "H0 M5")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"text": "a漢"}, "text.text: 'a漢' has '漢' (U+6F22), which the font DejaVu Sans does not have; take another letter"),
        ({"text": " \n"}, "text.text: ' \\n' is not allowed; it must be a text with something to see"),
        ({"text": "a", "font": "Dejavu Sans"}, "text.font: 'Dejavu Sans' is not installed; did you mean 'DejaVu Sans'?"),
        ({"text": "a", "font": "none.ttf"}, "text.font: 'none.ttf' is not there"),
        ({"text": "a", "font": "DejaVu Sans:fat"}, "text.font: 'DejaVu Sans:fat' is not allowed; it must be a family with"),
        ({"text": "a", "height": 0.0}, "text.height: 0.0 is not allowed; it must be greater than 0"),
        ({"text": "a", "kind": "stone"}, "text.kind: 'stone' is not allowed; it must be one of 'jelly', 'cloth', 'collider'"),
        ({"text": "a", "kind": "collider", "density": 3.0}, 'text.density: is not for kind = "collider"'),
        ({"text": "a", "kind": "cloth", "depth": 3.0}, "text.depth: is for jelly and colliders in a scene with dim = 3"),
        ({"text": "a", "spacing": 1e-5}, "text.spacing: 1e-05 is not allowed;"),
        ({"text": "a", "material": "coton"}, "text.material: 'coton' is not a material of this scene; did you mean 'cotton'?"),
        ({"text": 1001 * "a"}, "text.text: 'aaa"),
        ({"text": "a", "pinned": [10_000]}, "text.pinned[0]: 10000 is not allowed"),
        ({"text": "a", "position": (0, 0)}, "text.position: shape (2,) does not fit"),
        ({"text": "a", "kind": "cloth", "mass_per_area": -1.0}, "text.mass_per_area: -1.0 is not allowed"),
    ],
)  # fmt: skip
def test_what_is_refused_leaves_the_scene_as_it_was(given, message):
    assert_unchanged(ts.Scene(dim=3), lambda scene: ts.shapes.text(scene, **given), f"^{re.escape(message)}")


@pytest.mark.parametrize(
    ("drawing", "message"),
    [
        (
            OPEN,
            "has an open outline, the path 'frame', which goes from (10, 0) to (10, 40); close it, or give it fill=\"none\"",
        ),
        ("<svg", "cannot be read as SVG: "),
        ("<svg xmlns='http://www.w3.org/2000/svg'></svg>", "shows nothing that has an area"),
        (DRAWING.replace("#ff0000", "none").replace('"blue"', '"none"'), "shows no filled area"),
        (HUGE.format("1e300"), "has coordinates beyond 1e+50"),
        (HUGE.format("1e60"), "has coordinates beyond 1e+50"),
        (
            '<ellipse xmlns="http://www.w3.org/2000/svg" rx="2" ry="1"/>',
            "cannot be read as SVG: its root is <ellipse>, not <svg>",
        ),
        ("<g><rect width='2' height='1'/></g>", "cannot be read as SVG: its root is <g>, not <svg>"),
        ("<body/>", "cannot be read as SVG: its root is <body>, not <svg>"),
        *(
            (
                f"<svg xmlns='http://www.w3.org/2000/svg'><{one}/></svg>",
                f"cannot be read as SVG: <{one.split()[0]}> has {what}, {BELOW}",
            )
            for one, what in (
                ("rect width='-3' height='2'", "width='-3'"),
                ("rect width='3' height=' -2mm '", "height=' -2mm '"),
                ("rect width='3' height='2' rx='-.5'", "rx='-.5'"),
                ("circle r='-4e0'", "r='-4e0'"),
                ("ellipse rx='5' ry='-5%'", "ry='-5%'"),
                ("svg width='-7' height='8'", "width='-7'"),
            )
        ),
        (ARC.format("1e-290 1e-290"), "cannot be read as SVG: it has numbers that are too small or too large"),
        (ARC.format("3e-155 3e-155"), "has numbers "),
        (None, "is not there; it must be an existing .svg file"),
        *(
            (
                DRAWING.replace("scale(2)", wrong),
                f"cannot be read as SVG: transform='translate(10 0) {wrong}' is not as",
            )
            for wrong in (
                "scale(9e306) skewX(nan)",
                "rotate(1 2)",
                "matrix(1 0 0 1 2)",
                "scale(inf)",
                "turn(3)",
                "rotate(4",
            )
        ),
        (DRAWING.replace("scale(2)", "scale(3e307)"), "has coordinates beyond 1e+50"),
    ],
)
def test_drawings_that_are_refused(tmp_path, drawing, message):
    file = tmp_path / "a.svg"
    if drawing is not None:
        file.write_text(drawing)
    with pytest.raises(ts.SceneError) as caught:
        ts.shapes.svg(ts.Scene(dim=3), file)
    assert message in str(caught.value)
    assert str(caught.value).startswith("svg.file: ")


def test_transforms_as_others_write_them(tmp_path):
    """With commas, units and signs between numbers, in capitals, one after another, or none."""
    found = []
    for same in (
        "scale(2)",
        "scale(2,2)",
        " scale ( 1e0 +1 ) , scale(2.)",
        "matrix(2 0 0 2 0 0)",
        "rotate(-0deg)scale(2)",
    ):
        (tmp_path / "a.svg").write_text(
            DRAWING.replace("scale(2)", same).replace("<circle", '<circle transform="none"')
        )
        found.append([one.polygon.bounds for one in drawing_outlines("svg", tmp_path / "a.svg", 1.0)])
    assert np.allclose(found, found[0])


def test_without_the_packages(monkeypatch):
    monkeypatch.setitem(sys.modules, "shapely", None)
    with pytest.raises(ts.SceneError, match=r'^text: needs one more package: pip install "taichi-sim\[text\]"$'):
        ts.shapes.text(ts.Scene(dim=3), "a")


def test_a_spacing_that_is_too_coarse_is_refused():
    thin = shapely.box(0, 0, 1, 1e-9)
    with pytest.raises(ts.SceneError, match=r"text.spacing: 0.1 is too coarse for what is thin in its outline"):
        filled("text.spacing", thin.difference(shapely.box(0.4, 0, 0.6, 0.9999e-9)), 0.1)


@pytest.mark.parametrize(("word", "labels"), [("I", ["sign"]), ("OI", ["sign_0", "sign_1"])])
def test_colliders_of_letters_have_the_name_of_their_table(tmp_path, word, labels):
    file = tmp_path / "sign.toml"
    file.write_text(
        "format = 1\ndim = 3\n"
        "balls = [{ position = [[0, 9, 0]], radius = 0.1 }]\n"
        f'text = [{{ text = "{word}", kind = "collider", name = "sign" }}]\n'
    )
    scene = ts.load_scene(file)
    assert [one.label for one in scene.colliders] == labels
    assert [one.name for one in scene.objects] == []
    scene.save(file)
    assert [one.label for one in ts.load_scene(file).colliders] == labels


def test_a_letter_around_a_ball_is_named():
    scene = ts.Scene(dim=3)
    ts.shapes.text(scene, "I", kind="collider")
    scene.set_collider_name(0, "beam")
    scene.add_balls([scene.colliders[0].vertices.mean(axis=0)], radius=1e-3)
    with pytest.raises(ts.SceneError, match=r"^colliders\[0\]: the mesh 'beam' starts around ball 0, up to"):
        ts.Simulation(scene)
    with pytest.raises(ts.SceneError, match=r"colliders\[0\]\.name: 'beam' exists already"):
        scene.set_collider_name(0, "beam")


@pytest.mark.once
def test_a_speck_of_a_drawing_is_left_out_with_a_word(tmp_path):
    file = tmp_path / "specks.svg"
    rect = '<rect x="{0}" y="3" width="{1}" height="{1}"/>'
    marks = rect.format(0, 6) + rect.format(8, 0.002) + rect.format(9, 0.4)
    file.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 10 10">{marks}</svg>')
    scene = ts.Scene(dim=2)
    with pytest.warns(UserWarning, match=r"svg: 1 of 3 pieces are left out: .*0\.00\d* m wide, at \(") as told:
        ts.shapes.svg(scene, file, 3.0, spacing=1.0)
    assert told[0].filename == __file__
    assert np.ptp(scene.position[scene.solids], axis=1).min() > 0.1
    collider = ts.Scene(dim=2)
    ts.shapes.svg(collider, file, 3.0, spacing=1.0, kind="collider")
    assert collider.rest_length.min() < 0.01
