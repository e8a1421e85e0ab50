"""A folder of PNG frames through Pillow."""

import os
import re
from os import PathLike
from pathlib import Path

from taichi_sim.analysis.frame import Frame
from taichi_sim.common.atomic_file import replacing
from taichi_sim.outputs.base import Image, Output, require_folder_place

_FRAME = re.compile(r"frame_\d{5,}\.png")


class PngFolder(Output):
    """frame_00000.png, frame_00001.png, ... in a folder, which is made when it is not there; its parent is not.

    Each file is complete when it appears. A folder that holds anything is an error unless overwrite (its frames are
    deleted at the first write, other files stay) or resume (frames that are there are kept and neither drawn nor
    written again; use it with the same scene and options). What was written before an error or Ctrl-C stays, for
    resume.
    """

    apart = True
    alpha = True
    resumable = True

    def __init__(self, path: str | PathLike[str], *, overwrite: bool = False, resume: bool = False) -> None:
        self.path = Path(path)
        if overwrite and resume:
            raise ValueError("overwrite and resume exclude each other; give one of them")
        require_folder_place(self.path)
        self._made = not self.path.is_dir()
        if not self._made and any(self.path.iterdir()) and not (overwrite or resume):
            raise FileExistsError(f"{self.path}: the folder is not empty; use --overwrite, --resume or another name")
        self._make_writable()
        frames = [entry for entry in self.path.iterdir() if _FRAME.fullmatch(entry.name)]
        self._stale = frames if overwrite else []  # deleted at the first write, when nothing can be wrong any more
        self._there = {entry.name for entry in frames} if resume else set()

    def _make_writable(self) -> None:
        try:
            self.path.mkdir(exist_ok=True)
            with replacing(self.path / "frame_test"):
                pass
            (self.path / "frame_test").unlink()
        except OSError as error:
            raise OSError(f"{self.path}: cannot be written: {error.strerror or error}") from error

    def wants(self, index: int) -> bool:
        """Whether the frame is not there yet."""
        return self._name(index) not in self._there

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        from PIL import Image as Pictures

        assert image is not None
        while self._stale:
            self._stale.pop().unlink(missing_ok=True)
        with replacing(self.path / self._name(index)) as file:
            Pictures.fromarray(image).save(file, "PNG", compress_level=1)

    def discard(self) -> None:
        """Remove the folder if this made it and nothing was written; frames stay."""
        if self._made and self.path.is_dir() and not any(self.path.iterdir()):
            os.rmdir(self.path)

    @staticmethod
    def _name(index: int) -> str:
        return f"frame_{index:05d}.png"
