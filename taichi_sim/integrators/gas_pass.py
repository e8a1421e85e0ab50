"""Gas in XPBD: each closed surface is a constraint on its volume."""

from typing import Any

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model

__all__ = ["GasPass"]


@ti.data_oriented
class GasPass:
    """One pass over the gases: each asks for its volume V after the step, as springs do for their lengths, and gives the
    impulse h p dV/dx at the pressure that would be right if the gas were alone, p(V) / (1 + h^2 C / V^2 W), W = sum w |dV/dx|^2;
    a ball of several gases splits its mass between them. Gas that acted where the step began, against springs that act where it
    ends, would leave a torque against any rotation.
    """

    def __init__(self, gases: Any, model: Model, fields: Fields) -> None:
        self.gases, self.model, self.n = gases, model, model.n
        self.here = fields.table({"x": ti.types.vector(3, fields.real)}, self.n)
        scene = model.scene
        count = np.zeros(model.n)
        for gas in scene.gases:
            count[np.unique(gas.triangles)] += 1.0
        self.give = fields.reals(
            np.array([_give(scene.position, g, model.inverse_mass_array * count) for g in scene.gases])
        )
        self.first = fields.reals(np.array([gas.volume for gas in scene.gases]))

    @ti.func
    def push(self, ball: ti.template(), state: ti.template(), h):
        """Kick all balls."""
        for i in range(self.n):
            self.here[i].x = ball[i].x + h * ball[i].v
        self.gases.press(self.here)
        ti.loop_config(serialize=True)
        for g in range(self.gases.count):
            rate = self.gases.rate[g] * self.give[g]
            self.gases.pressure[g] = self.gases.pressure[g] / (1.0 + h * h * rate)
        for i in range(self.n):
            state.kick(i, self.model.inverse_mass[i] * h * self.gases.force(self.here, i))


def _give(x: np.ndarray, gas: Any, w: np.ndarray) -> float:
    """sum w |dV/dx|^2 at the places x (n, 3)."""
    t = gas.triangles
    sides = np.cross(x[t[:, 1]] - x[t[:, 0]], x[t[:, 2]] - x[t[:, 0]]) / 6.0
    gradient = np.zeros_like(x)
    for corner in range(3):
        np.add.at(gradient, t[:, corner], sides)
    return float(w @ np.sum(gradient**2, axis=1))
