"""The reference that errors are measured from, to what it is known, and how far ahead the scene can be told at all.

It is the scene in double precision by Runge-Kutta's method at two steps, or by the scene's own method where contacts keep that
from converging. The difference of the two is published: the finer one is at least as good. A third run starts 1e-8 of the size
away; when it has parted by a thousandth of the size, pointwise errors say nothing any more, of any method.
"""

import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.methods import RK4
from taichi_sim.common.atomic_file import replacing
from taichi_sim.reports.speed_error.compared import Compared, rms
from taichi_sim.reports.speed_error.csv_table import whole
from taichi_sim.reports.speed_error.plan import (
    FRAME,
    PARTS,
    WORK,
    Plan,
    Step,
    fitting,
    halved,
    limit,
    own_step,
    size_of,
)
from taichi_sim.reports.speed_error.worker import Outcome, Trial
from taichi_sim.scene.scene import Scene

__all__ = ["APART", "PARTED", "Reference", "load", "make", "save"]

REFERENCE = RK4.name

Floats = NDArray[np.float64]
APART, PARTED = 1e-8, 1e-3  # of the size, at the start and at the horizon; of a quantity's motion there
GOOD = 1e-6  # of the motion: a reference known to that needs no other method
FINE = 1e-9  # of the motion: finer steps are tried up to that where they cost little
QUICK = 2.0  # times the work of a default reference, for which another method need not be compiled
ATTEMPTS = 3  # at half the step, where it became unstable


@dataclass(frozen=True)
class Reference:
    """What the runs of the reference say, an entry for each of the PARTS of the duration. Without one, `position` is empty."""

    method: str
    step: float  # s, of the finer run
    size: float  # m, of the scene
    position: Floats  # (PARTS, n, dim) m
    quantity: Floats  # (PARTS, 1 or dim) in its unit, where one is asked for, else (PARTS, 0)
    energy: Floats  # (PARTS, 4) J
    difference: Floats  # (PARTS,) between the two steps: rms of positions [m], or of the quantity in its unit
    displacement: Floats  # (PARTS,) what that is relative to, see `Compared.motion`
    parting: Floats  # (PARTS,) between the runs that start APART: of positions as a part of the size, of a quantity of its motion
    contacts: int  # the most that were seen
    touch: bool  # whether contacts can act, seen at a moment that was looked at or not
    why: str  # there is none

    @property
    def parts(self) -> int:
        """How many parts of the duration come before the horizon."""
        gone = np.flatnonzero(~(self.parting <= PARTED))
        return int(gone[0]) if len(gone) else len(self.parting)

    @property
    def known(self) -> float:
        """To what the reference is known, at the worst moment before the horizon; infinite where there is none."""
        return float(self.difference[: self.parts].max()) if self.parts else np.inf

    @property
    def motion(self) -> float:
        """What errors are relative to, the largest before the horizon."""
        return float(self.displacement[: self.parts].max(initial=0.0))

    @property
    def growth(self) -> float:
        """How many times a small difference at the start has grown at the horizon or the end."""
        return float(self.parting[: max(1, self.parts)].max(initial=0.0)) / APART

    @property
    def scale(self) -> float:
        """Largest kinetic and spring energy [J], which energies are compared with."""
        return _largest(self.energy)

    @property
    def chaotic(self) -> bool:
        """Whether the horizon comes before the end."""
        return bool(len(self.position)) and self.parts < PARTS

    def moves(self, scene: Scene) -> bool:
        """Whether anything moves by more than rounding; taken to be so without a reference."""
        if not len(self.position):
            return True
        return bool(np.any(np.abs(self.position - scene.position) > 1e-12 * self.size))


def apart(scene: Scene, share: float, seed: int) -> Floats:
    """Positions (n, dim) [m] a share of the size away from the scene's, rms over the balls that are not pinned."""
    noise = np.random.default_rng(seed).normal(size=scene.position.shape) / np.sqrt(scene.dim)
    noise[scene.pinned] = 0.0
    return scene.position + share * size_of(scene) * noise


def _largest(energy: Floats) -> float:
    return float(np.abs(energy[:, :2]).sum(axis=1).max(initial=0.0)) or 1.0  # that of a gas may be negative


