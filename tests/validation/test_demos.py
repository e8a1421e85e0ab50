"""Every built-in scene, run to its end without pictures and judged by its own check."""

from runpy import run_path

import numpy as np
import pytest
from scipy.spatial import cKDTree

import taichi_sim as ts
from taichi_sim.files.source import built_in, demos, open_scene, resolve
from taichi_sim.geometry.intersections import crossings
from taichi_sim.render.content import Content

pytestmark = pytest.mark.once

DEMOS = demos()


def check_box(sim):
    """Nothing leaves the box nor overlaps by more than a tenth of a radius, and everything rests."""
    assert abs(sim.position[:, 0]).max() < 2.3 - 0.05 + 0.005
    assert sim.penetration() < 0.005
    assert abs(sim.velocity).max() < 0.05
    assert sim.energy().kinetic < 1e-4 * sim.energy().gravity


QUICK = ("shell",)
LONG = (
    "box",
    "car",
    "flag",
    "million",
    "net",
    "octopus",
    "pudding",
    "silk",
    "sphere",
    "stairs",
    "squeeze",
    "tower",
    "wind",
    "wrecking",
    "thread/05_restitution",
    "thread/13_ball_collisions",
    "thread/15_ball_stick",
    "thread/16_many_kinds",
)  # up to minutes each
BRIEF = ("cloth", "eel", "jelly", "shell")  # the others in which surfaces are drawn
CHECKS = {"box": check_box}  # scene files hold no code


def _how_long(name):
    return [] if name in QUICK else [pytest.mark.long if name in LONG else pytest.mark.slow]


@pytest.mark.parametrize("name", [pytest.param(name, marks=_how_long(name)) for name in DEMOS])
def test_demo_ends_as_its_check_says(name):
    scene = open_scene(DEMOS[name])
    assert scene is not None, "a demo defines scene(), so that its output and settings are known"
    check = CHECKS.get(name) or run_path(str(DEMOS[name]))["check"]
    with ts.Simulation(scene) as sim:
        if name in LONG and scene.dim == 3:
            _nothing_pierces_itself(sim)
        sim.run(scene.output["duration"] - sim.time)
        check(sim)


@pytest.mark.long
@pytest.mark.parametrize("name", BRIEF)
def test_surfaces_that_are_drawn_do_not_pierce_themselves(name):
    with ts.Simulation(open_scene(DEMOS[name])) as sim:
        _nothing_pierces_itself(sim)


def _nothing_pierces_itself(sim):
    """In no frame of the demo."""
    for k, frame in enumerate(sim.frames(sim.scene.output["fps"], sim.scene.output["duration"])):
        shown = Content.of(frame, 1.0)
        x = np.concatenate([frame.position, shown.binding.apply(frame.position)])
        assert len(crossings(x, shown.triangles)) == 0, f"frame {k}"


@pytest.mark.parametrize("name", ["drum", "net", "million", "stairs"])
def test_balls_that_collide_do_not_overlap_at_the_start(name):
    """Balls that overlap fly apart, with energy that nothing gave them. Those of one body, spring or brick do not collide."""
    scene = open_scene(DEMOS[name], parameters={"layers": 2} if name == "million" else {})
    x, r, body = np.asarray(scene.position), np.asarray(scene.radius), np.asarray(scene.body)
    near = np.sort(cKDTree(x).query_pairs(2.2 * r.max(), output_type="ndarray"), axis=1)
    edges = [scene.bricks[:, [i, j]] for i in range(scene.bricks.shape[1]) for j in range(i)]
    joined = np.sort(np.concatenate([scene.pairs, *edges]), axis=1) @ [scene.n_balls, 1]
    apart = (body[near[:, 0]] != body[near[:, 1]]) | (body[near[:, 0]] == 0)
    near = near[apart & ~np.isin(near @ [scene.n_balls, 1], joined)]
    gap = np.linalg.norm(x[near[:, 0]] - x[near[:, 1]], axis=1) - r[near].sum(axis=1)
    assert gap.min() > -1e-6 * r.max()


@pytest.mark.parametrize("name", DEMOS)
def test_demo_says_in_one_line_what_one_sees(name):
    line = built_in(DEMOS[name])
    assert line.endswith(".") or DEMOS[name].suffix == ".toml"
    assert 20 < len(line) <= 130


def test_thread_follows_the_article_in_order():
    numbers = [int(name.split("/")[1][:2]) for name in DEMOS if name.startswith("thread/")]
    assert numbers == list(range(1, 17))


def test_demos_are_found_by_their_short_names():
    for name, file in DEMOS.items():
        assert resolve(name.rsplit("/", 1)[-1]) == file
