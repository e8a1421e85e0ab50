"""Python processes that this program starts: none takes modules from the working folder, which may be that of a scene from
elsewhere, in Python 3.10 either, which has no PYTHONSAFEPATH."""

import os
import sys
from collections.abc import Sequence
from typing import Any

__all__ = ["OWN_MODULES", "own_command", "settle_children"]

OWN_MODULES = "import sys; sys.path = [place for place in sys.path if place]; "  # what `python -c` begins with
MAIN = "from taichi_sim.__main__ import main; main()"


def own_command(*arguments: str) -> list[str]:
    """The words of a process that does what `taichi-sim` does with these arguments."""
    return [sys.executable, "-c", OWN_MODULES + MAIN, *arguments]


def settle_children() -> None:
    """Let processes that are started from here on, those of `multiprocessing` among them, take no modules from the working
    folder."""
    os.environ.setdefault("PYTHONSAFEPATH", "1")
    if sys.version_info < (3, 11):
        from multiprocessing import util

        start = util.spawnv_passfds

        def spawn(path: bytes, args: Sequence[Any], passfds: Sequence[int]) -> int:
            code = args.index("-c") + 1
            return start(path, [*args[:code], OWN_MODULES + args[code], *args[code + 1 :]], passfds)

        util.spawnv_passfds = spawn
