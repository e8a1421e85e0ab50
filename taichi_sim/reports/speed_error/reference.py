"""The reference that errors are measured from, to what it is known, and how far ahead the scene can be told at all.

It is the scene in double precision by Runge-Kutta's method at two steps, or by the scene's own method where contacts keep that
from converging. The difference of the two is published: the finer one is at least as good. A third run starts 1e-8 of the size
away; when it has parted by a thousandth of the size, pointwise errors say nothing any more, of any method.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.between_samples import beyond
from taichi_sim.analysis.methods import RK4
from taichi_sim.analysis.richardson import rms
from taichi_sim.common.quantities import EXACT
from taichi_sim.reports.speed_error.compared import distance, worst
from taichi_sim.reports.speed_error.plan import FRAME, PARTS, WORK, Step, fitting, halved, limit, own_step
from taichi_sim.reports.speed_error.trial_process import Outcome
from taichi_sim.reports.speed_error.trials import Trials
from taichi_sim.scene.scene import Scene

REFERENCE = RK4.name

Floats = NDArray[np.float64]
APART, PARTED = 1e-8, 1e-3  # of the size, at the start and at the horizon; of a quantity's motion there
LEAST = 1e-4  # of the size: in less motion than that, PARTED is what the runs start APART, and nothing has grown
GOOD = 1e-6  # of the motion: a reference known to that needs no other method
FINE = 1e-9  # of the motion: finer steps are tried up to that where they cost little
QUICK = 2.0  # times the work of a default reference, for which another method need not be compiled
RUNS = 3  # of a reference that needs no other method
ATTEMPTS = 3  # at half the step, where it became unstable


def _none() -> Floats:
    return np.zeros((0, 4))


@dataclass(frozen=True)
class Reference:
    """Results of the reference's runs, an entry for each of the PARTS of the duration; empty where there is no reference."""

    method: str
    step: float  # s, of the finer run
    size: float  # m, of the scene
    position: Floats = field(default_factory=_none)  # (PARTS, n, dim) m
    quantity: Floats = field(
        default_factory=_none
    )  # (PARTS, 1 or dim) in its unit, where one is asked for, else (PARTS, 0)
    energy: Floats = field(default_factory=_none)  # (PARTS, 4) J
    # all (PARTS,): between the two steps, rms of positions [m] or of the quantity in its unit; what that is relative to, see
    # `Compared.motion`; between the runs that start APART, see `_parting`
    difference: Floats = field(default_factory=lambda: np.zeros(0))
    displacement: Floats = field(default_factory=lambda: np.zeros(0))
    parting: Floats = field(default_factory=lambda: np.zeros(0))
    peak: Floats = field(default_factory=lambda: np.zeros(0))  # (PARTS,) see `Outcome`; empty or nan where not known
    contacts: int = 0  # the most that were seen
    touch: bool = False  # whether contacts can act, whether at a moment that was sampled or not
    why: str = ""  # there is none
    # effect of what `settle` leaves, as `difference`, at the worst moment; None without it, infinite: not known
    settling: float | None = None
    begin: Floats | None = None  # (1 or dim,) the quantity at the start

    @property
    def parts(self) -> int:
        """Number of parts of the duration that end before the horizon."""
        gone = np.flatnonzero(~(self.parting <= PARTED))
        return int(gone[0]) if len(gone) else len(self.parting)

    @property
    def known(self) -> float:
        """Error up to which the reference is known, at the worst moment before the horizon; infinite where there is none."""
        return float(self.difference[: self.parts].max()) if self.parts else np.inf

    @property
    def motion(self) -> float:
        """Size that errors are relative to, the largest before the horizon."""
        return float(self.displacement[: self.parts].max(initial=0.0))

    @property
    def rests(self) -> bool:
        """True if what is compared moves by no more than what `settle` left."""
        return self.motion <= (self.settling or 0.0) < np.inf

    @property
    def rounding(self) -> float:
        """Error of rounding, below which no finer step helps, in the unit of what is compared."""
        values = self.quantity if self.quantity.size else self.position
        return EXACT * float(np.abs(values[: self.parts]).max(initial=0.0))

    @property
    def missed(self) -> float:
        """Bound of how far that goes beyond the largest value at the moments compared: what steps between them showed, or, where
        none were read, a guess from the moments."""
        seen = self.displacement[: self.parts]
        if self.reads_peak:
            return max(0.0, float(np.max(self.peak[: self.parts])) - self.motion)
        return beyond(seen, int(np.argmax(seen))) if len(seen) else 0.0

    @property
    def reads_peak(self) -> bool:
        """True if steps between the moments compared were read."""
        return len(self.peak) > 0 and bool(np.isfinite(self.peak[: self.parts]).all())

    @property
    def growth(self) -> float:
        """Factor by which a small difference at the start has grown at the horizon or the end [1]."""
        return float(self.parting[: max(1, self.parts)].max(initial=0.0)) / APART

    @property
    def scale(self) -> float:
        """Largest kinetic and spring energy [J], which energies are compared with."""
        return _largest(self.energy)

    @property
    def chaotic(self) -> bool:
        """True if the horizon comes before the end."""
        return bool(len(self.position)) and self.parts < PARTS

    def moves(self, scene: Scene) -> bool:
        """True if anything moves by more than rounding; taken to be so without a reference."""
        if not len(self.position):
            return True
        return bool(np.any(np.abs(self.position - scene.position) > 1e-12 * self.size))


