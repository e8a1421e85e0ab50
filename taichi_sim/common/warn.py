"""Warnings that name the line of the user's program which led to them, however many calls of this package lie between."""

import sys
import warnings

__all__ = ["warn"]

PACKAGE = __name__.partition(".")[0]


def warn(text: str) -> None:
    """Warn of the innermost line outside this package that led here; of the outermost line where there is none."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == PACKAGE:
        level, frame = level + 1, frame.f_back
    warnings.warn(text, stacklevel=level)
