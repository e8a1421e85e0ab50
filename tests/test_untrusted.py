"""Scenes, arrays and meshes from anywhere: what they ask for is bounded before it is made, and judged as added by hand."""

import json
import struct
import zipfile

import numpy as np
import pytest
from typer.testing import CliRunner

import taichi_sim as ts
from taichi_sim.analysis.collider_checks import check_colliders
from taichi_sim.cli.main import main
from taichi_sim.common.memory import available
from taichi_sim.common.npz import read_npz
from taichi_sim.contacts import distance_grid
from taichi_sim.contacts.distance_grid import distance_grids
from taichi_sim.geometry.mesh import read_surface
from taichi_sim.reports.speed_error import command
from taichi_sim.scene.columns import Table
from taichi_sim.scene.document import document, fill
from taichi_sim.scene.parts import PARTS
from tests.fuzz.state_files import everything

pytestmark = pytest.mark.once

HEAD = "format = 1\ndim = 3\n"
BALL = "[[balls]]\nposition = [[0, 0, 0]]\nradius = 0.1\n"
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


def written(folder, text, name="scene.toml"):
    (folder / name).write_text(text)
    return folder / name


# Scene files -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        f"a = {'[' * 700}{']' * 700}", f"a{'.b' * 4000} = 1", f"a{' . b' * 30_000} = 1", f"[a{'.b' * 30_000}]",
        f"a = {'[' * 30}{']' * 30}",
    ],
)  # fmt: skip
def test_nothing_lies_deep(tmp_path, text):
    with pytest.raises(ts.SceneError, match=r"line 3.*more than 16 deep"):
        ts.load_scene(written(tmp_path, HEAD + text + "\n"))


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("pile]]\nradius = 1.0\nresolution = [40_000, 30_000, 2]", r"line 5: pile\[0\].resolution: .* GB are free"),
        ("rope]]\nstart = [0, 0, 0]\nend = [1, 0, 0]\nn = 30_000_000_000", r"rope\[0\].n: .* GB are free"),
        ("wheel]]\ncentre = [0, 0, 0]\nradius = 1.0\nspokes = 30_000_000_000", r"wheel\[0\].spokes: .* GB are free"),
        ("tower]]\nlevels = 2\nresolution = [3_000_000, 3_000_000, 3_000_000]", r"tower\[0\].levels: .* GB are free"),
        ("balloon]]\ncentre = [0, 0, 0]\nradius = 1\nsubdivisions = 900_000_000", r"subdivisions: .* from 0 to 30"),
        ("balloon]]\ncentre = [0, 0, 0]\nradius = 1e-200", r"line 5: balloon\[0\].radius: 1e-200 .* at least 1e-50"),
        (f"balls]]\nposition = [[0, 0, 0]]\nradius = {'3' * 5000}", r"is not valid TOML: .* 5000 digits"),
    ],
)
def test_sizes_are_bounded_first(tmp_path, table, message):
    with pytest.raises(ts.SceneError, match=message):
        ts.load_scene(written(tmp_path, f"{HEAD}[[{table}\n"))


def test_a_table_that_grows_is_copied_seldom():
    table, kept = Table(x=np.zeros((0, 2))), []
    for k in range(1000):
        table.append(1, x=np.full((1, 2), float(k)))
        kept.append(table["x"])
    assert table["x"][:, 0].tolist() == list(range(1000))
    assert len({id(x if x.base is None else x.base) for x in kept}) < 30
    table.cut(10)
    table.append(1, x=np.ones((1, 2)))
    assert table["x"][:, 1].tolist() == [*range(10), 1]


class Counted(list):
    """A list that counts the items that are looked at."""

    looked_at = 0

    def __getitem__(self, key):
        found = super().__getitem__(key)
        self.looked_at += len(found) if isinstance(key, slice) else 1
        return found

    def __iter__(self):
        self.looked_at += len(self)
        return super().__iter__()


