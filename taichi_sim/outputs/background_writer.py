"""Behind: frames are written by a thread of their own while the next ones are simulated and drawn."""

from collections.abc import Callable
from queue import Queue
from threading import Thread
from types import TracebackType

from taichi_sim.analysis.frame import Frame
from taichi_sim.outputs.base import Image

WAITING = 4  # frames at most, so that a slow encoder holds the run back and not the memory


class Behind:
    """Calls what takes a frame, as `write` of an output, in order in a thread. On leaving the block all frames are written.

    What it raises is raised here, at the next frame or at the end; frames after it are dropped.
    """

    def __init__(self, take: Callable[[int, Frame, Image | None], None]) -> None:
        self._take = take
        self._queue: Queue[tuple[int, Frame, Image | None] | None] = Queue(WAITING)
        self._error: BaseException | None = None
        self._thread = Thread(target=self._work, name="writing frames", daemon=True)

    def write(self, index: int, frame: Frame, image: Image | None) -> None:
        """Leave a frame to the thread; waits while too many are waiting."""
        if self._error is not None:
            raise self._error
        self._queue.put((index, frame, image))

    def settle(self) -> None:
        """Wait until all frames are written."""
        self._queue.join()
        if self._error is not None:
            raise self._error

    def _work(self) -> None:
        while (entry := self._queue.get()) is not None:
            if self._error is None:
                try:
                    self._take(*entry)
                except BaseException as error:  # for the thread that simulates
                    self._error = error
            self._queue.task_done()

    def __enter__(self) -> "Behind":
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._queue.put(None)
        self._thread.join()
        if self._error is not None and error is None:
            raise self._error
