"""What an output is. A user-defined one is a class with these members, in any file; pass the object to `export`:

    class Heights(ts.Output):
        needs_image = False

        def write(self, index, frame, image):
            with open("heights.csv", "a") as file:
                print(frame.time, *frame.position[:, 1], sep=",", file=file)

    ts.export(simulation, Heights(), fps=60, duration=2)

Without `needs_image = False` pictures are drawn, and `image` is that of the frame. An output needs no simulation: frames from
anywhere may be given to it, `with Heights() as output: output.write(0, frame, None)`.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.common import validation
from taichi_sim.common.atomic_file import require_parent
from taichi_sim.common.errors import UnstableError

# (height, width, 3) sRGB, row 0 at the top; with alpha (height, width, 4), colours not multiplied by it
Image = NDArray[np.uint8]
USUAL_FPS = 60.0  # of frames from elsewhere
LEAST_FPS, MOST_FPS = 1e-4, 1e9  # of films


def require_folder_place(path: Path) -> None:
    """Raises OSError where there can be no folder: without a parent, or where a file is."""
    require_parent(path)
    if path.exists() and not path.is_dir():
        raise NotADirectoryError(f"{path}: is a file; give the name of a folder")


def require_alpha(outputs: Sequence["Output"], style: Mapping[str, Any]) -> None:
    """Raises ValueError where pictures with alpha are asked for, by arguments of `Renderer`, and an output cannot hold them."""
    for one in outputs:
        if style.get("transparent") and one.needs_image and not one.alpha:
            name = getattr(one, "path", "this output")
            raise ValueError(f"transparent: {name} holds no transparency; write PNG frames, to a folder/")


def film_rate(fps: float) -> float:
    """Frames per second of a film, whose rate is a fraction of whole numbers. Raises SceneError, a ValueError, for others."""
    return validation.number("fps", fps, low=LEAST_FPS, high=MOST_FPS)


class Output:
    """Takes frames in order of time. As a context manager it is finished on leaving the block.

    It is finished, too, when the simulation became unstable: the frames so far are kept. Any other exception, Ctrl-C
    among them, discards it, and whatever lay under its name before is still there. What is `resumable` keeps its finished
    frames for another run.
    """

    needs_image = True  # False: write is called with image None
    apart = False  # True: write may be called in a thread of its own, while the simulation goes on and `wants` is asked
    is_film = False  # whether fps has the bounds that films have
    alpha = False  # whether it takes pictures with alpha
    resumable = False  # whether a run that was cut off can be resumed; see taichi_sim.outputs.resumable
    fps: float | None = None  # at which what it writes is shown [1/s]; None: `export` sets that of its frames
    pattern = ""  # of the names that it writes, where they are not the one it was given
    frames = 0  # how many it holds so far; `export` counts
    simulated = 0  # how many are kept to be drawn by a run that resumes it, where it was given up

    def prepare(self, first: Frame, size: tuple[int, int], style: Mapping[str, Any]) -> None:
        """What `export` calls before anything else: the frame that the run begins with, also where it is resumed later on, and
        the arguments of `Renderer`."""

    def wants(self, index: int) -> bool:
        """Whether frame `index` is still to be written; when it is not, it is neither drawn nor passed."""
        return True

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        """Take frame `index`, counted from 0, and its picture where needs_image."""
        raise NotImplementedError

    def finish(self) -> None:
        """Complete the output: it now lies under its final name."""

    def discard(self) -> None:
        """Give it up: no trace of it is left, but for what a resumable one keeps."""

    def __enter__(self) -> "Output":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        keep = kind is None or (issubclass(kind, UnstableError) and self.frames > 0)
        try:
            if keep:
                self.finish()
        except BaseException:
            keep = False
            raise
        finally:
            if not keep:
                self.discard()
