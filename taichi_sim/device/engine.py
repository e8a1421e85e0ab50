"""The one import of Taichi: everything else takes `ti` from here."""

from taichi_sim.common.errors import BackendError

try:
    import taichi as ti
except (ImportError, OSError) as error:  # on Linux, Taichi's library is linked against libX11 even without a window
    _hint = (
        " Install it: `apt install libx11-6` (Debian, Ubuntu), `dnf install libX11` (Fedora), `apk`-based systems lack glibc."
        if "libX11" in str(error)
        else " Reinstall it: `pip install taichi==1.7.4` (Python 3.10 to 3.13, 64 bit)."
    )
    raise BackendError(f"Taichi cannot be loaded: {error}.{_hint}") from error

__all__ = ["ti"]
