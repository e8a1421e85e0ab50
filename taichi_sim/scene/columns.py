"""Tables: columns that grow by whole calls and are joined when read; what is read cannot be written to."""

from dataclasses import fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = ["Table", "sealed"]

Held = TypeVar("Held")


def sealed(held: Held) -> Held:
    """The same object, of which nobody can change an element from now on: an array, or a dataclass, whose arrays, which may be
    somebody's, are copied."""
    if isinstance(held, np.ndarray):
        held.flags.writeable = False
    elif hasattr(held, "__dataclass_fields__"):
        for field in fields(held):  # type: ignore[arg-type]
            value = getattr(held, field.name)
            if isinstance(value, np.ndarray) and value.flags.writeable:
                object.__setattr__(held, field.name, sealed(value.copy()))
    return held


class Table:
    """Columns of one length, by name."""

    def __init__(self, **columns: NDArray) -> None:
        self._parts = {name: [_held(column)] for name, column in columns.items()}
        self.names = tuple(columns)
        self.rows = 0

    def append(self, n: int, **columns: NDArray) -> None:
        """Add n rows. The arrays are the table's from now on."""
        for name, column in columns.items():
            self._parts[name].append(_held(column))
        self.rows += n

    def cut(self, n: int) -> None:
        """Keep the first n rows."""
        self._parts = {name: [self[name][:n]] for name in self.names}
        self.rows = n

    def replace(self, rows: Any, **columns: Any) -> None:
        """Give rows, an index of NumPy's, other values in some columns. Arrays read before keep what they have."""
        for name, values in columns.items():
            column = self[name].copy()
            column[rows] = values
            self._parts[name] = [_held(column)]

    def copy(self) -> "Table":
        """Another table with the same rows; arrays are shared, for nobody can write to them."""
        table = Table(**{name: self[name] for name in self.names})
        table.rows = self.rows
        return table

    def __getitem__(self, name: str) -> NDArray:
        parts = self._parts[name]
        if len(parts) > 1:
            parts[:] = [_held(np.concatenate(parts))]
        return parts[0]


def _held(column: NDArray) -> NDArray:
    """A read-only view, which cannot be made writeable again."""
    return sealed(column).view()
