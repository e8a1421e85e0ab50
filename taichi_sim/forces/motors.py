"""Motors: rest lengths of springs as functions of time."""

from typing import Any

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import NUMPY_TYPES, Fields
from taichi_sim.device.model import Model
from taichi_sim.forces.springs import Springs
from taichi_sim.scene.motion import TICKS, moments

__all__ = ["Motors"]


@ti.data_oriented
class Motors:
    """Sets the rest lengths of driven springs in the springs themselves, at the start of each substep, and again, by `flex`,
    where a method asks for forces at a later time within it.

    Strains are worked out on the host in float64, at the start, in the middle and at the end of each of TICKS substeps, where
    they are exact; `wave` (2 TICKS + 1, motors) holds them, row 2 `tick` belongs to the present moment. In between, at the other
    stages of a method, they lie on the parabola through these three, which is off by the third order of the step.
    A spring of phase p has the strain sine cos p + cosine sin p.
    """

    def __init__(self, model: Model, springs: Springs, fields: Fields) -> None:
        scene = model.scene
        self.springs, self.motors = springs, list(scene.motors)
        owner = np.full(scene.n_springs, -1, dtype=np.int64)
        phase = np.zeros(scene.n_springs)
        for k, motor in enumerate(self.motors):
            owner[motor.springs], phase[motor.springs] = k, np.radians(motor.phase)
        place = np.flatnonzero(springs.number >= 0)
        place = place[owner[springs.number[place]] >= 0]  # both of a spring that two balls list
        spring = springs.number[place]
        self.m, self.count = len(place), len(self.motors)
        real = fields.real
        self.driven = fields.table(
            {"place": ti.i32, "motor": ti.i32, "length": real, "sine": real, "cosine": real},
            self.m,
            {
                "place": place,
                "motor": owner[spring],
                "length": scene.rest_length[spring],
                "sine": np.sin(phase[spring]),
                "cosine": np.cos(phase[spring]),
            },
        )
        self.wave = fields.table({"sine": real, "cosine": real}, (2 * TICKS + 1) * self.count)
        self.tick = fields.integers(1)

    def load(self, time: float, h: float, first: int) -> None:
        """Work out the strains for TICKS substeps of h, from number `first` of those from `time` on."""
        t = moments(time, 0.5 * h, 2 * first, 2 * TICKS)
        table = np.stack([motor.parts(t) for motor in self.motors], axis=1)
        self._load(np.ascontiguousarray(table.reshape(-1, 2), dtype=NUMPY_TYPES[self.wave.sine.dtype]))

    @ti.kernel
    def _load(self, table: ti.types.ndarray()):
        self.tick[0] = 0
        for r in range(table.shape[0]):
            self.wave[r].sine = table[r, 0]
            self.wave[r].cosine = table[r, 1]

    @ti.func
    def drive(self, forth: ti.template()):
        """Rest lengths of the present moment; forth: it is the start of a substep, which begins."""
        for k in range(self.m):
            self._set(k, self._strain(self.driven[k], 2 * self.tick[0]))
        if ti.static(forth):
            ti.loop_config(serialize=True)
            for _ in range(1):
                self.tick[0] = self.tick[0] + 1

    @ti.func
    def flex(self, part):
        """Rest lengths once that part of the present substep is over, in 0..1."""
        for k in range(self.m):
            spring, row = self.driven[k], 2 * (self.tick[0] - 1)
            strain = self._strain(spring, row) * (1.0 - part) * (1.0 - 2.0 * part)
            strain += self._strain(spring, row + 1) * 4.0 * part * (1.0 - part)
            self._set(k, strain + self._strain(spring, row + 2) * part * (2.0 * part - 1.0))

    @ti.func
    def _strain(self, spring, row):
        wave = self.wave[row * self.count + spring.motor]
        return wave.sine * spring.cosine + wave.cosine * spring.sine

    @ti.func
    def _set(self, k, strain):
        spring = self.driven[k]
        self.springs.spring[spring.place].rest_length = spring.length * (1.0 + strain)


def motors_of(model: Model, springs: Springs | None, fields: Fields) -> Any:
    """Motors of a scene, or None."""
    return Motors(model, springs, fields) if springs is not None and model.scene.motors else None
