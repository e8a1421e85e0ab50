"""Rows: what was measured of one method with one step, and what they say together."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from taichi_sim.reports.speed_error.plan import METHODS

STABLE, UNSTABLE, LEFT_OUT = "stable", "unstable", "left out"
LONGER_STEP = 1.9  # times a step must be as long as another for their errors to be compared
SAME_TIME = 1.2  # times another row's time: up to that they are equally fast
MUCH_LONGER = f"over {100.0 * (SAME_TIME - 1.0):.0f} % longer"
ERROR_FALLS = 0.7  # of the error at the longer step, above which a shorter step did not lessen it
CLEAR_OF_REFERENCE = 10.0  # times what the reference is known to: a smaller error says more of it than of the method


@dataclass(frozen=True)
class Row:
    """One method with one step. None: not known, or not a number that means anything. Errors are of positions, over all balls
    that are not pinned, or of the quantity asked for."""

    scene: str
    balls: int
    springs: int
    precision: str
    device: str
    method: str
    step: float  # s
    part_of_safe_step: float | None  # None where nothing limits the step, or no step is safe
    passes: float | None  # over the forces, per simulated second
    seconds: float | None  # per simulated second, see `clock`; the least of repeated runs
    noise: float | None  # of that: by how much a usual run takes longer
    ns_per_ball_step: float | None
    rms_error: float | None  # m, or in the quantity's unit: over balls, at the moment where it is largest
    max_error: float | None  # the same of one ball
    relative_error: float | None  # the rms as a part of the motion
    order: float | None  # observed, from the step twice as long
    energy_drift: float | None  # from the reference, as a part of its largest kinetic and spring energy
    verdict: str  # stable, unstable, left out
    reason: str  # of the verdict, or a warning

    @property
    def key(self) -> tuple[str, str, float]:
        """Key that tells rows of one report apart."""
        return self.precision, self.method, self.step

    @property
    def clock(self) -> str:
        """Kind of time that is measured: of all threads of the processor together; on other devices of a clock on the wall."""
        return "processor time" if self.device.startswith("cpu") else "wall time"

    def __post_init__(self) -> None:
        if self.verdict not in (STABLE, UNSTABLE, LEFT_OUT) or self.method not in METHODS:
            raise ValueError(f"{self.method!r} with {self.verdict!r} is no row")


def tells(row: Row, known: float) -> bool:
    """True if the row's error is one of the method's: it is stable and clear of what the reference is known to [m]."""
    return row.verdict == STABLE and row.rms_error is not None and row.rms_error > CLEAR_OF_REFERENCE * known


def with_orders(rows: Sequence[Row], known: float) -> list[Row]:
    """The rows, sorted by precision and method, steps falling, with the order from each pair of steps that tell."""
    found = sorted(rows, key=lambda row: (row.precision != "f64", METHODS.index(row.method), -row.step))
    for k, fine in enumerate(found):
        order = None
        longer = {one.step: one for one in found[:k] if (one.precision, one.method) == (fine.precision, fine.method)}
        coarse = longer.get(coarser(fine.step, list(longer)) or 0.0)
        if coarse is not None and tells(coarse, known) and tells(fine, known):
            assert coarse.rms_error is not None
            assert fine.rms_error is not None
            order = math.log(coarse.rms_error / fine.rms_error) / math.log(coarse.step / fine.step)
        found[k] = replace(fine, order=order)
    return found


def coarser(step: float, longer: Sequence[float]) -> float | None:
    """Of longer steps [s] the one that is nearest to twice as long, with which errors are compared; None where there is none."""
    return min(longer, key=lambda other: abs(math.log2(other / step) - 1.0), default=None)


def stuck(rows: Sequence[Row], known: float) -> list[str]:
    """Methods, in the best precision that there is, whose errors do not fall with the step any more, over one halving
    or two. Rows: sorted."""
    found = []
    for method in dict.fromkeys(row.method for row in rows):
        own = [row for row in rows if (row.precision, row.method) == (rows[0].precision, method) and tells(row, known)]
        longer = [row for row in own if row.step > LONGER_STEP * own[-1].step]
        if longer and (own[-1].rms_error or 0.0) > ERROR_FALLS * max(row.rms_error or 0.0 for row in longer[-2:]):
            found.append(method)
    return found


def as_fast(row: Row, other: Row) -> bool:
    """True if one row takes no longer than another, as far as times can be told apart. The margin is a fixed part, whatever
    the noise was: a busy machine must not make more rows equal than an idle one."""
    return (row.seconds or 0.0) <= SAME_TIME * (other.seconds or 0.0)


def pareto(rows: Sequence[Row], known: float) -> list[Row]:
    """The rows that none beats in both speed and error, the fastest first: none that is as fast has a smaller error. Rows too
    near to the reference for their error to be told are not among them, but beat those that they are faster than."""
    stable = [row for row in rows if row.verdict == STABLE and row.rms_error is not None and row.seconds is not None]
    telling = [row for row in stable if tells(row, known)]
    front: list[Row] = []
    for row in sorted(telling, key=lambda row: (row.seconds, row.rms_error)):
        better = [other for other in stable if other.rms_error < row.rms_error]  # type: ignore[operator]
        same = any(other.rms_error == row.rms_error for other in front)
        if not same and not any(as_fast(other, row) for other in better):
            front.append(row)
    return front


def cheapest(rows: Sequence[Row], tolerance: float, motion: float, known: float) -> list[Row]:
    """The rows whose error, and what the reference may be off, are together within the tolerance, a part of the motion, and which
    none of those beats clearly in speed. Of equally fast ones that which goes through the forces least often comes first, then
    that of the smallest error: both are counted, not timed."""
    within = [row for row in rows if row.rms_error is not None and row.rms_error + known <= tolerance * motion]
    good = [row for row in within if row.verdict == STABLE and row.seconds is not None]
    fastest = min(good, key=lambda row: row.seconds or 0.0, default=None)
    equal = [] if fastest is None else [row for row in good if as_fast(row, fastest)]
    return sorted(equal, key=lambda row: (round(row.passes or 0.0, 3), row.rms_error or 0.0))
