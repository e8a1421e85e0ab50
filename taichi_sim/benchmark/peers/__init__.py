"""Reference implementations of the benchmark. Each is optional: what lacks a compiler or a package says so."""

from typing import Protocol

from numpy.typing import NDArray


class PeerMissingError(Exception):
    """The peer cannot run here; the text says what is lacking."""


class Runner(Protocol):
    """A scene, ready to be timed."""

    def reset(self) -> None:
        """Back to the start, ready to step: nothing is left to compile or to build."""

    def step(self, steps: int) -> None:
        """Advance by `steps` steps; return when they are done."""

    def result(self) -> tuple[NDArray, NDArray]:
        """Position [m] and velocity [m/s] as they are now, each (n, dim)."""
