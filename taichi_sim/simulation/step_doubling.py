"""SecondSolution: a second solution of the same scene, with other steps, stored beside the first, to measure the error by."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from taichi_sim.contacts.base import ContactRule
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import phase_type
from taichi_sim.device.state import WORLD_RADIUS, State
from taichi_sim.integrators.base import Integrator
from taichi_sim.kernels.reductions import each_part, part_size, parts_of

__all__ = ["AHEAD", "BEGUN", "COARSE", "FINE", "LIVE", "NEXT", "START", "SecondSolution"]

# moments: the present fields, then those that are stored: the solution kept, the second solution, where both were when they
# began, and both one step on
LIVE, FINE, COARSE, START, BEGUN, NEXT, AHEAD = range(-1, 6)
STORED = 6
NAMED = {COARSE: "", START: "start.", BEGUN: "begun."}  # those that are written to a file, by their names there
TABLES = ("", "low_")  # of places


@ti.data_oriented
class SecondSolution:
    """Moments of what a step starts from: balls, what rounding left of them, turns, a method's own memory, what contacts hold.
    The second solution one step on counts once the step is accepted.

    What contacts hold belongs to one solution: a pair that has met in one of them has not yet in the other.
    """

    def __init__(
        self, state: State, integrator: Integrator, contacts: ContactRule, fields: Fields, serial: bool
    ) -> None:
        self.state, self.integrator, self.serial = state, integrator, serial
        self.n = state.n
        self.parts = parts_of(self.n)
        self.row = np.zeros(self.parts, dtype=np.float64 if fields.real == ti.f64 else np.float32)
        live = [state.ball]
        live += [state.low] if state.compensated else []
        live += [state.spin] if state.spins else []
        self.first = len(live)  # of a method's memory
        live += integrator.memory()
        self.count = len(live)
        self.live, self.stored = live, [self._like(field, fields) for field in live]  # moment k from k n on
        self.seen = fields.table(
            {"x": ti.types.vector(state.dim, fields.real)}, self.n
        )  # the second solution, to be compared
        self.pairs = contacts.pairs if contacts.plan.warm_starts else None
        self.sticks = contacts.sticks if contacts.plan.warm_starts else None
        self.held = self._memory(contacts)
        self.held_stored = [_like_table(field, STORED, fields) for field in self.held]
        self.sizes = [field.shape[0] for field in self.held]
        self.scaled = [
            [name for name in ("impulse", "tangential_impulse") if name in getattr(f, "keys", [])] for f in self.held
        ]
        self.h = [0.0] * (STORED + 1)  # s, of the substep in which contacts came to hold what they do; LIVE is the last

    def _like(self, field: Any, fields: Fields) -> Any:
        n = STORED * self.n
        if isinstance(field, ti.StructField):
            return fields.table(phase_type(self.state.dim, fields.real), n)
        return fields.vectors(n, field.n) if hasattr(field, "n") else fields.reals(n)

    def _memory(self, contacts: ContactRule) -> list[Any]:
        """Fields that say what contacts hold: all that one step hands to the next where `prime` follows."""
        found: list[Any] = []
        self.lists: dict[
            int, tuple[int, int]
        ] = {}  # by number of a table: that of how much of it is used, beyond what always is
        if self.pairs is not None:
            self.lists[1] = (0, self.pairs.pool_start)
            found += [self.pairs.used, self.pairs.link, self.pairs.first, self.pairs.touching]
        if self.sticks is not None:
            self.lists[len(found) + 1] = (len(found), 0)
            found += [self.sticks.used, self.sticks.contact, self.sticks.begin, self.sticks.length]
        if contacts.walls is not None:
            found.append(contacts.walls.contact)
            if contacts.walls.has_colliders:
                found += [contacts.walls.collider_contacts.slot, contacts.walls.collider_contacts.filled]
        return found

    @ti.func
    def _entries(self, k: ti.template(), tables: ti.template(), moment):
        """How much of field k is in use: lists have far more room than they need."""
        entries = 0 * moment + ti.static(self.sizes[k])
        if ti.static(k in self.lists):
            entries = ti.min(entries, ti.static(self.lists[k][1]) + tables[ti.static(self.lists[k][0])][moment])
        return entries

    @ti.kernel
    def _store(self, into: int):
        """The present fields into a moment."""
        for k in ti.static(range(self.count)):
            ti.loop_config(serialize=self.serial)
            for i in range(self.n):
                self.stored[k][into * self.n + i] = self.live[k][i]
        for k in ti.static(range(len(self.held))):
            ti.loop_config(serialize=self.serial)
            for i in range(self._entries(k, self.held, 0)):
                self.held_stored[k][into * ti.static(self.sizes[k]) + i] = self.held[k][i]

    @ti.kernel
    def _load(self, out: int, ratio: float):
        """The reverse, for a step `ratio` times as long: what rests holds as much more."""
        for k in ti.static(range(self.count)):
            ti.loop_config(serialize=self.serial)
            for i in range(self.n):
                self.live[k][i] = self.stored[k][out * self.n + i]
        for k in ti.static(range(len(self.held))):
            ti.loop_config(serialize=self.serial)
            for i in range(self._entries(k, self.held_stored, out)):
                held = self.held_stored[k][out * ti.static(self.sizes[k]) + i]
                if ti.static("impulse" in self.scaled[k]):
                    held.impulse = ratio * held.impulse
                if ti.static("tangential_impulse" in self.scaled[k]):
                    held.tangential_impulse = ratio * held.tangential_impulse
                self.held[k][i] = held

    @ti.kernel
    def _copy(self, into: int, out: int):
        """One stored moment into another."""
        for k in ti.static(range(self.count)):
            ti.loop_config(serialize=self.serial)
            for i in range(self.n):
                self.stored[k][into * self.n + i] = self.stored[k][out * self.n + i]
        for k in ti.static(range(len(self.held))):
            ti.loop_config(serialize=self.serial)
            for i in range(self._entries(k, self.held_stored, out)):
                size = ti.static(self.sizes[k])
                self.held_stored[k][into * size + i] = self.held_stored[k][out * size + i]

    @ti.kernel
    def _remember(self, out: int):
        for k in ti.static(range(self.first, self.count)):
            ti.loop_config(serialize=self.serial)
            for i in range(self.n):
                self.live[k][i] = self.stored[k][out * self.n + i]

    @ti.kernel
    def _show(self):
        ti.loop_config(serialize=self.serial)
        for i in range(self.n):
            self.seen[i].x = self.state.ball[i].x

    def load(self, out: int, h: float) -> None:
        """A moment into the present fields, for substeps of h seconds."""
        self._load(out, h / self.h[out])
        self.h[LIVE] = h

    def store(self, into: int) -> None:
        """The present fields into a moment."""
        self._store(into)
        self.h[into] = self.h[LIVE]

    def copy(self, into: int, out: int) -> None:
        """One stored moment into another."""
        self._copy(into, out)
        self.h[into] = self.h[out]

    def remember(self, out: int) -> None:
        """Only a method's own memory, from a moment."""
        self._remember(out)

    def show(self) -> None:
        """The second solution is where the balls are now."""
        self._show()

    @ti.func
    def _part(self, c, row: ti.template()):
        largest = 0.0 * self.seen[0].x[0]
        size = ti.static(part_size())
        for i in range(c * size, ti.min((c + 1) * size, self.n)):
            square = (self.state.ball[i].x - self.seen[i].x).norm_sqr()
            if not square < WORLD_RADIUS:  # nan, too
                square = WORLD_RADIUS
            largest = ti.max(largest, square)
        row[c] = largest

    @ti.kernel
    def _compare(self, row: ti.types.ndarray()):
        if ti.static(self.serial):
            ti.loop_config(serialize=True)
            for c in range(self.parts):
                self._part(c, row)
        else:
            each_part(self.parts, self._part, (row,))

    def apart(self) -> float:
        """Largest distance [m] of a ball from where the second solution was shown; infinite where either is nowhere."""
        self._compare(self.row)
        square = float(self.row.max())
        return float(np.sqrt(square)) if square < WORLD_RADIUS else np.inf

    def take(self, other: "SecondSolution") -> None:
        """All moments of another one, whose fields are still there, but for what contacts hold."""
        for into, out in zip(self.stored, other.stored):
            into.copy_from(out)
        self.seen.copy_from(other.seen)
        self.h = list(other.h)

    # To a file and back ----------------------------------------------------------------------------------------------

    def arrays(self, memory: bool, began: bool) -> dict[str, np.ndarray]:
        """Moments by name, in float64: position, velocity (n, dim), what rounding left of them, where that is kept, turns (n, dim
        or 3), and a method's memory in both solutions, where there is one now, and where there was one when they began."""
        found = {}
        for name, (field, moment) in self._names().items():
            if not name.startswith("memory") or (memory if moment in (FINE, COARSE) else began):
                values = self._values(field)[moment * self.n : (moment + 1) * self.n]
                found[name] = (
                    values if self.state.order is None else _put(np.empty_like(values), self.state.order, values)
                )
        return found

    def write(self, arrays: Mapping[str, np.ndarray]) -> bool:
        """Put all back as `arrays` gave it; whether all but memories was there."""
        names = self._names()
        if any(name not in arrays for name in names if not name.startswith("memory")):
            return False
        for name, (field, moment) in names.items():
            if name in arrays:
                values, all_of_them = arrays[name], self._values(field)
                values = values if self.state.order is None else values[self.state.order]
                all_of_them[moment * self.n : (moment + 1) * self.n] = values
                stored = all_of_them if hasattr(field, "n") else all_of_them[:, 0]
                field.from_numpy(stored.astype(np.float64 if field.dtype == ti.f64 else np.float32))
        return True

    def _names(self) -> dict[str, tuple[Any, int]]:
        """Stored field and moment by the name in a file."""
        found: dict[str, tuple[Any, int]] = {}
        for moment, prefix in NAMED.items():
            for name, table in zip(TABLES, self.stored[: 2 if self.state.compensated else 1]):
                found[f"{prefix}{name}x"], found[f"{prefix}{name}v"] = (table.x, moment), (table.v, moment)
            if self.state.spins:
                found[f"{prefix}turn"] = (self.stored[self.first - 1], moment)
        for moment in (FINE, COARSE, START, BEGUN):
            for k, field in enumerate(self.stored[self.first :]):
                found[f"memory.{moment}.{k}"] = (field, moment)
        return found

    def _values(self, field: Any) -> np.ndarray:
        """As a file has them: scalars are the first of `dim` columns."""
        values = field.to_numpy()
        return values if values.ndim == 2 else np.pad(values[:, None], ((0, 0), (0, self.state.dim - 1)))


def _put(into: np.ndarray, at: np.ndarray, values: np.ndarray) -> np.ndarray:
    into[at] = values
    return into


def _like_table(field: Any, times: int, fields: Fields) -> Any:
    """A field of the same type as a table or one of integers, so many times as long."""
    n = times * field.shape[0]
    if not isinstance(field, ti.StructField):
        return fields.integers(n)
    members = {name: field.get_member_field(name) for name in field.keys}
    return fields.table({name: _type(member) for name, member in members.items()}, n)


def _type(member: Any) -> Any:
    return ti.types.vector(member.n, member.dtype) if hasattr(member, "n") else member.dtype
