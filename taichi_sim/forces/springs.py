"""Springs: Hooke's law with damping along the spring, summed by gather, by blocks, padded or not, with atomics, or in turn."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields, fill
from taichi_sim.device.model import Model, incidence, phase_type
from taichi_sim.forces.slices import Slices
from taichi_sim.forces.spring_batches import batches
from taichi_sim.forces.spring_colours import colours
from taichi_sim.kernels.springs import law, padded_blocks, simd_batches
from taichi_sim.kernels.springs.law import Terms

__all__ = ["Springs"]

FEWEST_BLOCKS = 32  # half of them, one phase, keeps a desktop's threads busy; a fixed number, so that bits do not
# depend on how many threads there are
SMALLEST_BLOCK = 64  # balls
ELASTIC, DAMPING = Terms(True, False, False), Terms(False, True, False)


@ti.data_oriented
class Springs:
    """The springs of a scene.

    Args:
        damping: (m,) [N s/m] as the integrator wants it.
        order: "gather", "blocks", "padded" blocks, SIMD "batches", "colours" (fixed orders), "atomic", or "ends", where both
            ends of a spring work out what it does to each: for implicit methods on devices.
    """

    def __init__(self, model: Model, fields: Fields, damping: NDArray[np.float64], order: str) -> None:
        scene = model.scene
        self.n, self.m, self.dim = model.n, scene.n_springs, model.dim
        self.entries = self.m
        self.damped = bool(np.any(scene.damping > 0))
        self.together, self.apart = (Terms(True, self.damped, apart) for apart in (False, True))
        self.order = order
        self.given = damping
        self.tearing: Any = None  # see forces.tearing
        low = scene.pairs.min(axis=1)
        high = scene.pairs.max(axis=1)
        slices = None
        if order == "gather":
            start, other, spring = incidence(scene.pairs, self.n)
            self.entries = 2 * self.m
            slices = Slices.of(start)
        else:
            spring = np.lexsort((high, low))
            other = high[spring]
            start = np.zeros(self.n + 1, dtype=np.int32)
            np.cumsum(np.bincount(low, minlength=self.n), out=start[1:])
        self.start = fields.integers(start)  # (n + 1) the first entry of each ball
        # other: the ball at the other end; stiffness [N/m], rest_length [m]
        columns = {"other": ti.i32, "stiffness": fields.real, "rest_length": fields.real}
        data = {"other": other, "stiffness": scene.stiffness[spring], "rest_length": scene.rest_length[spring]}
        if self.damped:
            columns["damping"] = fields.real  # N s/m
            data["damping"] = damping[spring]
        self.placed = order in ("batches", "colours")  # not stored by ball
        if order == "ends":
            end_start, _, ends = incidence(scene.pairs[spring], self.n)
            # end_start (n + 1): where the list of each ball begins, as lower or upper end; end_spring (2 m): its entries
            self.end_start, self.end_spring = fields.integers(end_start), fields.integers(ends)
        if order in ("atomic", "ends") or self.placed:
            columns["one"] = ti.i32  # the lower ball
            data["one"] = low[spring]
        self.number = spring  # in the scene, of each stored here; -1 of idle ones
        self.sliced = slices is not None
        if slices is not None:
            self.slice_start = fields.integers(slices.start)  # (slices) the first entry of each
            data = {name: slices.spread(values) for name, values in data.items()}
            self.entries, self.number = slices.room, slices.spread(spring, -1)
        if order == "batches":
            chosen = batches(np.stack([low, high], axis=1)[spring], simd_batches.BATCH_WIDTH).ravel()
            data = self._placed_as(chosen, data, fields)
            self.batches = self.entries // simd_batches.BATCH_WIDTH
        if order == "colours":
            colour = colours(np.stack([low, high], axis=1)[spring], self.n)
            assert colour is not None  # with at most half as many springs at a ball
            data = self._placed_as(np.argsort(colour, kind="stable"), data, fields)
            self.colours = (0, *np.cumsum(np.bincount(colour)).tolist())  # entries of colour c: from [c] to [c + 1]
        if order == "padded":
            width = padded_blocks.width(self.dim)
            self.phase = fields.table(phase_type(width, fields.real), self.n)  # padded copies of balls
            # [N s], padded; `damping_sum`: of damping, where it is summed apart
            self.sum, self.damping_sum = (fields.vectors(n, width) for n in (self.n, self.n if self.damped else 0))
        self.spring = fields.table(columns, self.entries, data, by_column=self.sliced)
        self.block = max(SMALLEST_BLOCK, bandwidth(model) + 1)  # balls in each
        self.blocks = -(-self.n // self.block)
        orders = {
            "gather": law.gather,
            "blocks": law.blocks,
            "padded": padded_blocks.blocks,
            "atomic": law.scatter,
            "ends": law.scatter,
        }
        self.loop = orders.get(order)  # batches are for methods that take springs in turn

    def _placed_as(self, chosen: NDArray, data: dict[str, NDArray], fields: Fields) -> dict[str, NDArray]:
        """Columns of the springs in the order `chosen`, with idle springs from ball 0 to ball 1 where it is -1."""
        # (m) entry of each spring of `start`
        self.place = fields.integers(np.argsort(chosen, kind="stable")[-self.m :])
        self.entries = len(chosen)
        self.number = np.where(chosen < 0, -1, self.number[chosen])
        return {name: np.where(chosen < 0, name == "other", values[chosen]) for name, values in data.items()}

    def set_damping(self, damping: NDArray[np.float64]) -> None:
        """Replace the damping (m,) [N s/m] of all springs."""
        self.given = damping
        if self.damped:
            stored = np.where(self.number < 0, 0.0, damping[self.number])
            if self.tearing is not None:
                stored = np.where(self.tearing.whole(), stored, 0.0)
            fill(self.spring.damping, stored)

    def names(self) -> list[str]:
        """Names of the parts that are compiled in, for `Simulation.kernels()`."""
        return [f"springs.{self.order}"] + (["springs.damping"] if self.damped else [])

    @ti.func
    def elastic(self, ball: ti.template(), impulse: ti.template(), h):
        """impulse [N s] = h times the elastic forces."""
        ti.static(self.loop)(ball, self, impulse, impulse, h, h, ELASTIC)

    @ti.func
    def damp(self, ball: ti.template(), damping_impulse: ti.template(), tau):
        """damping_impulse [N s] = tau times the damping forces."""
        ti.static(self.loop)(ball, self, damping_impulse, damping_impulse, tau, tau, DAMPING)

    @ti.func
    def both(self, ball: ti.template(), impulse: ti.template(), damping_impulse: ti.template(), h, tau):
        """Elastic impulses over h into `impulse`, damping impulses over tau into `damping_impulse`, in one pass."""
        ti.static(self.loop)(ball, self, impulse, damping_impulse, h, tau, self.apart)

    @ti.func
    def total(self, ball: ti.template(), impulse: ti.template(), h):
        """impulse [N s] = h times the elastic and the damping forces together."""
        ti.static(self.loop)(ball, self, impulse, impulse, h, h, self.together)


def bandwidth(model: Model) -> int:
    """Largest difference between the indices of two balls that a spring joins."""
    pairs = model.scene.pairs.astype(np.int64)
    return int(np.abs(pairs[:, 1] - pairs[:, 0]).max()) if len(pairs) else 0


def fixed_order(model: Model, cpu: bool, small: bool) -> str:
    """The fastest fixed order: padded in a cache; blocks where springs reach few indices far, else gather; GPUs gather."""
    if cpu and small:
        return "padded"
    blocks = model.n // max(SMALLEST_BLOCK, bandwidth(model) + 1)
    return "blocks" if cpu and blocks >= FEWEST_BLOCKS else "gather"
