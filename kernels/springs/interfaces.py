"""What the kernels of springs read of the objects handed to them, with shape and unit, beside kernels.interfaces.

n balls in `dim` dimensions, m springs; entries: places in the list of springs, see forces.springs.Springs. Padded vectors: see
padded_blocks.
"""

from typing import Any, NamedTuple, Protocol

from taichi_sim.kernels.interfaces import Ball, Field, Lists


class Terms(NamedTuple):
    """What of the law a loop sums, known when it is compiled: what is off costs nothing."""

    elastic: bool  # k (d - l) n
    damped: bool  # c (u . n) n
    apart: bool  # damping apart from the rest


class Spring(Protocol):
    """(entries) one spring."""

    one: int  # its lower ball, in the orders "atomic", "ends", "batches" and "colours"
    other: int  # its other ball
    stiffness: float  # N/m
    damping: float  # N s/m, where any spring has some
    rest_length: float  # m


class Springs(Lists, Protocol):
    """The springs of a scene, listed by ball."""

    n: int  # balls
    m: int  # springs
    dim: int  # 2 or 3
    order: str  # in which springs are summed: "gather", "blocks", "padded", "batches", "colours", "ends" or "atomic"
    placed: bool  # whether entries do not follow `start`, but `place`: with the orders "batches" and "colours"
    place: Field  # (m) entry of each spring of `start`, where that is so
    end_start: Field  # (n + 1) where the springs at either of whose ends ball i is begin, in the order "ends"
    end_spring: Field  # (2 m) their entries
    colours: tuple[int, ...]  # first entry of each colour, and the end of the last one
    spring: Spring  # (entries)
    block: int  # balls in a block
    blocks: int  # number of blocks
    batches: int  # number of SIMD batches
    phase: Ball  # (n) padded
    sum: Field  # (n) padded, N s
    damping_sum: Field  # (n) padded, N s: of damping, where that is apart


class EdgeSum(Protocol):
    """Sums of one kind of term over the springs of each ball."""

    dim: int  # numbers in a term
    sum: Field  # (n) vectors, set

    def own(self, i: int) -> Any:
        """What ball i begins with."""

    def term(self, i: int, j: int, e: int, h: float) -> Any:
        """What spring e adds at its lower ball i and takes at its other one, j; or the same seen from the other end."""


class Sweep(Protocol):
    """What changes balls spring by spring."""

    def change(self, i: int, j: int, e: int, h: float) -> None:
        """Apply spring e at its balls i and j."""


class BatchSweep(Sweep, Protocol):
    """The same in two steps, for springs that share no ball."""

    dim: int  # 2 or 3

    def give(self, i: int, j: int, e: int, h: float) -> Any:
        """Impulse of spring e on ball i [N s], and the square of the distance of its ends [m^2]."""

    def take(self, i: int, j: int, p: Any) -> None:
        """Impulse p [N s] on ball i, -p on ball j."""


READS = {"springs": Springs, "spring": Spring, "what": Terms, "total": EdgeSum, "sweep": Sweep}
