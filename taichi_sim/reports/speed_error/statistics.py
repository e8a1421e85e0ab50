"""What can be said beyond the horizon: statistics of many runs that start a little apart, with their intervals."""

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from taichi_sim.common.atomic_file import replacing
from taichi_sim.reports.speed_error.plan import PARTS, Plan, Step, fitting, halved, own_step
from taichi_sim.reports.speed_error.reference import apart
from taichi_sim.reports.speed_error.rows import lines_of, whole
from taichi_sim.reports.speed_error.worker import Outcome, Trial
from taichi_sim.scene.scene import Scene

__all__ = ["QUANTITIES", "SEEDS", "Interval", "Seed", "intervals", "one_seed", "read", "steps_of_seeds", "write"]

SEEDS = 8
START = 1e-6  # of the size, between the starts
STUDENT = 2.365  # of 7 degrees of freedom, for 95 %
LAST = PARTS // 2  # parts over which each run is averaged
QUANTITIES = {
    "kinetic": "kinetic energy [J]",
    "total": "total energy [J]",
    "height": "mean height [m]",
    "overlap": "largest overlap [radii]",
}


@dataclass(frozen=True)
class Seed:
    """One run, averaged over the second half of the duration; `overlap` is the largest seen there."""

    precision: str
    method: str
    step: float  # s
    seed: int
    kinetic: float
    total: float
    height: float
    overlap: float
    failed: str = ""

    @property
    def key(self) -> tuple[str, str, float, int]:
        """What tells the runs of one report apart."""
        return self.precision, self.method, self.step, self.seed


@dataclass(frozen=True)
class Interval:
    """Mean and half width of the 95 % interval of each quantity, over the seeds of one method; failed: why there are none."""

    precision: str
    method: str
    step: float
    mean: dict[str, float]
    half: dict[str, float]
    failed: str = ""


def steps_of_seeds(scene: Scene, plan: Plan) -> list[tuple[str, Step]]:
    """Each method at the step that the scene would be run with, and last the scene's own at half of it, for comparison."""
    steps = [(method, fitting(plan.duration, own_step(scene, method)[1])) for method in plan.methods]
    own, seconds = own_step(scene)
    return [*steps, (own, halved(plan.duration, fitting(plan.duration, seconds)))]


def one_seed(
    scene: Scene, plan: Plan, run: Callable[[Trial], Outcome], precision: str, method: str, step: Step, seed: int
) -> Seed:
    """Run one method from one start."""
    outcome = run(Trial(method, step, start=apart(scene, START, seed), most=plan.most, look=True))
    failed = outcome.unstable or outcome.left_out
    if failed:
        return Seed(precision, method, step.seconds, seed, np.nan, np.nan, np.nan, np.nan, failed)
    kinetic, _, _, total = (float(value) for value in np.mean(outcome.energy[-LAST:], axis=0))
    g = float(np.linalg.norm(scene.gravity))
    up = -scene.gravity / g if g else np.eye(scene.dim)[-1]
    height = float(np.mean([x[~scene.pinned] @ up for x in outcome.position[-LAST:]]))
    overlap = max(depth for _, depth in outcome.contacts[-LAST:])
    return Seed(precision, method, step.seconds, seed, kinetic, total, height, overlap)


def intervals(seeds: Sequence[Seed]) -> list[Interval]:
    """What the seeds of each method say together."""
    found = []
    for key in dict.fromkeys(seed.key[:3] for seed in seeds):
        own = [seed for seed in seeds if seed.key[:3] == key]
        failed = next((seed.failed for seed in own if seed.failed), "")
        values = {name: np.array([getattr(seed, name) for seed in own]) for name in QUANTITIES}
        mean = {name: float(value.mean()) for name, value in values.items()}
        half = {
            name: STUDENT * float(value.std(ddof=1)) / np.sqrt(len(value)) if len(value) == SEEDS else np.nan
            for name, value in values.items()
        }
        found.append(Interval(*key, mean, half, failed))
    return found


def write(path: Path, seeds: Sequence[Seed]) -> None:
    """As CSV, replaced whole."""
    text = io.StringIO()
    table = csv.DictWriter(text, [field.name for field in fields(Seed)], lineterminator="\n")
    table.writeheader()
    table.writerows(asdict(seed) for seed in seeds)
    with replacing(path) as file:
        file.write(text.getvalue().encode())


def read(path: Path) -> list[Seed]:
    """What `write` wrote; none where there is no such file."""
    kinds = {field.name: field.type for field in fields(Seed)}
    with whole(path, csv.Error):
        lines = lines_of(path, list(kinds))
        return [Seed(**{name: kinds[name](text) for name, text in line.items()}) for line in lines]  # type: ignore[operator]
