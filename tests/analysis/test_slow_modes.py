"""Slowest motions of strings and beams against their exact frequencies, and how `check` words them."""

import re

import numpy as np
import pytest
from statics import at_rest

import taichi_sim as ts
from taichi_sim.analysis.methods import IMPLICIT_EULER, VERLET
from taichi_sim.analysis.slow_modes import not_worked_out, slow_decays
from taichi_sim.reports import check

pytestmark = pytest.mark.once

LENGTH, MASS, STRETCH, H = 0.7, 0.02, 900.0, 1e-5  # m, kg/m, N, s


def rope(dim, n, **more):
    """A rope along a slanted line."""
    scene = ts.Scene(dim=dim)
    along = np.array([0.6, 0.8]) if dim == 2 else np.array([2.0, 3.0, 6.0]) / 7.0
    start = np.arange(dim) - 0.3
    ts.shapes.rope(scene, start, start + LENGTH * along, n, EA=STRETCH, radius=1e-3, **more)
    return scene


def frequencies(scene, method=VERLET):
    return np.array([mode.frequency for mode in slow_decays(scene, method, H, scene.position)])


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("tension", [3.0, 40.0])
def test_a_string_between_two_nails(dim, tension):
    """n / (2 L) sqrt(T / mu), each once for every direction across."""
    rest = LENGTH / (1.0 + tension / STRETCH)
    scene = rope(dim, 41, length=rest, mass=MASS * LENGTH, pinned="border")
    exact = np.arange(1, 4) / (2.0 * LENGTH) * np.sqrt(tension / MASS)
    assert frequencies(scene)[: 3 * (dim - 1)] == pytest.approx(np.repeat(exact, dim - 1), rel=5e-3)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(("ends", "roots"), [("clamped", [1.875104]), ("free", [4.730041, 7.853205])])
def test_a_beam(dim, ends, roots):
    """(x / L)^2 sqrt(EI / mu) / (2 pi), cos x cosh x = -1 of one end clamped, 1 of both free."""
    n, rigidity = 41, 0.004
    clamped = ends == "clamped"
    scene = rope(dim, n, mass_per_length=MASS, EI=rigidity, pinned=[0, 1] if clamped else False)
    free = LENGTH * (n - 2) / (n - 1) if clamped else LENGTH
    exact = (np.array(roots) / free) ** 2 * np.sqrt(rigidity / MASS) / (2.0 * np.pi)
    found = frequencies(scene)[: len(roots) * (dim - 1)]
    assert found == pytest.approx(np.repeat(exact, dim - 1), rel=8e-3)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_chain_that_hangs_from_its_end(dim):
    """j / (4 pi) sqrt(g / L), j the zeros of J0; unstretched at the start, so that its weight is yet to pull."""
    g, n = 7.0, 41
    scene = ts.Scene(dim=dim, gravity=[0, -g, 0][:dim])
    down = np.array([0, -1, 0])[:dim]
    ts.shapes.rope(scene, 0 * down, LENGTH * down, n, EA=STRETCH, mass=0.3, pinned=[0])
    exact = np.array([2.404826, 5.520078]) / (4.0 * np.pi) * np.sqrt(g / LENGTH)
    assert frequencies(scene)[: 2 * (dim - 1)] == pytest.approx(np.repeat(exact, dim - 1), rel=0.01)


@pytest.mark.parametrize("rounding", [np.float64, np.float32])
@pytest.mark.parametrize(("n", "far"), [(101, 0.0), (41, 100.0), (201, -7.0)])
def test_a_chain_of_many_balls_or_far_away_is_no_other(n, far, rounding):
    """Coordinates are rounded to more than its stretch; differences, and the weight below, are known."""
    g, length = 7.0, 0.8
    scene = ts.Scene(dim=2, gravity=(0, -g))
    ts.shapes.rope(scene, (far, 0), (far, -length), n, mass=0.06, pinned=[0])
    exact = 2.404826 / (4.0 * np.pi) * np.sqrt(g / length)
    assert slowest(scene, scene.position.astype(rounding)) == pytest.approx(exact, rel=0.01)
    hangs = scene.position.copy()  # stretched by the weight below, as it comes to rest
    weight = np.cumsum(scene.mass[::-1])[::-1][1:] * g
    strain = weight / (scene.stiffness * scene.rest_length)
    hangs[1:, 1] = -np.cumsum(scene.rest_length * (1.0 + strain))
    assert slowest(scene, hangs.astype(rounding)) == pytest.approx(exact, rel=0.01)


def slowest(scene, position):
    return slow_decays(scene, VERLET, H, position.astype(float))[0].frequency


