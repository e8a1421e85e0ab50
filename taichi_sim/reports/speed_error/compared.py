"""Quantities that errors are of: the positions of all balls, or one quantity that a probe names; and what they are relative
to."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.probe_readings import quantity_of
from taichi_sim.analysis.richardson import rms
from taichi_sim.reports.speed_error.plan import PARTS, Plan
from taichi_sim.scene.scene import Scene

Floats = NDArray[np.float64]


def distance(scene: Scene, a: Floats, b: Floats) -> Floats:
    """Distances (n',) [m] of the balls that are not pinned."""
    return np.linalg.norm((a - b)[~scene.pinned], axis=1)


def worst(errors: Sequence[Floats]) -> float:
    """Root of the mean square over balls at the moment where it is largest; 0 without any."""
    return max((rms(error) for error in errors), default=0.0)


class Compared:
    """The quantity that a plan asks for; None: the positions of all balls that are not pinned.

    An error is relative to how far what is compared moves from where it starts; to its own size for what has a zero of its own,
    such as a tension; energies to the largest kinetic and spring energy. Raises SceneError for a quantity that there is not.
    """

    def __init__(self, scene: Scene, plan: Plan) -> None:
        self.scene, self.plan = scene, plan
        self.quantity = None if plan.quantity is None else quantity_of(scene, plan.quantity)

    @property
    def unit(self) -> str:
        """Unit of errors; empty where the quantity is a plain number."""
        return "m" if self.quantity is None else self.quantity.unit

    @property
    def name(self) -> str:
        """Name of what is compared, in words."""
        return "positions" if self.quantity is None else self.quantity.name

    def errors(self, a: Any, b: Any) -> list[Floats]:
        """Distances of two outcomes or references at each moment: (n',) m, or (1,) in the quantity's unit."""
        if self.quantity is None:
            return [distance(self.scene, x, y) for x, y in zip(a.position, b.position)]
        return [np.array([np.linalg.norm(x - y)]) for x, y in zip(a.quantity, b.quantity)]

    def motion(self, outcome: Any, energy: float) -> Floats:
        """Sizes that errors are relative to, (parts,) at each moment of an outcome. energy: the largest kinetic and spring
        one [J]."""
        sizes = self.sizes(outcome)
        return np.full(len(sizes), energy) if self.quantity is not None and self.quantity.of_energy else sizes

    def sizes(self, outcome: Any) -> Floats:
        """Sizes of what is compared, (parts,) at each moment of an outcome or reference: from its start, or from its own zero."""
        if self.quantity is None:
            return np.array([rms(distance(self.scene, x, self.scene.position)) for x in outcome.position])
        return np.linalg.norm(np.array(outcome.quantity) - (outcome.begin if self.quantity.from_start else 0.0), axis=1)

    def error_of_largest(self, a: Any, b: Any, parts: int) -> float:
        """Distance of two outcomes or references at the moments, of the first `parts`, where either of them has its largest size,
        as rms over balls: two largest sizes may agree by luck."""
        errors = self.errors(a, b)
        return max(rms(errors[int(np.argmax(self.sizes(one)[:parts]))]) for one in (a, b))

    def size_in_words(self, parts: int) -> str:
        """Name of the size that errors are relative to. parts: of the duration, at whose ends it was looked for."""
        if self.quantity is None:
            return self.sampled("rms displacement of the balls", parts)
        if self.quantity.of_energy:
            return self.sampled("kinetic and spring energy", PARTS)
        return self.sampled(f"{'motion of ' if self.quantity.from_start else ''}{self.name}", parts)

    def sampled(self, what: str, parts: int) -> str:
        """Name of the largest value seen at the ends of parts of the duration, which may miss a peak between them."""
        until = self.plan.duration * parts / PARTS
        return f"largest {what} at {parts} sample {'time' if parts == 1 else 'times'} up to {until:.3g} s"
