"""Growing: a file that gets one frame after another, and is whole after each."""

from pathlib import Path
from typing import Any

from taichi_sim.analysis.frame import Frame
from taichi_sim.common.atomic_file import PartFile, naming
from taichi_sim.outputs.base import FileOutput, Image, require_there


class Growing(FileOutput):
    """Output that lies under its final name from the first frame on, in place of what was there, so that other programs can
    read it while the run goes on. What was written before an error, Ctrl-C or a kill stays. resume: go on from the last
    checkpoint."""

    needs_image = False
    _file: Any = None  # open for more

    def begun(self, part: Path, frame: Frame) -> None:
        """Write a file that holds the first frame."""
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

    def holds(self, count: int) -> bool:
        return self.path.is_file() and self.length() == count

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        self.log.open()  # refused where another run writes it
        with naming(self.path):
            if self._file is not None:
                self.more(index, frame)
                return
            part = PartFile(self.path)
            try:
                self.begun(part.part, frame)
                part.finish()
            finally:
                part.discard()
            self._file = self.opened()

    def finish(self) -> None:
        """Raises OSError where the file was removed meanwhile."""
        self._close()
        require_there([self.path] if self.frames else [])
        super().finish()

    def discard(self) -> None:
        """Give it up; frames that were written stay."""
        self._close()
        super().discard()

    def _close(self) -> None:
        if self._file is not None:
            file, self._file = self._file, None
            file.close()
