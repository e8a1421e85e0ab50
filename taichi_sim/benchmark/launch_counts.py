"""Counts, for a piece of work, of the loops that it launches on the device, and of the times that the host waits for it.

Launches are what the engine's profiler records: each loop of a kernel, and each stretch between its loops, which runs on one
thread. It records only in a process that was started with the environment variable of `PROFILED`.

The host waits where Python asks for what the device has computed: `ti.sync`, a kernel that returns something or fills a NumPy
array, a field that is copied to NumPy, a field of which one element is read or written. All but the last pass two functions of
the engine, which are wrapped meanwhile; one that finds nothing launched since the last wait is not counted. The last are kernels
of the engine's own, which it waits for and the profiler records. The CPU lets nobody wait; there the numbers say where a device
would.
"""

import json
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np

from taichi_sim.common.errors import BackendError
from taichi_sim.device import backend
from taichi_sim.device.engine import program as running
from taichi_sim.device.engine import ti
from taichi_sim.device.fast_launches import by_engine

__all__ = ["PROFILED", "Counts", "count"]

PROFILED = {"TI_KERNEL_PROFILER": "1", "QD_KERNEL_PROFILER": "1"}  # of Taichi and of Quadrants
ELEMENT = ("snode_reader", "snode_writer")  # how kernels begin that read or write one element of a field
SERIAL = 0  # the type of a task that runs on one thread, in the description of a compiled kernel


class Counts(NamedTuple):
    """launches: of loops and single threads together; one_thread: the latter; waits: of the host for the device."""

    launches: int
    one_thread: int
    waits: int


def count(work: Callable[[], object]) -> Counts:
    """Counts of one call of `work`. What it compiles is not counted, but its launches are: call it once before.

    Raises BackendError where the profiler is off.
    """
    if not ti.profiler.kernel_profiler.get_default_kernel_profiler().get_kernel_profiler_mode():
        raise BackendError(f"launches: the profiler is off; start the process with {next(iter(PROFILED))}=1")
    ti.sync()
    ti.profiler.clear_kernel_profiler_info()
    with _watched() as watch:
        work()
    ti.sync()  # Vulkan records what has ended
    program = running()
    program.sync_kernel_profiler()
    program.update_kernel_profiler()
    names = [record.name for record in program.get_kernel_profiler_records()]
    single = _one_thread(watch.kernels)
    elements = sum(name.startswith(ELEMENT) for name in names)
    return Counts(len(names), sum(map(single, names)), watch.waits + elements)


class _Watch:
    """kernels: what was launched, by its identity; waits: how often the host waited for it."""

    def __init__(self) -> None:
        self.kernels: dict[int, Any] = {}
        self.waits, self._pending = 0, False

    def launched(self, kernel: Any) -> None:
        self.kernels[id(kernel)], self._pending = kernel, True

    def waited(self) -> None:
        self.waits += self._pending
        self._pending = False


@contextmanager
def _watched() -> Iterator[_Watch]:
    """Let a watch see each launch from Python and each wait."""
    watch, runtime, kind = _Watch(), ti.lang.impl.get_runtime(), ti.lang.kernel_impl.Kernel
    launch, sync = kind.launch_kernel, runtime.sync

    def watched_launch(kernel: Any, compiled: Any, *arguments: Any, **named: Any) -> Any:
        watch.launched(compiled)
        found = launch(kernel, compiled, *arguments, **named)
        if any(isinstance(argument, np.ndarray) for argument in arguments):  # copied back before the launch returns
            watch.waited()
        return found

    def watched_sync() -> None:
        watch.waited()
        sync()

    launches, syncs = patch.object(kind, "launch_kernel", watched_launch), patch.object(runtime, "sync", watched_sync)
    with by_engine(), launches, syncs:
        yield watch


def _one_thread(kernels: dict[int, Any]) -> Callable[[str], bool]:
    """Function that says of a task of these kernels, by its name, if it runs on one thread. Code made by LLVM says it in the
    name; what is made for Vulkan and Metal in the description that the engine writes for programs without Python."""
    if backend.has_wide_numbers():  # made by LLVM
        return lambda name: name.endswith("_serial")
    program = running()
    arch = program.config().arch
    builder = program.make_aot_module_builder(arch, [])
    for number, kernel in enumerate(kernels.values()):
        builder.add(str(number), kernel)
    with tempfile.TemporaryDirectory() as folder:
        builder.dump(folder, "")
        described = json.loads(Path(folder, "metadata.json").read_text(encoding="utf-8"))
    kinds = {task["name"]: task["task_type"] for kernel in described["kernels"] for task in kernel["tasks_attribs"]}
    return lambda name: name.startswith(ELEMENT) or kinds[name] == SERIAL
