"""Moving pins: pinned balls that are led along a path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.common.plain import plain
from taichi_sim.scene.columns import Marked, sealed
from taichi_sim.scene.motion import Keyframe, Motion, plain_path

__all__ = ["MovingPins", "PinMethods"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class MovingPins:
    """Pinned balls that are led along a path as one rigid body."""

    balls: NDArray[np.int32]  # (k,)
    motion: Motion  # of their centre
    given: Mapping[str, Any]  # the arguments, for saving

    def velocities(self, start: Floats, time: float, h: float) -> Floats:
        """Velocities (k, dim) [m/s] that take the balls from where they are at `time` to where they are h seconds later, of
        those that start at `start` (k, dim) [m]."""
        x, turn = self.motion.at(np.array([0.0, time, time + h]))
        arm = (start - x[0]) @ turn[0]
        return np.asarray((x[2] - x[1] + arm @ (turn[2] - turn[1]).T) / h)


class PinMethods:
    """The part of a Scene that holds them."""

    moving_pins: list[MovingPins]

    def _begin_pins(self) -> None:
        self._led = Marked("balls")

    def add_moving_pins(
        self: Any,
        balls: ArrayLike,
        *,
        velocity: ArrayLike | None = None,
        rotation_rate: ArrayLike | None = None,
        pivot: ArrayLike | None = None,
        path: Sequence[Keyframe | Sequence[Any]] | None = None,
        repeat: bool = False,
    ) -> None:
        """Pin balls (k,) and lead them as one rigid body; they push what they meet and take nothing.

        Args:
            balls: (k,) of the scene.
            velocity: (dim,) for ever [m/s].
            rotation_rate: about `pivot`, for ever [degrees per second], counter-clockwise in 2D, (3,) in 3D.
            pivot: (dim,) that they turn about, which moves along [m]; their mean if left out.
            path: in place of these, keyframes {time, position, rotation} or (time, position[, rotation]): by how far they have
                moved from where they start, and turned about their mean. The first is 0. Between keyframes they move with
                constant velocities, and they stay where the last one leaves them, unless the path repeats.
            repeat: whether the path starts again at its end, for ever.
        """
        where = f"moving_pins[{len(self.moving_pins)}]"
        index = validation.indices(f"{where}.balls", np.atleast_1d(validation.as_array(balls)), self.n_balls)
        if not len(index):
            raise SceneError(f"{where}.balls", says="is empty; name at least one ball")
        both = index[self._led.by(self.moving_pins, self.n_balls)[index]]
        if len(both) or len(np.unique(index)) < len(index):
            k = int(both[0]) if len(both) else int(np.sort(index)[:-1][np.diff(np.sort(index)) == 0][0])
            says = f"ball {k} is named twice; a ball can be led along one path only"
            raise SceneError(f"{where}.balls", says=says)
        moves = {"velocity": velocity, "rotation_rate": rotation_rate, "pivot": pivot, "path": path, "repeat": repeat}
        centre = self.position[index].mean(axis=0)
        motion = Motion.of(where, self.dim, centre, {**moves, "rotation": None}, named=False)
        if not motion.moves:
            says = "does not move; give a velocity, a rotation_rate or a path, or use `pinned`"
            raise SceneError(where, says=says)
        self.tables["balls"].replace(index, pinned=True, velocity=0.0)
        given: dict[str, Any] = {key: value for key, value in moves.items() if value is not None}
        given |= {} if path is None else {"path": plain_path(path)}
        self.moving_pins.append(MovingPins(sealed(index), sealed(motion), plain(given)))
