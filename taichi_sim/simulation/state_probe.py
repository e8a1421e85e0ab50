"""StateProbe: a sample of a state after some steps: is every ball where it can be, how fast is the fastest, how much energy."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from taichi_sim.device.engine import on_device, ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.device.state import WORLD_RADIUS, State
from taichi_sim.forces.springs import Springs
from taichi_sim.kernels import reductions
from taichi_sim.kernels.springs import law

__all__ = ["StateProbe", "StateSample", "sample_of"]

MOST_ROWS = 1 << 14  # that a device hands to the host: as many threads as keep it busy


class StateSample(NamedTuple):
    """`bad`: lowest index of a ball that is not finite or has left the world, or None; then the rest says nothing. Energies
    in J; `weight`: the sum of the sizes of what `gravity` sums, which its rounding goes with; `lift`: what gravity may hold more
    once what overlaps is pushed out."""

    bad: int | None
    speed: float  # m/s, of the fastest ball
    kinetic: float
    elastic: float
    gravity: float
    weight: float
    lift: float = 0.0

    @property
    def total(self) -> float:
        """Energy that friction, damping and contacts may only lessen [J]."""
        return self.kinetic + self.elastic + self.gravity

    @property
    def motion(self) -> float:
        """Kinetic and elastic energy [J]: the part that does not depend on where the origin is."""
        return self.kinetic + self.elastic


def sample_of(plain: Sequence[Any]) -> StateSample:
    """A sample of its plain values. Raises TypeError or ValueError for anything else."""
    bad, *numbers = plain
    return StateSample(None if bad is None else int(bad), *map(float, numbers))


@ti.data_oriented
class StateProbe:
    """Looks at the balls of a state. stores: forces that hold energy besides springs; contacts: all kinds that there are. serial:
    all on one thread, as the fused driver runs; else parts go to all threads."""

    def __init__(
        self,
        model: Model,
        state: State,
        springs: Springs | None,
        stores: Sequence[Any],
        contacts: Sequence[Any],
        fields: Fields,
        serial: bool,
    ) -> None:
        self.model, self.state, self.springs, self.serial = model, state, springs, serial
        self.stores, self.contacts = list(stores), list(contacts)
        self.has_springs = springs is not None
        self.share = 0.5 if springs is not None and springs.order == "gather" else 1.0  # both ends list a spring
        self.n, self.parts = model.n, reductions.parts_of(model.n)
        self.wide = fields.wide
        if on_device() and fields.has_wide_numbers:  # in single precision longer sums would lose digits
            self.parts = min(self.parts, MOST_ROWS)
        self.row = np.zeros((self.parts, reductions.SIZE), dtype=np.float64 if self.wide == ti.f64 else np.float32)

    @ti.func
    def _part(self, c, row: ti.template()):
        """Row c: of the balls of part c."""
        bad, fastest = self.n, ti.cast(0.0, self.wide)
        kinetic, elastic = ti.cast(0.0, self.wide), ti.cast(0.0, self.wide)
        gravity, weight, lift = ti.cast(0.0, self.wide), ti.cast(0.0, self.wide), ti.cast(0.0, self.wide)
        for k in range(reductions.members(c, self.parts, self.n)):
            i = reductions.member(c, k, self.parts)
            ball = self.state.ball[i]
            if not reductions.good(ball, WORLD_RADIUS):
                bad = ti.min(bad, i)
            w = ti.cast(self.model.inverse_mass[i], self.wide)
            if w > 0.0:
                square = ti.cast(0.0, self.wide)
                for a in ti.static(range(self.model.dim)):
                    square += ti.cast(ball.v[a], self.wide) ** 2
                fastest = ti.max(fastest, square)
                if ti.static(self.state.spins):
                    square += ti.cast(self._turn(i), self.wide)
                kinetic += 0.5 * square / w
                if ti.static(self.model.has_gravity):
                    height = ti.cast(0.0, self.wide)
                    for a in ti.static(range(self.model.dim)):
                        height -= ti.cast(self.model.gravity[0][a], self.wide) * ti.cast(ball.x[a], self.wide)
                    gravity += height / w
                    weight += ti.abs(height) / w
            elastic += self._stored(i)
            lift += self._lift(i)
        row[c, reductions.BAD] = ti.cast(bad, self.wide)
        row[c, reductions.SPEED] = fastest
        row[c, reductions.KINETIC] = kinetic
        row[c, reductions.ELASTIC] = elastic
        row[c, reductions.GRAVITY] = gravity
        row[c, reductions.WEIGHT] = weight
        row[c, reductions.LIFT] = lift

    @ti.func
    def _stored(self, i):
        """Share of ball i of what springs and other forces hold [J]."""
        energy = ti.cast(0.0, self.wide)
        if ti.static(self.has_springs):
            energy += self.share * law.stored(self.state.ball, self.springs, i, self.wide)
        for force in ti.static(self.stores):
            energy += force.stored(self.state.ball, i, self.wide)
        return energy

    @ti.func
    def _lift(self, i):
        """Energy [J] that gravity may hold more once ball i is pushed out of what it overlaps."""
        energy = ti.cast(0.0, self.wide)
        if ti.static(self.model.has_gravity):
            for part in ti.static(self.contacts):
                energy += part.lift(self.state.ball, i)
        return energy

    @ti.func
    def _turn(self, i):
        """I omega^2 / m of ball i [m^2/s^2]."""
        turn = self.state.spin[i]
        if ti.static(self.model.dim == 2):
            return turn * turn / self.model.spin_inertia_ratio
        else:
            return turn.dot(turn) / self.model.spin_inertia_ratio

    @ti.kernel
    def _look(self, row: ti.types.ndarray()):
        if ti.static(self.serial):
            ti.loop_config(serialize=True)
            for c in range(self.parts):
                self._part(c, row)
        else:
            reductions.each_part(self.parts, self._part, (row,))

    def sample(self) -> StateSample:
        """The present state; a pass over balls and springs."""
        if self.n == 0:
            return StateSample(None, 0.0, 0.0, 0.0, 0.0, 0.0)
        self._look(self.row)
        return _whole(self.row, self.n, self.state.order)


def _whole(row: Any, n: int, order: Any) -> StateSample:
    """One look from the rows of all parts."""
    bad = int(row[:, reductions.BAD].min())
    sums = row[:, reductions.KINETIC :].sum(axis=0, dtype=np.float64)
    fastest = float(np.sqrt(row[:, reductions.SPEED].max(), dtype=np.float64))
    user = None if bad == n else bad if order is None else int(order[bad])
    return StateSample(user, fastest, *sums.tolist())
