"""What a warning of overlaps names."""

import numpy as np
import pytest

import taichi_sim as ts
from taichi_sim.analysis import touching
from taichi_sim.analysis.touching import further_overlap, overlap, overlap_of_bodies

pytestmark = pytest.mark.once


def test_what_is_touched_is_named():
    scene = ts.Scene(dim=2)
    scene.add_wall((0, 1), -5.0)
    scene.add_wall((0, 1), 0.0)
    scene.add_collider(ts.Box((3.0, 0.0), (1.0, 1.0)))
    scene.add_collider(ts.Sphere((6.0, 0.0), 1.0, name="globe"))
    x = [[0.0, 0.05], [3.0, 0.55], [6.0, 1.02], [9.0, 4.0], [9.25, 4.0], [20.0, 20.0]]
    scene.add_balls(x, radius=[0.1, 0.1, 0.1, 0.2, 0.1, 0.1])
    said = [overlap(scene, np.array(x), 0.0, ball, part) for ball, part in enumerate([0.5, 0.501, 0.8, 0.5, 0.5, 0.3])]
    assert said == [
        "ball 0 and wall 1 overlap by 0.5 of the smaller radius",
        "ball 1 and collider 0 overlap by 0.5 of the smaller radius",
        "ball 2 and collider 'globe' overlap by 0.8 of the smaller radius",
        "ball 3 and ball 4 overlap by 0.5 of the smaller radius",
        "ball 4 and ball 3 overlap by 0.5 of the smaller radius",
        "ball 5 and what it touches overlap by 0.3 of the smaller radius",
    ]


def test_what_moves_is_where_it_is_at_that_time():
    scene = ts.Scene(dim=2)
    scene.add_collider(ts.Sphere((0.0, 0.0), 1.0, velocity=(1.0, 0.0), name="globe"))
    scene.add_balls([[2.0, 1.0]], radius=0.1, pinned=True)
    scene.add_moving_pins([0], path=[{"time": 0.0, "position": (0.0, 0.0)}, {"time": 9.0, "position": (0.0, 1.0)}])
    words = overlap(scene, np.array([[2.0, 1.0]]), 2.0, 0, 1.0)
    assert words == "moving pin 0 and collider 'globe' overlap by 1 of the smaller radius"


@pytest.mark.parametrize(
    ("apart", "pinned", "told"), [(0.1, False, True), (0.24, False, True), (0.1, True, False), (0.5, False, False)]
)
def test_bodies_in_one_place_are_told_of_before_a_run(apart, pinned, told):
    """Not those that cannot move, nor those that are apart."""
    scene = ts.Scene(dim=2)
    block = {"size": (0.3, 0.2), "resolution": (4, 3), "young_modulus": 1e4, "poisson_ratio": 0.3, "pinned": pinned}
    for k in range(2):
        ts.shapes.jelly(scene, position=(k * apart, 0.01), **block)
    assert ("of jelly_1) overlap by" in overlap_of_bodies(scene, 0.5)) == told


@pytest.mark.parametrize("kind", ["springs", "solids", "bricks", ""])
def test_balls_of_one_element_that_never_collide_overlap_nothing(kind):
    def scene(radius):
        one = ts.Scene(dim=2)
        one.add_balls([[0.0, 0.0], [0.3, 0.0], [0.0, 0.3], [0.3, 0.3]], radius=radius)
        if kind == "springs":
            one.add_springs([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]], stiffness=1.0)
        elif kind == "solids":
            one.add_solids([[0, 1, 2], [1, 3, 2], [0, 1, 3]], young_modulus=1.0, poisson_ratio=0.3)
        elif kind == "bricks":
            one.add_bricks([[0, 2, 1, 3]], young_modulus=1.0, poisson_ratio=0.3)
        return one

    assert bool(further_overlap(scene(0.1), scene(0.26))) == (not kind)


@pytest.mark.parametrize("at_once", [7, 1000])
def test_overlaps_are_those_of_all_pairs(monkeypatch, at_once):
    """Of a crowd of all sizes, some of it pinned, joined, of one body, or of a group that does not meet another."""
    monkeypatch.setattr(touching, "MEASURED", at_once)
    rng = np.random.default_rng(4)
    scene = ts.Scene(dim=2)
    x, r = rng.uniform(0.0, 1.0, (60, 2)), rng.uniform(0.02, 0.2, 60)
    for k in range(3):
        scene.add_balls(
            x[20 * k : 20 * k + 20],
            radius=r[20 * k : 20 * k + 20],
            pinned=k == 2,
            group=f"group {k % 2}",
        )
    scene.add_springs(rng.permuted(np.tile(np.arange(60), (9, 1)), axis=1)[:, :2], stiffness=1.0)
    scene.set_balls(slice(3, 30), body=scene.new_body())
    joined = set(map(tuple, np.sort(scene.excluded_pairs(), axis=1).tolist()))
    found = {}
    for i in range(60):
        for j in range(i + 1, 60):
            apart = scene.body[i] == 0 or scene.body[i] != scene.body[j]
            meets = (scene.group[i] & scene.mask[j]) and (scene.group[j] & scene.mask[i])
            deep = (r[i] + r[j] - np.hypot(*(x[i] - x[j]))) / min(r[i], r[j])
            if deep > 0.0 and apart and meets and not (i >= 40 and j >= 40) and (i, j) not in joined:
                found[i, j] = deep
    said = {(min(i, j), max(i, j)): deep for i, j, deep in touching._overlapping(scene, np.arange(60))}
    assert said == pytest.approx(found)
    assert len(found) > 100
