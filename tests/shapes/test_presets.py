"""Materials that are known by name."""

import numpy as np
import pytest
from typer.testing import CliRunner

import taichi_sim as ts
from taichi_sim.cli.main import main
from taichi_sim.scene.document import document
from taichi_sim.scene.presets import KES_BENDING, KES_SHEAR, KES_WEIGHT, PRESETS

pytestmark = pytest.mark.once


def test_the_command_lists_them_with_their_sources():
    shown = CliRunner().invoke(main, ["materials"])
    assert shown.exit_code == 0
    for name, preset in PRESETS.items():
        assert f"{name}: " in shown.stdout
        assert preset.source in shown.stdout
        assert len(preset.source) > 40


def test_a_cloth_of_a_preset_is_the_one_with_its_numbers():
    named, given = ts.Scene(dim=3), ts.Scene(dim=3)
    silk = PRESETS["silk"]
    ts.shapes.cloth(named, resolution=(5, 5), material="silk")
    given.add_material("silk", friction=silk.friction)
    keys = ("mass_per_area", "stretch_stiffness", "shear_stiffness", "bending_rigidity", "bending_weft")
    ts.shapes.cloth(given, resolution=(5, 5), material="silk", **{key: getattr(silk, key) for key in keys})
    assert named.materials == given.materials
    for key, column in document(named)[1].items():
        np.testing.assert_array_equal(column, document(given)[1][key], err_msg=key)
    assert named.mass.sum() == pytest.approx(0.069)


FABRICS = {name: preset for name, preset in PRESETS.items() if preset.warp is not None}


@pytest.mark.parametrize("name", FABRICS)
def test_a_fabric_has_threads_that_a_sheet_and_a_mesh_take(name):
    """By warp_angle alone; what is given goes before the preset, and with a warp the threads are all one's own."""
    known = FABRICS[name]

    def made(**options):
        scene = ts.Scene(dim=3)
        ts.shapes.cloth(scene, material=name, warp_angle=30.0, **options)
        return scene

    mesh = ([[0, 0, 0], [1, 0, 0], [0, 0, 1], [1.0, 0, 1]], [[0, 2, 1], [1, 2, 3]])
    for scene in (made(resolution=(3, 4)), made(mesh=mesh)):
        assert scene.n_springs == 0
        assert scene.mass.sum() == pytest.approx(known.mass_per_area)
        for key in ("warp", "weft", "shear", "coupling"):
            assert (getattr(scene, f"membrane_{key}") == (getattr(known, key) or 0.0)).all()
    assert (made(mesh=mesh, shear=7.0).membrane_shear == 7.0).all()
    own = made(mesh=mesh, warp=5e3)
    assert (own.membrane_weft == 5e3).all()
    assert (own.membrane_shear == 1e3).all()
    one, other = made(mesh=mesh, bending_rigidity=2e-5), made(mesh=mesh, bending_rigidity=2e-5, bending_weft=2e-5)
    np.testing.assert_array_equal(one.bend_stiffness, other.bend_stiffness)


