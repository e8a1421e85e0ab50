"""Moments: what a step starts from, stored beside the present fields, to go back to, to compare with, or to write to a file."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.contacts.base import ContactRule
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.state import State
from taichi_sim.integrators.base import Integrator

__all__ = ["KEPT", "LIVE", "Moments", "named", "unnamed"]

LIVE, KEPT = -1, 0  # the present fields; the first that is stored: the last state known to be good


@ti.data_oriented
class Moments:
    """`count` moments of all that a run needs to begin anew where `prime` follows: balls, what rounding left of them, turns, a
    method's own memory, what contacts hold. What `prime` makes of a moment depends on nothing else, to the last bit.

    h: seconds (count + 1) of the substep in which contacts came to hold what they do; the last is that of the present fields.
    """

    def __init__(
        self, state: State, integrator: Integrator, contacts: ContactRule, fields: Fields, serial: bool, count: int = 1
    ) -> None:
        self.state, self.integrator, self.serial, self.moments = state, integrator, serial, count
        self.n = state.n
        self.live = [state.ball]
        self.live += [state.low] if state.compensated else []
        self.live += [state.spin] if state.spins else []
        self.first = len(self.live)  # of a method's memory
        self.live += integrator.memory()
        self.count = len(self.live)  # of tables of balls; what contacts hold follows
        warm = contacts.plan.warm_starts
        self.pairs, self.sticks = (contacts.pairs, contacts.sticks) if warm else (None, None)
        self.walls, self.has_walls = contacts.walls, contacts.walls is not None
        self._hold(contacts)
        self.sizes = [self.n if k < self.count else field.shape[0] for k, field in enumerate(self.live)]
        # moment k of a table from k times its size on
        self.stored = [_like(field, count * size, fields) for field, size in zip(self.live, self.sizes)]
        self.scaled = [
            [name for name in ("impulse", "tangential_impulse", "load") if name in getattr(field, "keys", [])]
            for field in self.live
        ]
        self.counters = {f"counter.{k}": field for k, field in enumerate(integrator.counters())}
        self.whole = dict(self.counters)  # stored as they are now
        self.h = [0.0] * (count + 1)

    def _hold(self, contacts: ContactRule) -> None:
        """Append the fields that say what contacts hold."""
        # by number of a table: that of how much of it is used, beyond what always is
        self.lists: dict[int, tuple[int, int]] = {}
        self.pieces: tuple[int, ...] = ()  # numbers of the links of pairs and of where each ball's begin
        if self.pairs is not None:
            used, link, first = range(self.count, self.count + 3)
            self.lists[link], self.pieces = (used, self.pairs.pool_start), (link, first)
            self.live += [self.pairs.used, self.pairs.link, self.pairs.first, self.pairs.touching]
        if self.sticks is not None:
            self.lists[len(self.live) + 1] = (len(self.live), 0)
            self.live += [self.sticks.used, self.sticks.contact, self.sticks.begin, self.sticks.length]
        if contacts.walls is not None:
            self.live.append(contacts.walls.contact)
            if contacts.walls.has_colliders:
                self.live += [contacts.walls.collider_contacts.slot, contacts.walls.collider_contacts.filled]

    @ti.func
    def _entries(self, k: ti.template(), tables: ti.template(), moment):
        """Number of entries of table k in use: lists have far more room than they need."""
        entries = 0 * moment + ti.static(self.sizes[k])
        if ti.static(k in self.lists):
            entries = ti.min(entries, ti.static(self.lists[k][1]) + tables[ti.static(self.lists[k][0])][moment])
        return entries

    @ti.func
    def _pass(self, out: ti.template(), moment, into: ti.template(), other, ratio, scales: ti.template()):
        """Copy a moment of the tables `out` into another one of the tables `into`, and scale what contacts hold by a ratio."""
        for k in ti.static(range(len(self.sizes))):
            ti.loop_config(serialize=self.serial)
            for i in range(self._entries(k, out, moment) if ti.static(k in self.lists) else self.sizes[k]):
                row = out[k][moment * ti.static(self.sizes[k]) + i]
                if ti.static(scales and "impulse" in self.scaled[k]):
                    row.impulse = ratio * row.impulse
                if ti.static(scales and "tangential_impulse" in self.scaled[k]):
                    row.tangential_impulse = ratio * row.tangential_impulse
                if ti.static(scales and "load" in self.scaled[k]):
                    row.load = ratio * row.load
                into[k][other * ti.static(self.sizes[k]) + i] = row

    @ti.kernel
    def _store(self, into: int):
        """Copy the present fields into a moment."""
        self._pass(self.live, 0, self.stored, into, 1.0, False)

    @ti.kernel
    def _load(self, out: int, ratio: float):
        """Copy a moment into the present fields, for a step `ratio` times as long: what rests holds as much more."""
        self._pass(self.stored, out, self.live, 0, ratio, True)
        if ti.static(self.has_walls):  # what they hold is loaded: `prime` is to look at all of it
            ti.loop_config(serialize=self.serial)
            for i in range(self.n):
                self.walls.touching[i] = 1

    @ti.kernel
    def _copy(self, into: int, out: int):
        """One stored moment into another."""
        self._pass(self.stored, out, self.stored, into, 1.0, False)

    @ti.kernel
    def _remember(self, out: int):
        for k in ti.static(range(self.first, self.count)):
            ti.loop_config(serialize=self.serial)
            for i in range(self.n):
                self.live[k][i] = self.stored[k][out * self.n + i]

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
        """Load only a method's own memory, from a moment."""
        self._remember(out)

    def counts(self) -> dict[str, NDArray]:
        """Counts of the method so far, as `arrays` names them."""
        return {
            key: values
            for name, field in self.counters.items()
            for key, values in named(name, field.to_numpy()).items()
        }

    def recount(self, counts: Mapping[str, NDArray]) -> None:
        """Return to what `counts` gave."""
        for name, field in self.counters.items():
            field.from_numpy(unnamed(name, field.to_numpy(), counts))

    # To a file and back ----------------------------------------------------------------------------------------------

    def arrays(self) -> dict[str, NDArray]:
        """All that is stored, by number of a field and name of a member: all moments one after another, of lists only what is in
        use. Lists of pairs are in one piece each, as on a CPU, whatever device they are on."""
        found: dict[str, NDArray] = {}
        for k, field in enumerate(self.stored):
            values = self._in_pieces(k, field.to_numpy(), True)
            rows: Any = slice(None)
            if k in self.lists:
                number, start = self.lists[k]
                most = min(self.sizes[k], start + int(self.stored[number].to_numpy().max()))
                rows = (np.arange(self.moments)[:, None] * self.sizes[k] + np.arange(most)).ravel()
            found.update(named(self._name(k), values, rows))
        for name, field in self.whole.items():
            found.update(named(name, field.to_numpy()))
        return found

    def prepared(self, arrays: Mapping[str, NDArray], h: list[float]) -> list[tuple[Any, Any]]:
        """Values of `arrays` for each field of those stored here: (field, values). Raises ValueError where they do not fit."""
        if len(h) != len(self.h) or not all(one >= 0.0 for one in h) or not h[KEPT] > 0.0:
            raise ValueError(f"{h} are no lengths of steps")
        found = []
        for k, field in enumerate(self.stored):
            moments = self.moments if k in self.lists else 0
            values = unnamed(self._name(k), field.to_numpy(), arrays, moments)
            found.append((field, self._in_pieces(k, values, False)))
        return found + [(field, unnamed(name, field.to_numpy(), arrays)) for name, field in self.whole.items()]

    def _name(self, k: int) -> str:
        """Name of table k in files."""
        return f"ball.{k}" if k < self.count else f"contact.{k - self.count}"

    def _in_pieces(self, k: int, values: Any, pieces: bool) -> Any:
        """Table k, where lists of pairs lie side by side (see kernels.contacts.pair_lists), as if they lay in pieces, or back."""
        if self.pairs is None or not self.pairs.interleaved or k not in self.pieces:
            return values
        if isinstance(values, Mapping):
            return {name: self._in_pieces(k, column, pieces) for name, column in values.items()}
        each, end = self.pairs.block_capacity, self.pairs.pool_start  # what lies in the pool stays there
        if k == self.pieces[1]:
            return np.where(values < end, values * each if pieces else values // each, values)
        moved = values.reshape(self.moments, -1, *values.shape[1:]).copy()
        shape = (self.moments, each, self.n) if pieces else (self.moments, self.n, each)
        own = moved[:, :end].reshape(*shape, *values.shape[1:])
        moved[:, :end] = own.swapaxes(1, 2).reshape(moved[:, :end].shape)
        return moved.reshape(values.shape)

    def write(self, arrays: Mapping[str, NDArray], h: list[float]) -> None:
        """Put all back; lists may have more room than they had."""
        for field, values in self.prepared(arrays, h):
            field.from_numpy(values)
        self.h = [float(one) for one in h]


def named(name: str, values: Any, rows: Any = slice(None)) -> dict[str, NDArray]:
    """The rows of a field's values by names of their own: those of a struct by its members."""
    if isinstance(values, Mapping):
        return {f"{name}.{member}": column[rows] for member, column in values.items()}
    return {name: values[rows]}


def unnamed(name: str, present: Any, arrays: Mapping[str, NDArray], moments: int = 0) -> Any:
    """Inverse of `named`: the values of `arrays`, in the shape of the values that are present. Lists of several moments lie one
    behind the other, each with as much room behind it as there is now; moments = 0: no list."""
    if isinstance(present, Mapping):
        return {member: unnamed(f"{name}.{member}", column, arrays, moments) for member, column in present.items()}
    given = arrays.get(name)
    if given is None:
        raise ValueError(f"{name} is missing")
    if given.dtype != present.dtype or given.shape[1:] != present.shape[1:]:
        raise ValueError(f"{name} has the wrong type")
    if given.shape == present.shape:
        return np.ascontiguousarray(given)
    each, room = (len(given) // moments, len(present) // moments) if moments else (0, 0)
    if not moments or each * moments != len(given) or each > room:
        raise ValueError(f"{name} has {len(given)} entries, which do not fit")
    values = np.zeros_like(present)
    for k in range(moments):
        values[k * room : k * room + each] = given[k * each : (k + 1) * each]
    return values


def _like(field: Any, n: int, fields: Fields) -> Any:
    """A field of n entries of the type of another one."""
    if isinstance(field, ti.StructField):
        members = {name: field.get_member_field(name) for name in field.keys}
        return fields.table({name: _type(member) for name, member in members.items()}, n)
    if hasattr(field, "n"):
        return fields.vectors(n, field.n)
    return fields.integers(n) if field.dtype == ti.i32 else fields.reals(n)


def _type(member: Any) -> Any:
    return ti.types.vector(member.n, member.dtype) if hasattr(member, "n") else member.dtype
