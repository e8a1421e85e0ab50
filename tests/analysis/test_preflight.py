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