def make(scene: Scene, plan: Plan, run: Callable[[Trial], Outcome], enough: float | None = None) -> Reference:
    """Run what the reference needs in double precision. enough: part of the motion to which it must be known; then the scene's
    own method is tried first, which is compiled anyway."""
    own, step = own_step(scene)
    if enough is not None and own != REFERENCE:
        quick = _by(scene, plan, run, own, step / 4.0, enough, QUICK * WORK)
        if len(quick.position) and quick.known <= enough * quick.motion:
            return quick
    reference = _by(scene, plan, run, REFERENCE, min(FRAME, limit(scene, REFERENCE)) / 4.0, enough or FINE)
    if enough is not None and own != REFERENCE:
        return quick if len(quick.position) and not reference.known < quick.known else reference
    if own != REFERENCE and (
        not len(reference.position) or (reference.touch and reference.known > GOOD * reference.motion)
    ):
        other = _by(scene, plan, run, own, step / 4.0, FINE)
        if len(other.position) and (not len(reference.position) or other.known < reference.known):
            return other
    return reference


def _by(
    scene: Scene,
    plan: Plan,
    run: Callable[[Trial], Outcome],
    method: str,
    seconds: float,
    fine_enough: float,
    work: float = WORK / 8,
) -> Reference:
    step = fitting(plan.duration, seconds)
    for _ in range(ATTEMPTS):
        coarse, fine = run(Trial(method, step)), run(Trial(method, halved(plan.duration, step), look=True))
        why = coarse.unstable or fine.unstable or coarse.left_out or fine.left_out
        if not why:
            parting = _parting(scene, plan, coarse, run(Trial(method, step, start=apart(scene, APART, 0))))
            while True:
                reference = _reference(scene, plan, method, step, coarse, fine, parting)
                if (
                    reference.known <= fine_enough * reference.motion
                    or _work(scene, step) >= work
                    or not reference.parts
                ):
                    return reference
                step = halved(plan.duration, step)
                coarse, fine = fine, run(Trial(method, halved(plan.duration, step), look=True))
        step = halved(plan.duration, step)
    none = np.zeros((0, 4))
    return Reference(
        method=method,
        step=step.seconds,
        size=size_of(scene),
        position=np.zeros((0, 0, 0)),
        quantity=none,
        energy=none,
        difference=none[:, 0],
        displacement=none[:, 0],
        parting=none[:, 0],
        contacts=0,
        touch=False,
        why=why,
    )


def _parting(scene: Scene, plan: Plan, one: Outcome, other: Outcome) -> Floats:
    """What `Reference.parting` is, of two runs."""
    compared = Compared.of(scene, plan)
    unit = size_of(scene) if compared.quantity is None else _motion(compared, one).max() or 1.0
    parting = [rms(error) / unit for error in compared.errors(one, other)]
    return np.array(parting + [np.inf] * (PARTS - len(parting)))


def _motion(compared: Compared, outcome: Outcome) -> Floats:
    return compared.motion(outcome, _largest(np.array(outcome.energy)))


def _work(scene: Scene, step: Step) -> float:
    """Springs and balls that a run at a quarter of this step goes through, four times each."""
    return 4.0 * 4.0 * step.number * PARTS * (scene.n_balls + scene.n_springs)


def _reference(
    scene: Scene, plan: Plan, method: str, step: Step, coarse: Outcome, fine: Outcome, parting: Floats
) -> Reference:
    compared = Compared.of(scene, plan)
    return Reference(
        method=method,
        step=step.seconds / 2.0,
        size=size_of(scene),
        position=np.array(fine.position),
        quantity=np.array(fine.quantity) if fine.quantity else np.zeros((PARTS, 0)),
        energy=np.array(fine.energy),
        difference=np.array([rms(error) for error in compared.errors(coarse, fine)]),
        displacement=_motion(compared, fine),
        parting=parting,
        contacts=max(number for number, _ in fine.contacts),
        touch=fine.touch,
        why="",
    )


def save(path: Path, reference: Reference) -> None:
    """As an .npz."""
    with replacing(path) as file:
        np.savez(file, **{name: np.asarray(value) for name, value in asdict(reference).items()})  # type: ignore[arg-type]


def load(path: Path) -> Reference | None:
    """What `save` wrote, or None where there is no such file."""
    if not path.exists():
        return None
    with whole(path, BadZipFile, EOFError, KeyError, zlib.error), np.load(path, allow_pickle=False) as file:
        values = {field.name: file[field.name] for field in fields(Reference)}
    return Reference(**{name: value.item() if value.ndim == 0 else value for name, value in values.items()})
