"""Shared parts of the published tests: a measured row, their check, and how scenes are refined.

Each file has a docstring (title; problem, formula, source and reference) and `measure()`, which gives the rows that `test_all`
holds. One that holds more than its rows, `test_NAME.py`, has tests of its own. `CHAOTIC` marks a mean of random starts, measured
in single precision alone. `CAUSE` says why the program cannot pass yet; such a test is marked xfail, strictly.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

import taichi_sim as ts

DEFAULTS = "defaults"


@dataclass(frozen=True)
class Row:
    """One quantity of a test: its reference and what the program gives.

    unit: of both. allowed: largest relative error [1]. scale: what the error is relative to, in the unit; the reference by
    default. settings: "defaults", or what is finer than them.
    """

    quantity: str
    unit: str
    reference: float
    found: float
    allowed: float
    scale: float | None = None
    settings: str = DEFAULTS

    @property
    def error(self) -> float:
        """Difference from the reference in parts of the scale [1]."""
        return float((self.found - self.reference) / abs(self.scale or self.reference))


def hold(rows: list[Row]) -> None:
    """Fail with all rows whose error is larger than allowed."""
    wrong = [
        f"{row.quantity} ({row.settings}): {row.found:.6g} {row.unit}, reference {row.reference:.6g}, error "
        f"{row.error:+.2%}, allowed {row.allowed:.2%}"
        for row in rows
        if not abs(row.error) <= row.allowed
    ]
    assert not wrong, "\n".join(wrong)


def refined(scene: Callable[[], ts.Scene], *parts: int) -> Iterator[tuple[Callable[..., Row], ts.Simulation]]:
    """Simulations at the defaults, then with the automatic step divided by each of `parts`, with a maker of rows that name it."""
    for part in (1, *parts):
        with ts.Simulation(scene()) as sim:
            if part > 1:
                sim.set_dt(sim.dt / part)
            yield partial(Row, settings=DEFAULTS if part == 1 else f"dt / {part}"), sim


def history(sim: ts.Simulation, end: float, every: float, read: Callable[[ts.Simulation], tuple]) -> list[np.ndarray]:
    """Times (n,) and each reading (n, ...), from now to about the time `end`; every: seconds between two, 0: each step."""
    steps = max(1, round(every / sim.dt))
    rows = [(sim.time, *read(sim))]
    while sim.time < end - 0.5 * steps * sim.dt:
        sim.step(steps)
        rows.append((sim.time, *read(sim)))
    return [np.array(column) for column in zip(*rows)]


def crossings(time: np.ndarray, value: np.ndarray, rising: bool = True) -> np.ndarray:
    """Times at which a sampled value goes through 0 upward (or downward), by linear interpolation."""
    value = value if rising else -value
    at = np.flatnonzero((value[:-1] < 0) & (value[1:] >= 0))
    return time[at] - value[at] * (time[at + 1] - time[at]) / (value[at + 1] - value[at])


def relax(sim: ts.Simulation, still: float, longest: float, chunk: float = 2e-3) -> None:
    """Bring a scene to rest by kinetic damping: velocities are set to 0 at each peak of the kinetic energy.

    still: largest move [m] over 40 chunks that counts as rest; longest, chunk: simulated seconds.
    """
    steps = max(1, round(chunk / sim.dt))
    before, since, reference = -1.0, 0, sim.position
    for count in range(1, round(longest / (steps * sim.dt))):
        sim.step(steps)
        since += 1
        kinetic = sim.energy().kinetic
        if kinetic < before and since >= 3:
            sim.set_velocity(0.0 * sim.velocity)
            before, since = -1.0, 0
        else:
            before = kinetic
        if count % 40 == 0:
            if np.abs(sim.position - reference).max() < still:
                return
            reference = sim.position
    raise AssertionError(f"not at rest after {longest:g} s")
