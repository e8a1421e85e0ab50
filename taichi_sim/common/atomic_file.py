"""Files that appear under their final name only when they are complete."""

import errno
import glob
import os
import re
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from secrets import token_hex
from typing import IO

try:
    import fcntl
except ImportError:  # Windows, where a file that is open cannot be deleted
    fcntl = None  # type: ignore[assignment]

PART = re.compile(r"\..+\.[0-9a-f]{16}\.part")  # names of files under construction
AS_IT_IS = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
WAIT = 0.05  # s, between two looks at a lock

__all__ = [
    "PART",
    "PartFile",
    "kind_of",
    "lock",
    "locked",
    "locking",
    "naming",
    "replacing",
    "require_file",
    "require_name",
    "require_parent",
    "require_place",
    "sweep",
    "synced",
    "waiting",
]


def require_parent(path: Path) -> None:
    """Raises FileNotFoundError or NotADirectoryError where there is no folder to write into."""
    parent = path.parent
    if parent.is_dir():
        return
    if parent.exists():
        raise NotADirectoryError(f"{path}: {str(parent)!r} is a file; name a folder before the last part")
    raise FileNotFoundError(f"{path}: there is no folder {str(parent)!r}; make it first")


class PartFile:
    """A file under construction: a hidden temporary file in the final folder, so that the last move is atomic.

    It is made at once, so a missing parent folder (which is never created), a folder, pipe or device in its place or a lack of
    rights is an OSError with one sentence before any work is done. What killed runs into the same name left is deleted, where
    `swept` does not say that this was done already. Its name is random, and it is never opened where it is there already: other
    machines and containers that see the folder have processes of the same numbers.
    """

    def __init__(self, path: str | os.PathLike[str], *, swept: bool = False) -> None:
        self.path = Path(path)
        require_name(self.path)
        require_parent(self.path)
        kind = kind_of(self.path)
        if kind == "folder":
            raise IsADirectoryError(f"{self.path}: is a folder; give the name of a file")
        if kind not in ("file", ""):
            only = "only x.csv can be written into one" if kind == "pipe" else "give the name of a file"
            raise FileExistsError(f"{self.path}: is a {kind}; {only}")
        if not swept:
            sweep(self.path.parent, glob.escape(self.path.name))
        self._make()
        while not (locked(self.file) and self.part.exists()):  # another run swept it before it was locked
            self.file.close()
            self._make()

    def _make(self) -> None:
        self.part = self.path.with_name(f".{self.path.name}.{token_hex(8)}.part")
        try:
            self.file: IO[bytes] = open(self.part, "x+b")  # noqa: SIM115  # closed by finish or discard
        except OSError as error:
            raise OSError(f"{self.path}: cannot be written: {error.strerror}") from error

    def finish(self) -> None:
        """Close the file, once it is on the disk, and move it to its final name."""
        with naming(self.path):
            synced(self.file)
            self.file.close()
            try:
                os.replace(self.part, self.path)
            except FileNotFoundError as error:
                gone = "what was written of it was removed before it was complete"
                raise FileNotFoundError(errno.ENOENT, gone, str(self.path)) from error
            _sync_folder(self.path.parent)

    def discard(self) -> None:
        """Close and delete it; whatever lies under the final name stays as it was. Does nothing after finish."""
        with suppress(OSError):  # what a full disk did not take is not wanted any more
            self.file.close()
        self.part.unlink(missing_ok=True)


@contextmanager
def replacing(path: str | os.PathLike[str], *, swept: bool = False) -> Iterator[IO[bytes]]:
    """A binary file to write that takes the place of `path` when the block ends, and vanishes when it raises."""
    part = PartFile(path, swept=swept)
    try:
        with naming(path):
            yield part.file
        part.finish()
    finally:
        part.discard()


def kind_of(path: str | os.PathLike[str]) -> str:
    """`file`, `folder`, `pipe` or `device` (a socket, too), whatever links lead to it; empty where there is nothing."""
    try:
        mode = os.stat(path).st_mode
    except OSError:  # what cannot be looked at is said by what opens it
        return ""
    kinds = {stat.S_IFREG: "file", stat.S_IFDIR: "folder", stat.S_IFIFO: "pipe"}
    return kinds.get(stat.S_IFMT(mode), "device")


