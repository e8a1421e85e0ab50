"""Folders that this program makes for itself: no link is followed, and only files of its own names are deleted in them."""

import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

from taichi_sim.common.atomic_file import PART, kind_of, sweep

__all__ = ["LOCK", "emptied", "is_fresh", "require_own", "require_own_file"]

DOES = "{}: {}; this program makes such a {} itself: remove it, or give another name"
LOCK = "lock"  # the first file that is made in one, and the last that is deleted


def require_own(
    folder: Path, is_ours: Callable[[Path], bool] | None = None, files: re.Pattern[str] | None = None
) -> None:
    """Raises OSError, with one sentence, where a link or a file lies in place of the folder, where it holds a link, also
    a hard one, a pipe or a device, where a folder lies in place of its lock or of its `files`, and where it is not empty and
    not `is_ours`, which reads the file that says what it is of."""
    _require(folder, "folder")
    if not folder.is_dir():
        return
    for entry in folder.iterdir():
        kind = _kind_of(entry)
        is_file = entry.name == LOCK or (files is not None and files.fullmatch(entry.name))
        if kind in ("link", "pipe", "device") or (is_file and kind == "folder"):
            raise FileExistsError(DOES.format(folder, f"holds {entry.name!r}, which is a {kind}", "folder"))
        if kind == "file" and entry.stat().st_nlink > 1:
            says = f"holds {entry.name!r}, which is also the file of another name"
            raise FileExistsError(DOES.format(folder, says, "folder"))
    if is_ours is not None and not is_fresh(folder) and not is_ours(folder):
        says = "is a folder that this program did not make, or whose record was changed"
        raise FileExistsError(DOES.format(folder, says, "folder"))


def require_own_file(path: Path) -> None:
    """Raises OSError, with one sentence, where a link, a folder, a pipe or a device lies in place of the file."""
    _require(path, "file")


def _require(path: Path, allowed: str) -> None:
    if (kind := _kind_of(path)) not in (allowed, ""):
        raise FileExistsError(DOES.format(path, f"is a {kind}", allowed))


def _kind_of(path: Path) -> str:
    """See `kind_of`; `link`, wherever it leads to."""
    return "link" if path.is_symlink() else kind_of(path)


def is_fresh(folder: Path) -> bool:
    """True if a folder holds nothing, or only what a run leaves that was killed at its start."""
    return all(entry.name == LOCK or PART.fullmatch(entry.name) for entry in folder.iterdir())


def emptied(folder: Path, names: re.Pattern[str], order: Mapping[str, int] | None = None) -> None:
    """Delete files of these names, and those that killed runs left under construction, in a folder that `require_own` has passed:
    those that `order` ranks below 0 first, those above last."""
    if folder.is_symlink():  # since then
        return
    sweep(folder, "*")
    rank = order or {}
    for entry in sorted(folder.iterdir(), key=lambda entry: rank.get(entry.name, 0)):
        if names.fullmatch(entry.name):
            with suppress(IsADirectoryError, PermissionError):  # macOS says the second of a folder
                entry.unlink(missing_ok=True)
