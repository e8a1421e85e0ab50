"""What every run of a report or of tune needs: the scene, the plan, and the processes that run it."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.reports.speed_error.compared import Compared
from taichi_sim.reports.speed_error.kept_outcomes import KeptOutcomes
from taichi_sim.reports.speed_error.plan import Plan, Step, fitting, own_step, size_of
from taichi_sim.reports.speed_error.worker import Outcome, Trial, Workers
from taichi_sim.scene.scene import Scene


@dataclass(frozen=True)
class Study:
    """A scene, what is asked of it, and who runs it. kept: where outcomes are kept for a report that was interrupted."""

    scene: Scene
    plan: Plan
    workers: Workers
    kept: KeptOutcomes | None = None

    @cached_property
    def compared(self) -> Compared:
        """What errors are of."""
        return Compared(self.scene, self.plan)

    @cached_property
    def size(self) -> float:
        """Of the scene [m]."""
        return size_of(self.scene)

    def own_step(self, method: str | None = None) -> tuple[str, Step]:
        """A method, by default the scene's own, and the step that the scene would be run with."""
        method, seconds = own_step(self.scene, method)
        return method, fitting(self.plan.duration, seconds)

    def run(self, precision: str, method: str, step: Step, **how: Any) -> Outcome:
        """One trial, see `Trial`, or what is kept of it. Timed ones are not kept: they become rows."""
        trial = Trial(method, step, **how)
        kept = None if trial.timed else self.kept
        found = None if kept is None else kept.find(precision, trial)
        if found is None:
            found = self.workers.run(precision, trial)
            if kept is not None and not found.left_out:
                kept.keep(precision, trial, found)
        return found

    def apart(self, share: float, seed: int) -> NDArray[np.float64]:
        """Positions (n, dim) [m] a share of the size away from the scene's, rms over the balls that are not pinned."""
        scene = self.scene
        noise = np.random.default_rng(seed).normal(size=scene.position.shape) / np.sqrt(scene.dim)
        noise[scene.pinned] = 0.0
        return scene.position + share * self.size * noise
