"""Table: columns of a scene that grow by whole calls."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["Table"]


class Table:
    """Columns that grow by whole calls and are joined when read."""

    def __init__(self, **columns: NDArray) -> None:
        self._parts = {name: [column] for name, column in columns.items()}
        self.names = tuple(columns)
        self.rows = 0

    def append(self, n: int, **columns: NDArray) -> None:
        """Add n rows."""
        for name, column in columns.items():
            self._parts[name].append(column)
        self.rows += n

    def __getitem__(self, name: str) -> NDArray:
        parts = self._parts[name]
        if len(parts) > 1:
            parts[:] = [np.concatenate(parts)]
        return parts[0]
