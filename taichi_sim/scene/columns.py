"""Tables: columns that grow by whole calls and are joined when read."""

from numpy import concatenate
from numpy.typing import NDArray

__all__ = ["Table"]


class Table:
    """Columns of one length, by name."""

    def __init__(self, **columns: NDArray) -> None:
        self._parts = {name: [column] for name, column in columns.items()}
        self.names = tuple(columns)
        self.rows = 0

    def append(self, n: int, **columns: NDArray) -> None:
        """Add n rows."""
        for name, column in columns.items():
            self._parts[name].append(column)
        self.rows += n

    def cut(self, n: int) -> None:
        """Keep the first n rows."""
        self._parts = {name: [self[name][:n]] for name in self.names}
        self.rows = n

    def __getitem__(self, name: str) -> NDArray:
        parts = self._parts[name]
        if len(parts) > 1:
            parts[:] = [concatenate(parts)]
        return parts[0]
