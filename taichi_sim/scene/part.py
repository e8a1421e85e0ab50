"""Part: what a kind of thing that a scene holds is to files, copies, digests and messages.

A part is a table of scene files, whose keys are the arguments of the method of Scene that adds it, and rows of such arguments
that add the same again."""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.scene.collision_groups import EVERY, ONLY

__all__ = ["Columns", "Element", "Listed", "Part", "Quadratic", "Row", "group_keys"]

Row = dict[str, Any]  # arguments of a method of Scene, arrays or plain values
Floats = NDArray[np.float64]


class Part:
    """One kind of thing that a scene holds, made of these attributes; those that a subclass does not set are given by name."""

    name: str  # of its table in a file
    method: str  # of Scene, which adds it; its signature and docstring are the schema of the table
    has_file: bool = True  # whether a table may name an .npz in which the longer of its arrays lie
    counted: tuple[str, ...] = ()  # arguments that number balls within those that a table names as `balls`
    # arguments that are balls, by a name or by their numbers, each with the key of those of its members that are meant
    chosen: ClassVar[Mapping[str, str]] = {}
    is_one: bool = False  # whether a scene has one row at most
    is_single: bool = False  # whether a file has one table at most
    is_simulated: bool = True  # whether a simulation depends on it by itself
    title: str = ""  # in words and in the plural, where that is not the name
    keys: tuple[str, ...] = ()  # what is read of each item of a list, and is an argument where it is not None
    assumed: ClassVar[Mapping[str, float]] = {}  # values that an array may be left out for, where all are that

    def __init__(self, **attributes: Any) -> None:
        vars(self).update(attributes)

    @property
    def words(self) -> str:
        """Name of several of them, for messages."""
        return self.title or self.name.replace("_", " ")

    def rows(self, scene: Any) -> list[Row]:
        """Arguments that add the same again."""
        return []

    def count(self, scene: Any) -> int:
        """Number of them in a scene."""
        return len(self.rows(scene))

    def add(self, scene: Any, row: Mapping[str, Any]) -> Any:
        """Add what a table of a file says, with the scene's numbers of balls."""
        return getattr(scene, self.method)(**row)

    def restorer(self, scene: Any) -> Callable[..., Any]:
        """A function that takes a row."""
        return getattr(scene, self.method)  # type: ignore[no-any-return]


class Columns(Part):
    """A part in a table of the scene: one row, of all its columns."""

    is_one = True

    def rows(self, scene: Any) -> list[Row]:
        table = scene.tables[self.name]
        return [_without(self.assumed, {key: table[key] for key in table.names})] if table.rows else []

    def count(self, scene: Any) -> int:
        return int(scene.tables[self.name].rows)


class Listed(Part):
    """A part in a list of the scene, which has its name. Items may have more arguments, in `given`."""

    def row(self, scene: Any, one: Any) -> Row:
        """Arguments that add one of them again."""
        own = {key: value for key in self.keys if (value := getattr(one, key)) is not None}
        return _without(self.assumed, own) | dict(getattr(one, "given", {}))

    def rows(self, scene: Any) -> list[Row]:
        return [self.row(scene, one) for one in getattr(scene, self.name)]

    def count(self, scene: Any) -> int:
        return len(getattr(scene, self.name))


class Quadratic(NamedTuple):
    """Elements that store strength |sum_k g_k x_k|^2 / 2: balls (e, k), gradient (e, k, dim), strength (e,). A gradient (e, k, 1)
    stands for the same in all directions."""

    corners: NDArray
    gradient: Floats
    strength: Floats


class Element(Part):
    """A part that exerts forces on balls: beside its table in files, what reports and step sizes need of it, in NumPy. Its
    kernels are in the room `forces`, by its name."""

    # whether a scene has what kernels are compiled for, in words
    features: ClassVar[Mapping[str, Callable[[Any], Any]]] = {}

    # whether implicit methods solve for it: its kernels give the derivatives, see forces.corners.Corners
    is_implicit: bool = False
    is_linear: bool = False  # forces are linear in places and velocities: its stiffness and damping hold in any shape
    gives_energy: bool = False  # or takes it: the energy of a scene with one does not stay
    excludes_contact: bool = False  # two balls of one element never collide
    has_volume: bool = False  # it can be turned inside out
    work: int = 0  # of one for a substep, in springs

    def acts(self, scene: Any) -> bool:
        """True if the scene has one that exerts a force."""
        return self.count(scene) > 0

    def corners(self, scene: Any) -> NDArray[np.int32]:
        """Balls (e, k) of its elements, which it joins."""
        return scene.tables[self.name]["corners"]  # type: ignore[no-any-return]

    def energies(self, scene: Any, x: Floats, whole: NDArray[np.bool_]) -> list[float]:
        """Terms of its energy [J] at x (n, dim), of the elements (e,) that are whole."""
        return []

    def stiffness(self, scene: Any) -> list[Quadratic]:
        """Quadratic forms of its energy in displacements x about the present shape."""
        return []

    def damping(self, scene: Any) -> list[Quadratic]:
        """Quadratic forms of the power that it dissipates, in velocities in place of displacements."""
        return []

    def cancelling(self, scene: Any) -> float:
        """Joule of terms of its energy that cancel each other at rest, but for rounding."""
        return 0.0

    def further_rates(self, scene: Any) -> tuple[float, float]:
        """Terms to add to the largest eigenvalues of M^-1 K [1/s^2] and M^-1 D [1/s] of its quadratic forms."""
        return 0.0, 0.0


def _without(assumed: Mapping[str, float], row: Row) -> Row:
    """A row without the arrays all of whose values are those that are assumed."""
    return {key: value for key, value in row.items() if key not in assumed or np.any(value != assumed[key])}


def group_keys(scene: Any, group: int, mask: int) -> Row:
    """The arguments for collision groups, where they are not the default."""
    keys: Row = {} if group == ONLY else {"group": scene.groups.listed(group)}
    return keys if mask == EVERY else keys | {"collides_with": scene.groups.listed(mask)}
