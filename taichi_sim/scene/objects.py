"""Objects: which balls are one thing, and what it is called: for files that other programs open."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError

__all__ = ["LOOSE", "Objects", "SceneObject", "named"]

LOOSE = "balls"  # what balls of no object are called together


@dataclass(frozen=True, slots=True, eq=False)
class SceneObject:
    """One object of a scene. kind: the shape that made it, `cloth`. name: "" where it was given none."""

    kind: str
    name: str
    balls: NDArray[np.int32]  # (k,)
    uv: NDArray[np.float64] | None = None  # (k, 2) in 0..1, of a sheet that has them


class Objects:
    """The part of a Scene that holds them."""

    def _begin_objects(self) -> None:
        self.objects: list[SceneObject] = []

    def set_name(self: Any, balls: ArrayLike, name: str) -> None:
        """Call balls (k,) by a name, those of a shape for instance, in files that other programs open. Raises SceneError where
        something has that name already."""
        if not isinstance(name, str) or not name:
            raise SceneError("name", name, "a text")
        if any(one.name == name for one in self.objects):
            raise SceneError("name", name, says="exists already; every object needs its own name")
        index = validation.indices("balls", np.atleast_1d(np.asarray(balls)), self.n_balls)
        for k, one in enumerate(self.objects):
            if not one.name and np.array_equal(one.balls, index):
                self.objects[k] = replace(one, name=name)
                return
        self.objects.append(SceneObject(LOOSE, name, index))

    def _object(
        self: Any, where: str, given: Mapping[str, Any], arrays: Mapping[str, NDArray], prefix: str
    ) -> SceneObject:
        """One as a file has it. Raises SceneError."""
        kind, name = given["kind"], given["name"]
        if not isinstance(kind, str) or not isinstance(name, str):
            raise SceneError(where, [kind, name], "two texts")
        balls, uv = (
            validation.indices(f"{where}.balls", arrays[f"{prefix}.balls"], self.n_balls),
            arrays.get(f"{prefix}.uv"),
        )
        if uv is not None:
            uv = validation.vectors(f"{where}.uv", uv, len(balls), 2)
        return SceneObject(kind, name, balls, uv)


def named(n: int, objects: Sequence[SceneObject]) -> tuple[NDArray[np.int32], list[str]]:
    """For each of n balls the number (n,) of its object, the last one where several have it, and what these are called, in the
    order of the scene: by name, or by kind and number, cloth_0. Balls of none come last."""
    taken, counts, names = {one.name for one in objects}, dict[str, int](), []
    for one in objects:
        name = one.name
        while not name or (name in taken and not one.name):
            count = counts.get(one.kind, 0)
            name, counts[one.kind] = f"{one.kind}_{count}", count + 1
        names.append(name)
    number = np.full(n, len(objects), dtype=np.int32)
    for k, one in enumerate(objects):
        number[one.balls] = k
    used, inverse = np.unique(number, return_inverse=True)
    loose = LOOSE
    while loose in names:
        loose += "_"
    return inverse.astype(np.int32), [[*names, loose][k] for k in used.tolist()]
