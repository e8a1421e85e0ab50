"""Environment variables that are changed for a while."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["restored_environment"]


@contextmanager
def restored_environment() -> Iterator[None]:
    """Give the environment variables their present values back at the end of the block."""
    before = dict(os.environ)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)
