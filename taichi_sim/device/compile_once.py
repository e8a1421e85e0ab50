"""Kernels that several processes of a machine need at the same time: one of them compiles, the others wait and load."""

import hashlib
import time
from collections.abc import Callable
from contextlib import ExitStack

from taichi_sim.common.atomic_file import waiting
from taichi_sim.device import backend

__all__ = ["compile_once"]


def compile_once(kind: str, job: str, rehearse: Callable[[], None]) -> float:
    """Let one process of this machine compile the kernels of that kind for a job, while others wait that call this. Returns how
    long this one waited [s].

    rehearse: launches all of these kernels. job: name of the work, in which each kind is compiled once. The engine reads the
    cache when it starts and writes it when it ends, so it does not run when this returns. Where the process that compiles is
    killed, the next one compiles. Where the folder of the cache is another user's, each process compiles.
    """
    backend.stop()
    folder = backend.kernel_folder()
    name = hashlib.sha256(kind.encode()).hexdigest()
    mark = hashlib.sha256(f"{job} {kind}".encode()).hexdigest().encode()
    begun = time.perf_counter()
    with ExitStack() as stack:
        try:  # few files, whatever is run: two kinds may have one
            file = stack.enter_context(waiting(folder / f"once_{name[:2]}.lock")) if folder else None
        except OSError:  # another user's
            file = None
        waited = time.perf_counter() - begun
        if file is None or file.read() == mark:
            return waited
        stack.callback(backend.stop)
        rehearse()
        backend.stop()
        file.seek(0)
        file.truncate()
        file.write(mark)
    return waited
