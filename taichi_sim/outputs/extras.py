"""Packages that some outputs need and that are not installed with this one."""

from importlib import import_module
from pathlib import Path
from typing import Any

__all__ = ["needed"]


def needed(module: str, extra: str, path: Path) -> Any:
    """A module of an optional package. Raises ValueError that says how to get it for the output `path`."""
    try:
        return import_module(module)
    except ImportError:
        raise ValueError(f'{path}: {path.suffix} needs one more package: pip install "taichi-sim[{extra}]"') from None
