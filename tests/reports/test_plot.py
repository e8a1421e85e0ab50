"""The plot of a report, whose legend names all that is drawn, and what a report recommends."""

import pytest
from speed_support import MadeUp, pair, plan

from taichi_sim.reports.speed_error import report
from taichi_sim.reports.speed_error.findings import LONG_RUN
from taichi_sim.reports.speed_error.plot import READ, draw

pytestmark = pytest.mark.once


@pytest.mark.parametrize("precisions", [("f64",), ("f64", "f32")])
def test_words_do_not_meet_and_every_kind_of_mark_is_named(tmp_path, monkeypatch, precisions):
    scene = pair()
    monkeypatch.setattr(report, "TrialProcesses", lambda *_: MadeUp(scene))
    asked = plan(precisions=precisions)
    figure = draw(report.main(scene, asked, tmp_path / "r", progress=False, say=lambda line: None))
    figure.canvas.draw()
    legend = figure.legends[0]
    words = next(text for text in figure.texts if text.get_text() == READ)
    assert not words.get_window_extent().overlaps(legend.get_window_extent())
    named = {text.get_text() for text in legend.get_texts()}
    band = next(line for line in figure.axes[0].lines if line.get_linewidth() == 7)
    assert band.get_label() in named
    assert "verlet" in named


def test_steps_are_recommended_by_the_rule_of_tune(tmp_path, monkeypatch):
    """Up to 0.4 of the bound by Verlet on undamped springs, though a longer one was stable and near enough here."""
    scene = pair()
    scene.set_springs(damping=0.0)
    monkeypatch.setattr(report, "TrialProcesses", lambda *_: MadeUp(scene))
    asked = plan(methods=("verlet",), steps=(0.1, 0.02), duration=0.8)
    found = report.main(scene, asked, tmp_path / "r", progress=False, say=lambda line: None)
    long, short = sorted(found.rows, key=lambda row: -row.step)
    assert long.verdict == short.verdict == "stable"
    assert short.part_of_safe_step < 0.4 < long.part_of_safe_step < 0.9
    assert next(found.fastest((100.0,)))[1] == [short]
    assert LONG_RUN in list(found.lines())
    scene.set_springs(damping=0.1)
    assert next(found.fastest((100.0,)))[1] == [long]
    assert LONG_RUN not in list(found.lines())
