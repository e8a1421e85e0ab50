"""Words on what an interrupted run leaves behind."""

from types import SimpleNamespace

import pytest

from taichi_sim.cli.running import _kept
from taichi_sim.reports.speed_error.resolution import advice

pytestmark = pytest.mark.once


@pytest.mark.parametrize("error", [False, True])
@pytest.mark.parametrize(
    ("frames", "simulated", "checkpoint", "said"),
    [
        (0, 0, None, ""),
        (1, 1, None, "1 frame is kept; {} it"),
        (7, 9, None, "7 frames are kept; {} them"),
        (1, 1, "there", "1 frame and a checkpoint are kept; {} them"),
        (0, 1, None, "1 frame is simulated, and kept; {} it"),
        (0, 4, None, "4 frames are simulated, and kept; {} them"),
    ],
)
def test_what_is_kept(error, frames, simulated, checkpoint, said):
    """And the command that goes on, which takes no --error."""
    log = SimpleNamespace(checkpoint=checkpoint)
    target = SimpleNamespace(path="x.csv", frames=frames, simulated=simulated, log=log)
    on = "--resume without --error goes on with" if error else "--resume goes on with"
    assert _kept(target, error) == said.format(on)


@pytest.mark.parametrize(
    ("body", "refines"),
    [
        ("[[rope]]\nstart = [0.0, 0.0]\nend = [1.0, 0.0]\nn = 4\nEA = 300.0\n", True),
        ("[[rope]]\nstart = [0.0, 0.0]\nend = [1.0, 0.0]\nn = 4\nstiffness = 300.0\n", False),
        ('[[text]]\ntext = "L"\n', False),
    ],
)
def test_a_finer_mesh_is_advised_where_it_can_be_made(tmp_path, body, refines):
    file = tmp_path / "s.toml"
    file.write_text(f"format = 1\ndim = 2\n{body}")
    assert [str(file) in line for line in advice(file)] == [True] * refines
    assert not list(advice(tmp_path / "s.py"))
