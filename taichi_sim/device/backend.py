"""The only place that starts and stops Taichi. Arch, precision and threads hold for the whole process.

A second `ti.init` would silently invalidate every field that exists, so a request that differs from what runs is refused. Taichi
serves one thread, that which started it; in another its kernels fail or compute nonsense, so use from there is refused, too.
"""

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from taichi_sim.common.environment import restored_environment
from taichi_sim.common.errors import BackendError
from taichi_sim.common.warn import warn
from taichi_sim.device.compile_speedup import quicken
from taichi_sim.device.compiling import count_time
from taichi_sim.device.devices import find, verdict
from taichi_sim.device.engine import ENGINE, PREFIX, QUADRANTS_ARCHES, VERSION, finds, program, ti
from taichi_sim.device.kernel_cache import cache_folder

__all__ = [
    "ARCHES",
    "PRECISIONS",
    "Backend",
    "check_thread",
    "has_wide_numbers",
    "kernel_folder",
    "running",
    "start",
    "stop",
]

ARCHES = ("auto", "cpu", "cuda", "vulkan", "metal")
PRECISIONS = ("f32", "f64")
AUTOMATIC = ("cuda", "metal", "vulkan", "cpu")  # in the order in which they are tried
WIDE_ARCHES = ("cpu", "cuda")  # with 64-bit numbers
# of environment variables that the engine reads behind its prefix
OWN_SETTINGS = ("ARCH", "DEFAULT_FP", "DEFAULT_IP", "CPU_MAX_NUM_THREADS", "OFFLINE_CACHE", "OFFLINE_CACHE_FILE_PATH",
    "OFFLINE_CACHE_MAX_SIZE_OF_FILES", "LOG_LEVEL", "FAST_MATH", "ADVANCED_OPTIMIZATION")  # fmt: skip
MOST_THREADS = max(64, 4 * (os.cpu_count() or 1))  # where memory is limited the engine hangs when it cannot start them
# Calls within each other. The engine's compiler takes some for each level of a kernel's source and of the functions in it:
# 750 for a scene with one thread and all kinds of parts, beside those of its caller; Python allows 1000.
DEEPEST_CALLS = 5000
CACHE_BYTES = 1 << 30  # of compiled kernels kept on disk; of the 100 MB that Taichi keeps a dozen scenes leave nothing


class Backend(NamedTuple):
    """Engine's target: arch ("cpu", "cuda", ...), precision ("f32" or "f64"), threads (CPU threads; 0 on a GPU), device: its
    name and driver, "" for the CPU."""

    arch: str
    precision: str
    threads: int
    device: str = ""

    def __str__(self) -> str:
        """`cpu, 2 threads, f32, taichi 1.7.4`, `vulkan Some GPU (Vulkan 1.3, driver 0x1), f32, taichi 1.7.4`."""
        where = f"{self.arch} {self.device}".rstrip()
        if self.arch == "cpu":
            where = f"{self.arch}, {self.threads} thread{'s' * (self.threads != 1)}"
        return f"{where}, {self.precision}, {ENGINE} {VERSION}"

    @property
    def has_wide_numbers(self) -> bool:
        """True if its kernels may use 64-bit numbers and atomics on them: many Vulkan and Metal devices have none."""
        return self.arch in WIDE_ARCHES

    @property
    def real(self) -> Any:
        """Taichi's type for real numbers in the simulation's fields."""
        return ti.f64 if self.precision == "f64" else ti.f32


_running: Backend | None = None
_owner: tuple[int, int, str] | None = None  # process, thread and its name that started it
_program: Any = None  # the engine's, which goes where somebody else resets or starts it
_starting = threading.Lock()


def running() -> Backend | None:
    """The backend of this process, or None before the first start, and after somebody's own `ti.reset()` or `ti.init()`."""
    return _running if _running is not None and program() is _program else None


def has_wide_numbers() -> bool:
    """True if the running backend has 64-bit numbers, or none runs."""
    runs = running()
    return runs is None or runs.has_wide_numbers


def check_thread() -> None:
    """Raise BackendError in any other thread, or a forked process, than that which started Taichi; takes less than a
    microsecond."""
    if _owner is None or (threading.get_ident() == _owner[1] and os.getpid() == _owner[0]):
        return
    if os.getpid() != _owner[0]:
        raise BackendError(
            "process: this one was forked from one in which simulations already ran, and shares its Taichi, which cannot work;"
            ' start processes by "spawn": multiprocessing.get_context("spawn")'
        )
    here = threading.current_thread().name
    raise BackendError(
        f"thread: simulations and renderers of this process belong to the thread {_owner[2]!r}, in which the first one was made,"
        f" and this is {here!r}; make, step, read and close them there, or give each thread's work a process of its own"
    )


