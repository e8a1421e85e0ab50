"""Statistics beyond the horizon: of many runs that start a little apart, with their intervals."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from taichi_sim.reports.speed_error.plan import PARTS, Step, halved
from taichi_sim.reports.speed_error.trials import Trials
from taichi_sim.studies.intervals import half_width

SEEDS = 8
STARTS_APART = 1e-6  # of the size, between the starts
FALSE_FINDINGS = 0.05  # at most, of all quantities that are said to differ
LAST_PARTS = PARTS // 2  # parts over which each run is averaged
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
        """Key that tells the runs of one report apart."""
        return self.precision, self.method, self.step, self.seed


@dataclass(frozen=True)
class Interval:
    """Mean and half width of the 95 % interval (Student) of each quantity, over the seeds of one method; failed: why there are
    none. differs: the quantities whose mean differs from that of the last method and step of this precision, by Welch's test
    with at most 5 % of all these findings false (Benjamini and Hochberg, 1995)."""

    precision: str
    method: str
    step: float
    mean: dict[str, float]
    half: dict[str, float]
    differs: tuple[str, ...] = ()
    failed: str = ""


def steps_of_seeds(trials: Trials) -> list[tuple[str, Step]]:
    """Each method at the step that the scene would be run with, and last the scene's own at half of it, for comparison."""
    own, step = trials.own_step()
    return [*map(trials.own_step, trials.plan.methods), (own, halved(trials.plan.duration, step))]


def one_seed(trials: Trials, precision: str, method: str, step: Step, seed: int) -> Seed:
    """Run one method from one start."""
    start, scene = trials.apart(STARTS_APART, seed), trials.scene
    outcome = trials.run(precision, method, step, keep=False, start=start, most=trials.plan.most, contacts=True)
    failed = outcome.unstable or outcome.left_out
    if failed:
        return Seed(precision, method, step.seconds, seed, np.nan, np.nan, np.nan, np.nan, failed)
    kinetic, _, _, total = (float(value) for value in np.mean(outcome.energy[-LAST_PARTS:], axis=0))
    g = float(np.linalg.norm(scene.gravity))
    up = -scene.gravity / g if g else np.eye(scene.dim)[-1]
    height = float(np.mean([x[~scene.pinned] @ up for x in outcome.position[-LAST_PARTS:]]))
    overlap = max(depth for _, depth in outcome.contacts[-LAST_PARTS:])
    return Seed(precision, method, step.seconds, seed, kinetic, total, height, overlap)


def intervals(seeds: Sequence[Seed]) -> list[Interval]:
    """Intervals of the quantities, of the seeds of each method together."""
    groups = {key: [seed for seed in seeds if seed.key[:3] == key] for key in dict.fromkeys(s.key[:3] for s in seeds)}
    judges = {key[0]: own for key, own in groups.items()}  # the last of each precision
    places = [(key, name) for key in groups for name in QUANTITIES]
    chances = [_chance(_values(groups[key], name), _values(judges[key[0]], name)) for key, name in places]
    least = dict(zip(places, stats.false_discovery_control(chances))) if chances else {}
    found = []
    for key, own in groups.items():
        values = {name: _values(own, name) for name in QUANTITIES}
        half = {n: half_width(v) if len(v) == SEEDS else np.nan for n, v in values.items()}
        failed = next((seed.failed for seed in own if seed.failed), "")
        differs = tuple(name for name in QUANTITIES if least[key, name] < FALSE_FINDINGS)
        found.append(Interval(*key, {n: float(v.mean()) for n, v in values.items()}, half, differs, failed))
    return found


def _values(seeds: Sequence[Seed], name: str) -> NDArray[np.float64]:
    return np.array([getattr(seed, name) for seed in seeds])


def _chance(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Welch's: how likely two means differ so much by chance; 1 where one is not known, or nothing differs at all."""
    whole = len(one) == len(other) == SEEDS and np.all(np.isfinite([one, other]))
    if not whole or one.mean() == other.mean():
        return 1.0
    spread = (one.mean(), one.std(ddof=1), SEEDS, other.mean(), other.std(ddof=1), SEEDS)
    with np.errstate(divide="ignore"):  # two that do not spread at all
        return float(stats.ttest_ind_from_stats(*spread, equal_var=False).pvalue)