@pytest.mark.parametrize("dim", [2, 3])
def test_a_cable_between_two_points(dim):
    """Unstretched at the start it has the modes of where it comes to rest, found by Newton's method."""
    scene = ts.Scene(dim=dim, gravity=[0, -7.0, 0][:dim])
    ends = np.array([[0.1, 0.0, 0.2], [0.9, 0.3, 0.2]])[:, :dim]
    ts.shapes.rope(scene, *ends, 25, length=1.2, EA=STRETCH, mass=0.3, pinned="border")
    rest, _ = at_rest(scene, scene.position * (1.0, 1.002, 1.0)[:dim], most=1e-9)
    found, exact = (slow_decays(scene, VERLET, H, x)[0].frequency for x in (scene.position, rest))
    assert found == pytest.approx(exact, rel=0.02)
    assert exact < 2.0


def test_a_level_rope_is_not_near_its_place_of_rest():
    """Nothing resists that it falls."""
    scene = ts.Scene(dim=2, gravity=(0, -7.0))
    ts.shapes.rope(scene, (0, 0), (LENGTH, 0), 21, EA=STRETCH, mass_per_length=MASS, pinned="border")
    assert frequencies(scene)[0] == pytest.approx(np.sqrt(STRETCH / MASS) / (2.0 * LENGTH), rel=0.01)


def test_bends_damp_what_bends():
    """Every mode of a beam whose bends are damped by a time decays by half of that times omega^2."""
    scene, time = rope(2, 21, mass_per_length=MASS, EI=0.004, damping=0.0), 2e-4
    scene.set_bending(damping=time * scene.bend_stiffness)
    modes = slow_decays(scene, VERLET, H, scene.position)
    rates = [0.5 * time * (2.0 * np.pi * mode.frequency) ** 2 for mode in modes]
    assert [mode.exact for mode in modes] == pytest.approx(rates, rel=1e-6)
    assert [mode.found for mode in modes] == pytest.approx(rates, rel=1e-2)


def test_check_names_the_slowest_first():
    """Also where the step is more wrong of a faster one, which it names as well."""
    tension = 11.0
    scene = rope(2, 12, length=LENGTH / (1.0 + tension / STRETCH), mass=MASS * LENGTH, damping=0.0, pinned="border")
    slow = frequencies(scene)
    for method, h in ((VERLET, 1e-5), (IMPLICIT_EULER, 1e-4)):
        lines = list(check.damping(scene, method, h, scene.position))
        named = [float(one) for line in lines for one in re.findall(r"([\d.]+) Hz", line)]
        assert named[0] == pytest.approx(slow[0], rel=5e-3)
        assert (len(lines) == 1) is (method is VERLET)
    assert named[1] == pytest.approx(slow[-1], rel=5e-3)


@pytest.mark.parametrize("gravity", [0.0, 6.0])
@pytest.mark.parametrize("pinned", ["corners", False])
def test_swings_that_no_spring_resists_are_slower_than_what_is_named(gravity, pinned):
    """A flat net that hangs, whose sag no spring resists; a free one falls and turns, whose slowest motion is meant."""
    scene = ts.Scene(dim=3, gravity=(0, -gravity, 0))
    ts.shapes.net(scene, size=(0.8, 0.7), meshes=(3, 4), stiffness=5e4, pinned=pinned)
    lines = list(check.damping(scene, IMPLICIT_EULER, 0.004, scene.position))
    hangs = bool(gravity and pinned)
    assert ("the slowest motion that springs resist, " in lines[0]) is hangs
    assert any("slower ones, such as a swing, " in line for line in lines) is hangs
    assert any("take tr_bdf2, or steps of" in line for line in lines) is not hangs


@pytest.mark.parametrize("ground", ["wall", "collider"])
@pytest.mark.parametrize("gap", [0.0, 0.1])
def test_what_stands_on_something_is_said_to_be_as_if_free(ground, gap):
    """A column whose ends are free has twice the frequency of one that stands."""
    scene = ts.Scene(dim=2, gravity=(0, -7.0))
    balls = scene.add_balls([[0.0, 0.05 + gap + 0.12 * k] for k in range(7)], radius=0.05, mass=0.1)
    scene.add_springs(np.stack([balls[:-1], balls[1:]], axis=1), stiffness=4e3)
    if ground == "wall":
        scene.add_wall((0, 1))
    else:
        scene.add_collider(ts.Box((0.0, -0.5), (2.0, 1.0)))
    line = next(check.damping(scene, VERLET, 1e-4, scene.position))
    assert ("the slowest motion, as if nothing held what touches walls or colliders, " in line) is (gap == 0.0)


def test_what_is_not_worked_out():
    scene = rope(2, 5, mass=1.0, EI=0.1)
    assert not not_worked_out(scene)
    scene = ts.Scene(dim=2)
    ts.shapes.jelly(scene, size=(1.0, 1.0), resolution=(3, 3), young_modulus=100.0)
    scene.add_springs([[0, 8]], stiffness=1.0)
    assert not_worked_out(scene).endswith("this scene also has bricks")
