"""Balls, springs and colliders in messages: by number, and by the name of what they belong to."""

import pytest

import taichi_sim as ts
from taichi_sim.analysis.methods import VERLET
from taichi_sim.analysis.stability import stability
from taichi_sim.analysis.touching import overlap
from taichi_sim.scene.objects import ball_in_words, balls_in_words, pair_in_words

pytestmark = pytest.mark.once


def scene():
    """A loose ball, a rope called cable, and a rope without a name."""
    made = ts.Scene(dim=2, gravity=(0, -9.81))
    made.add_balls([[0, 5]], radius=0.1)
    made.set_name(ts.shapes.rope(made, (0, 0), (1, 0), 4).balls, "cable")
    ts.shapes.rope(made, (0, 2), (1, 2), 5, stiffness=1e6)
    return made


def test_balls_and_springs_in_words():
    objects = scene().objects
    assert ball_in_words(objects, 0) == "ball 0"
    assert ball_in_words(objects, 3) == "ball 3 (number 2 of cable)"
    assert ball_in_words(objects, 9) == "ball 9 (number 4 of rope_0)"
    assert balls_in_words(objects, [3]) == "ball 3 (number 2 of cable)"
    assert balls_in_words(objects, [0, 9]) == "balls 0, 9 (of rope_0)"
    assert balls_in_words(objects, [4, 5, 6, 7, 8]) == "balls 4, 5, 6 and 2 more (of cable, rope_0)"
    assert pair_in_words(objects, 5, 6) == "balls 5 and 6 of rope_0"
    assert pair_in_words(objects, 4, 5) == "balls 4 and 5 of cable and rope_0"
    assert pair_in_words(objects, 0, 0) == "balls 0 and 0"


def test_messages_name_what_they_are_about():
    made = scene()
    made.set_balls([4], position=[[0.5, 2.0]])
    said = overlap(made, made.position, 0.0, 7, 7 / 3)
    assert said == "ball 7 (number 2 of rope_0) and ball 4 (number 3 of cable) overlap by 2.3 of the smaller radius"
    assert " of rope_0, k = 1e+06 N/m" in stability(scene(), VERLET).reason


def test_what_starts_in_a_collider_is_named_with_it():
    made = scene()
    made.add_collider(ts.Sphere((0.5, 2.0), 0.2, name="post"))
    with pytest.raises(
        ts.SceneError, match=r"^colliders\[0\]: the sphere 'post' starts around ball 7 \(number 2 of rope_0\)"
    ):
        ts.Simulation(made)
