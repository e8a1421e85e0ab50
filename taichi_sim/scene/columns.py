"""Tables: columns of one length that grow, and cannot be written to when read; and names of what is in a list that grows.

class Scene:
    mass = Column("balls", "mass", "(n,) kg")
"""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = ["Column", "Marked", "Names", "Table", "sealed", "tables_of"]

ROOM = 1.5  # times as many rows as there are: a table that grows has room for, so that it is copied seldom
Held = TypeVar("Held")


def sealed(held: Held) -> Held:
    """Return `held` so that nobody can change an element from now on: an array itself, or a dataclass, whose arrays, which
    may be somebody's, are replaced by copies."""
    if isinstance(held, np.ndarray):
        held.flags.writeable = False
    elif hasattr(held, "__dataclass_fields__"):
        for field in fields(held):  # type: ignore[arg-type]
            value = getattr(held, field.name)
            if isinstance(value, np.ndarray) and value.flags.writeable:
                object.__setattr__(held, field.name, sealed(value.copy()))
    return held


class Table:
    """Columns of one length, by name. Arrays that were read stay as they are, whatever is added or changed later."""

    def __init__(self, **columns: NDArray) -> None:
        self._columns = {name: sealed(column) for name, column in columns.items()}
        self._views: dict[str, NDArray] = {}  # what was read since the last change
        self.names = tuple(columns)
        self.rows = 0

    def append(self, n: int, **columns: NDArray) -> NDArray[np.int32]:
        """Add n rows, every column of shape (n, ...), and return their numbers (n,). A table that was empty takes the arrays,
        which are its own from now on."""
        rows = self.rows + n
        self._views.clear()
        for name, new in columns.items():
            old = self._columns[name]
            if self.rows == 0:
                self._columns[name] = sealed(
                    new if new.base is None else new.copy()
                )  # else its owner could be written to
                continue
            if len(old) < rows:
                room = np.empty((max(rows, int(ROOM * self.rows)), *old.shape[1:]), dtype=old.dtype)
                room[: self.rows] = old[: self.rows]
                self._columns[name] = old = room
            old.flags.writeable = True  # rows that nobody has read
            old[self.rows : rows] = new
            sealed(old)
        self.rows = rows
        return np.arange(rows - n, rows, dtype=np.int32)

    def cut(self, n: int) -> None:
        """Keep the first n rows; those after them may have been read, so what is added next goes elsewhere."""
        self._columns = {name: column[:n] for name, column in self._columns.items()}
        self._views.clear()
        self.rows = n

    def replace(self, rows: Any, **columns: Any) -> None:
        """Give rows, an index of NumPy's, other values in some columns. Arrays read before keep what they have."""
        for name, values in columns.items():
            column = self[name].copy()
            column[rows] = values
            self._columns[name] = sealed(column)
        self._views.clear()

    def copy(self) -> "Table":
        """Another table with the same rows; arrays are shared, for nobody can write to them."""
        table = Table(**{name: self[name] for name in self.names})
        table.rows = self.rows
        return table

    def __getitem__(self, name: str) -> NDArray:
        view = self._views.get(name)
        if view is None:  # one that cannot be made writeable again
            view = self._views[name] = self._columns[name][: self.rows]
        return view


class Column(property):
    """A column of one of the tables of a scene, as the scene hands it out. `tables_of` makes the tables.

    table, name: of the column; doc: its shape, unit and meaning; row: shape of a row, a name for what depends on the dimensions.
    """

    def __init__(self, table: str, name: str, doc: str, row: Sequence[int | str] = (), dtype: Any = float) -> None:
        super().__init__(lambda scene: scene.tables[table][name], doc=doc)
        self.table, self.name, self.row, self.dtype = table, name, row, dtype


def tables_of(kind: type, dim: int) -> dict[str, Table]:
    """The tables of a scene, without rows, with the columns that its class and those that it is made of declare."""
    sizes = {"dim": dim, "dim + 1": dim + 1, "2 ** dim": 2**dim}
    columns: dict[str, dict[str, NDArray]] = {}
    for base in reversed(kind.__mro__):
        for one in vars(base).values():
            if isinstance(one, Column):
                shape = (0, *(sizes[n] if isinstance(n, str) else n for n in one.row))
                columns.setdefault(one.table, {})[one.name] = np.zeros(shape, dtype=one.dtype)
    return {name: Table(**own) for name, own in columns.items()}


class Names:
    """The names of the items of a list that grows, each looked at once: many are added in as many steps."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}
        self._items: Sequence[Any] = ()
        self._seen = 0

    def number(self, items: Sequence[Any], name: str) -> int | None:
        """Number of the first item of that name; None where there is none, or an item was replaced by it meanwhile."""
        if items is not self._items or self._seen > len(items):  # another list, or some were taken back
            self._numbers, self._items, self._seen = {}, items, 0
        for k in range(self._seen, len(items)):
            self._numbers.setdefault(items[k].name, k)
        self._seen = len(items)
        found = self._numbers.get(name)
        return found if found is not None and items[found].name == name else None


class Marked:
    """Mask of the things that items of a growing list name. Each item is looked at once, so adding n of them takes O(n)."""

    def __init__(self, key: str) -> None:
        """key: of an item, the numbers that it names."""
        self._key, self._marked = key, np.zeros(0, dtype=bool)
        self._items: Sequence[Any] = ()
        self._seen = 0

    def by(self, items: Sequence[Any], n: int) -> NDArray[np.bool_]:
        """A bool for each of n things."""
        if items is not self._items or self._seen > len(items):  # another list, or some were taken back
            self._marked, self._items, self._seen = self._marked[:0], items, 0
        if len(self._marked) < n:
            self._marked = np.concatenate([self._marked, np.zeros(n - len(self._marked), dtype=bool)])
        for item in items[self._seen :]:
            self._marked[getattr(item, self._key)] = True
        self._seen = len(items)
        return self._marked
