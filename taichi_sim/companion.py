"""Companion: a second solution of the same scene with steps twice as long, stored beside the first, to measure the error by."""

from typing import Any

import numpy as np
import taichi as ti

from taichi_sim.fields import Fields
from taichi_sim.integrators.base import Integrator
from taichi_sim.kernels.springs import GRAIN, PART
from taichi_sim.model import phase_type
from taichi_sim.state import FAR, State

__all__ = ["AHEAD", "COARSE", "FINE", "LIVE", "Companion"]

LIVE, FINE, COARSE, AHEAD = range(
    4
)  # moments: the present fields, the solution kept, the companion, the same one step on


TABLES = ("", "low_")  # of a companion's places, by their names in a file


@ti.data_oriented
class Companion:
    """Moments of what a step starts from: balls, what rounding left of them, turns, a method's own memory. The companion one step
    on counts once the step is accepted."""

    def __init__(self, state: State, integrator: Integrator, fields: Fields, serial: bool) -> None:
        self.state, self.integrator, self.serial = state, integrator, serial
        self.n = state.n
        self.parts = -(-self.n // PART)
        self.row = np.zeros(self.parts, dtype=np.float64 if fields.real == ti.f64 else np.float32)
        live = [state.ball]
        live += [state.low] if state.compensated else []
        live += [state.turn] if state.spins else []
        self.first = len(live)  # of a method's memory
        live += integrator.memory()
        self.count = len(live)
        self.moments = [live, *([self._like(field, fields) for field in live] for _ in range(3))]
        self.moment = self.moments[AHEAD][0]

    def _like(self, field: Any, fields: Fields) -> Any:
        if isinstance(field, ti.StructField):
            return fields.table(phase_type(self.state.dim, fields.real), self.n)
        return fields.vectors(self.n, self.state.dim) if hasattr(field, "n") else fields.reals(self.n)

    @ti.kernel
    def _copy(self, into: ti.template(), out: ti.template(), first: ti.template()):
        for k in ti.static(range(first, self.count)):
            if ti.static(self.serial):
                ti.loop_config(serialize=True)
                for i in range(self.n):
                    self.moments[into][k][i] = self.moments[out][k][i]
            else:
                for i in range(self.n):
                    self.moments[into][k][i] = self.moments[out][k][i]

    def copy(self, into: int, out: int) -> None:
        """One moment into another."""
        self._copy(into, out, 0)

    def remember(self, out: int) -> None:
        """Only a method's own memory, from a moment."""
        self._copy(LIVE, out, self.first)

    @ti.func
    def _part(self, row: ti.template(), c):
        largest = 0.0 * self.moment[0].x[0]
        for i in range(c * PART, ti.min((c + 1) * PART, self.n)):
            square = (self.state.ball[i].x - self.moment[i].x).norm_sqr()
            if not square < FAR:  # nan, too
                square = FAR
            largest = ti.max(largest, square)
        row[c] = largest

    @ti.kernel
    def _compare(self, row: ti.types.ndarray()):
        if ti.static(self.serial):
            ti.loop_config(serialize=True)
            for c in range(self.parts):
                self._part(row, c)
        else:
            for k in range(self.parts * GRAIN):
                if k % GRAIN == 0:
                    self._part(row, k // GRAIN)

    def apart(self) -> float:
        """Largest distance [m] of a ball from where the companion ahead has it; infinite where either is nowhere."""
        self._compare(self.row)
        square = float(self.row.max())
        return float(np.sqrt(square)) if square < FAR else np.inf

    def take(self, other: "Companion") -> None:
        """All moments of another one, whose fields are still there."""
        for mine, theirs in zip(self.moments[FINE:], other.moments[FINE:]):
            for into, out in zip(mine, theirs):
                into.copy_from(out)

    def arrays(self, memory: bool) -> dict[str, np.ndarray]:
        """Position, velocity (n, dim) of the companion in float64 by name, what rounding left of them, where that is kept, and
        the method's memory in both solutions."""
        found = {}
        for name, table in zip(TABLES, self.moments[COARSE][: 2 if self.state.compensated else 1]):
            found[f"{name}x"], found[f"{name}v"] = self.state.values(table.x), self.state.values(table.v)
        for moment in (FINE, COARSE) if memory else ():
            for k, field in enumerate(self.moments[moment][self.first :]):
                found[f"memory.{moment}.{k}"] = self.state.values(field)
        return found

    def write(self, arrays: dict[str, np.ndarray]) -> bool:
        """Put all back as `arrays` gave it; whether a memory was there."""
        for name, table in zip(TABLES, self.moments[COARSE][: 2 if self.state.compensated else 1]):
            if f"{name}x" in arrays:
                self.state._copy_in(table, arrays[f"{name}x"], arrays[f"{name}v"])
        there = False
        for moment in (FINE, COARSE):
            for k, field in enumerate(self.moments[moment][self.first :]):
                if f"memory.{moment}.{k}" in arrays:
                    self.state.set_values(field, arrays[f"memory.{moment}.{k}"])
                    there = True
        return there