def test_units_of_fabric_tests():
    """A strip 1 cm wide bent by 1 gf cm at 1/cm; one sheared by 1 gf/cm at 1 degree; 1 mg on 1 cm^2."""
    assert pytest.approx(9.80665e-5 / 1e-2 * 1e-2) == KES_BENDING
    assert pytest.approx(0.980665 * 180 / np.pi) == KES_SHEAR
    assert pytest.approx(1e-6 / 1e-4) == KES_WEIGHT
    assert PRESETS["wool"].bending_rigidity == pytest.approx(6.5704555e-06)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_rope_of_a_preset_and_a_radius_is_a_solid_rod_of_it(dim):
    wood, radius, length = PRESETS["wood"], 0.02, 3.0
    area = np.pi * radius**2
    ends = (0.0,) * dim, (length, *[0.0] * (dim - 1))

    def made(**options):
        scene = ts.Scene(dim=dim)
        scene.add_material("own", friction=0.4)
        return scene, shapes_columns(scene, ts.shapes.rope(scene, *ends, 7, **options))

    scene, named = made(material="wood", radius=radius)
    own = {"young_modulus": wood.young_modulus, "mass_per_length": wood.density * area}
    for key, column in made(material="own", radius=radius, **own)[1].items():
        np.testing.assert_array_equal(named[key], column, err_msg=key)
    assert scene.mass.sum() == pytest.approx(wood.density * area * length)
    assert named["stiffness"] * length / 6 == pytest.approx(wood.young_modulus * area)
    # what is given goes before the preset
    for given in ({"mass": 3.0}, {"mass_per_length": 1.0}):
        heavy, columns = made(material="wood", radius=radius, **given)
        assert heavy.mass.sum() == pytest.approx(3.0)
        assert columns["stiffness"] == pytest.approx(named["stiffness"])
    soft = made(material="wood", radius=radius, EA=50.0)
    assert soft[1]["stiffness"] * length / 6 == pytest.approx(50.0)
    assert len(soft[0].bends) == 0
    assert soft[0].mass.sum() == pytest.approx(wood.density * area * length)
    limp = made(material="wood", radius=radius, EI=0.0)
    assert limp[1]["stiffness"] == pytest.approx(named["stiffness"])
    assert len(limp[0].bends) == 0
    # without a radius, of a chain, or of a material of cloth only the preset's touch is meant
    for material, options in (
        ("wood", {}),
        ("wood", {"radius": radius, "stiffness": 9.0}),
        ("silk", {"radius": radius}),
    ):
        usual, columns = made(material=material, **options)
        for key, column in made(material="own", **options)[1].items():
            np.testing.assert_array_equal(columns[key], column, err_msg=key)
        assert usual.mass.sum() == pytest.approx(0.1 * length)


def shapes_columns(scene, rope):
    """Numbers that a rope is made of."""
    springs = {key: getattr(scene, key)[rope.springs] for key in ("stiffness", "damping", "rest_length")}
    return springs | {"mass": scene.mass[rope.balls], "bends": scene.bend_stiffness}


def test_a_mesh_has_no_shear_stiffness_of_its_own():
    scene = ts.Scene(dim=3)
    ts.shapes.cloth(scene, mesh=([[0, 0, 0], [1, 0, 0], [0, 0, 1]], [[0, 2, 1]]), material="denim")
    assert scene.mass.sum() == pytest.approx(0.324 / 2)


def test_what_is_given_goes_before_the_preset():
    scene = ts.Scene(dim=3)
    heavy = ts.shapes.cloth(scene, resolution=(5, 5), material="silk", mass=3.0)
    assert scene.mass[heavy.balls].sum() == pytest.approx(3.0)
    springy = ts.shapes.cloth(scene, resolution=(5, 5), material="silk", stiffness=7.0)
    assert scene.stiffness[springy.springs].max() == 7.0
    body = ts.shapes.jelly(scene, size=(1, 1, 1), resolution=(3, 3, 3), material="gelatine", density=500.0)
    assert scene.mass[body.balls].sum() == pytest.approx(500.0)


def test_a_sheet_of_triangles_weighs_density_times_thickness():
    def made(**options):
        scene = ts.Scene(dim=3)
        ts.shapes.cloth(scene, (2.0, 0.5), (4, 3), **options)
        return scene

    rubber, steel = PRESETS["rubber"], PRESETS["steel"]
    thick = made(material="rubber", young_modulus=3e6, thickness=4e-3)
    assert thick.mass.sum() == pytest.approx(rubber.density * 4e-3)
    alone = made(material="rubber", thickness=2e-3)
    assert alone.mass.sum() == pytest.approx(rubber.density * 2e-3)
    assert alone.membrane_warp == pytest.approx(rubber.young_modulus * 2e-3 / (1 - rubber.poisson_ratio**2))
    assert made(material="steel", thickness=5e-4).mass.sum() == pytest.approx(steel.density * 5e-4)
    # what is given goes before that, and cotton has no density, but a mass per area
    assert made(material="steel", thickness=5e-4, mass=0.3).mass.sum() == pytest.approx(0.3)
    assert made(material="steel", thickness=5e-4, mass_per_area=0.7).mass.sum() == pytest.approx(0.7)
    cotton = made(material="cotton", young_modulus=1e6, thickness=3e-3)
    assert cotton.mass.sum() == pytest.approx(PRESETS["cotton"].mass_per_area)
    with pytest.raises(ts.SceneError, match=r"cloth\.thickness: is missing"):
        made(material="rubber", young_modulus=1e6)


