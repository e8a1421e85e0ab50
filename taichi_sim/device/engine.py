"""The one import of the engine that compiles kernels: everything else takes `ti` from here.

It is Taichi, or, where the environment variable TAICHI_SIM_ENGINE says "quadrants", its successor Quadrants, which takes the same
programs. What is private to one of them, or named otherwise, is asked of it here.
"""

import os
import sys
import warnings
from copy import copy
from functools import wraps
from types import ModuleType
from typing import Any

from taichi_sim.common.environment import restored_environment
from taichi_sim.common.errors import BackendError
from taichi_sim.device.kernel_cache import settle_home

__all__ = [
    "ENGINE",
    "IS_KNOWN",
    "PREFIX",
    "QUADRANTS_ARCHES",
    "VERSION",
    "CompilationError",
    "another",
    "finds",
    "has_right_sines",
    "on_device",
    "program",
    "shape_of",
    "ti",
]

ENGINES = ("taichi", "quadrants")
QUADRANTS_ARCHES = ("cpu", "cuda")  # with Vulkan it cannot bind these kernels' fields (1.3.3, on SwiftShader)
ENGINE = os.environ.get("TAICHI_SIM_ENGINE", "taichi")  # of this process
PREFIX = "TI_" if ENGINE == "taichi" else "QD_"  # of its environment variables


def _taichi() -> ModuleType:
    if (
        "ipykernel" in sys.modules
    ):  # which shows what kernels print; Taichi would say in the cell that it found a notebook
        os.environ.setdefault("TI_ENABLE_PYBUF", "0")
    try:
        with restored_environment():
            os.environ.pop("TI_LOG_LEVEL", None)  # an unknown one cannot be imported with; `start` sets it
            with warnings.catch_warnings():
                warnings.simplefilter(
                    "ignore"
                )  # that it uses what Python is going to drop; `python -W error` would end here
                import taichi
    except (ImportError, OSError) as error:  # on Linux, its library is linked against libX11 even without a window
        hint = (
            " Install it: `apt install libx11-6` (Debian, Ubuntu), `dnf install libX11` (Fedora), `apk`-based systems lack glibc."
            if "libX11" in str(error)
            else " Reinstall it: `pip install taichi==1.7.4` (Python 3.10 to 3.13, 64 bit)."
        )
        raise BackendError(f"Taichi cannot be loaded: {error}.{hint}") from error
    return taichi


def _quadrants() -> ModuleType:
    os.environ.setdefault("ENABLE_QUADRANTS_HEADER_PRINT", "0")  # it greets on standard output
    try:
        import quadrants
    except (ImportError, OSError) as error:
        raise BackendError(f"Quadrants cannot be loaded: {error}. Install it: `pip install quadrants`.") from error
    return quadrants


if ENGINE not in ENGINES:
    raise BackendError(f"TAICHI_SIM_ENGINE: {ENGINE!r} is not allowed; it must be one of {', '.join(ENGINES)}")
settle_home()
ti: Any = _taichi() if ENGINE == "taichi" else _quadrants()
VERSION = ".".join(map(str, ti.__version__))


def another(part: Any) -> Any:
    """A copy of a user's part for one simulation. Quadrants keeps bound functions on the object; the copy binds its own."""
    made = copy(part)
    if ENGINE == "taichi":
        return made
    for name, value in list(vars(made).items()):
        if callable(value) and hasattr(type(made), name):
            delattr(made, name)
    return made


# whether the engine is that whose private names are touched, see compile_speedup, compiling, host_memory, parts and
# shared_kernels
IS_KNOWN = (ENGINE, VERSION) == ("taichi", "1.7.4")


def _inside_class(level_of_class_stackframe: int) -> bool:
    """Tell whether a decorator stands in a class body, by the names of its frame.

    Taichi reads the line of source for that, which takes a fifth of the time of importing this package.
    """
    names = sys._getframe(level_of_class_stackframe - 1).f_locals  # the body's; the level counts to the frame around it
    return "__qualname__" in names and "__module__" in names


def shape_of(value: Any) -> tuple[int, ...]:
    """Shape of a value in a kernel that is being compiled: () of a number, (k,) of a vector, (k, l) of a matrix."""
    is_number = not hasattr(value, "get_shape") or (hasattr(value, "is_tensor") and not value.is_tensor())
    return () if is_number else tuple(value.get_shape())


def _of_like_shape(change: Any) -> Any:
    """An operation that changes a value, such as `+=`, which raises where vectors or matrices differ in shape: Taichi compares
    them where they are assigned, and ends the process where one is added to the other."""

    @wraps(change)
    def checked(x: Any, y: Any) -> Any:
        if shape_of(y) not in ((), shape_of(x)):
            raise ti.TaichiTypeError(f"{change.__name__}: shape {shape_of(y)} does not fit one of {shape_of(x)}")
        return change(x, y)

    return checked


if IS_KNOWN:
    ti.lang.kernel_impl._inside_class = _inside_class
    for _name in ("add", "sub", "mul", "min", "max"):
        _changed = _of_like_shape(getattr(ti.lang.ops, f"atomic_{_name}"))
        setattr(ti.lang.ops, f"atomic_{_name}", _changed)
        setattr(ti, f"atomic_{_name}", _changed)


def program() -> Any:
    """Running program, or None: the same object until the engine is stopped."""
    runtime = ti.lang.impl.get_runtime()
    return runtime.prog if ENGINE == "taichi" else runtime._prog


def forget_launches() -> None:
    """Forget prepared launches, where kernels were dropped: Quadrants 1.4.0 keeps them by address, and a new kernel that gets
    the address of a dropped one is refused ("kernel_ == other.kernel_")."""
    if ENGINE == "quadrants":
        for kernel in ti.lang.impl.get_runtime().kernels:
            prepared = getattr(kernel, "launch_context_buffer_cache", None)  # other versions may have none
            if prepared is not None:
                prepared._launch_ctx_cache.clear()
                prepared._launch_ctx_cache_tracker.clear()


# what a mistake in a user's kernel raises
CompilationError: type[Exception] = ti.TaichiCompilationError if ENGINE == "taichi" else ti.QuadrantsCompilationError


def finds(arch: str) -> bool:
    """True if the engine was built with this arch and finds a device for it."""
    return bool(ti.lang.misc.is_arch_supported(getattr(ti, arch)))


def on_device() -> bool:
    """True if the kernels run on a device with thousands of threads, and not on a CPU."""
    return ti.lang.impl.current_cfg().arch not in (ti.x64, ti.arm64)


def has_right_sines() -> bool:
    """True if sines are right to the last digits where kernels run: Vulkan and Metal promise three."""
    return ti.lang.impl.current_cfg().arch in (ti.x64, ti.arm64, ti.cuda)
