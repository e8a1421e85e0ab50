"""A bounded part of the referee: a batch of random scenes of each kind, and that the referee itself does what it says."""

import numpy as np
import pytest
from physics_support import F64
from referee.families import FAMILIES
from referee.observe import Case
from referee.relations import Relation
from referee.run import RELATIONS, judge, referee, table
from referee.scenes import Change, changed, components, merged, part, renumbered
from referee.shrink import shrink, toml

import taichi_sim as ts
from taichi_sim.scene.elements import ELEMENTS as KINDS

pytestmark = pytest.mark.skipif(not F64, reason="relations are held in double precision")
FROM_ANYWHERE = ("mirror", "elsewhere", "in_other_masses", "renumbered", "momentum_is_kept")  # in one simulation

SLOW, LONG = pytest.mark.slow, pytest.mark.long
SINGLE = (SLOW, pytest.mark.long_in("f64"))  # in single precision only, but in tests that take hours
DEPTH = ("nothing_overlaps_far",)
LEDGERS = ("momentum_with_the_colliders", "energy_with_the_work", "in_a_moving_frame", "mirror")


def _holds(family, seed, scenes, relations=None, mark=None):
    return pytest.param(family, seed, scenes, relations, id=f"{family}-{seed}", marks=mark or [])


def _fails(family, seed, scenes, reason, relations=None, mark=None):
    case = _holds(family, seed, scenes, relations, mark)
    return pytest.param(*case.values, id=case.id, marks=[*case.marks, pytest.mark.xfail(strict=True, reason=reason)])


@pytest.mark.parametrize(
    ("family", "seed", "scenes", "relations"),
    [
        _holds("few_balls", 7, 8, (*FROM_ANYWHERE, "energy_never_grows"), mark=LONG),
        _holds("chain", 4, 10, mark=SLOW),
        _holds("chain", 2, 10),
        _holds("sled", 2, 12),
        _holds("column", 0, 20, mark=SLOW),
        _holds("balloon", 1, 4),
        _holds("pendulum", 0, 12),
        _holds("folded_sheet", 0, 8),
        _holds("hollow_box", 6, 60, mark=SINGLE),
        _holds("held_by_a_stick", 2, 30, mark=SINGLE),
        _holds("thrown", 1, 4),
        _holds("on_a_stick", 1, 3, mark=SINGLE),
        _holds("driven", 1, 6, LEDGERS, LONG),
        _holds("thrown", 0, 4, mark=LONG),
        _holds("on_a_stick", 0, 5, mark=LONG),
        _holds("on_pinned_cloth", 1, 4, mark=LONG),
        _holds("heap", 1, 5, mark=LONG),
        _holds("driven", 0, 6, mark=LONG),
        _holds("mixed", 1, 1, mark=LONG),
        _holds("net", 2, 8, ("methods_agree", "one_thread_is_two", "single_is_near_double"), mark=LONG),
        _holds("neighbours", 3, 10, mark=LONG),
        _holds("balloon", 4, 4, mark=LONG),
        _holds("jelly_stays", 1, 6, mark=LONG),
        _holds("cluster", 1, 20, mark=LONG),
        _holds("elastic_row", 1, 20, mark=LONG),
        _holds("jelly_slides", 2, 8, mark=LONG),
        _holds("sled", 5, 4, mark=LONG),
        _holds("sled", 7, 8, mark=LONG),
        _holds("unequal_crowd", 0, 4, ("energy_never_grows",), mark=LONG),
        _fails("unequal_crowd", 0, 4, "masses 1 to 100: up to 0.6 of a radius for a moment", DEPTH, LONG),
        _holds("elastic_crowd", 1, 4, mark=LONG),
        _holds("heavy_crowd", 1, 4, ("energy_is_kept",), mark=LONG),
        _fails("heavy_crowd", 1, 4, "12 to 30 radii a step: up to 1.7 of a radius for a moment", DEPTH, LONG),
        _holds("slow_balls", 1, 10, mark=LONG),
        _holds("glancing", 0, 6, mark=LONG),
        _holds("led_chain", 0, 10, ("order_is_kept",), mark=LONG),
        _holds("free_continuum", 4, 4, mark=LONG),
        _holds("held_continuum", 2, 4, mark=LONG),
        _holds("torn_continuum", 3, 4, mark=LONG),
        _holds("driven_continuum", 5, 3, mark=LONG),
        _holds("resting_continuum", 3, 4, mark=LONG),
        _fails(
            "landing_continuum",
            (41, 11),
            8,
            "what an implicit stage of a body that lands presses into the floor is not held there: it is strained",
            ("energy_never_grows",),
            LONG,
        ),
    ],
)
@pytest.mark.slow_where(family=["pendulum", "folded_sheet", "sled", "balloon"])
def test_relations(family, seed, scenes, relations):
    chosen = FAMILIES[family]
    cases = list(chosen.draw(np.random.default_rng(seed), scenes))
    found = judge(cases, relations or chosen.relations)
    assert any(f.figure is not None for findings in found for f in findings)
    failing = [
        f"scene {k}: {f.relation} {f.figure:.3g}, allowed {f.tolerance:g}"
        for k, findings in enumerate(found)
        for f in findings
        if f.fails
    ]
    assert not failing, "\n".join(failing)


