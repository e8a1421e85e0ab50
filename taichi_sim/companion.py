"""Companion: a second solution of the same scene with steps twice as long, stored beside the first, to measure the error by."""

from typing import Any

import numpy as np
import taichi as ti

from taichi_sim.fields import Fields
from taichi_sim.integrators.base import Integrator
from taichi_sim.kernels.gauge import PART
from taichi_sim.kernels.springs import GRAIN
from taichi_sim.model import phase_type
from taichi_sim.state import FAR, State

__all__ = ["AHEAD", "COARSE", "FINE", "LIVE", "Companion"]

LIVE, FINE, COARSE, AHEAD = range(
    4
)  # moments: the present fields, the solution kept, the companion, the same one step on


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

    def positions(self) -> tuple[np.ndarray, ...]:
        """Position and velocity (n, dim) of the companion in float64, and what rounding left of them, where that is kept."""
        tables = self.moments[COARSE][: 2 if self.state.compensated else 1]
        return tuple(self.state.values(field) for table in tables for field in (table.x, table.v))

    def memory(self, *moments: int) -> list[np.ndarray]:
        """A method's own memory (n, dim) in each of the moments."""
        return [self.state.values(field) for moment in moments for field in self.moments[moment][self.first :]]

    def write(self, arrays: list[np.ndarray], *moments: int) -> bool:
        """Put the companion where `positions` said, and a method's own memory back as `memory` gave it; whether it was there."""
        tables = self.moments[COARSE][: 2 if self.state.compensated else 1]
        places, own = arrays[: 2 * len(tables)], arrays[2 * len(tables) :]
        for k, table in enumerate(tables[: len(places) // 2]):
            self.state._copy_in(table, places[2 * k], places[2 * k + 1])
        fields = [field for moment in moments for field in self.moments[moment][self.first :]]
        for field, values in zip(fields, own):
            self.state.set_values(field, values)
        return bool(own) and len(own) == len(fields)
