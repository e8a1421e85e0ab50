"""Workers that do tasks: this process, or the workers of Dask, on this machine or a cluster."""

import logging
import os
import platform
from asyncio import TimeoutError
from collections import Counter, deque
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from importlib.util import find_spec
from typing import Any, TypeVar
from urllib.request import ProxyHandler, build_opener

from taichi_sim.common import validation
from taichi_sim.common.errors import BackendError, SceneError
from taichi_sim.common.signals import heard, without_interrupts
from taichi_sim.common.version import __version__

__all__ = ["MOST_ENDS", "Here", "Workers", "connected", "forget", "kept", "place", "require_workers"]

AHEAD = 3  # tasks for each worker that wait for it
MOST_ENDS = 4  # of workers of one task
PATIENCE = 10.0  # s, for a scheduler
Task = Any
Kept = TypeVar("Kept")
Work = Callable[[Task], Any]
Parts = Callable[[Task], list[Task]]
Results = Iterator[tuple[Task, Any]]


_kept: tuple[Any, Any] | None = None  # of this process: the key of what its tasks work with, and that itself


def kept(key: Any, make: Callable[[], Kept]) -> Kept:
    """An object that a process works with from task to task. Where the key is another one, the object before is closed."""
    global _kept
    if _kept is None or _kept[0] != key:
        forget()
        _kept = (key, make())
    return _kept[1]  # type: ignore[no-any-return]


def forget() -> None:
    """Close what this process works with."""
    global _kept
    if _kept is not None:
        _kept[1].close()
        _kept = None


class Here:
    """Tasks one after another in this process."""

    said, number, apart = "in this process", 1, False

    def run(self, work: Work, waiting: deque[Task], what: str, parts: Parts = lambda task: [task]) -> Results:
        """Each task with what `work` makes of it. More may be put into `waiting` meanwhile. what: the work, for messages."""
        while waiting:
            task = waiting.popleft()
            yield task, work(task)


class Workers:
    """Tasks by Dask's workers. watched: whether there is a dashboard."""

    apart = True

    def __init__(self, client: Any, number: int, watched: bool) -> None:
        self.client, self.number, self.watched = client, number, watched

    @property
    def said(self) -> str:
        """Number of workers, and the address where they can be watched, in words."""
        workers = f"{self.number} worker{'s' * (self.number != 1)}"
        return f"{workers}, {self.client.dashboard_link}" if self.watched else workers

    def run(self, work: Work, waiting: deque[Task], what: str, parts: Parts = lambda task: [task]) -> Results:
        """Run tasks, with arguments as those of `Here.run`, and yield them in the order in which they end. One whose worker
        ended is repeated in its `parts`, for another task of that worker may have ended it; the last time at the end, with no
        other task on any worker. The result of a part that ended MOST_ENDS workers is None.

        Raises BackendError where `work` fails, or the scheduler is lost."""
        from distributed import as_completed
        from distributed.comm import CommClosedError

        running: dict[Any, Task] = {}
        ends, alone = Counter[str](), deque[Task]()
        done = as_completed()
        try:
            while waiting or running or alone:
                if alone and not waiting and not running:
                    waiting.append(alone.popleft())
                while waiting and len(running) < (1 + AHEAD) * self.number:
                    task = waiting.popleft()
                    future = self.client.submit(work, task, pure=False, retries=0)
                    running[future] = task
                    done.add(future)
                future = next(done)
                task, result = running.pop(future), self._result(future, what)
                if result is not None:
                    yield task, result
                    continue
                for part in parts(task):
                    ends[repr(part)] += 1
                    if ends[repr(part)] < MOST_ENDS:
                        (alone if ends[repr(part)] == MOST_ENDS - 1 else waiting).append(part)
                    else:
                        yield part, None
        except (CancelledError, CommClosedError):
            raise BackendError(
                f"{what}: the scheduler was lost; give the same command again once there is one"
            ) from None
        finally:
            with suppress(Exception):  # the scheduler may have gone
                self.client.cancel(list(running))

    def _result(self, future: Any, what: str) -> Any:
        """Result of a task; None where its worker ended, or was lost."""
        from distributed import KilledWorker

        if future.status == "finished":
            with suppress(KilledWorker):  # it ended before its result was fetched
                return future.result()
        if future.status == "error" and not isinstance(problem := future.exception(), KilledWorker):
            raise BackendError(f"{what}: a worker failed: {problem}")
        if future.status == "cancelled" and self.client.status != "running":
            raise CancelledError
        return None


def versions() -> dict[str, str]:
    """Versions that must be equal on all workers for equal results, by name."""
    engine = import_module("taichi_sim.device.engine")
    return {
        "taichi_sim": __version__,
        engine.ENGINE: engine.VERSION,
        "Python": ".".join(platform.python_version_tuple()[:2]),
    }