def test_many_of_a_kind_are_added_in_as_many_steps():
    scene = ts.Scene()
    scene.materials, scene.moving_pins, scene.probes = Counted(scene.materials), Counted(), Counted()
    scene.motors = Counted()
    scene.add_balls([[k, 0] for k in range(301)], radius=0.1)
    scene.add_springs([[k, k + 1] for k in range(300)], stiffness=1.0)
    for k in range(300):
        scene.add_material(f"m{k}")
        scene.add_moving_pins([k], velocity=(1, 0))
        scene.add_motor([k], amplitude=0.1, frequency=1.0)
        scene.add_probe(f"p{k}", "position", balls=[k])
    for kind in (scene.materials, scene.moving_pins, scene.motors, scene.probes):
        assert kind.looked_at < 10 * len(kind)
    for again in (lambda: scene.add_material("m7"), lambda: scene.add_probe("p7", "energy")):
        with pytest.raises(ts.SceneError, match="exists already"):
            again()
    with pytest.raises(ts.SceneError, match="ball 7 is named twice"):
        scene.add_moving_pins([7], velocity=(0, 1))


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('[[colliders]]\nshape = "sphere"\ncenter = [0.0, 0.0, 0.0]\nradius = 2.0\n', 6),
        ('[[walls]]\nnormal = [0.0, 1.0, 0.0]\ncollides_with = "nobody"\n', 8),
        ("[[cloth]]\nresolution = [4, 4]\nsurface_collision = true\n[[moving_pins]]\nballs = [1]\nvelocity = [3e5, 0, 0]\n", 9),
    ],
)  # fmt: skip
def test_what_only_a_simulation_finds_has_its_line(tmp_path, text, line):
    scene = ts.load_scene(written(tmp_path, HEAD + BALL + text))
    with pytest.raises(ts.SceneError) as caught:
        scene.has_groups() or check_colliders(scene, 2e-3)
    assert caught.value.line == line
    assert "scene.toml, line" in str(caught.value)


def test_grids_of_meshes_fit_into_memory_together(tmp_path, monkeypatch):
    mesh = '[[colliders]]\nshape = "mesh"\nmesh = "m.obj"\nresolution = 20\n'
    written(tmp_path, OBJ, "m.obj")
    scene = ts.load_scene(written(tmp_path, HEAD + BALL + mesh * 3))
    corners = distance_grids(scene)[0].value.size
    monkeypatch.setattr(distance_grid, "available", lambda: int(2.5 * distance_grid.memory_of(corners)))
    with pytest.raises(ts.SceneError, match=r"line 17: colliders\[2\].resolution: 20 is not allowed; the grids"):
        distance_grids(scene)


RAGGED = [[0], [1, 2]]


@pytest.mark.parametrize(
    ("text", "place"),
    [
        (f"[output.camera]\nazimuth = 1.0\ndistance = 2.0\nfollow = {RAGGED}", "output.camera.follow"),
        (
            f"[[moving_pins]]\nballs = [0]\npath = [[0.0, [0, 0, 0], {RAGGED}], [1.0, [0, 0, 1]]]",
            "moving_pins[0].path[0]",
        ),
        (
            f"[[moving_pins]]\nballs = [0]\npath = [[0.0, [0, 0, 0]], [1.0, [0, 0, 1], {RAGGED}]]",
            "moving_pins[0].path[1].rotation",
        ),
        (
            '[[colliders]]\nshape = "sphere"\nradius = 1.0\ncenter = [9, 9, 9]\n'
            f"path = [[0.0, [0, 0, 0], {RAGGED}], [1.0, [0, 0, 1], {RAGGED}]]",
            "colliders[0].path[0].rotation",
        ),
    ],
)
def test_lists_of_different_lengths_have_their_place(tmp_path, text, place):
    with pytest.raises(ts.SceneError) as caught:
        ts.load_scene(written(tmp_path, HEAD + BALL + text + "\n"))
    assert f": {place}" in str(caught.value)
    assert caught.value.line


@pytest.mark.parametrize(
    "add",
    [
        lambda s: s.add_moving_pins(RAGGED, velocity=(1, 0)),
        lambda s: s.add_moving_pins([0], rotation_rate=RAGGED),
        lambda s: s.attach(RAGGED, [0], stiffness=1.0),
        lambda s: s.set_group(RAGGED, "a"),
        lambda s: s.add_probe("p", "position", balls=RAGGED),
    ],
)
def test_lists_of_different_lengths_in_python(add):
    scene = ts.Scene()
    scene.add_balls([[0, 0], [1, 0], [2, 0]], radius=0.1)
    with pytest.raises(ts.SceneError):
        add(scene)