# The referee itself ---------------------------------------------------------------------------------------------------


@pytest.fixture
def mixed():
    """A bit of everything that a scene can have in 3D."""
    scene = ts.Scene(3, (0.0, -10.0, 0.0))
    scene.add_material("m", restitution=0.5, friction=0.25)
    scene.add_balls(
        [[0.0, 1.0, 0.0], [0.5, 1.0, 0.25]], radius=0.1, velocity=(1.0, 0.0, 0.5), mass=[1, 20], material="m"
    )
    ts.shapes.cloth(scene, (1, 1), (3, 3), mass_per_area=0.5, bending_rigidity=1e-3, position=(0, 2, 0))
    ts.shapes.jelly(scene, (0.4, 0.4, 0.4), (2, 2, 2), young_modulus=1e4, poisson_ratio=0.4, position=(2, 1, 0))
    ts.shapes.balloon(scene, (4.0, 1.0, 0.0), 0.3, 0)
    sheet = ts.shapes.cloth(
        scene, (1, 1), (3, 3), mass_per_area=0.2, warp=90, weft=40, shear=7, warp_angle=20, position=(0, 3, 0)
    )
    block = scene.add_balls([[5.0, 1, 0], [5.5, 1, 0], [5, 1.25, 0], [5, 1, 0.75]], radius=0.1, body=scene.new_body())
    scene.add_solids([block], young_modulus=1e4, poisson_ratio=0.4, viscosity=3.0)
    scene.add_cells([block], bulk_modulus=2e3, crush_modulus=1e3)
    ends = scene.add_springs([[sheet.balls[0], sheet.balls[8]], [block[0], block[3]]], stiffness=3.0)
    scene.add_motor(ends, amplitude=0.25, frequency=2.0, phase=[30.0, 60.0])
    scene.add_moving_pins([2], velocity=(0.0, 0.0, 1.0))
    scene.add_wall((0, 1, 0), 0.25, "m")
    scene.add_collider(ts.Box((0, 0, 4), (1, 2, 1), velocity=(0, 0, 1)))
    scene.add_collider(ts.Capsule((1, 0, 8), (2, 0, 8), 0.5, material="m"))
    scene.add_wind((1.0, 2.0, 3.0))
    return scene


BALLS = ("position", "velocity", "mass", "radius", "pinned", "body", "gravity")
SPRINGS = ("pairs", "stiffness", "damping", "rest_length", "triangles")
ELEMENTS = (
    *("cells", "bulk_modulus", "crush_modulus", "rest_volume", "bends", "bend_weights", "bend_stiffness"),
    *("membranes", "membrane_rest", "membrane_warp", "membrane_weft", "membrane_shear", "membrane_damping"),
    *("bricks", "brick_modulus", "brick_ratio", "brick_viscosity", "brick_size"),
    *("solids", "solid_modulus", "solid_ratio", "solid_viscosity", "solid_rest"),
)


def same(a, b):
    for name in (*BALLS, *SPRINGS, *ELEMENTS):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-15, atol=1e-15, err_msg=name)
    laws = [[(s.materials[k].restitution, s.materials[k].friction) for k in s.material] for s in (a, b)]
    assert laws[0] == laws[1]
    assert [(w.normal, w.offset) for w in a.walls] == [(w.normal, w.offset) for w in b.walls]
    for one, other in zip(a.colliders, b.colliders, strict=True):
        points = np.random.default_rng(0).uniform(-9, 9, (20, 3))
        np.testing.assert_allclose(one.distance(points, 0.5), other.distance(points, 0.5), atol=1e-13)
    assert [(g.pressure, g.volume) for g in a.gases] == [(g.pressure, g.volume) for g in b.gases]
    assert [(m.springs.tolist(), m.frequency, m.phase.tolist()) for m in a.motors] == [
        (m.springs.tolist(), m.frequency, m.phase.tolist()) for m in b.motors
    ]
    assert a.wind == b.wind


