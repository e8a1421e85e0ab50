"""Folder in which compiled kernels are kept. It is chosen before the engine starts: without a home it ends the process at once,
and at the end where it cannot write there."""

import os
import stat
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from taichi_sim.common.warn import warn

__all__ = ["cache_folder", "settle_home"]

LIST = "ticache.tcb"  # of what is kept; the engine ends the process where it cannot be written
LOCK = "ticache.lock"  # held while the list is read or written: for a second at most
STALE = 600.0  # s; older than that, its owner has been killed


def settle_home() -> None:
    """Name a folder of caches by XDG_CACHE_HOME where this process has no home, or a relative one."""
    named = (os.environ.get(name, "") for name in ("XDG_CACHE_HOME", "HOME"))
    if os.name != "posix" or any(map(os.path.isabs, named)):
        return
    import pwd

    try:
        home = pwd.getpwuid(os.getuid()).pw_dir
    except KeyError:  # as in a container that runs as some user
        home = ""
    cache = Path(home) / ".cache" if os.path.isabs(home) else _temporary()
    os.environ["XDG_CACHE_HOME"] = str(cache or os.sep)


def cache_folder(usual: Path) -> Path | None:
    """A folder that compiled kernels can be kept in: the usual one, else one for temporary files, which is said; None, and said,
    where there is neither."""
    problem = _problem(usual)
    if not problem:
        _unlock(usual)
        return usual
    folder = _temporary()
    done = f"they are kept in {folder}" if folder else "each process compiles all of them"
    warn(
        f"{usual}: compiled kernels cannot be kept there ({problem}); {done}."
        " Set XDG_CACHE_HOME to a folder that you can write"
    )
    return folder


def _problem(folder: Path) -> str:
    """Why nothing can be kept there, or nothing."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        with suppress(FileNotFoundError), open(folder / LIST, "r+b"):  # it may be another user's
            pass
    except OSError as error:
        return error.strerror or str(error)
    return ""


def _temporary() -> Path | None:
    """A folder of this user alone for all processes, where others can put no kernels of theirs."""
    try:
        user = os.getuid() if hasattr(os, "getuid") else "all"
        folder = Path(tempfile.gettempdir()) / f"taichi_sim_{user}"
        with suppress(FileExistsError):
            folder.mkdir(mode=0o700)
        about = folder.lstat()
    except OSError:
        return None
    is_own = not hasattr(os, "getuid") or (about.st_uid == os.getuid() and not about.st_mode & 0o077)
    return folder if stat.S_ISDIR(about.st_mode) and is_own and not _problem(folder) else None


def _unlock(folder: Path) -> None:
    """Remove the lock that a killed process left: the engine keeps and finds nothing while it is there, and says so only in its
    log."""
    lock = folder / LOCK
    try:
        age = time.time() - lock.stat().st_mtime
        if age < STALE:
            return
        lock.unlink()
        done = "it was removed"
    except FileNotFoundError:
        return
    except OSError as error:
        done = f"remove it ({error.strerror}): until then everything is compiled anew in each process"
    warn(f"{lock}: a killed process has locked the cache of compiled kernels; {done}")