def test_what_was_added_later_has_no_line(tmp_path):
    scene = ts.load_scene(written(tmp_path, HEAD + BALL))
    scene.add_collider(ts.Sphere((0, 0, 0), 2.0))
    with pytest.raises(ts.SceneError, match=r"^colliders\[0\]: the sphere starts around"):
        check_colliders(scene, 2e-3)


def test_a_report_names_the_line_of_a_setting(tmp_path):
    file = written(tmp_path, HEAD + "[simulation]\ndt = 2e-3\ntolerance = 1e-2\n" + BALL)
    with pytest.raises(ts.SceneError, match=r"scene.toml, line 5: simulation.tolerance: chooses the step"):
        command.read(str(file), limit=1.0, tolerance="1e-3", duration=None)


# Files that a scene names ------------------------------------------------------------------------------------------


def test_files_outside_the_folder_need_an_option(tmp_path):
    folder = tmp_path / "scene"
    folder.mkdir()
    np.savez(tmp_path / "up.npz", position=[[0, 0, 0]])
    written(tmp_path, OBJ, "up.obj")
    (folder / "link.obj").symlink_to(tmp_path / "up.obj")
    for table, key in (
        ('balls]]\nradius = 1.0\nfile = "../up.npz"', "balls[0].file"),
        (f'balls]]\nradius = 1.0\nfile = "{tmp_path}/up.npz"', "balls[0].file"),
        ('cloth]]\nmesh = "../up.obj"', "cloth[0].mesh"),
        ('cloth]]\nmesh = "link.obj"', "cloth[0].mesh"),
        ('jelly]]\nmesh = "../up.obj"\nspacing = 0.3', "jelly[0].mesh"),
        (f'colliders]]\nshape = "mesh"\nresolution = 4\nposition = [9, 9, 9]\nmesh = "../up.obj"\n{BALL}', "colliders[0].mesh"),
    ):  # fmt: skip
        file = written(folder, f"{HEAD}[[{table}\n")
        with pytest.raises(ts.SceneError) as caught:
            ts.load_scene(file)
        assert f"{key}: " in str(caught.value)
        assert "--allow-outside" in str(caught.value)
        assert caught.value.line
        assert ts.load_scene(file, allow_outside=True).n_balls
    file = written(folder, f'{HEAD}[[balls]]\nradius = 1.0\nfile = "../up.npz"\n')
    shown = CliRunner().invoke(main, ["check", str(file)])
    assert shown.exit_code == 2
    for name in ("run", "view", "check", "report", "tune"):
        assert "--allow-outside" in CliRunner().invoke(main, [name, "--help"]).output


@pytest.mark.parametrize("name", ["", ".", "a\\u0000b", "/dev/zero", "no.npz"])
def test_what_is_no_file_is_refused(tmp_path, name):
    file = written(tmp_path, f'{HEAD}[[balls]]\nradius = 1.0\nfile = "{name}"\n')
    with pytest.raises(ts.SceneError, match=r"line 5: balls\[0\].file: "):
        ts.load_scene(file, allow_outside=True)