def test_changes_there_and_back_leave_the_scene(mixed):
    same(changed(mixed, Change()), mixed)
    mirror = Change(turn=np.diag([-1.0, 1.0, 1.0]))
    same(
        changed(
            changed(mixed, Change(length=2.0**-10, time=2.0**-5, mass=4.0)),
            Change(length=2.0**10, time=2.0**5, mass=0.25),
        ),
        mixed,
    )
    back = changed(changed(mixed, mirror), mirror)
    same(back, mixed)
    once = changed(mixed, mirror)
    assert once.position[0, 0] == -mixed.position[0, 0]
    assert once.gases[0].volume == pytest.approx(mixed.gases[0].volume)
    assert once.rest_volume == pytest.approx(mixed.rest_volume)
    for kind in KINDS:  # a mirror image of what is at rest is at rest
        assert kind.count(mixed) > 0, kind.name
        whole = np.ones(len(kind.corners(mixed)), dtype=bool)
        energy = kind.energies(mixed, mixed.position, whole)
        np.testing.assert_allclose(kind.energies(once, once.position, whole), energy, atol=1e-9, err_msg=kind.name)
    order = np.random.default_rng(0).permutation(mixed.n_balls)
    other = renumbered(mixed, order)
    np.testing.assert_array_equal(other.position, mixed.position[order])
    np.testing.assert_array_equal(order[other.pairs], mixed.pairs)


def test_side_by_side_nothing_is_lost(mixed):
    both = merged([mixed, mixed], [0.0, 64.0])
    assert both.n_balls == 2 * mixed.n_balls
    assert len(both.walls) == 1
    half = part(both, np.arange(mixed.n_balls, 2 * mixed.n_balls))
    assert half.n_springs == mixed.n_springs
    assert len(components(both)) == 2 * len(components(mixed)) == 14
    apart = ts.Scene(2)
    apart.add_balls([[0.0, 0.0]], radius=0.1)
    apart.add_wall((1, 0), -1.0)
    two = merged([apart, apart], [0.0, 8.0])
    assert [w.offset for w in two.walls] == [-1.0, 7.0]
    assert two.walls[1].mask != two.walls[0].mask


@pytest.mark.slow
@pytest.mark.long_in("f32")
def test_a_failing_scene_is_shrunk(mixed, monkeypatch, tmp_path):
    heavy = Relation("no_heavy_ball", 10.0, lambda case, _: float(case.scene.mass.max(initial=0.0)), lambda _: [])
    monkeypatch.setitem(RELATIONS, heavy.name, heavy)
    case, figure = shrink(Case(mixed, {"integrator": "verlet"}, 1.0), heavy.name)
    assert figure == 20.0
    assert case.scene.n_balls == 1
    assert not (case.scene.walls)
    assert not (case.scene.colliders)
    assert not (case.scene.wind)
    assert not (case.scene.gravity.any())
    text = toml(case)
    assert len(text.splitlines()) < 40
    (tmp_path / "scene.toml").write_text(text)
    again = ts.load_scene(tmp_path / "scene.toml")
    assert again.mass.tolist() == [20.0]
    assert again.settings == {"integrator": "verlet"}
    light = Case(part(mixed, [0]), {}, 1.0)
    assert shrink(light, heavy.name) == (light, 0.0)


def test_a_run_goes_on_where_it_was_ended(monkeypatch):
    drawn = Relation("small", 0.9, lambda case, _: float(case.scene.mass[0]), lambda _: [])
    monkeypatch.setitem(RELATIONS, drawn.name, drawn)

    def draw(rng, n):
        cases = []
        for _ in range(n):
            scene = ts.Scene(2)
            scene.add_balls([[0.0, 0.0]], radius=1.0, mass=rng.uniform(0.1, 1.0))
            cases.append(Case(scene, {}, 1.0))
        return cases

    kept = {}
    family = type(FAMILIES["sled"])("drawn", draw, ("small",), 10)
    whole = referee([family], 40, 3)[0]
    referee([family], 20, 3, kept, keep=lambda tallies, *at: kept.update(tallies))
    halves = referee([family], 40, 3, kept, 2, 20)[0]
    assert (
        (halves.scenes, halves.failures, halves.worst)
        == (whole.scenes, whole.failures, whole.worst)
        == (40, whole.failures, whole.worst)
    )
    assert whole.failures > 0
    assert "small" in table([whole])