def start(arch: str | None = None, precision: str | None = None, threads: int | None = None) -> Backend:
    """Start Taichi, or return what runs already when it fits.

    Args: what is left None takes what runs, or else arch "auto" (a GPU if one works, else the CPU), precision "f32" and
    all CPU threads. Raises ValueError for an unknown word, or threads with the arch of a GPU, BackendError for a missing
    device or a second, different start.
    """
    global _running, _owner, _program
    if arch is not None and arch not in ARCHES:
        raise ValueError(f"arch: {arch!r} is not allowed; it must be one of {', '.join(ARCHES)}")
    if threads is not None and arch not in (None, "auto", "cpu"):
        raise ValueError(
            f"threads: {threads!r} is not allowed; they are those of arch 'cpu', and {arch!r} was asked for"
        )
    if precision is not None and precision not in PRECISIONS:
        raise ValueError(f"precision: {precision!r} is not allowed; it must be f32 or f64")
    if threads is not None and (
        isinstance(threads, bool) or not isinstance(threads, int) or not 1 <= threads <= MOST_THREADS
    ):
        raise ValueError(f"threads: {threads!r} is not allowed; it must be a whole number from 1 to {MOST_THREADS}")
    if precision == "f64" and arch not in (None, "auto", *WIDE_ARCHES):
        raise BackendError(
            f"precision: 'f64' was asked for, which {arch} devices may lack; use 'f32', or arch 'cpu' or 'cuda'"
        )
    if arch is not None and not _is_served(arch):
        raise BackendError(
            f"arch: {arch!r} was asked for, where Quadrants does not run these kernels; use 'cpu' or 'cuda', or Taichi"
        )
    with _starting:
        runs = running()
        if runs is None:
            sys.setrecursionlimit(max(sys.getrecursionlimit(), DEEPEST_CALLS))
            _running = runs = _init(arch or "auto", precision or "f32", threads or os.cpu_count() or 1)
            _program = program()
            _owner = (os.getpid(), threading.get_ident(), threading.current_thread().name)
            return runs
    check_thread()
    for name, asked, own in (
        ("arch", None if arch == "auto" else arch, runs.arch),
        ("precision", precision, runs.precision),
        ("threads", threads if runs.arch == "cpu" else None, runs.threads),
    ):
        if asked is not None and asked != own:
            raise BackendError(
                f"{name}: {asked!r} was asked for, but this process already runs with {own!r}; Taichi holds one for the"
                " whole process. Use that, or start a new process."
            )
    return runs


def stop() -> None:
    """End Taichi in this process, which gives all its memory back. Simulations and renderers that exist are closed by that; the
    next one starts it again, with any arch and precision, and finds kernels of another process in the cache, as it would first
    in this one."""
    global _running, _owner, _program
    check_thread()
    if running() is not None:  # what somebody else started since is theirs
        ti.reset()
    _running = _owner = _program = None


def kernel_folder() -> Path | None:
    """The folder that compiled kernels are kept in; None, and said, where there is none that can be."""
    usual = os.environ.get(f"{PREFIX}OFFLINE_CACHE_FILE_PATH") or str(
        ti.lang.impl.default_cfg().offline_cache_file_path
    )
    return cache_folder(Path(usual))


def _init(arch: str, precision: str, threads: int) -> Backend:
    ti.set_logging_level(ti.ERROR)
    candidates = [arch]
    if arch == "auto":
        candidates = [a for a in AUTOMATIC if (precision == "f32" or a in WIDE_ARCHES) and _is_served(a)]
    name = next((a for a in candidates if a == "cpu" or (_works(a) and (arch != "auto" or _is_trusted(a)))), None)
    if name is None:
        raise BackendError(
            f"arch: {arch!r} was asked for, but no such device works here: `taichi-sim devices` says what does; use 'cpu' or"
            " 'auto'"
        )
    real = ti.f64 if precision == "f64" else ti.f32
    cache = kernel_folder()
    quicken()
    count_time()
    with _without_banner(), _own_settings():
        ti.init(
            arch=getattr(ti, name),
            default_fp=real,
            cpu_max_num_threads=threads,
            offline_cache=cache is not None,
            offline_cache_file_path=str(cache or os.sep),  # a folder that is there: otherwise it ends the process
            offline_cache_max_size_of_files=CACHE_BYTES,
            log_level=ti.ERROR,
            fast_math=False,
            unrolling_limit=0,  # loops over colours are unrolled on purpose, with no warning
            advanced_optimization=False,  # Taichi's own passes: LLVM repeats them; compiling takes a third, running the same
        )
    device = None if name == "cpu" else find(name)
    return Backend(name, precision, threads if name == "cpu" else 0, "" if device is None else device.words)


@contextmanager
def _without_banner() -> Iterator[None]:
    """Silence the banner that Taichi prints and no option turns off; other threads print on."""
    ti.lang.misc.print = lambda *_, **__: None
    try:
        yield
    finally:
        del ti.lang.misc.print


@contextmanager
def _own_settings() -> Iterator[None]:
    """Context without environment variables that change what `start` sets, as TI_ARCH, of which a wrong one would end the
    process. Raises BackendError where another one is wrong."""
    with restored_environment():
        for name in OWN_SETTINGS:
            os.environ.pop(PREFIX + name, None)
        given = ", ".join(sorted(name for name in os.environ if name.startswith(PREFIX)))
        os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")  # it would ask its makers' server each day
        try:
            yield
        except FileNotFoundError as error:
            if error.filename is not None:
                raise
            raise BackendError("the working folder was deleted; change to another one") from None
        except ValueError as error:
            raise BackendError(f"{ENGINE} cannot be started with the environment variables {given}: {error}") from None


def _is_trusted(arch: str) -> bool:
    """True if a device that nobody asked for may be taken: no software one, and one that has passed the self-test."""
    device = find(arch)
    if device is None or device.software:
        return False
    wrong = verdict(device, f"{ENGINE} {VERSION}")
    if wrong:
        warn(f"{device.name} ({arch}) is not used: {wrong}")
    return not wrong


def _is_served(arch: str) -> bool:
    """True if the engine runs these kernels there, as far as is known."""
    return ENGINE != "quadrants" or arch in ("auto", *QUADRANTS_ARCHES)


def _works(arch: str) -> bool:
    """True if Taichi was built with this arch and finds a device for it."""
    if sys.platform == "linux" and find(arch) is None:  # Taichi would complain on standard error
        return False
    return finds(arch)
