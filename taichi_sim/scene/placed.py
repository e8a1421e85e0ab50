"""The part that all shapes of colliders share: where they stand, how they move, what they are made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from taichi_sim.common import validation
from taichi_sim.common.errors import unknown_key
from taichi_sim.geometry.mesh import Surface
from taichi_sim.scene.collider_forms import Floats, Form
from taichi_sim.scene.motion import Keyframe

__all__ = ["Checked", "Placed"]


class Checked(NamedTuple):
    """Properties that follow from the arguments of a shape, see Collider."""

    form: type[Form]
    centre: Floats
    half: Floats
    radius: float = 0.0
    hollow: float = 0.0
    turn: Floats | None = None  # of its local frame, before its motion
    surface: Surface = Surface(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32))
    resolution: int = 0


@dataclass(frozen=True)
class Placed:
    """Arguments of every collider.

    Args:
        material: name of a material added before, or of a preset. colour: sRGB in 0..1 [1]; grey otherwise.
        group: name or names of the collision groups that it is in. collides_with: names of the groups that it collides with;
            None: all. name: what files for other programs call it.
        rotation: about its centre at the start [degrees]: one number in 2D, three about x, y and z in 3D; or a matrix.
        velocity: (dim,) for ever [m/s].
        rotation_rate: about `pivot`, for ever [degrees per second], counter-clockwise in 2D, (3,) in 3D.
        pivot: (dim,) that it turns about, which moves along [m]; its centre if left out.
        path: in place of these, keyframes {time, position, rotation} or (time, position[, rotation]): by how far it has moved
            from where it starts, and turned about its centre. The first is 0. Between keyframes it moves with constant
            velocities, in 3D turning the shorter way around, and it stays where the last one leaves it, unless the path repeats.
        repeat: whether the path starts again at its end, for ever.
    """

    def __init_subclass__(cls) -> None:
        """Shapes say what they all take, too, for `help`."""
        if cls.__module__.startswith("taichi_sim.") and cls.__doc__ is not None:
            common = (Placed.__doc__ or "").partition("Args:\n")[2].rstrip()
            cls.__doc__ = f"{cls.__doc__.rstrip()}\n\n    Args of every shape, by name:\n{common}\n"

    def __new__(cls, *_: Any, **given: Any) -> Placed:
        if "angular_velocity" in given:
            raise unknown_key(("colliders", "angular_velocity"), ("rotation_rate",))
        return object.__new__(cls)

    _: KW_ONLY
    material: str = "default"
    rotation: ArrayLike | None = None
    velocity: ArrayLike | None = None
    rotation_rate: ArrayLike | None = None
    pivot: ArrayLike | None = None
    path: Sequence[Keyframe | Sequence[Any]] = ()
    repeat: bool = False
    colour: Sequence[float] | None = None
    group: str | Sequence[str] = "default"
    collides_with: str | Sequence[str] | None = None
    name: str | None = None

    def _checked(self, dim: int, where: str) -> Checked:
        """Its own arguments, checked. Raises SceneError."""
        raise NotImplementedError

    def _number(self, where: str, key: str, **bounds: Any) -> float:
        return validation.number(f"{where}.{key}", getattr(self, key), **bounds)

    def _vector(self, where: str, key: str, dim: int) -> Floats:
        return validation.vector(f"{where}.{key}", getattr(self, key), dim)
