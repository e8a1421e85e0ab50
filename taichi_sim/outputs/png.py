"""A folder of PNG frames through Pillow."""

import os
import re
from os import PathLike
from pathlib import Path

from taichi_sim.analysis.frame import Frame
from taichi_sim.common.atomic_file import replacing, require_place, sweep
from taichi_sim.outputs.base import Image, Output, require_folder_place, require_there
from taichi_sim.outputs.frame_records import png_of

_FRAME = re.compile(r"frame_\d{5,}\.png")


class PngFolder(Output):
    """frame_00000.png, frame_00001.png, ... in a folder, which is made when it is not there; its parent is not.

    Each file is complete when it appears. A folder that holds anything is an error unless overwrite (its frames are
    deleted at the first write, other files stay) or resume (frames of the same run that are there are kept and neither drawn nor
    written again). What was written before an error or Ctrl-C stays, for resume.
    """

    needs_arrays = False
    keeps_frames = True
    within = True
    apart = True
    alpha = True
    path: Path

    def __init__(self, path: str | PathLike[str], *, overwrite: bool = False, resume: bool = False) -> None:
        if overwrite and resume:
            raise ValueError("overwrite and resume exclude each other; give one of them")
        self.path, self.resume = Path(path), resume
        self.log  # noqa: B018  # refused where it cannot be ours
        require_folder_place(self.path, overwrite)
        self._made = not self.path.is_dir()
        entries = [] if self._made else [entry for entry in self.path.iterdir() if entry != self.log.folder]
        if entries and not (overwrite or resume):
            raise FileExistsError(f"{self.path}: the folder is not empty; use --overwrite, --resume or another name")
        frames = [entry for entry in entries if _FRAME.fullmatch(entry.name)]
        self._make_writable()
        self._stale = frames if overwrite else []  # deleted at the first write, when nothing can be wrong any more
        self._there = {entry.name for entry in frames} if resume else set()
        self.frames = len(self._there)
        self._count = 0  # of frames that were asked for

    def _make_writable(self) -> None:
        try:
            self.path.mkdir(exist_ok=True)
            require_place(self.path / "frame_test")
            sweep(self.path, "frame_*.png")
        except OSError as error:
            raise OSError(f"{self.path}: cannot be written: {error.strerror or error}") from error

    def is_finished(self, count: int) -> bool:
        """Raises FileExistsError where there are frames of nobody knows which run."""
        is_finished = super().is_finished(count)
        if self._there and not self.log.resumes and not is_finished:
            raise FileExistsError(
                f"{self.path}: nothing says which run its frames are of, and so it cannot be resumed; use --overwrite or another"
                " name"
            )
        return is_finished

    def holds(self, count: int) -> bool:
        return self._there == set(map(self._name, range(count)))

    def contains(self, count: int) -> bool:
        return self._there.issuperset(map(self._name, range(count)))

    def kept(self) -> int:
        return sum(_FRAME.fullmatch(entry.name) is not None for entry in self.path.iterdir())

    def wants(self, index: int) -> bool:
        """True if the frame is not there yet."""
        self._count = index + 1
        return self._name(index) not in self._there

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        assert image is not None
        self.log.open()  # refused where another run writes there
        while self._stale:
            self._stale.pop().unlink(missing_ok=True)
        with replacing(self.path / self._name(index), swept=True) as file:
            file.write(png_of(image))

    def finish(self) -> None:
        """Raises OSError where a frame was removed meanwhile."""
        require_there(self.path / self._name(index) for index in range(self._count))
        super().finish()

    def discard(self) -> None:
        """Remove the folder if this made it and nothing was written; frames stay."""
        super().discard()
        if self._made and self.path.is_dir() and not any(self.path.iterdir()):
            os.rmdir(self.path)

    @staticmethod
    def _name(index: int) -> str:
        return f"frame_{index:05d}.png"
