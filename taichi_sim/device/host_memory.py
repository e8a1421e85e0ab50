"""Memory of fields as NumPy sees it on the CPU, so that copies in and out need no kernels.

Taichi copies by a kernel for each field and each direction, and reads or writes one number by another one; a simulation has some
fifty of them, each of which takes 50 ms to compile and 17 ms to load. On the CPU the memory of a field is the process's own: here
its numbers are read and written where they lie. On a device, and in a version of Taichi whose layout is not known, nothing is
seen, and the engine copies.
"""

import ctypes
import functools
from collections.abc import Callable, Iterable
from numbers import Number
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.errors import BackendError
from taichi_sim.device.engine import IS_KNOWN, on_device, program, ti

__all__ = ["HostMemory", "seen"]

VIEW = "_numbers_on_host"  # attribute of a field whose memory is seen
NUMPY_TYPES = {
    ti.u8: np.uint8,
    ti.u32: np.uint32,
    ti.i32: np.int32,
    ti.i64: np.int64,
    ti.f32: np.float32,
    ti.f64: np.float64,
}


def seen(field: Any) -> NDArray | None:
    """The numbers of a field where they lie, shape (n,), or (n, rows, columns) of matrices and vectors; None where they are not
    seen."""
    memory, view = vars(field).get(VIEW, (None, None))
    return view if memory is not None and memory.alive else None


class HostMemory:
    """The memory of trees of fields, each of which is given a view of its own. It is seen until it is freed."""

    def __init__(self, fields: Iterable[Any]) -> None:
        self._program: Any = None
        self._views: list[NDArray] = []
        if (
            not IS_KNOWN or on_device() or ti.lang.impl.current_cfg().kernel_profiler
        ):  # which counts what a device would do
            return
        _install()
        own = [one for field in fields for one in _without_structs(field)]
        self._program = program()
        roots: dict[int, int] = {}  # addresses, by the number of the tree
        for field in own:
            tree = field.snode.ptr.get_snode_tree_id()
            if tree not in roots:
                roots[tree] = int(_address(field)) - _offset(field.snode.ptr)
            if field.dtype in NUMPY_TYPES:
                self._show(field, roots[tree])

    @property
    def alive(self) -> bool:
        """True if the memory is there, and seen."""
        return self._program is not None and self._program is program()

    def clear(self) -> None:
        """Set all numbers to zero."""
        for view in self._views:
            view[...] = 0

    def free(self) -> None:
        """The memory goes back."""
        self._program = None

    def _show(self, field: Any, root: int) -> None:
        """Give a field, of numbers or of matrices of them, its view."""
        dtype = np.dtype(NUMPY_TYPES[field.dtype])
        places = [_offset(one.ptr.snode()) for one in field._get_field_members()]
        assert places == [places[0] + k * dtype.itemsize for k in range(len(places))]  # one entry lies together
        n, step = field.shape[0], field.snode.parent()._cell_size_bytes
        length = (n - 1) * step + len(places) * dtype.itemsize
        memory = (ctypes.c_char * length).from_address(root + places[0])
        columns: NDArray = np.ndarray((n, len(places)), dtype, memory, strides=(step, dtype.itemsize))
        view = columns[:, 0]
        if isinstance(field, ti.MatrixField):
            strides = (step, field.m * dtype.itemsize, dtype.itemsize)
            view = np.ndarray((n, field.n, field.m), dtype, memory, strides=strides)
        self._views.append(view)
        vars(field)[VIEW] = self, view
        field.host_accessors = [_Accessor(self, column) for column in columns.T]


class _Accessor:
    """Reads and writes one number, in place of the engine's accessor. Raises BackendError once the memory is freed."""

    def __init__(self, memory: HostMemory, column: NDArray) -> None:
        self._memory, self._numbers = memory, column

    @property
    def _column(self) -> NDArray:
        if not self._memory.alive:
            raise BackendError(
                "this field's memory was freed when its simulation was closed; take its numbers before that"
            )
        return self._numbers

    def getter(self, *key: int) -> int | float:
        return self._column[key[0]].item()

    def setter(self, value: float, *key: int) -> None:
        self._column[key[0]] = value


def _without_structs(field: Any) -> list[Any]:
    """The fields of numbers, vectors and matrices of which a field is made."""
    if isinstance(field, ti.StructField):
        return [one for _, member in field._items for one in _without_structs(member)]
    return [field]


def _offset(place: Any) -> int:
    """Bytes from the start of a tree to the first entry of a place in it."""
    return int(place.offset_bytes_in_parent_cell + place.parent.offset_bytes_in_parent_cell)


@ti.kernel
def _address(field: ti.template()) -> ti.u64:
    return ti.cast(ti.get_addr(field, [0]), ti.u64)


@functools.cache
def _install() -> None:
    """Make the engine's fields copy by their views where they have them."""
    for kind in (ti.ScalarField, ti.MatrixField):
        for name, ours in (("to_numpy", _read), ("_from_external_arr", _write), ("fill", _fill)):
            setattr(kind, name, _either(ours, getattr(kind, name)))


def _either(ours: Callable, theirs: Callable) -> Callable:
    """One of two methods of fields: ours, which returns NotImplemented where theirs is needed."""

    @functools.wraps(theirs)
    def call(field: Any, *args: Any, **named: Any) -> Any:
        numbers = None if ti.lang.impl.inside_kernel() else seen(field)
        found = NotImplemented if numbers is None else ours(_plain(numbers), *args, **named)
        return theirs(field, *args, **named) if found is NotImplemented else found

    return call


def _plain(numbers: NDArray) -> NDArray:
    """The numbers of vectors without the axis of columns."""
    return numbers[:, :, 0] if numbers.ndim == 3 and numbers.shape[2] == 1 else numbers


def _read(numbers: NDArray, *other: Any, **named: Any) -> Any:
    return NotImplemented if other or named else numbers.copy()


def _write(numbers: NDArray, given: NDArray) -> Any:
    if numbers.shape != given.shape:
        return NotImplemented
    numbers[...] = given
    return None


def _fill(numbers: NDArray, value: Any) -> Any:
    if not isinstance(value, Number):
        return NotImplemented
    numbers[...] = value
    return None
