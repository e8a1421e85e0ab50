"""Warnings before a run; nothing is compiled."""

import pytest

import taichi_sim as ts
from taichi_sim.analysis.accuracy import Setup
from taichi_sim.analysis.methods import IMPLICIT_EULER, TR_BDF2, VERLET, XPBD
from taichi_sim.analysis.preflight import cautions

pytestmark = pytest.mark.once


def of_tearing(scene: ts.Scene, method, h: float) -> list[str]:
    return [words for words in cautions(scene, Setup(method, h, "f64")) if words.startswith("tearing: ")]


def chain(break_strain: float | None) -> ts.Scene:
    """Springs of 4e4 N/m between balls of 2 kg: each answers a pull in 5 ms."""
    scene = ts.Scene(dim=2)
    scene.add_balls([[0.4 * k, 0.0] for k in range(5)], radius=0.05, mass=2.0)
    scene.add_springs([[k, k + 1] for k in range(4)], stiffness=4e4, break_strain=break_strain)
    return scene


@pytest.mark.parametrize("method", [IMPLICIT_EULER, TR_BDF2, XPBD])
def test_what_tears_is_warned_of_where_steps_do_not_resolve_it(method):
    (words,) = of_tearing(chain(0.1), method, 1 / 90)
    assert words.startswith("tearing: springs that may tear answer to a pull within 0.005 s")
    assert words.endswith("take verlet, or steps of 0.0025 s")
    assert not of_tearing(chain(0.1), method, 2e-3)
    assert not of_tearing(chain(None), method, 1 / 90)
    assert not of_tearing(chain(0.1), VERLET, 1 / 90)  # whose bound is warned of anyway


def test_triangles_whose_sides_tear_count_by_their_membrane():
    """Their sides carry springs of zero stiffness."""
    said = []
    for stiffness in (20.0, 2e4):
        scene = ts.Scene(dim=3)
        ts.shapes.cloth(
            scene, size=(1, 1), resolution=(6, 6), warp=stiffness, weft=stiffness, mass=4.0, break_strain=0.3
        )
        said.append(len(of_tearing(scene, IMPLICIT_EULER, 1 / 200)))
    assert said == [0, 1]


def test_stiff_parts_that_cannot_tear_do_not_count():
    scene = chain(0.1)
    scene.add_balls([[0.0, 1.0], [0.4, 1.0]], radius=0.05, mass=2.0)
    scene.add_springs([[5, 6]], stiffness=4e8)
    assert not of_tearing(scene, IMPLICIT_EULER, 2e-3)


def truss(restitution: float, damping: float = 0.0) -> ts.Scene:
    """Balls of 0.5 kg on springs of 450 N/m over a floor."""
    scene = ts.Scene(dim=2, gravity=(0.0, -9.0))
    scene.add_material("steel", restitution=restitution)
    balls = scene.add_balls([[0, 1], [1, 1], [0, 2], [1, 2]], radius=0.1, mass=0.5, material="steel")
    scene.add_springs(balls[[[0, 1], [1, 3], [3, 2], [2, 0], [0, 3], [1, 2]]], stiffness=450.0, damping=damping)
    scene.add_wall((0, 1), material="steel")
    return scene


@pytest.mark.parametrize(
    ("method", "restitution", "damping", "warns"),
    [
        (VERLET, 1.0, 0.0, True),
        (TR_BDF2, 0.95, 0.0, True),
        (IMPLICIT_EULER, 0.9, 0.4, True),
        (VERLET, 1.0, 0.4, False),  # damped
        (TR_BDF2, 0.7, 0.0, False),
        (IMPLICIT_EULER, 0.5, 0.0, False),
        (XPBD, 1.0, 0.0, False),  # it says so itself
    ],
)
def test_bodies_that_bounce_at_steps_too_long_for_them_are_warned_of(method, restitution, damping, warns):
    scene = truss(restitution, damping)
    said = [words for words in cautions(scene, Setup(method, 0.012, "f64", "jacobi")) if words.startswith("bounce: ")]
    assert len(said) == warns
    if warns:
        step = float(said[0].split()[-2])
        assert 0.003 < step < 0.012
        assert not [w for w in cautions(scene, Setup(method, 0.99 * step, "f64", "jacobi")) if w.startswith("bounce: ")]


@pytest.mark.parametrize("method", [TR_BDF2, IMPLICIT_EULER])
def test_steps_in_which_bodies_have_no_restitution_of_their_own_are_told(method):
    scene = truss(0.3, 0.0)
    (words,) = [
        words for words in cautions(scene, Setup(method, 0.03, "f64", "jacobi")) if words.startswith("bounce: ")
    ]
    assert "by their elasticity alone, without the restitution of 0.3" in words
    step = float(words.split()[-2])
    assert 0.005 < step < 0.03
    assert not [w for w in cautions(scene, Setup(method, step, "f64", "jacobi")) if w.startswith("bounce: ")]
    assert not [w for w in cautions(truss(0.0, 0.0), Setup(method, 0.03, "f64", "jacobi")) if w.startswith("bounce: ")]


def test_only_what_collides_is_warned_of_its_bounces():
    setup = Setup(VERLET, 0.012, "f64", rule="off")
    assert not [words for words in cautions(truss(1.0), setup) if words.startswith("bounce: ")]