def bomb(path, size):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("x.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "|u1", "fortran_order": False, "shape": (size,)})
        for _ in range(size >> 20):
            file.write(bytes(1 << 20))


def test_a_bomb_is_refused_by_its_headers(tmp_path):
    bomb(tmp_path / "bomb.npz", 200 << 20)
    with pytest.raises(ts.SceneError, match=r"bomb.npz: holds arrays of 0.21 GB in 0.204 MB, and 100 times"):
        read_npz(tmp_path / "bomb.npz")
    file = written(tmp_path, f'{HEAD}[[balls]]\nradius = 1.0\nfile = "bomb.npz"\n')
    with pytest.raises(ts.SceneError, match=r"line 5: balls\[0\].file: .*bomb.npz' holds arrays of"):
        ts.load_scene(file)


def with_header(path, header, size=80):
    with zipfile.ZipFile(path, "w") as archive, archive.open("x.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, {"fortran_order": False, **header})
        file.write(bytes(size))


def test_what_cannot_be_sought_is_refused(tmp_path):
    """The first member begins before the file does."""
    np.savez(tmp_path / "x.npz", a=np.arange(3))
    data = bytearray((tmp_path / "x.npz").read_bytes())
    data[-6:-2] = (2**31).to_bytes(4, "little")  # where the list of members begins
    (tmp_path / "x.npz").write_bytes(data)
    with pytest.raises(ts.SceneError, match=r"x.npz: cannot be read as .npz arrays"):
        read_npz(tmp_path / "x.npz")


def test_a_limit_of_the_process_counts(monkeypatch):
    resource = pytest.importorskip("resource")
    assert available() > 0
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (1 << 20, resource.RLIM_INFINITY))
    assert available() == 0


@pytest.mark.parametrize(
    "header",
    [
        {"descr": "<f8", "shape": (10**12,)},
        {"descr": "<f8", "shape": (11,)},
        {"descr": "<f8", "shape": (-1,)},
        {"descr": "|O", "shape": (10,)},
        {"descr": "|V0", "shape": (10**18,)},
        {"descr": [("a", "<f8")], "shape": (10,)},
    ],
    ids=str,
)
def test_headers_that_lie_are_refused(tmp_path, header):
    with_header(tmp_path / "x.npz", header)
    with pytest.raises(ts.SceneError, match=r"x.npz: cannot be read as .npz arrays: 'x' "):
        read_npz(tmp_path / "x.npz")


def test_arrays_come_as_they_were_written(tmp_path):
    kept = {
        "a": np.arange(12.0).reshape(3, 4),
        "b": np.asfortranarray(np.arange(6).reshape(2, 3)),
        "c": np.array("text"),
    }
    kept |= {"d": np.zeros((0, 3), dtype=np.int32), "e": np.array([True, False])}
    np.savez_compressed(tmp_path / "x.npz", **kept)
    found = read_npz(tmp_path / "x.npz")
    for name, array in kept.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype
        assert found[name].flags.writeable
    assert list(read_npz(tmp_path / "x.npz", "b")) == [""]


def test_meshes_in_any_encoding_and_false_ones(tmp_path):
    (tmp_path / "latin.obj").write_bytes(b"# caf\xe9\n" + OBJ.encode())
    assert len(read_surface(tmp_path / "latin.obj").triangles) == 4
    (tmp_path / "false.stl").write_bytes(b"\xe9\xff" * 40 + struct.pack("<I", 7) + bytes(100))
    with pytest.raises(ts.SceneError, match=r"false.stl' .* of 7 triangles that would have 434 bytes, and it has 184"):
        read_surface(tmp_path / "false.stl")


def test_faces_of_vertices_that_there_are_not(tmp_path):
    head = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    )
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    body = struct.pack("<9f", *range(9))
    for last in (3, -1):
        (tmp_path / "a.ply").write_bytes(head.encode() + body + struct.pack("<Biii", 3, 0, 1, last))
        with pytest.raises(
            ts.SceneError, match=rf"a.ply' has face 0 \(from 0\) of vertices \[0, 1, {last}\], and there are 3"
        ):
            read_surface(tmp_path / "a.ply")


def test_what_a_gltf_says_is_bounded(tmp_path):
    header = {"buffers": [{"byteLength": 9, "uri": "../up.bin"}]}
    (tmp_path / "a.gltf").write_text(json.dumps(header))
    with pytest.raises(ts.SceneError, match=r"names '../up.bin', which lies outside its folder"):
        read_surface(tmp_path / "a.gltf")
    (tmp_path / "a.gltf").write_text(
        json.dumps({"accessors": [{"count": 10**12, "componentType": 5126, "type": "VEC3"}]})
    )
    with pytest.raises(ts.SceneError, match=r"accessors\[0\] would have 1000000000000 items"):
        read_surface(tmp_path / "a.gltf")
    nodes = [{"mesh": 0}] * 3000
    corners = {"count": 4, "componentType": 5126, "type": "VEC3"}
    faces = [{"attributes": {"POSITION": 0}}] * 3000
    text = json.dumps({"accessors": [corners], "meshes": [{"primitives": faces}], "nodes": nodes})
    (tmp_path / "a.gltf").write_text(text)
    with pytest.raises(ts.SceneError, match=r"needs about .* GB of memory"):
        read_surface(tmp_path / "a.gltf")


# Arrays and plain values -------------------------------------------------------------------------------------------


WHOLE = everything()


