"""Fields: trees of Taichi fields that are declared piece by piece, filled once, and freed as a whole."""

import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.errors import SceneError
from taichi_sim.device import backend
from taichi_sim.device.engine import ti
from taichi_sim.device.fast_launches import copy_in
from taichi_sim.device.trees import Tree, drop, forget, kept, lead, take, take_back, twin

__all__ = ["NUMPY_TYPES", "Fields", "fill"]

MOST_NODES = 1024  # of a tree, in Taichi: a root, and for each field or column one and one for each number of an entry
NUMPY_TYPES = {ti.i32: np.int32, ti.f32: np.float32, ti.f64: np.float64}


def fill(field: Any, values: NDArray) -> None:
    """Copy values of its shape into a field, in its own type."""
    copy_in(field, values.astype(NUMPY_TYPES[field.dtype]))


class Fields:
    """Collects fields with their first values; `build()` allocates and fills them, `free()` gives the memory back.

    Taichi frees memory only by whole trees, and a process holds few hundred of them: so one per simulation, or several where
    Taichi's limit of nodes in a tree asks for them. What is freed
    serves later fields of the same types and lengths, see `trees`: as long as what is declared is like a freed tree's fields,
    these are handed out, because Taichi takes half a millisecond to make one. A field that would be empty gets one unused
    element, because Taichi has no empty fields.

    on: other fields, still in use, that are freed when these are built, which take over their memory where they are like them.
    """

    def __init__(self, real: Any, wide: bool = True, on: "Fields | None" = None) -> None:
        backend.check_thread()
        self.real, self.has_wide_numbers = real, wide
        self._on = on
        self._alike = kept()  # trees that begin like what is declared
        if on is not None and on._tree is not None:
            self._alike.append(on._tree)
        self._builders: list[Any] = []  # of a tree each, once there is no tree to take over
        self._nodes = MOST_NODES  # in the last one
        self._declared: list[Any] = []
        self._makers: list[Callable[[], Any]] = []  # of a new field for each
        self._layout: list[tuple[Any, ...]] = []  # type, length and way of storage of each
        self._first: list[tuple[int, Any]] = []  # number of the field, values
        self._tree: Tree | None = None
        self._owner_collected: Any = None  # gives the tree back where nobody called `free`
        self._bytes: dict[int, int] = {}  # by the identity of a field

    def _place(
        self, make: Callable[[], Any], kind: object, n: int, data: Any, item_bytes: int, by_column: bool = False
    ) -> Any:
        """Declare a field of n entries, each of a kind and so many bytes, that begins with data, or with zeros. make: one that
        is new."""
        n, number = max(1, n), len(self._declared)
        self._makers.append(make)
        self._layout.append((kind, n, by_column))
        self._alike = [
            tree for tree in self._alike if len(tree.layout) > number and tree.layout[number] == self._layout[-1]
        ]
        if not self._alike:
            self._begin_new()
        field = twin(self._alike[-1].fields[number]) if self._alike else self._new(number)
        if data is not None:
            self._first.append((number, data))
        self._declared.append(field)
        self._bytes[id(field)] = n * item_bytes
        return field

    def _begin_new(self) -> None:
        """Make fields for all that were declared so far."""
        if not self._builders:
            self._add_builder()
            for number, field in enumerate(self._declared):
                lead(field, self._new(number))

    def _add_builder(self) -> None:
        self._builders.append(ti.FieldsBuilder())
        self._nodes = 1  # its root

    def _new(self, number: int) -> Any:
        """A new field in place of the one declared with this number."""
        _, n, by_column = self._layout[number]
        field = self._makers[number]()
        for part in [field.get_member_field(name) for name in field.keys] if by_column else [field]:
            nodes = 1 + len(part._get_field_members())
            if self._nodes + nodes > MOST_NODES:
                self._add_builder()
            self._nodes += nodes
            self._builders[-1].dense(ti.i, n).place(part)
        return field

    @property
    def layout(self) -> tuple[Any, ...]:
        """Type, length and way of storage of each field."""
        return tuple(self._layout)

    @property
    def bytes(self) -> int:
        """Memory of all fields together."""
        return sum(self._bytes.values())

    def size(self, field: Any) -> int:
        """Bytes of one field; 0 for what is none of these."""
        return self._bytes.get(id(field), 0)

    @property
    def wide(self) -> Any:
        """Taichi's type for sums: double precision, or, where the device has none, that of the run."""
        return ti.f64 if self.has_wide_numbers else self.real

    @property
    def widens(self) -> bool:
        """True if sums have more digits than the numbers of the run."""
        return bool(self.wide != self.real)

    @property
    def _size(self) -> int:
        return 8 if self.real == ti.f64 else 4

    def _cast(self, data: NDArray, what: str = "number") -> NDArray:
        """A copy in the precision of the run, where a number may become 0. One that is too large raises SceneError, with a word
        for what it is."""
        if self.real == ti.f64:
            return np.ascontiguousarray(data, dtype=np.float64)
        with np.errstate(over="ignore"):
            array = np.ascontiguousarray(data, dtype=np.float32)
        lost = ~np.isfinite(array)
        if lost.any():
            value = np.asarray(data)[lost].flat[0]
            says = f'the {what} {value:.4g} does not fit into single precision; use precision "f64"'
            raise SceneError("precision", says=says)
        return array

    def reals(self, data: int | NDArray) -> Any:
        """A field of reals: n of them, zero, or a copy of data, shape (n,) or (n, dim)."""
        if isinstance(data, int):
            return self._place(lambda: ti.field(self.real), str(self.real), data, None, self._size)
        array = self._cast(data)
        width = array.shape[1] if array.ndim == 2 else 0
        first = array if len(array) else None

        def make() -> Any:
            return ti.Vector.field(width, self.real) if width else ti.field(self.real)

        return self._place(make, (str(self.real), width), len(array), first, self._size * max(1, width))

    def doubles(self, n: int) -> Any:
        """n zeros in double precision, for sums; in single precision where the device has no other."""
        real, size = self._kind(True)
        return self._place(lambda: ti.field(real), str(real), n, None, size)

    def vectors(self, n: int, dim: int, *, wide: bool = False) -> Any:
        """n zero vectors; wide: of the type `wide`."""
        real, size = self._kind(wide)
        return self._place(lambda: ti.Vector.field(dim, real), (str(real), dim), n, None, size * dim)

    def matrices(self, n: int, dim: int, *, wide: bool = False) -> Any:
        """n zero matrices (dim, dim); wide: of the type `wide`."""
        real, size = self._kind(wide)
        return self._place(lambda: ti.Matrix.field(dim, dim, real), (str(real), dim, dim), n, None, size * dim * dim)

    def _kind(self, wide: bool) -> tuple[Any, int]:
        """Type of wide numbers, or of those of the run, and its bytes."""
        real = self.wide if wide else self.real
        return real, 8 if real == ti.f64 else 4

    def spins(self, n: int, dim: int) -> Any:
        """n zero spins: a scalar each in 2D, a vector in 3D."""
        return self.reals(n) if dim == 2 else self.vectors(n, 3)

    def impulses(self, dim: int, friction: bool) -> dict[str, Any]:
        """Columns of what a contact accumulates [N s]: `impulse` along its normal; with friction `tangential_impulse` along the
        surface, in 2D a scalar along the normal turned by 90 degrees."""
        along = self.real if dim == 2 else ti.types.vector(3, self.real)
        return {"impulse": self.real, **({"tangential_impulse": along} if friction else {})}

    def integers(self, data: int | NDArray) -> Any:
        """A field of 32-bit integers: n zeros, or a copy of data, shape (n,)."""
        n = data if isinstance(data, int) else len(data)
        array = None if isinstance(data, int) or n == 0 else np.ascontiguousarray(data, dtype=np.int32)
        return self._place(lambda: ti.field(ti.i32), "i32", n, array, 4)

    def keys(self, n: int) -> Any:
        """n zeros of 64-bit integers."""
        return self._place(lambda: ti.field(ti.i64), "i64", n, None, 8)

    def cells(self, n: int, dim: int) -> Any:
        """n zero vectors of 32-bit integers."""
        return self._place(lambda: ti.Vector.field(dim, ti.i32), ("i32", dim), n, None, 4 * dim)

    def table(
        self, columns: dict[str, Any], n: int, data: dict[str, NDArray] | None = None, *, by_column: bool = False
    ) -> Any:
        """n rows of a struct, members side by side, or column after column. columns: name to Taichi type (a scalar or a vector
        type)."""
        width = sum(
            getattr(t, "n", 1) * (4 if getattr(t, "dtype", t) == ti.i32 else self._size) for t in columns.values()
        )
        typed = None
        if data is not None and n:
            typed = {
                name: np.ascontiguousarray(data[name], dtype=np.int32)
                if getattr(t, "dtype", t) == ti.i32
                else self._cast(data[name], name)
                for name, t in columns.items()
            }
        kind = tuple((name, str(getattr(t, "dtype", t)), getattr(t, "n", 0)) for name, t in columns.items())
        return self._place(lambda: ti.Struct.field(columns), kind, n, typed, width, by_column)

    def build(self) -> None:
        """Allocate everything, or take over what was freed of the same layout, and copy the first values in."""
        others = None if self._on is None else self._on._released()
        self._tree = take(self.layout, self._declared, self._builders, others)
        if others is not None and self._tree is not others:
            take_back(others)
        if self._tree is None:
            self._begin_new()
            self._tree = Tree(self.layout, self._declared, self._builders, self.bytes)
        for number, data in self._first:
            copy_in(self._tree.fields[number], data)
        self._first.clear()
        self._makers.clear()
        self._alike = []
        self._on = None
        self._owner_collected = weakref.finalize(self, drop, self._tree)

    def abandon(self) -> None:
        """Undo a construction that failed: a builder left open would make every later simulation fail."""
        if self._tree is None:
            forget(self._builders)
        self.free()

    @property
    def built(self) -> bool:
        """True if the fields may be used: built, neither freed nor gone with the engine."""
        return self._tree is not None and self._tree.alive

    def free(self) -> None:
        """Give the memory back. The fields must not be used after that."""
        if self._tree is not None:
            backend.check_thread()
            tree = self._released()
            assert tree is not None
            take_back(tree)

    def _released(self) -> Tree | None:
        """Memory that is no longer these fields'."""
        if self._owner_collected is not None:  # else filling it failed, or there is none yet
            self._owner_collected.detach()
        tree, self._tree = self._tree, None
        return tree
