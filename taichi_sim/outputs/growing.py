"""Growing: a file that gets one frame after another, and is whole after each."""

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from taichi_sim.analysis.frame import Frame
from taichi_sim.common.atomic_file import PartFile, naming, require_place, synced
from taichi_sim.outputs.base import Image
from taichi_sim.outputs.resumable import Resumable, require_there
from taichi_sim.outputs.run_log import Checkpoint


class Growing(Resumable):
    """It lies under its final name from the first frame on, in place of what was there, so that other programs can read it while
    the run goes on. What was written before an error, Ctrl-C or a kill stays. resume: go on from the last checkpoint."""

    needs_image = False

    def __init__(self, path: str | PathLike[str], resume: bool = False) -> None:
        super().__init__(path, resume=resume)
        require_place(path)
        self._file: Any = None  # open for more

    def begun(self, part: Path, frame: Frame) -> None:
        """Write a file that holds the first frame."""
        raise NotImplementedError

    def cut(self, part: Path, frames: int) -> None:
        """Write a file that holds so many frames of the one that is there."""
        raise NotImplementedError

    def length(self) -> int:
        """Whole frames in the file that is there; 0 where it cannot be read."""
        raise NotImplementedError

    def opened(self) -> Any:
        """The file, open for more; it has `close`."""
        raise NotImplementedError

    def more(self, index: int, frame: Frame) -> None:
        """Append a frame."""
        raise NotImplementedError

    def has(self, checkpoint: Checkpoint) -> bool:
        return self.path.is_file() and self.length() >= checkpoint.frame

    def holds(self, count: int) -> bool:
        return self.path.is_file() and self.length() == count

    def go_on(self, checkpoint: Checkpoint) -> None:
        self.frames = checkpoint.frame
        self._replace(lambda part: self.cut(part, checkpoint.frame))

    def hold(self) -> Mapping[str, Any]:
        with open(self.path, "r+b") as file:
            synced(file)
        return {}

    def _replace(self, fill: Any) -> None:
        part = PartFile(self.path)
        try:
            with naming(self.path):
                fill(part.part)
            part.finish()
        finally:
            part.discard()
        self._file = self.opened()

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        self.log.open()
        if self._file is None:
            self._replace(lambda part: self.begun(part, frame))
        else:
            with naming(self.path):
                self.more(index, frame)

    def finish(self) -> None:
        """Raises OSError where the file was removed meanwhile."""
        self._close()
        require_there([self.path] if self.frames else [])
        self.log.delete()

    def discard(self) -> None:
        """Give it up; frames that were written stay."""
        self._close()
        self.leave()

    def _close(self) -> None:
        if self._file is not None:
            file, self._file = self._file, None
            file.close()