VALUES, ARRAYS = document(WHOLE)


def again(arrays=None, values=None):
    """The scene, from its document with some arrays and plain values in the place of others; None: gone."""
    scene = ts.Scene(dim=3)
    fill(scene, VALUES | (values or {}), {k: one for k, one in (ARRAYS | (arrays or {})).items() if one is not None})
    return scene


def test_a_scene_comes_back_from_its_document():
    assert {part.name for part in PARTS} - VALUES.keys() == {
        "attachments",
        "bricks",
        "membranes",
        "solids",
    }  # which become springs; see also their own tests
    scene = again()
    values, arrays = document(scene)
    assert values == VALUES
    assert arrays.keys() == ARRAYS.keys()
    for name, before in ARRAYS.items():
        np.testing.assert_array_equal(before, arrays[name], err_msg=name)
        assert before.dtype == arrays[name].dtype
    assert scene.new_body() == WHOLE.new_body()


def item(name, index, value):
    array = ARRAYS[name].copy()
    array[index] = value
    return {name: array}


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        (item("balls.mass", 2, -3.0), "balls.mass[2]: -3.0 is not allowed; it must be greater than 0"),
        (item("balls.radius", 1, np.nan), "balls.radius[1]: nan is not allowed; it must be a finite number"),
        (item("balls.group", 1, -4), "balls.group[1]: -4 is not allowed; it must be bits of the 2 groups there are, one or more"),
        (item("balls.mask", 1, 8), "balls.mask[1]: 8 is not allowed; it must be bits of the 2 groups there are, or -1 for all"),
        (item("balls.material", 3, 2), "balls.material[3]: 2 is not allowed; it must name a material, from 0 to 1"),
        (item("balls.body", 0, -1), "balls.body[0]: -1 is not allowed"),
        (item("balls.velocity", 0, 2.0), "balls.velocity[0][0]: 2.0 is not allowed; it must be 0, it is pinned"),
        (item("balls.colour", (1, 1), 2.0), "balls.colour[1][0]: nan is not allowed; it must be from 0 to 1, or all three nan"),
        (item("springs.pairs", (1, 0), -1), "springs.pairs[1]: [-1, 2] is not allowed; it must name a ball, from 0 to 3"),
        (item("springs.break_strain", 0, -1.0), "springs.break_strain[0]: -1.0 is not allowed"),
        (item("triangles.triangles", (2, 0), 9), "triangles.triangles[2]: [9, 2, 3] is not allowed"),
        (item("cells.rest_volume", 0, 0.0), "cells.rest_volume[0]: 0.0 is not allowed; it must be greater than 0"),
        (item("bending.weights", (0, 0), 3.0), "bending.weights[0]: "),
        (item("embedded_surfaces.0.weights", (0, 0), 3.0), "embedded_surfaces[0].weights[0]: "),
        (item("gases.0.triangles", (0, 0), -1), "gases[0].triangles[0]: [-1, 2, 1] is not allowed"),
        (item("moving_pins.0.balls", 0, 4), "moving_pins[0].balls[0]: 4 is not allowed"),
        (item("probes.0.springs", 1, 2), "probes[0].springs[1]: 2 is not allowed"),
        ({"balls.mass": np.ones((4, 1))}, "balls.mass: shape (4, 1) does not fit; it must be one number or 4 of them"),
        ({"balls.mass": np.ones(3)}, "balls.mass: shape (3,) does not fit; it must be one number or 4 of them"),
        ({"balls.body": np.ones(3, dtype=int)}, "balls.body: shape (3,) does not fit; it must have as many rows"),
        ({"balls.mass": np.array(list("1234"))}, "balls.mass: ['1', '2', '3', '4'] is not a number or a list of numbers"),
        ({"balls.pinned": np.zeros(4)}, "balls.pinned: [0.0, 0.0, 0.0, 0.0] does not fit"),
        ({"balls.material": np.zeros(4)}, "balls.material: [0.0, 0.0, 0.0, 0.0] is not a list of integers"),
        ({"balls.radius": None}, "balls.radius: is missing; there is no array 'balls.radius'"),
        ({"embedded_surfaces.0.corners": None}, "embedded_surfaces[0].corners: is missing"),
        ({"gases.0.triangles": None}, "gases[0].triangles: is missing; there is no array 'gases.0.triangles'"),
    ],
    ids=lambda value: value.split(" ")[0] if isinstance(value, str) else "",
)  # fmt: skip
def test_every_array_is_judged(arrays, message):
    with pytest.raises(ts.SceneError) as caught:
        again(arrays)
    assert str(caught.value).startswith(message)


