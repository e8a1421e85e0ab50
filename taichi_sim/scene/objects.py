"""Objects: which balls are one thing, and what it is called: for files that other programs open."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.scene.columns import sealed

__all__ = [
    "LOOSE",
    "Objects",
    "SceneObject",
    "ball_in_words",
    "balls_in_words",
    "mapped",
    "named",
    "owner",
    "pair_in_words",
]

LOOSE = "balls"  # what balls of no object are called together


@dataclass(frozen=True, slots=True, eq=False)
class SceneObject:
    """One object of a scene."""

    name: str
    balls: NDArray[np.int32]  # (k,)
    # (k, 2) places of the balls of a sheet on a texture, in 0..1; or (t, 3, 2) those of the corners of its triangles, as a mesh
    # with seams has them
    uv: NDArray[np.float64] | None = None
    kind: str = ""  # the shape that made it, where its name is this and a number, cloth_0

    @property
    def is_sheet(self) -> bool:
        """True where each of its balls has one place on a texture, as on a rectangular cloth."""
        return self.uv is not None and self.uv.ndim == 2


def mapped(objects: Iterable[SceneObject], triangles: NDArray) -> Iterator[tuple[SceneObject, NDArray, NDArray]]:
    """The objects whose triangles have places on a texture at their corners, these (t, 3), of all triangles of a scene, and the
    places (t, 3, 2)."""
    for one in objects:
        if one.uv is not None and one.uv.ndim == 3 and len(one.balls):
            own = triangles[np.isin(triangles, one.balls).all(axis=1)]
            if len(own) == len(one.uv):
                yield one, own, one.uv


class Objects:
    """The part of a Scene that holds them."""

    objects: list[SceneObject]

    def _begin_objects(self) -> None:
        self._names: dict[str, int] = {}  # their numbers by name, and by the first of their balls
        self._firsts: dict[int, int] = {}
        self._counts: dict[str, int] = {}  # by kind: numbers that are in use below this one

    def set_name(self: Any, balls: ArrayLike, name: str, uv: ArrayLike | None = None) -> None:
        """Call balls (k,) by a name, those of a shape for instance, in files that other programs open. Raises SceneError where
        something was given that name already.

        Args:
            balls: (k,) of the scene; name: what they are called together.
            uv: (k, 2) places of the balls on a texture, in 0..1 [1], or (t, 3, 2) of the corners of its t triangles; None: those
                that it has, as a rectangular cloth does, and a mesh with places.
        """
        name = validation.name("objects.name", name)
        index = validation.indices("objects.balls", np.atleast_1d(np.asarray(balls)), self.n_balls)
        places = None if uv is None else self._places(index, uv)
        self._look_up()
        same = self._firsts.get(int(index[0])) if len(index) else None
        if same is not None and not np.array_equal(self.objects[same].balls, index):
            same = None
        other = self._names.get(name, same)
        if other is not None and other != same:
            kind = self.objects[other].kind
            if not kind:
                raise SceneError("objects.name", name, says="exists already; every object needs its own name")
            self._put(other, replace(self.objects[other], name=self._free_name(kind)))
        if places is None and same is not None:
            places = self.objects[same].uv
        self._put(len(self.objects) if same is None else same, SceneObject(name, index, places))

    def _places(self: Any, index: NDArray[np.int32], uv: ArrayLike) -> NDArray[np.float64]:
        given = validation.as_array(uv)
        if given.ndim != 3:
            return validation.vectors("objects.uv", uv, len(index), 2)
        own = int(np.isin(self.triangles, index).all(axis=1).sum())
        if given.shape != (own, 3, 2):
            raise SceneError(
                "objects.uv", given.shape, f"of shape ({own}, 3, 2): two numbers for each corner of its triangles"
            )
        return validation.vectors("objects.uv", given.reshape(-1, 2), 3 * own, 2).reshape(own, 3, 2)

    def new_object(self, kind: str, balls: NDArray[np.int32], uv: NDArray[np.float64] | None = None) -> None:
        """Balls (k,) that a shape of this kind has added are one object, called by it and a number. uv: as for `set_name`."""
        self._look_up()
        self._put(len(self.objects), SceneObject(self._free_name(kind), balls, uv, kind))

    def _put(self, number: int, one: SceneObject) -> None:
        if number < len(self.objects):
            self._names.pop(self.objects[number].name)
        self.objects[number : number + 1] = [sealed(one)]
        self._names[one.name] = number
        if len(one.balls):
            self._firsts[int(one.balls[0])] = number

    def _look_up(self) -> None:
        """Know them by name, also where some were taken back."""
        if len(self._names) != len(self.objects):
            self._names = {one.name: k for k, one in enumerate(self.objects)}
            self._firsts = {int(one.balls[0]): k for k, one in enumerate(self.objects) if len(one.balls)}
            self._counts = {}

    def _free_name(self, kind: str) -> str:
        count = self._counts.get(kind, 0)
        while (name := f"{kind}_{count}") in self._names:
            count += 1
        self._counts[kind] = count
        return name


def owner(objects: Sequence[SceneObject], ball: int) -> SceneObject | None:
    """The object of a ball, the last one where several have it."""
    return next((one for one in reversed(objects) if ball in one.balls), None)


def ball_in_words(objects: Sequence[SceneObject], ball: int) -> str:
    """`ball 49 (number 9 of rope_0)`, as it counts in the object that it belongs to, or `ball 49`."""
    own = owner(objects, ball)
    return f"ball {ball}" + (f" (number {np.flatnonzero(own.balls == ball)[0]} of {own.name})" if own else "")


def pair_in_words(objects: Sequence[SceneObject], i: int, j: int) -> str:
    """`balls 49 and 50 of rope_0`: the ends of a spring, and the objects that they belong to."""
    owners = {own.name: own for own in (owner(objects, i), owner(objects, j)) if own}
    return f"balls {i} and {j}" + (f" of {' and '.join(owners)}" if owners else "")


def balls_in_words(objects: Sequence[SceneObject], balls: Sequence[int], most: int = 3) -> str:
    """`balls 49, 50, 51 and 4 more (of rope_0)`: the first of one or more balls, and the objects that they belong to."""
    if len(balls) == 1:
        return ball_in_words(objects, balls[0])
    shown = ", ".join(str(ball) for ball in balls[:most])
    more = f" and {len(balls) - most} more" if len(balls) > most else ""
    owners = {own.name: own for own in (owner(objects, ball) for ball in balls[:most]) if own}
    return f"balls {shown}{more}" + (f" (of {', '.join(owners)})" if owners else "")


def named(n: int, objects: Sequence[SceneObject]) -> tuple[NDArray[np.int32], list[str]]:
    """Number (n,) of the object of each of n balls, the last one where several have it, and the objects' names, in the order
    of the scene. Balls of none come last."""
    number = np.full(n, len(objects), dtype=np.int32)
    for k, one in enumerate(objects):
        number[one.balls] = k
    used, inverse = np.unique(number, return_inverse=True)
    names, loose = [one.name for one in objects], LOOSE
    while loose in names:
        loose += "_"
    return inverse.astype(np.int32), [[*names, loose][k] for k in used.tolist()]
