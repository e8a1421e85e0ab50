"""The plot of a report: its legend names all that is drawn, and nothing is drawn over it."""

import pytest
from speed_support import MadeUp, pair, plan

from taichi_sim.reports.speed_error import report
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
