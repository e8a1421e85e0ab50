"""Tables: columns of one length that grow; and names of what is in a list that grows."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Names", "Table"]

ROOM = 1.5  # times as many rows as there are: a table that grows has room for, so that it is copied seldom


class Table:
    """Columns of one length, by name."""

    def __init__(self, **columns: NDArray) -> None:
        self._columns = columns
        self.names = tuple(columns)
        self.rows = 0

    def append(self, n: int, **columns: NDArray) -> None:
        """Add n rows: every column, each of shape (n, ...). A table that was empty takes the arrays as they are."""
        rows = self.rows + n
        for name, new in columns.items():
            old = self._columns[name]
            if self.rows == 0:
                self._columns[name] = new
                continue
            if len(old) < rows:
                room = np.empty((max(rows, int(ROOM * self.rows)), *old.shape[1:]), dtype=old.dtype)
                room[: self.rows] = old[: self.rows]
                self._columns[name] = old = room
            old[self.rows : rows] = new
        self.rows = rows

    def cut(self, n: int) -> None:
        """Keep the first n rows."""
        self.rows = n

    def __getitem__(self, name: str) -> NDArray:
        column = self._columns[name]
        return column if len(column) == self.rows else column[: self.rows]


class Names:
    """The names of the items of a list that grows, each looked at once: many are added in as many steps."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}
        self._items: Sequence[Any] = ()
        self._seen = 0

    def number(self, items: Sequence[Any], name: str) -> int | None:
        """Of the first item of that name; None where there is none, or an item was replaced by it meanwhile."""
        if items is not self._items or self._seen > len(items):  # another list, or some were taken back
            self._numbers, self._items, self._seen = {}, items, 0
        for k in range(self._seen, len(items)):
            self._numbers.setdefault(items[k].name, k)
        self._seen = len(items)
        found = self._numbers.get(name)
        return found if found is not None and items[found].name == name else None
