"""A worker of a sweep that says what it compiles: `python -m tests.support.sweep_worker JOB FOLDER RESTITUTION ...`.

FOLDER: `started` appears there once this one compiles. The environment variable DIES ends it then by SIGKILL.
"""

import os
import signal
import sys
from pathlib import Path

from taichi_sim.device import backend
from taichi_sim.sweeps.measures import measures_of
from taichi_sim.sweeps.points import Job, Point, Runner, run_batch
from taichi_sim.sweeps.subject import subject_of
from tests.support import sweep_scenes


def main(name: str, folder: str, *restitutions: str) -> None:
    precision = os.environ.get("TAICHI_SIM_PRECISION", "f32")
    measures = measures_of(["energy.total", "probes.floor.y"], sweep_scenes.heap())
    settings = {"arch": "cpu", "threads": 1, "precision": precision}
    subject = subject_of(sweep_scenes.heap, Path(folder), False)
    rehearse = Runner._rehearse

    def seen(self, scene):
        rehearse(self, scene)
        Path(folder, "started").touch()
        if os.environ.get("DIES"):
            os.kill(os.getpid(), signal.SIGKILL)

    setattr(Runner, "_rehearse", seen)  # noqa: B010 - a method
    backend.ti.ERROR = backend.ti.DEBUG  # the engine says then what it compiles
    job = Job(subject, measures, settings, known_by=name, shared=True)
    rows = run_batch(job, [Point({"restitution": float(one)}) for one in restitutions])
    backend.stop()
    print([(row.measures, row.error, row.compiled) for row in rows])


if __name__ == "__main__":
    main(*sys.argv[1:])
