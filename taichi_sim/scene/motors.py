"""Motors: springs whose length at rest follows a sine or keyframes, as muscles do. Imports no Taichi."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import partial
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.scene.columns import Marked, sealed
from taichi_sim.scene.keyframes import Checks, check_repeat, keyframes

__all__ = ["Motor", "MotorKeyframe", "Motorised"]

Floats = NDArray[np.float64]
KEYS = ("time", "strain")
MOST_STRAIN = 10.0  # a longer spring is a mistake: its unit, or a length in place of a part of it


class MotorKeyframe(TypedDict):
    """Strain by which springs are longer at rest, at a time. In the first keyframe it is 0.

    Args:
        time: since the start [s].
        strain: by how much, as a part of their rest length [1]; negative where they are shorter.
    """

    time: float
    strain: float


@dataclass(frozen=True, slots=True, eq=False)
class Motor:
    """Springs whose rest length is (1 + e) times what it is without a motor, and how e depends on time.

    Either e = amplitude sin(2 pi frequency t + phase), or, where there are `times`, strains at these and straight lines between.
    """

    springs: NDArray[np.int32]  # (k,)
    phase: Floats  # (k,) degrees: as given, for files to bring back the same bits
    amplitude: float  # 1
    frequency: float  # 1/s
    times: Floats  # (f,) s
    strains: Floats  # (f,) 1
    repeat: bool
    given: Mapping[str, Any]  # the plain arguments, for saving

    def parts(self, time: ArrayLike) -> Floats:
        """(t, 2) at the times (t,) [s]: what e is made of, for e = parts[:, 0] cos(phase) + parts[:, 1] sin(phase)."""
        t = np.atleast_1d(np.asarray(time, dtype=np.float64))
        if not len(self.times):
            angle = 2.0 * np.pi * np.mod(self.frequency * t, 1.0)
            return self.amplitude * np.stack([np.sin(angle), np.cos(angle)], axis=1)
        if self.repeat:
            first, whole = self.times[0], self.times[-1] - self.times[0]
            t = first + np.mod(np.maximum(t - first, 0.0), whole)
        return np.stack([np.interp(t, self.times, self.strains), np.zeros_like(t)], axis=1)

    def strain(self, time: float) -> Floats:
        """e of each of its springs, (k,) [1], at a time [s]."""
        (sine, cosine), angle = self.parts(time)[0], np.radians(self.phase)
        return np.asarray(sine * np.cos(angle) + cosine * np.sin(angle))

    @property
    def fastest(self) -> float:
        """The largest change of e in a second [1/s]."""
        if not len(self.times):
            return 2.0 * np.pi * self.frequency * abs(self.amplitude)
        return float(np.abs(np.diff(self.strains) / np.diff(self.times)).max())


class Motorised:
    """The part of a Scene that holds motors."""

    motors: list[Motor]

    def _begin_motors(self) -> None:
        self._motored = Marked("springs")

    def add_motor(
        self: Any,
        springs: ArrayLike | None = None,
        *,
        balls: ArrayLike | None = None,
        amplitude: float | None = None,
        frequency: float | None = None,
        phase: ArrayLike = 0.0,
        path: Sequence[MotorKeyframe | Sequence[Any]] | None = None,
        repeat: bool = False,
    ) -> None:
        """Let springs grow and shrink, as a muscle does: their length at rest follows a sine or keyframes.

        At a time t it is (1 + e) times the rest length that the spring was given, with e = amplitude sin(360 degrees frequency t
        + phase), or the strain of the path. How hard they pull and push for that, and the work of the motor, is up to their
        stiffness. Springs tear at the length at which they did without a motor.

        Args:
            springs: (k,) of the scene.
            balls: in place of them, balls: all springs between two of these.
            amplitude: of the sine, as a part of the rest length [1], less than 1.
            frequency: of the sine [1/s].
            phase: of the sine, one or one per spring [degrees]; 90 begins with the longest. Other than 0, a spring that is at
                rest is under tension at the start.
            path: in place of the sine, keyframes {time, strain} or (time, strain): by how much the springs are longer at rest, as
                a part of their rest length. The first is 0. In between the change is even, and it stays as the last
                one leaves it, unless the path repeats.
            repeat: whether the path starts again at its end, for ever; it ends with a strain of 0.
        """
        where = f"motors[{len(self.motors)}]"
        index = _moved(self, where, springs, balls)
        check_repeat(where, path, repeat)
        if path is None:
            plain = _sine(where, amplitude, frequency)
            angles = validation.per_item(f"{where}.phase", phase, len(index))
            keys = np.zeros((0, 2))
        else:
            for name, value in (("amplitude", amplitude), ("frequency", frequency), ("phase", phase)):
                if value is not None and np.any(np.asarray(value) != 0.0):
                    raise SceneError(f"{where}.{name}", says="is given together with a path; give one of them")
            keys, angles = _keys(where, path, repeat), np.zeros(len(index))
            plain = {"path": [dict(zip(KEYS, row)) for row in keys.tolist()], "repeat": repeat}
        sine = plain.get("amplitude", 0.0), plain.get("frequency", 0.0)
        self.motors.append(sealed(Motor(index, angles, *sine, keys[:, 0], keys[:, 1], repeat, plain)))

    def at(self: Any, time: float) -> Any:
        """Return a copy of this scene with the rest lengths that its motors give it at a time [s]: to look at, not to
        change."""
        if not self.motors:
            return self
        now = copy(self)
        now.tables = self.tables | {"springs": self.tables["springs"].copy()}
        for motor in self.motors:
            length = self.rest_length[motor.springs]
            now.tables["springs"].replace(motor.springs, rest_length=length * (1.0 + motor.strain(time)))
        return now


def _moved(scene: Any, where: str, springs: Any, balls: Any) -> NDArray[np.int32]:
    """The springs that a motor is to drive, judged."""
    if (springs is None) == (balls is None):
        raise SceneError(f"{where}.springs", says="or `balls` must say which springs it drives; give one of them")
    if springs is None:
        named = np.zeros(scene.n_balls, dtype=bool)
        named[validation.indices(f"{where}.balls", np.atleast_1d(validation.as_array(balls)), scene.n_balls)] = True
        index = np.flatnonzero(named[scene.pairs].all(axis=1)).astype(np.int32)
        if not len(index):
            raise SceneError(f"{where}.balls", says="no spring joins two of them; there is nothing to drive")
    else:
        index = validation.indices(
            f"{where}.springs", np.atleast_1d(validation.as_array(springs)), scene.n_springs, what="spring"
        )
        if not len(index):
            raise SceneError(f"{where}.springs", says="is empty; name at least one spring")
    both, ordered = index[scene._motored.by(scene.motors, scene.n_springs)[index]], np.sort(index)
    again = both if len(both) else ordered[1:][np.diff(ordered) == 0]
    if len(again):
        raise SceneError(where, says=f"spring {again[0]} is driven twice; a spring can have one motor only")
    none = index[scene.rest_length[index] == 0.0]
    if len(none):
        raise SceneError(where, says=f"spring {none[0]} has no rest length, which a motor could change")
    return index


def _sine(where: str, amplitude: Any, frequency: Any) -> dict[str, Any]:
    if amplitude is None or frequency is None:
        name = "amplitude" if amplitude is None else "frequency"
        raise SceneError(f"{where}.{name}", says="is missing; a motor has amplitude and frequency, or a path")
    part = validation.number(f"{where}.amplitude", amplitude)
    if not 0.0 < abs(part) < 1.0:
        raise SceneError(f"{where}.amplitude", amplitude, "between -1 and 1, and not 0: a part of the rest length")
    return {"amplitude": part, "frequency": validation.number(f"{where}.frequency", frequency, positive=True)}


def _keys(where: str, path: Any, repeat: Any) -> Floats:
    """Keyframes (f, 2): times and strains, judged."""
    checks: Checks = {"time": partial(validation.number, low=0), "strain": _strain}
    found = [[key["time"], key["strain"]] for key in keyframes(f"{where}.path", path, checks, KEYS)]
    for k in (0, len(found) - 1) if repeat else (0,):
        if found[k][1] != 0.0:
            raise SceneError(f"{where}.path[{k}].strain", found[k][1], "0, or the rest length would jump")
    return np.array(found)


def _strain(place: str, value: Any) -> float:
    strain = validation.number(place, value)
    if not -1.0 < strain <= MOST_STRAIN:
        raise SceneError(place, strain, f"more than -1 and at most {MOST_STRAIN:g}: a part of the rest length")
    return strain
