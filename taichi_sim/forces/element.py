"""Element: user-defined forces between a few balls each.

    @ti.data_oriented
    class Rod(ts.Element):
        def __init__(self, balls, stiffness):
            self.balls = balls  # (e, 3)
            self.columns = {"stiffness": stiffness}  # N/m

        @ti.func
        def force(self, ball: ti.template(), row, time):
            bend = ball[row.a].x - 2.0 * ball[row.b].x + ball[row.c].x
            return -row.stiffness * ti.select(row.corner == 1, -2.0, 1.0) * bend

    ts.Simulation(scene, forces=[Rod([[0, 1, 2]], 100.0)])

docs/extending.md adds its energy and its stability.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.device.engine import CompilationError, shape_of, ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.device.state import State
from taichi_sim.forces.corners import CORNER_NAMES, Corners
from taichi_sim.scene.scene import Scene

__all__ = ["Element"]

DERIVATIVES = ("product", "block", "potential")


class FunctionError(CompilationError):  # type: ignore[misc, valid-type]
    """A mistake in a user's function that shows only while kernels are compiled; the text is one sentence.

    The engine raises it anew with the places in the sources that led there before its text: these are left out.
    """

    def __init__(self, text: str) -> None:
        super().__init__(text.strip().rsplit("\n", 1)[-1])


@ti.data_oriented
class Element(Corners):
    """A kind of element of 2 to 8 balls each; a subclass, itself @ti.data_oriented, gives `balls` and `force`.

    `balls` (e, k): the corners of each element. `columns`: what each element has besides, name to one number or (e,).
    `force(ball, row, time)`, a ti.func: what element `row` does to its corner number row.corner [N], from places and velocities
    ball[j].x and ball[j].v at j = row.a, row.b, ..., its corners in their order, and the columns row.name. Forces must sum to 0
    over the corners, else momentum is not kept. As any force it may have `stiffness_rate(scene)` [1/s^2], see `largest_rate`,
    and `damping_rate(scene)` [1/s]. `energies(position)`, NumPy: (e,) J at (n, dim) m, counted in `Simulation.energy`. An
    element two of whose balls a torn spring joined acts no more.

    With three more functions implicit methods solve for it, and it limits no step of theirs. Without them it is explicit.
    `product(ball, row, s)`: the rows of corner row.corner of (s^2 K + s D) p, p from ball[j].p, where -K and -D are the
    derivatives of the forces by places and velocities, symmetric, and without what is negative. `block(ball, row, s)`: the block
    (dim, dim) of s^2 K + s D that joins the corner to itself. `potential(ball, row, s)`: the corner's share of the energy [J]
    and of s / 2 times the power that damping takes. Places and velocities are those of the end of a stage of s seconds. Damping
    along a direction that turns counts in `potential` along that at ball[j].x - ball[j].p, before the change under test.
    """

    elastic = refined = False
    balls: ArrayLike
    force: Callable[..., Any]
    product: Any = None  # a ti.func
    block: Any = None
    potential: Any = None
    columns: Mapping[str, Any] = {}

    @property
    def implicit(self) -> bool:
        """True if it gives `product`, `block` and `potential`."""
        return self.product is not None

    def corners(self, scene: Scene) -> NDArray[np.int32]:
        """`balls`, checked. Raises SceneError."""
        where = f"{type(self).__name__}.balls"
        balls = validation.as_array(getattr(self, "balls", None))
        if balls.ndim != 2 or not 2 <= balls.shape[1] <= len(CORNER_NAMES):
            raise SceneError(
                where, says=f"shape {balls.shape} does not fit; it must be (e, k), k from 2 to {len(CORNER_NAMES)}"
            )
        return validation.corners(where, balls, scene.n_balls, balls.shape[1])

    def check(self, scene: Scene) -> None:
        """Raises SceneError for balls, columns or a force that do not fit."""
        validation.taichi_function("forces", self, "force", "ball, row, time")
        given = [name for name in DERIVATIVES if getattr(self, name) is not None]
        if 0 < len(given) < len(DERIVATIVES):
            missing = ", ".join(name for name in DERIVATIVES if name not in given)
            says = f"is given without {missing}; implicit methods need {', '.join(DERIVATIVES)}, or none of them"
            raise SceneError(f"{type(self).__name__}.{given[0]}", says=says)
        for name in given:
            validation.taichi_function("forces", self, name, "ball, row, s")
        balls = self.corners(scene)
        known = ["corner", *CORNER_NAMES[: balls.shape[1]], *self._checked_columns(len(balls))]
        for function in ("force", *given):
            for name in sorted(validation.attributes_read(getattr(type(self), function), 1) - set(known)):
                says = f"is read by {function}, but it is no column and no corner of its {balls.shape[1]}"
                raise SceneError(f"{type(self).__name__}.columns.{name}", says=f"{says}; there are {', '.join(known)}")

    def _checked_columns(self, count: int) -> dict[str, NDArray]:
        """`columns`, one number for each of so many elements."""
        where = f"{type(self).__name__}.columns"
        if not isinstance(self.columns, Mapping):
            raise SceneError(where, self.columns, "a dict of names, with one number each or one per element")
        for name in self.columns:
            if not isinstance(name, str) or not name.isidentifier():
                raise SceneError(where, name, "the name of a number, which `force` reads as row.name")
            if name in ("corner", *CORNER_NAMES):
                raise SceneError(f"{where}.{name}", says="is the name of a corner; call the column otherwise")
        return {name: validation.per_item(f"{where}.{name}", value, count) for name, value in self.columns.items()}

    def allocate(self, model: Model, state: State, fields: Fields) -> None:
        """List for each ball the elements that it is a corner of."""
        balls = self.corners(model.scene)
        count, k = balls.shape
        data = {name: np.tile(value, k) for name, value in self._checked_columns(count).items()}
        types = {"corner": ti.i32, **dict.fromkeys(data, fields.real)}
        data["corner"] = np.repeat(np.arange(k), count)
        self.gather(model, fields, np.tile(balls, (k, 1)), balls.T.ravel(), types, data)

    @ti.func
    def corner_force(self, ball: ti.template(), i, row, time):
        """The user's."""
        value = self.force(ball, row, time)
        ti.static(self._fits("force", value, (self.dim,)))
        return value

    @ti.func
    def corner_product(self, ball: ti.template(), i, row, s):
        """The user's."""
        value = self.product(ball, row, s)
        ti.static(self._fits("product", value, (self.dim,)))
        return value

    @ti.func
    def corner_block(self, ball: ti.template(), i, row, s):
        """The user's."""
        value = self.block(ball, row, s)
        ti.static(self._fits("block", value, (self.dim, self.dim)))
        return value

    @ti.func
    def corner_potential(self, ball: ti.template(), i, row, s, real: ti.template()):
        """The user's."""
        value = self.potential(ball, row, s)
        ti.static(self._fits("potential", value, ()))
        return ti.cast(value, real)

    def _fits(self, function: str, value: Any, shape: tuple[int, ...]) -> bool:
        """True where a function returns a value of this shape; raises FunctionError else, while kernels are compiled."""
        found = shape_of(value)
        if found != shape:
            raise FunctionError(
                f"{type(self).__name__}.{function}: returns {_of_shape(found)}; it must return {_of_shape(shape)}"
            )
        return True


def _of_shape(shape: tuple[int, ...]) -> str:
    return f"a vector or matrix of shape {shape}" if shape else "a number"
