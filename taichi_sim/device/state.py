"""State: what changes while a scene runs, as Taichi fields."""

from typing import Any

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields, fill
from taichi_sim.device.model import Model, phase_type

__all__ = ["WORLD_RADIUS", "State"]

WORLD_RADIUS = 1e12  # m; a ball beyond this has left the world


@ti.data_oriented
class State:
    """`ball` (n) struct with x [m] and v [m/s]. `compensated` keeps what single precision rounds off of x and v in `low` and
    gives it back with the next change (Kahan's sum). `spin` (n), where balls spin: radius times angular velocity [m/s], a scalar
    in 2D, a vector in 3D.

    order: number in the user's scene of each ball stored here, or None where they are the same. What goes in and out below
    is in the user's order."""

    def __init__(self, model: Model, fields: Fields, compensated: bool, order: np.ndarray | None = None) -> None:
        scene = model.scene
        self.order = order
        self.n, self.dim = model.n, model.dim
        self.turn = 1 if model.dim == 2 else 3  # components of an angular velocity
        phase = phase_type(model.dim, fields.real)
        self.ball = fields.table(phase, self.n, {"x": scene.position, "v": scene.velocity})
        self.compensated = compensated
        self.followers: list[Any] = []  # parts that keep, restore, store and put back what they have, see Moments
        if compensated:
            self.low = fields.table(phase, self.n)
        self.spins = model.spins
        self.still = ~model.spinning if model.some_spin else None  # balls that never spin
        if self.spins:
            self.spin = fields.spins(self.n, model.dim)

    @ti.func
    def shift(self, i, dx):
        """x += dx [m] for ball i."""
        if ti.static(self.compensated):
            change = dx + self.low[i].x
            moved = self.ball[i].x + change
            self.low[i].x = change - (moved - self.ball[i].x)
            self.ball[i].x = moved
        else:
            self.ball[i].x = self.ball[i].x + dx  # a bare += would be atomic

    @ti.func
    def kick(self, i, dv):
        """v += dv [m/s] for ball i."""
        if ti.static(self.compensated):
            change = dv + self.low[i].v
            faster = self.ball[i].v + change
            self.low[i].v = change - (faster - self.ball[i].v)
            self.ball[i].v = faster
        else:
            self.ball[i].v = self.ball[i].v + dv

    def keep(self) -> None:
        """Followers remember the present state as good."""
        for part in self.followers:
            part.keep()

    def restore(self) -> None:
        """Followers return to the state last kept."""
        for part in self.followers:
            part.restore()

    def write(self, x: np.ndarray, v: np.ndarray, low: tuple[np.ndarray, np.ndarray] | None = None) -> None:
        """Replace positions and velocities, both (n, dim), and what single precision rounded off of them (0)."""
        self._copy_in(self.ball, x, v)
        if self.compensated:
            self._copy_in(self.low, *(low or (np.zeros_like(x), np.zeros_like(v))))

    def write_spin(self, spin: np.ndarray | None = None) -> None:
        """Replace radius times angular velocity (n, 1 or 3) [m/s]; None: by 0."""
        if self.spins:
            spin = np.zeros((self.n, self.turn)) if spin is None else spin
            stored = spin if self.order is None else spin[self.order]
            if self.still is not None:
                stored = np.where(self.still[:, None], 0.0, stored)
            shaped = stored[:, 0] if self.dim == 2 else stored
            fill(self.spin, shaped)

    def _copy_in(self, table: Any, x: np.ndarray, v: np.ndarray) -> None:
        self.set_values(table.x, x)
        self.set_values(table.v, v)

    def set_values(self, field: Any, values: np.ndarray) -> None:
        """Fill a field (n) from (n, dim) in the user's order."""
        fill(field, values if self.order is None else values[self.order])

    def values(self, field: Any) -> np.ndarray:
        """A field (n) as (n, dim) in the user's order, a copy."""
        stored = field.to_numpy()[: self.n]
        if self.order is None:
            return stored
        values = np.empty_like(stored)
        values[self.order] = stored
        return values

    @property
    def rounded_off(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Parts that single precision rounded off of positions and velocities, both (n, dim), or None where they are not
        kept."""
        if not self.compensated:
            return None
        return self.values(self.low.x), self.values(self.low.v)

    @property
    def position(self) -> np.ndarray:
        """(n, dim) m, a copy in float64."""
        return self.values(self.ball.x).astype(np.float64)

    @property
    def velocity(self) -> np.ndarray:
        """(n, dim) m/s, a copy in float64."""
        return self.values(self.ball.v).astype(np.float64)

    @property
    def surface_speed(self) -> np.ndarray:
        """Radius times angular velocity, (n, 1) in 2D, (n, 3) in 3D [m/s], a copy in float64; 0 where balls do not spin."""
        if not self.spins:
            return np.zeros((self.n, self.turn))
        return self.values(self.spin).astype(np.float64).reshape(self.n, self.turn)
