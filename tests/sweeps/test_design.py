"""What is varied, and which points that makes."""

import numpy as np
import pytest

import taichi_sim as ts
from taichi_sim.studies.intervals import half_width
from taichi_sim.sweeps.design import Design, axes_of, axis_of
from taichi_sim.sweeps.effects import Group, grouped, main_effects, sobol
from taichi_sim.sweeps.points import Point, Row

pytestmark = pytest.mark.once


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("1,2.5,verlet,true", (1, 2.5, "verlet", True)),
        ("0.1:0.9:5", (0.1, 0.3, 0.5, 0.7, 0.9)),
        ("1:5:3", (1, 3, 5)),
        ("1e2:1e4:3:log", (100.0, 1000.0, 10000.0)),
        ("4", (4,)),
        ("5:1:2", (5, 1)),
    ],
)
def test_values(text, values):
    found = axis_of("x", text).values
    assert found == pytest.approx(values) if all(isinstance(v, float) for v in values) else found == values
    assert [type(v) for v in found] == [type(v) for v in values]


def test_ranges_and_sequences():
    assert (axis_of("x", "1e2:1e4:log").low, axis_of("x", "1e2:1e4:log").log) == (100.0, True)
    assert axis_of("x", np.array([1.0, 2.0])).values == (1.0, 2.0)
    assert axis_of("x", [(0, 1), (1, 2)]).values == ([0, 1], [1, 2])
    assert [axis.path for axis in axes_of(["a.b=1,2", " c[0].d =1:2:2"])] == ["a.b", "c[0].d"]


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"x": "1:1:3"}, "x: '1:1:3' is an empty range"),
        ({"x": "1:2:0"}, "x: '1:2:0' is not allowed; .*the number of values is from 1"),
        ({"x": "a:b"}, "x: 'a:b' is not allowed"),
        ({"x": "0:1:3:log"}, "both ends are above 0"),
        ({"x": "1,,2"}, "x: '1,,2' is not allowed"),
        ({"x": []}, "x: has no values"),
        ({"x": 3}, "x: 3 is not allowed; it must be a list of values"),
        (["x"], "vary: 'x' is not allowed; it must be PATH=VALUES"),
        (["x=1", "x=2"], "x: is varied twice"),
    ],
)
def test_what_is_refused(given, why):
    with pytest.raises(ts.SceneError, match=why):
        axes_of(given)


@pytest.mark.parametrize(
    ("kind", "points", "why"),
    [
        ("grid", None, "design: 'grid' is not allowed; it must be one of product"),
        ("product", None, "y: is a range; give a number of values"),
        ("latin", None, "points: None is not allowed"),
        ("sobol", 6, "points: 6 is not allowed; it must be a power of 2"),
        ("product", 5, "points: are for the designs"),
    ],
)
def test_designs_that_do_not_go_together(kind, points, why):
    with pytest.raises(ts.SceneError, match=why):
        Design(axes_of({"x": "1,2", "y": "0:1"}), kind, points).check()


@pytest.mark.parametrize("luck", [-1, 0.5, 2**32, True])
def test_luck_is_a_seed(luck):
    with pytest.raises(ts.SceneError, match=r"^luck: .* it must be a whole number from 0 to 4294967295"):
        Design(axes_of({"y": "0:1"}), "latin", 4, luck).check()


def test_products_and_samples():
    axes = axes_of({"x": "1,2", "y": "0:1:3"})
    product = Design(axes)
    assert (product.count, list(product)[1]) == (6, {"x": 1, "y": 0.5})
    axes = axes_of({"a": "10:20", "b": "1e2:1e4:log", "c": "u,v"})
    for kind in ("random", "latin", "sobol"):
        design = Design(axes, kind, 16, luck=3)
        points = list(design)
        assert len(points) == design.count == (80 if kind == "sobol" else 16)
        assert points == list(design)
        assert points != list(Design(axes, kind, 16, luck=4))
        assert all(10 <= p["a"] <= 20 and 100 <= p["b"] <= 10000 and p["c"] in "uv" for p in points)
    latin = [p["a"] for p in Design(axes, "latin", 16)]
    assert sorted(int((a - 10) * 1.6) for a in latin) == list(range(16))


def test_a_point_is_known_by_what_it_is():
    assert Point({"a": 1, "b": 2.0}, 3).key == Point({"b": 2.0, "a": 1}, 3).key
    assert len({Point({"a": 1}, 3).key, Point({"a": 1}, 4).key, Point({"a": 1}).key, Point({"a": 2}, 3).key}) == 4


def rows_of(design, function, seeds=(None,)):
    points = [Point(parameters, seed) for parameters in design for seed in seeds]
    return points, [Row.of(p, measures={"m": function(p.seed, **p.parameters)}) for p in points]


def test_effects_of_a_sum():
    """m = 3 x + y over the same values: nine tenths of the variance are x's."""
    design = Design(axes_of({"x": "0:1:5", "y": "0:1:5"}))
    _, rows = rows_of(design, lambda seed, x, y: 3 * x + y)
    first, second = main_effects(grouped(rows, "m"), ["y", "x"])
    assert (first.path, second.path) == ("x", "y")
    assert (first.share, second.share) == pytest.approx((0.9, 0.1))
    assert (first.low, first.high) == pytest.approx((0.5, 3.5))


def test_sobol_indices_of_the_ishigami_function():
    """The published values, .3139, .4424, 0 and .5576, .4424, .2437, for a = 7, b = .1."""
    design = Design(axes_of(dict.fromkeys("xyz", f"{-np.pi}:{np.pi}")), "sobol", 1024)
    ishigami = lambda seed, x, y, z: np.sin(x) + 7 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x)  # noqa: E731
    points, rows = rows_of(design, ishigami)
    by_key = {row.key: row for row in rows}
    found = sobol(design, points, by_key, "m")
    assert [found[name][0] for name in "xyz"] == pytest.approx([0.3139, 0.4424, 0.0], abs=0.02)
    assert [found[name][1] for name in "xyz"] == pytest.approx([0.5576, 0.4424, 0.2437], abs=0.02)
    del by_key[rows[5].key]
    assert sobol(design, points, by_key, "m") is None


def test_seeds_are_taken_together():
    design = Design(axes_of({"x": "1,2"}))
    _, rows = rows_of(design, lambda seed, x: x + seed, seeds=(0, 1, 2))
    rows.append(Row.of(Point({"x": 1}, 3), error="unstable"))
    one, two = grouped(rows, "m")
    assert (one.mean, two.mean, one.failed, two.failed) == (2.0, 3.0, 1, 0)
    assert half_width(one.values) == pytest.approx(
        4.30265 / np.sqrt(3), rel=1e-4
    )  # Student's t for 2 degrees of freedom
    assert np.isnan(half_width(Group({}, np.array([1.0]), 0).values))