WALL, GAS, PINS = (VALUES[name][0] for name in ("walls", "gases", "moving_pins"))


@pytest.mark.parametrize(
    ("plain", "message"),
    [
        ({"walls": [WALL | {"material": 5}]}, "walls[0].material: 5 is not a material of this scene"),
        ({"walls": [WALL | {"normal": [0, 0, 0]}]}, "walls[0].normal: [0.0, 0.0, 0.0] is not allowed; it must be a vector"),
        ({"walls": [WALL | {"offset": np.nan}]}, "walls[0].offset: nan is not allowed"),
        ({"walls": [WALL | {"group": -2}]}, "walls[0].group: -2 is not allowed"),
        ({"walls": [WALL, WALL | {"offset": np.nan}]}, "walls[1].offset: nan is not allowed"),
        ({"walls": [WALL | {"more": 1}]}, "walls[0]: got an unexpected keyword argument 'more'"),
        ({"walls": 3}, "walls: 3 is not allowed; it must be a list of tables"),
        ({"materials": [{"name": "default", "friction": -1}]}, "materials[0].friction: -1.0 is not allowed"),
        ({"materials": [{"name": "rubber"}]}, "materials: must begin with the one called 'default'"),
        ({"groups": ["a", "a"]}, "groups: ['a', 'a'] is not allowed; it must be a list of different names"),
        ({"groups": [3]}, "groups: [3] is not allowed"),
    ],
    ids=lambda value: value.split(" ")[0] if isinstance(value, str) else "",
)  # fmt: skip
def test_every_plain_value_is_judged(plain, message):
    with pytest.raises(ts.SceneError) as caught:
        again(values=plain)
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    ("about", "message"),
    [
        ({"gases": [GAS | {"volume": 0}]}, "gases[0].volume: 0.0 is not allowed"),
        ({"gases": [GAS | {"pressure": -1}]}, "gases[0].pressure: -1.0 is not allowed"),
        ({"gases": [{"volume": 1.0}]}, "gases[0]: missing a required "),
        (
            {"gases": [GAS | {"triangles": {"array": "none"}}]},
            "gases[0].triangles: is missing; there is no array 'none'",
        ),
        ({"gases": None}, "gases: None is not allowed; it must be a list of tables"),
        ({"moving_pins": [PINS | {"speed": 1}]}, "moving_pins[0]: got an unexpected keyword argument 'speed'"),
        ({"moving_pins": [PINS | {"rotation_rate": [[1], [2, 3]]}]}, "moving_pins[0].rotation_rate: "),
        ({"wind": 3}, "wind: "),
        ({"wind": {"velocity": [1, 2]}}, "wind.velocity: shape (2,) does not fit"),
        ({"probes": [{"kind": "strain"}]}, "probes[0]: missing a required "),
        ({"probes": [{"kind": "strain", "name": []}]}, "probes[0].name: [] is not allowed"),
    ],
    ids=lambda value: value.split(" ")[0] if isinstance(value, str) else "",
)
def test_every_element_is_judged(about, message):
    with pytest.raises(ts.SceneError) as caught:
        again(values=about)
    assert str(caught.value).startswith(message)


def test_pins_that_tear_a_surface_across_the_scene_are_refused():
    scene = ts.Scene(dim=3)
    ts.shapes.cloth(scene, resolution=(5, 5), surface_collision=True)
    scene.add_moving_pins([3], velocity=(0, 4e4, 0))
    check_colliders(scene, 1e-5)
    with pytest.raises(ts.SceneError, match=r"moving_pins\[0\]: leads some balls .* 80 m in one step of 0.002 s"):
        check_colliders(scene, 2e-3)
    whole = ts.Scene(dim=3)
    cloth = ts.shapes.cloth(whole, resolution=(5, 5), surface_collision=True)
    whole.add_moving_pins(cloth.balls, velocity=(0, 4e4, 0))  # nothing in it moves against the rest
    check_colliders(whole, 2e-3)
