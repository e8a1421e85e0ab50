"""Gas in methods that solve for it together with springs: closed surfaces in XPBD, and in an implicit stage."""

from typing import Any

import numpy as np

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.kernels.reductions import each_part
from taichi_sim.kernels.springs import padded_blocks

__all__ = ["GasConstraints", "StageGas"]


@ti.data_oriented
class GasConstraints:
    """In XPBD each gas is a constraint on its volume: it asks for its volume V after the step, as springs do for their lengths,
    and gives the impulse h p dV/dx at the pressure that would be right if the gas were alone, p(V) / (1 + h^2 C / V^2 W), W = sum
    w |dV/dx|^2; a ball of several gases splits its mass between them. Gas that acted where the step began, against springs that
    act where it ends, would leave a torque against any rotation."""

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


@ti.data_oriented
class StageGas:
    """Closed surfaces of gas in a StageSolver: forces where the stage ends, what the matrix has of them, and the potential.

    A gas adds U(V) = -C ln V + outside V, C = (pressure + outside) V0, to the potential of a stage, s p dV/dx to its residual and
    s^2 d2U/dx2 = s^2 (C / V^2 dV/dx dV/dx^T - p d2V/dx2) to its matrix. The second part has negative directions, but with
    it a surface in balance, springs against gas, rotates freely, as it should. A ball's own block of d2V/dx2 is 0: moved alone, a
    corner changes the volume linearly.

    Fields: `here` (n), x the places [m] at which the rest was worked out; `change` (gases) [m^3]: of volumes along a product's p.
    """

    def __init__(self, gases: Any, bodies: Any, fields: Fields) -> None:
        self.gases, self.bodies, self.n = gases, bodies, gases.n
        self.here = fields.table({"x": ti.types.vector(3, fields.real)}, self.n)
        self.step, self.change = fields.reals(1), fields.reals(gases.count)
        self.part = fields.doubles(gases.parts)
        self.wide = fields.wide

    @ti.func
    def push(self, base: ti.template(), total: ti.template(), s):
        """total (n), padded, += s times the forces at base.x + s base.v."""
        self.step[0] = s
        for i in range(self.n):
            self.here[i].x = base[i].x + s * base[i].v
        self.gases.press(self.here)
        for i in range(self.n):
            total[i] = total[i] + ti.cast(padded_blocks.pad(s * self.gases.force(self.here, i), 3), self.wide)

    @ti.func
    def multiply(self, p: ti.template(), total: ti.template()):
        """total (n) += the gas's part of the matrix times p (n), all padded."""
        each_part(self.gases.parts, self._change, (p,))
        ti.loop_config(serialize=True)
        for _ in range(1):
            for g in range(self.gases.count):
                self.change[g] = 0.0
            for c in range(self.gases.parts):
                g = self.gases.part[c].gas
                self.change[g] = self.change[g] + ti.cast(self.part[c], float)
        for i in range(self.n):
            f, s = ti.Vector.zero(float, 3), self.step[0]
            x, q = self.here[i].x, padded_blocks.cut(p[i], 3)
            for e in range(self.gases.start[i], self.gases.start[i + 1]):
                row = self.gases.row[e]
                a, b = self.here[row.a].x - x, self.here[row.b].x - x
                tilt = (padded_blocks.cut(p[row.a], 3) - q).cross(b) + a.cross(padded_blocks.cut(p[row.b], 3) - q)
                more = self.gases.rate[row.gas] * self.change[row.gas]
                f += more * a.cross(b) - self.gases.pressure[row.gas] * tilt
            total[i] = total[i] + padded_blocks.pad(s * s / 6.0 * f, 3)

    @ti.func
    def _change(self, c, p: ti.template()):
        """Change of the volume of part c along p; from the gas's first ball, as volumes are."""
        part = self.gases.part[c]
        home = self.gases.law[part.gas].home
        x, q = self.here[home].x, padded_blocks.cut(p[home], 3)
        total = ti.cast(0.0, self.wide)
        for k in range(part.first, part.last):
            t = self.gases.triangle[k]
            one, two, three = self.here[t.a].x - x, self.here[t.b].x - x, self.here[t.c].x - x
            change = (padded_blocks.cut(p[t.a], 3) - q).dot(two.cross(three))
            change += (padded_blocks.cut(p[t.b], 3) - q).dot(three.cross(one))
            change += (padded_blocks.cut(p[t.c], 3) - q).dot(one.cross(two))
            total += ti.cast(change, self.wide)
        self.part[c] = total / 6.0

    @ti.func
    def gradient(self, i):
        """g such that s^2 C / V^2 dV/dx dV/dx^T has the block g g^T at ball i."""
        g = ti.Vector.zero(float, 3)
        for e in range(self.gases.start[i], self.gases.start[i + 1]):
            row = self.gases.row[e]
            x = self.here[i].x
            g += ti.sqrt(self.gases.rate[row.gas]) / 6.0 * (self.here[row.a].x - x).cross(self.here[row.b].x - x)
        return self.step[0] * g

    @ti.func
    def weigh(self, solver: ti.template(), s, taken):
        """Add the energies to the potentials of a StageSolver, with the multiple `taken` of its change taken back."""
        for i in range(self.n):
            part = taken * ti.cast(solver.number[self.bodies.of(i)].part, float)
            self.here[i].x = solver.base[i].x + s * (solver.base[i].v - part * solver.dv[i])
        each_part(self.gases.parts, self._volume, ())
        ti.loop_config(serialize=True)
        for _ in range(1):
            c = 0
            for g in range(self.gases.count):
                volume = ti.cast(0.0, self.wide)
                while c < self.gases.parts and self.gases.part[c].gas == g:
                    volume += self.part[c]
                    c += 1
                own = self.bodies.first_part(self.bodies.of(self.gases.law[g].home))
                solver.part[own].potential += self._stored(g, volume)

    @ti.func
    def _volume(self, c):
        """Volume of part c, in double precision: what a step changes of a volume may be little."""
        part = self.gases.part[c]
        x = ti.cast(self.here[self.gases.law[part.gas].home].x, self.wide)
        total = ti.cast(0.0, self.wide)
        for k in range(part.first, part.last):
            t = self.gases.triangle[k]
            one = ti.cast(self.here[t.a].x, self.wide) - x
            two, three = ti.cast(self.here[t.b].x, self.wide) - x, ti.cast(self.here[t.c].x, self.wide) - x
            total += one.dot(two.cross(three))
        self.part[c] = total / 6.0

    @ti.func
    def _stored(self, g, volume):
        """U of gas g [J], without a constant; below the least volume the force stays as it is there."""
        law = self.gases.law[g]
        inside, outside = ti.cast(law.inside, self.wide), ti.cast(law.outside, self.wide)
        least = ti.cast(law.least, self.wide)
        full = ti.max(volume, least)
        return -inside * ti.log(full / least) + outside * full + (inside / least - outside) * (full - volume)