@pytest.mark.parametrize("key", ["weft", "shear", "coupling", "warp_angle", "poisson_ratio", "thickness"])
def test_a_key_of_triangles_alone_is_refused(key):
    with pytest.raises(ts.SceneError, match=r"cloth\.\w+: is missing; "):
        ts.shapes.cloth(ts.Scene(dim=3), (1, 1), (3, 3), **{key: 0.3})


def test_the_warp_of_a_sheet_that_is_alike_in_all_directions_has_no_angle():
    with pytest.raises(ts.SceneError, match=r"cloth\.warp_angle: does not go with young_modulus"):
        ts.shapes.cloth(ts.Scene(dim=3), (1, 1), (3, 3), young_modulus=1e6, thickness=1e-3, warp_angle=30.0)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_jelly_has_the_ratio_of_its_preset(dim):
    scene = ts.Scene(dim=dim)
    for name in ("glass", "wood", "gelatine"):
        ts.shapes.jelly(scene, (1.0,) * dim, (2,) * dim, material=name)
    assert scene.brick_ratio == pytest.approx([0.22, 0.3, 0.49])


def test_a_material_of_the_scene_goes_before_a_preset():
    scene = ts.Scene(dim=3)
    scene.add_material("cotton", friction=0.9)
    ts.shapes.cloth(scene, resolution=(3, 3), material="cotton")
    assert scene.materials[1].friction == 0.9
    assert scene.mass.sum() == pytest.approx(0.2)  # the default, not that of cotton


def test_bodies_balls_and_walls(tmp_path):
    for dim in (2, 3):
        scene = ts.Scene(dim=dim)
        body = ts.shapes.jelly(scene, size=(1,) * dim, resolution=(3,) * dim, material="gelatine")
        assert scene.mass[body.balls].sum() == pytest.approx(1020.0 if dim == 3 else 102.0)
        heap = ts.shapes.pile(scene, (2,) * dim, 0.1, material="steel", position=(5,) * dim)
        each = 7850 * np.pi * 0.01 * 0.1 if dim == 2 else 7850 * 4 / 3 * np.pi * 1e-3
        assert scene.mass[heap.balls] == pytest.approx(np.full(2**dim, each))
        scene.add_wall((0, 1, 0)[:dim], material="wood")
        scene.add_collider(ts.Sphere((9,) * dim, 1.0, material="sand"))
        assert [m.name for m in scene.materials] == ["default", "gelatine", "steel", "wood", "sand"]
    file = tmp_path / "a.toml"
    file.write_text('format = 1\ndim = 3\n[[cloth]]\nresolution = [3, 3]\nmaterial = "denim"\n')
    scene = ts.load_scene(file)
    assert (scene.materials[1].name, scene.materials[1].friction) == ("denim", 0.5)
    scene.save(tmp_path / "b.toml")
    assert ts.load_scene(tmp_path / "b.toml").materials == scene.materials


@pytest.mark.parametrize(
    "add",
    [
        lambda s: ts.shapes.cloth(s, material="coton"),
        lambda s: s.add_balls([0, 0, 0], radius=0.1, material="coton"),
        lambda s: s.add_wall((0, 1, 0), material="coton"),
        lambda s: s.add_collider(ts.Sphere((0, 0, 0), 1.0, material="coton")),
    ],
)
def test_an_unknown_one_is_refused_in_one_sentence(add):
    scene = ts.Scene(dim=3)
    with pytest.raises(ts.SceneError) as caught:
        add(scene)
    assert str(caught.value).endswith("material: 'coton' is not a material of this scene; did you mean 'cotton'?")
    assert (scene.n_balls, len(scene.materials)) == (0, 1)


@pytest.mark.parametrize(
    "add",
    [
        lambda s: ts.shapes.cloth(s, material="silk", pinned=[9999]),
        lambda s: s.add_balls([0, 0, 0], radius=0.1, material="silk", colour=(9, 9, 9)),
        lambda s: s.add_wall((0, 1, 0), material="silk", collides_with=[3]),
        lambda s: s.add_collider(ts.Sphere((0, 0, 0), -1.0, material="silk")),
    ],
)
def test_what_is_refused_leaves_no_material(add):
    scene = ts.Scene(dim=3)
    with pytest.raises(ts.SceneError):
        add(scene)
    assert len(scene.materials) == 1