def _largest(energy: Floats) -> float:
    return float(np.abs(energy[:, :2]).sum(axis=1).max(initial=0.0)) or 1.0  # that of a gas may be negative


def make(trials: Trials, enough: float | None = None) -> Reference:
    """Run what the reference needs in double precision. enough: part of the motion to which it must be known; then the scene's
    own method is tried first, which is compiled anyway."""
    reference = _make(trials, enough)
    if trials.plan.rest is None or not reference.parts:
        return reference
    outcome = settled_run(trials, reference)
    off = np.inf if outcome is None else worst(trials.compared.errors(outcome, reference)[: reference.parts])
    return replace(reference, settling=off)


def settled_run(trials: Trials, reference: Reference) -> Outcome | None:
    """The run from where the scene's own `settle` leaves the balls; None without one that tells the effect of what it leaves."""
    rest = trials.plan.rest
    if rest is None or not len(rest):
        return None
    outcome = trials.run("f64", reference.method, fitting(trials.plan.duration, reference.step), start=rest)
    return outcome if len(outcome.position) == PARTS else None


def _make(trials: Trials, enough: float | None) -> Reference:
    own, step = own_step(trials.scene)
    if enough is not None and own != REFERENCE:
        quick = _by(trials, own, step / 4.0, enough, QUICK * WORK)
        if len(quick.position) and quick.known <= enough * quick.motion:
            return quick
    reference = _by(trials, REFERENCE, min(FRAME, limit(trials.scene, REFERENCE)) / 4.0, enough or FINE)
    if own == REFERENCE:
        return reference
    none = not len(reference.position)
    if enough is not None:
        return quick if len(quick.position) and not reference.known < quick.known else reference
    if none or (reference.touch and reference.known > GOOD * reference.motion):
        other = _by(trials, own, step / 4.0, FINE)
        if len(other.position) and (none or other.known < reference.known):
            return other
    return reference


def _by(trials: Trials, method: str, seconds: float, fine_enough: float, work: float = WORK / 8) -> Reference:
    duration = trials.plan.duration
    step = fitting(duration, seconds)
    for _ in range(ATTEMPTS):
        coarse = trials.run("f64", method, step)
        fine = trials.run("f64", method, halved(duration, step), contacts=True)
        why = coarse.unstable or fine.unstable or coarse.left_out or fine.left_out
        if not why:
            parting = _parting(trials, coarse, trials.run("f64", method, step, start=trials.apart(APART, 0)))
            while True:
                found = _reference(trials, method, step, coarse, fine, parting)
                good = max(fine_enough * found.motion, found.rounding)
                if found.known <= good or _work(trials.scene, step) >= work or not found.parts:
                    return found
                step = halved(duration, step)
                coarse, fine = fine, trials.run("f64", method, halved(duration, step), contacts=True)
        step = halved(duration, step)
    return Reference(method, step.seconds, trials.size, why=why)


def _parting(trials: Trials, one: Outcome, other: Outcome) -> Floats:
    """Parting of two runs at each of the PARTS: of positions, as a part of the size; of a quantity, as a part of its motion, or
    of LEAST of the size where that says less. Infinite where a run has ended."""
    compared = trials.compared
    parting = np.array([rms(error) for error in compared.errors(one, other)])
    places = parting / trials.size
    if compared.unit != "m":
        places = (
            np.array([rms(distance(trials.scene, x, y)) for x, y in zip(one.position, other.position)]) / trials.size
        )
    if compared.quantity is not None:
        places = np.minimum(parting / (_motion(trials, one).max() or 1.0), places / LEAST)
    return np.append(places, [np.inf] * (PARTS - len(places)))


def _motion(trials: Trials, outcome: Outcome) -> Floats:
    return trials.compared.motion(outcome, _largest(np.array(outcome.energy)))


def _work(scene: Scene, step: Step) -> float:
    """Springs and balls that a run at a quarter of this step goes through, four times each."""
    return 4.0 * 4.0 * step.number * PARTS * (scene.n_balls + scene.n_springs)


def _reference(trials: Trials, method: str, step: Step, coarse: Outcome, fine: Outcome, parting: Floats) -> Reference:
    return Reference(
        method,
        step.seconds / 2.0,
        trials.size,
        position=np.array(fine.position),
        quantity=np.array(fine.quantity) if len(fine.quantity) else np.zeros((PARTS, 0)),
        begin=fine.begin,
        energy=np.array(fine.energy),
        difference=np.array([rms(error) for error in trials.compared.errors(coarse, fine)]),
        displacement=_motion(trials, fine),
        parting=parting,
        peak=np.array(fine.peak),
        contacts=int(max(number for number, _ in fine.contacts)),
        touch=fine.touch,
    )