def require_file(path: str | os.PathLike[str]) -> None:
    """Raises ValueError where something else lies there, which may never end, or never begin; nothing where nothing is."""
    if (kind := kind_of(path)) not in ("file", ""):
        raise ValueError(f"it is a {kind}, and no file")


def not_there(path: str | os.PathLike[str], what: str = "file") -> OSError:
    """The error about a file that is not there, or in whose place lies something else."""
    if kind := kind_of(path):
        return OSError(f"{path}: is a {kind}, and no {what}")
    return FileNotFoundError(f"{path}: there is no such {what}")


def require_name(path: Path) -> None:
    """Raises IsADirectoryError for what can only be a folder: `.`, or the root."""
    if not path.name:
        raise IsADirectoryError(f"{path}: is a folder; give the name of a file")


def require_place(path: str | os.PathLike[str]) -> None:
    """Raises OSError, with one sentence, where no file of that name can be written."""
    PartFile(path).discard()


@contextmanager
def naming(path: str | os.PathLike[str]) -> Iterator[None]:
    """Errors of the system name this file where they name none, as that of a full disk does, or one of ours."""
    try:
        yield
    except BrokenPipeError:  # about standard output
        raise
    except OSError as error:
        nameless = error.filename is None or str(error.filename).endswith(".part")
        if error.errno is None or not nameless:
            raise
        raise OSError(error.errno, error.strerror, os.fspath(path)) from error


def sweep(folder: Path, pattern: str) -> None:
    """Delete what was left of files under construction, whose final names match a pattern, by runs that were killed."""
    for part in folder.glob(f".{pattern}.*.part"):
        if PART.fullmatch(part.name):
            with suppress(OSError), _opened(part, os.O_RDWR) as file:  # gone meanwhile, or not ours to delete
                if _lock_of(file):  # nobody writes it
                    part.unlink()


def lock(path: Path, refusal: str) -> IO[bytes]:
    """A file that keeps other processes out until it is closed. Raises OSError, which says `refusal`, where another has it."""
    file = _opened(path, os.O_RDWR | os.O_CREAT)
    if not locked(file):
        file.close()
        raise OSError(refusal)
    return file


def _opened(path: Path, flags: int) -> IO[bytes]:
    """A file, which is never waited for. Raises OSError where there is a link, a pipe or a device in its place."""
    try:
        descriptor = os.open(path, flags | AS_IT_IS, 0o666)
    except OSError:
        if path.is_symlink():
            raise OSError(f"{path}: is a link; remove it, or give another name") from None
        raise
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(f"{path}: is no file; remove it, or give another name")
    return open(descriptor, "r+b")


@contextmanager
def locking(path: Path, refusal: str) -> Iterator[None]:
    """Keep other processes out of the block by a lock of that name, which is gone afterwards. Raises OSError, see `lock`."""
    file = lock(path, refusal)
    try:
        yield
    finally:
        path.unlink(missing_ok=True)
        file.close()


@contextmanager
def waiting(path: Path) -> Iterator[IO[bytes]]:
    """Wait until no other process is in such a block of that file, which stays, and may be read and written. A process that
    ends leaves its block, however it ends. Raises OSError where there can be no such file."""
    with _opened(path, os.O_RDWR | os.O_CREAT) as file:
        while not locked(file):
            time.sleep(WAIT)
        yield file


def locked(file: IO[bytes]) -> bool:
    """Lock a file until it is closed, or this process ends. True if it is ours; False where another process has it. Where
    the file system knows no locks all files are ours."""
    return _lock_of(file) is not False


def _lock_of(file: IO[bytes]) -> bool | None:
    """See `locked`; None where the file system knows no locks."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def synced(file: IO[bytes]) -> None:
    """Have all that was written to a file on the disk."""
    file.flush()
    os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    """Have the names in a folder on the disk, where the system can."""
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
