"""Plain values: None, numbers, texts, bools, lists and tables, as JSON and scene files have them."""

from collections.abc import Mapping
from os import PathLike, fspath
from typing import Any

import numpy as np

__all__ = ["plain"]


def plain(value: Any) -> Any:
    """A value as such, all the way down: NumPy's numbers and arrays, paths, tuples and any kind of table are what Python code
    gives for one. What is none of these stays as it is."""
    if isinstance(value, (np.generic, np.ndarray)):
        return plain(value.tolist()) if value.dtype == object else value.tolist()
    if isinstance(value, PathLike):
        return fspath(value)
    if isinstance(value, Mapping):
        return {key: plain(one) for key, one in value.items()}
    return [plain(one) for one in value] if isinstance(value, (list, tuple)) else value