def place(scheduler: str | None, workers: int | None) -> tuple[str | None, int | None]:
    """The two, judged. Raises SceneError."""
    if scheduler is not None and workers is not None:
        raise SceneError("workers", says="are those of the scheduler; give one of the two")
    return scheduler, None if workers is None else validation.whole("workers", workers, 0, 4096)


@contextmanager
def connected(scheduler: str | None, workers: int | None, say: Callable[[str], None]) -> Iterator[Any]:
    """Object that does tasks: with 0 workers this process; a number of processes of this machine, None: one for each core;
    or those of a scheduler. Raises SceneError or BackendError where that is not possible."""
    if workers == 0 and scheduler is None:
        yield Here()
        return
    dask, distributed = _packages()
    # logs of lost workers are ours to tell
    for name in ("distributed", "distributed.client"):  # which has a level of its own
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with dask.config.set({"distributed.scheduler.allowed-failures": 0, "distributed.admin.log-format": "%(message)s"}):
        if scheduler is not None:
            try:
                client = distributed.Client(scheduler, timeout=PATIENCE)
            except Exception as error:  # of an address that it does not know, whatever lies below
                says = f"no scheduler answers there ({' '.join(str(error).split())[:120]})"
                raise SceneError("scheduler", scheduler, says=says) from None
            with client:
                with suppress(TimeoutError, OSError):  # workers may have been started just now
                    client.wait_for_workers(1, timeout=PATIENCE)
                yield Workers(client, _checked(client, scheduler), _answers(client.dashboard_link))
            return
        number = workers or os.cpu_count() or 1
        with ExitStack() as stack:
            try:
                with without_interrupts():  # what is half started cannot be closed
                    cluster = distributed.LocalCluster(
                        n_workers=number,
                        threads_per_worker=1,
                        processes=True,
                        # others on this machine could send it programs otherwise
                        security=find_spec("cryptography") is not None or None,
                        dashboard_address="127.0.0.1:0",  # on all interfaces otherwise; without Bokeh a page that says so
                        silence_logs=logging.CRITICAL,
                    )
                    client = stack.enter_context(distributed.Client(stack.enter_context(cluster)))
                yield Workers(client, _checked(client, "local"), _answers(client.dashboard_link))
                _keep_kernels(client, distributed.wait)
            except (KeyboardInterrupt, SystemExit):
                heard()  # workers are ended in peace
                raise


def _keep_kernels(client: Any, wait: Callable[..., Any]) -> None:
    """Let each worker end its engine, which writes what it has compiled to the disk only then: workers are killed."""
    ends = [client.submit(_end_engine, workers=[worker], pure=False) for worker in client.ncores()]
    with suppress(Exception):  # another run compiles again, that is all
        wait(ends, timeout=PATIENCE)


def _end_engine() -> None:
    from taichi_sim.device import backend

    backend.stop()


def require_workers(scheduler: str | None, workers: int | None) -> None:
    """Raise SceneError or BackendError where `connected` would, as far as can be told without starting workers."""
    scheduler, workers = place(scheduler, workers)
    if scheduler is not None:
        with connected(scheduler, None, lambda line: None):
            pass
    elif workers != 0:
        _packages()


def _packages() -> tuple[Any, Any]:
    try:
        return import_module("dask"), import_module("distributed")
    except ImportError:
        says = 'workers need one more package: pip install "taichi-sim[sweep]"; with workers 0 this process does all'
        raise SceneError("sweep", says=says) from None


def _answers(link: str) -> bool:
    """True if there is a page: without Bokeh, and where a scheduler was started so, there is none."""
    try:
        with build_opener(ProxyHandler({})).open(link, timeout=1.0) as page:
            return bool(page.status == 200)
    except (OSError, ValueError):
        return False


def _checked(client: Any, where: str) -> int:
    """Number of workers. Raises SceneError where there is none, or one has other versions, or several threads."""
    workers = client.scheduler_info(n_workers=-1)["workers"]
    number = len(workers)
    if number == 0:
        raise SceneError("scheduler", where, says="has no workers; start some with: dask worker ADDRESS --nthreads 1")
    for worker, about in workers.items():
        if about["nthreads"] != 1:  # Taichi serves one
            says = (
                f"worker {worker} has {about['nthreads']} threads; start it with --nthreads 1, and more workers instead"
            )
            raise SceneError("scheduler", where, says=says)
    here = versions()
    try:
        found = client.run(versions)
    except (OSError, TimeoutError, CancelledError) as error:  # CommClosedError is an OSError
        says = f"was lost while its workers were asked for their versions ({' '.join(str(error).split())[:120]})"
        raise SceneError("scheduler", where, says=says) from None
    except Exception as error:
        raise SceneError("scheduler", where, says=f"its workers cannot import taichi_sim ({error})") from None
    for worker, there in found.items():
        if there != here:
            differ = [
                f"{name} {there.get(name, 'none')} there, {one} here"
                for name, one in here.items()
                if there.get(name) != one
            ]
            raise SceneError("scheduler", where, says=f"worker {worker} has other versions: {', '.join(differ)}")
    return number
