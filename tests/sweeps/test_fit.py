"""Fits: parameters that were known beforehand are found, what the measures do not tell is said."""

import math

import numpy as np
import pytest
from physics_support import PRECISION
from sweep_scenes import heap, springs

import taichi_sim as ts
from taichi_sim.sweeps.fit import _spread

HERE = {"workers": 0, "precision": PRECISION}
RANGE = {"stiffness": "50:5000:log"}
G = 10.0


def test_a_stiffness_is_found_from_sag_alone(tmp_path):
    """At rest the spring is longer by m g / k; so are its sensitivity, and what a percent of its length tells of k."""
    k, said = 321.0, []
    length = 1.0 + G / k
    given = {"folder": tmp_path / "f", "say": said.append, **HERE}
    found = ts.fit(springs, RANGE, {"probes.sag.length": length}, **given)
    assert found.reached
    assert found.parameters["stiffness"] == pytest.approx(k, rel=2e-3)
    assert found.runs < 40
    change = -(length - 1.0) / length
    assert found.sensitivity["stiffness"]["probes.sag.length"] == pytest.approx(change, rel=0.02)
    assert found.spread["stiffness"] == pytest.approx(1.0 / abs(change), rel=0.02)
    assert any("stiffness" in line and line.startswith("found") for line in found.lines())
    again = ts.fit(springs, RANGE, {"probes.sag.length": length}, **given)  # all runs were kept
    assert len(said) == 1
    assert (again.parameters, again.runs) == (found.parameters, found.runs)
    with found.open() as sim:
        assert sim.scene.stiffness[0] == found.parameters["stiffness"]


def test_what_cannot_be_reached_is_said():
    found = ts.fit(springs, RANGE, {"probes.sag.length": 2.5}, **HERE)
    assert not found.reached
    assert found.parameters["stiffness"] == pytest.approx(50.0, rel=1e-2)
    assert found.at_end == ("stiffness",)
    assert found.misfit == pytest.approx(1.3 / 2.5, rel=1e-3)
    said = "\n".join(found.lines())
    assert "NOT reached" in said
    assert "1.2 in " in said  # how far the measure went
    assert "widen it" in said


def test_two_parameters_of_one_sag_are_not_told_apart_but_by_the_load():
    both = {**RANGE, "mass": "0.5:2"}
    sag = {"probes.sag.length": 1.0 + 1.5 * G / 400.0}
    alone = ts.fit(springs, both, sag, **HERE)
    assert alone.reached
    assert alone.spread == {"stiffness": math.inf, "mass": math.inf}
    assert "do not tell stiffness" in "\n".join(alone.lines())
    # measures are told by their names: rows have those of functions last
    found = ts.fit(springs, both, {"sweep_scenes:load": 1.5 * G, **sag}, runs=150, **HERE)
    assert found.parameters == pytest.approx({"stiffness": 400.0, "mass": 1.5}, rel=0.02)
    assert max(found.spread.values()) < 100.0


@pytest.mark.slow
@pytest.mark.once
def test_evolution_finds_the_same():
    found = ts.fit(springs, RANGE, {"probes.sag.length": 1.0 + G / 777.0}, method="evolution", runs=150, luck=3, **HERE)
    assert found.reached
    assert found.parameters["stiffness"] == pytest.approx(777.0, rel=5e-3)


@pytest.mark.once
def test_how_well_targets_tell_parameters():
    """The root of the diagonal of (J^T J)^-1."""
    jacobian = np.random.default_rng(1).normal(size=(4, 3))
    expected = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    assert _spread(jacobian) == pytest.approx(expected)
    assert _spread(np.array([[1.0, 2.0, 0.0]])).tolist() == [math.inf] * 3
    assert _spread(np.array([[0.5, 0.0], [0.0, 0.0]])).tolist() == [2.0, math.inf]
    assert _spread(np.array([[np.nan]])).tolist() == [math.inf]


@pytest.mark.once
@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"vary": {}}, "nothing is varied"),
        ({"vary": {"restitution": [0.5]}}, "restitution: must be a range"),
        ({"vary": {"restitution": "0.2:0.2"}}, "is an empty range"),
        ({"vary": {"restitutoin": "0.2:0.4"}}, "did you mean 'restitution'"),
        ({"target": {}}, "target: there is none"),
        ({"target": {"probes.floor.y": math.nan}}, r"target\.probes\.floor\.y"),
        ({"target": {"probes.flor.y": 1.0}}, "did you mean 'floor'"),
        ({"method": "newton"}, "method: 'newton' is not allowed"),
        ({"misfit": 0.0}, "misfit: 0.0 is not allowed"),
        ({"runs": 5}, "runs: 5 is not allowed"),
        ({"luck": -1}, "luck: -1 is not allowed"),
    ],
)
def test_what_is_refused_before_anything_runs(given, why, tmp_path):
    asked = {"vary": {"restitution": "0.2:0.4"}, "target": {"probes.floor.y": -1.0}, **given}
    with pytest.raises(ts.SceneError, match=why):
        ts.fit(heap, asked.pop("vary"), asked.pop("target"), folder=tmp_path / "f", workers=0, **asked)
    assert not (tmp_path / "f").exists()


@pytest.mark.slow
@pytest.mark.once
def test_a_range_in_which_all_fails_is_said():
    with pytest.raises(ts.SceneError, match="no run within the ranges gave a measure; the first failed: "):
        ts.fit(heap, {"speed": "1e13:2e13"}, {"probes.floor.y": -1.0}, duration=0.02, **HERE)
