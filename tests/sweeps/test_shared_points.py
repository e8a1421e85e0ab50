"""Points of sweeps on workers that share what they compile."""

from pathlib import Path

import pytest
import sweep_scenes

from taichi_sim.device import backend
from taichi_sim.device import compile_once as compiling
from taichi_sim.device.compile_once import compile_once
from taichi_sim.simulation import simulation as simulations
from taichi_sim.sweeps.measures import measures_of
from taichi_sim.sweeps.points import Job, Point, Runner
from taichi_sim.sweeps.subject import subject_of


@pytest.mark.once
def test_a_lock_file_of_others_is_rehearsed_for_once(tmp_path, monkeypatch):
    """It held more than the mark of a job, which was written over its start alone."""
    monkeypatch.setattr(backend, "stop", lambda: None)
    monkeypatch.setattr(backend, "kernel_folder", lambda: tmp_path)
    rehearsed = []
    compile_once("kind", "job", lambda: rehearsed.append(1))
    (lock,) = tmp_path.glob("once_*.lock")
    lock.write_bytes(b"\xfe" * 700)
    for _ in range(3):
        assert compile_once("kind", "job", lambda: rehearsed.append(2)) < 0.1
    assert rehearsed == [1, 2]


@pytest.mark.once
def test_a_rehearsal_does_not_settle_and_waiting_is_no_time_of_a_point(monkeypatch):
    """Settling takes as long as many frames; what another worker compiles is not this point's."""
    seen = []

    class MadeError(Exception):
        pass

    class Recorded:
        def __init__(self, scene, **settings):
            seen.append(settings)
            raise MadeError

    def rehearses(kind, job, rehearse):
        with pytest.raises(MadeError):
            rehearse()
        return 1000.0

    monkeypatch.setattr(compiling, "compile_once", rehearses)
    monkeypatch.setattr(simulations, "Simulation", Recorded)
    job = Job(subject_of(sweep_scenes.heap, Path(), False), measures_of(["energy.total"], sweep_scenes.heap()),
              {"settle": 1e-3}, shared=True)  # fmt: skip
    row = Runner(job).run(Point({"restitution": 0.3}))
    assert [one["settle"] for one in seen] == [None, 1e-3]
    assert -1000.0 <= row.wall < -900.0
