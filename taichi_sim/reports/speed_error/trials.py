"""Context of every run of a report or of tune: the scene, the plan, and the processes that run it."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.reports.speed_error.compared import Compared
from taichi_sim.reports.speed_error.plan import Plan, Step, fitting, own_step, size_of
from taichi_sim.reports.speed_error.report_folder import RUN, ReportFolder
from taichi_sim.reports.speed_error.trial_process import Outcome, Trial, TrialProcesses
from taichi_sim.scene.scene import Scene
from taichi_sim.studies.records import packed


@dataclass(frozen=True)
class Trials:
    """A scene, what is asked of it, and who runs it. folder: of a report, which keeps what was run."""

    scene: Scene
    plan: Plan
    processes: TrialProcesses
    folder: ReportFolder | None = None

    @cached_property
    def compared(self) -> Compared:
        """Quantity that errors are of."""
        return Compared(self.scene, self.plan)

    @cached_property
    def size(self) -> float:
        """Size of the scene [m]."""
        return size_of(self.scene)

    def own_step(self, method: str | None = None) -> tuple[str, Step]:
        """A method, by default the scene's own, and the step that the scene would be run with."""
        method, seconds = own_step(self.scene, method)
        return method, fitting(self.plan.duration, seconds)

    def run(self, precision: str, method: str, step: Step, *, keep: bool = True, **how: Any) -> Outcome:
        """One trial, see `Trial`, or what the folder keeps of it. keep: False for one that becomes a row at once."""
        trial = Trial(method, step, **how)
        if self.folder is None or not keep:
            return self.processes.run(precision, trial)
        name = f"{RUN}{trial.digest(precision)}.npz"
        found = self.folder.record_in(name, Outcome)
        if found is None:
            found = self.processes.run(precision, trial)
            if not found.left_out:
                self.folder.write(name, packed(found._asdict()))
        return found

    def apart(self, share: float, seed: int) -> NDArray[np.float64]:
        """Positions (n, dim) [m] a share of the size away from the scene's, rms over the balls that are not pinned."""
        scene = self.scene
        noise = np.random.default_rng(seed).normal(size=scene.position.shape) / np.sqrt(scene.dim)
        noise[scene.pinned] = 0.0
        return scene.position + share * self.size * noise
