"""Bodies: balls that springs, elements or a gas join. In an implicit stage each is a problem of its own, with its own sums and
decisions, so that no result depends on a body that it does not touch."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.geometry.graph import components
from taichi_sim.kernels import reductions
from taichi_sim.scene.scene import Scene

__all__ = ["Bodies", "FreeBodies", "bodies_of"]

FEW_BODIES = 1024  # that one thread of a CPU decides for sooner than several wake up


def _gas_surfaces(scene: Scene) -> NDArray[np.int64]:
    """Pairs of balls (k, 2) that the gases of a scene join."""
    pairs = [np.stack([np.full(g.triangles.size, g.triangles[0, 0]), g.triangles.ravel()], axis=1) for g in scene.gases]
    return np.concatenate([np.zeros((0, 2), dtype=np.int64), *pairs])


def bodies_of(scene: Scene, ties: NDArray) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Body (n,) of each ball, in the order of their lowest balls; which bodies (b,) nothing holds; which are joined.

    ties: (k, 2) balls that elements join, see forces.corners.Corners.
    Pinned balls join nothing. Each is listed with a body that it holds. Balls that nothing joins are one body together: the
    solution for each of them is exact.
    """
    n, pinned, surfaces = scene.n_balls, scene.pinned, _gas_surfaces(scene)
    pairs = np.concatenate([scene.pairs, ties])
    label = components(n, np.concatenate([pairs[~pinned[pairs].any(axis=1)], surfaces]))
    joined, in_gas = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    joined[pairs], joined[surfaces], in_gas[surfaces] = True, True, True
    loose = np.flatnonzero(~joined & ~pinned)
    label[loose] = loose.min(initial=n)
    ends = np.concatenate([pairs, pairs[:, ::-1]])
    ends = ends[pinned[ends[:, 0]] & ~pinned[ends[:, 1]]]
    holds = np.full(n, n)
    np.minimum.at(holds, ends[:, 0], label[ends[:, 1]])
    outside = pinned & ~in_gas
    lowest = label[~pinned].min(initial=n)
    label[outside] = np.where(holds < n, holds, lowest if lowest < n else 0)[outside]
    body = np.unique(label, return_inverse=True)[1].reshape(n)
    free = np.ones(body.max() + 1, dtype=bool)
    free[body[np.concatenate([ends[:, 1], loose, np.flatnonzero(pinned & in_gas)])]] = False
    free[np.bincount(body, ~pinned, len(free)) == 0] = False
    return body, free, np.bincount(body, joined & ~pinned, len(free)) > 0


@ti.data_oriented
class Bodies:
    """The balls of a scene by bodies, for sums over each in parts of a fixed size, with the same bits for any number of threads.

    A column of sums, see `columns`, has a row for each part, and on a device behind them one for each group of parts.
    """

    def __init__(self, model: Model, ties: NDArray, fields: Fields) -> None:
        self.fields = fields
        body, self.free, self.joined = bodies_of(model.scene, ties)
        balls = np.bincount(body)
        self.count, self.several = len(balls), len(balls) > 1
        device, size = reductions.on_device(), reductions.part_size()
        self.few = self.count < (2 if device else FEW_BODIES)
        parts = -(-balls // size)  # of each body
        self.parts = int(parts.sum())
        first_part = np.cumsum(parts) - parts
        owner = np.repeat(np.arange(self.count), parts)
        number = np.arange(self.parts) - first_part[owner]  # of a part in its body
        # on a CPU the balls of a part lie one behind the other; on a device those that neighbouring threads read at once
        step, stride = (np.ones(1, dtype=int), parts[owner]) if device else (np.full(1, size), np.ones_like(owner))
        first = number * step
        within = -(-(balls[owner] - number) // stride) if device else np.minimum(size, balls[owner] - first)
        table = {"body": owner, "first": (np.cumsum(balls) - balls)[owner] + first, "count": within, "stride": stride}
        self.part = fields.table(dict.fromkeys(table, ti.i32), self.parts, table)
        self.body = body
        if self.several:
            self.order, self.body_of = fields.integers(np.argsort(body, kind="stable")), fields.integers(body)
        self._group(fields, parts, first_part, size, device)
        chunk = (
            np.arange(self.parts) if device else table["first"] // size
        )  # several small bodies are one thread's work
        begin = np.flatnonzero(np.diff(chunk, prepend=-1))
        self.chunks = len(begin)
        self.chunk = fields.integers(np.append(begin, self.parts))

    def _group(self, fields: Fields, parts: NDArray, first_part: NDArray, size: int, device: bool) -> None:
        """Rows of a column that are summed for each body: of its parts, or on a device of groups of these."""
        self.groups, rows, first_row = 0, parts, first_part
        if device:
            rows = -(-parts // size)
            self.groups = int(rows.sum())
            first_row = self.parts + np.cumsum(rows) - rows
            owner = np.repeat(np.arange(self.count), rows)
            begin = first_part[owner] + (self.parts + np.arange(self.groups) - first_row[owner]) * size
            end = np.minimum(begin + size, (first_part + parts)[owner])
            group = {"begin": begin, "end": end}
            self.group = fields.table(dict.fromkeys(group, ti.i32), self.groups, group)
        span = {"begin": first_row, "end": first_row + rows, "part": first_part}
        self.span = fields.table(dict.fromkeys(span, ti.i32), self.count, span)

    def columns(self, types: dict[str, Any]) -> Any:
        """A table with a row for each part and each group."""
        return self.fields.table(types, self.parts + self.groups)

    @ti.func
    def each_part(self, visit: ti.template(), arguments: ti.template()):
        """visit(part, *arguments) for each part, on any thread."""
        grain = ti.static(1 if reductions.on_device() else reductions.GRAIN)
        for k in range(self.chunks * grain):
            if k % grain == 0:
                for c in range(self.chunk[k // grain], self.chunk[k // grain + 1]):
                    visit(c, *arguments)

    @ti.func
    def ball(self, c, k):
        """Ball k of part c."""
        i = self.part[c].first + k * self.part[c].stride
        if ti.static(self.several):
            i = self.order[i]
        return i

    @ti.func
    def of(self, i):
        """The body of ball i."""
        b = 0
        if ti.static(self.several):
            b = self.body_of[i]
        return b

    @ti.func
    def first_part(self, b):
        """The first part of body b."""
        return self.span[b].part

    @ti.func
    def join(self, columns: ti.template()):
        """Add up the rows of parts in groups of neighbours, on a device, where a body may have many parts: `total` then reads one
        row for each group. columns: fields of `columns`, whose rows of all parts are filled."""
        if ti.static(self.groups > 0):
            for g in range(self.groups):
                for column in ti.static(columns):
                    whole = column[self.group[g].begin]
                    for c in range(self.group[g].begin + 1, self.group[g].end):
                        whole += column[c]
                    column[self.parts + g] = whole

    @ti.func
    def total(self, column: ti.template(), b):
        """The sum of a joined column for body b."""
        whole = column[self.span[b].begin]
        for c in range(self.span[b].begin + 1, self.span[b].end):
            whole += column[c]
        return whole


@ti.data_oriented
class FreeBodies:
    """Shifts the velocities of each free body together, so that its momentum is what it should be: conjugate gradients find
    this, the softest of all modes, last, and until then take it for a load that deforms and turns the body."""

    def __init__(self, model: Model, bodies: Bodies, fields: Fields) -> None:
        self.bodies, self.dim, self.n = bodies, model.dim, model.n
        self.some, self.wide = bool(bodies.free.any()), fields.wide
        self.inverse_mass = model.inverse_mass
        mass = np.bincount(bodies.body, np.where(model.scene.pinned, 0.0, model.scene.mass), bodies.count)
        self.mass = fields.reals(np.where(bodies.free, mass, 0.0))  # 0 of those that something holds
        self.part = bodies.columns({"momentum": ti.types.vector(self.dim, self.wide)})
        self.shift, self.change = (fields.vectors(bodies.count, self.dim) for _ in range(2))

    @ti.func
    def _collect(self, table: ti.template(), target: ti.template(), part):
        """shift = the momentum that each body has by the velocities `target` (n), less `part` of what table.v gives it, over its
        mass. A sum of its springs' impulses would be off by the rounding of large numbers."""
        self.bodies.each_part(self._collect_part, (table, target, part))
        self.bodies.join((self.part.momentum,))
        ti.loop_config(serialize=ti.static(self.bodies.few))
        for b in range(self.bodies.count):
            if self.mass[b] > 0.0:
                self.shift[b] = ti.cast(self.bodies.total(self.part.momentum, b), float) / self.mass[b]

    @ti.func
    def _collect_part(self, c, table: ti.template(), target: ti.template(), part):
        total = ti.Vector.zero(self.wide, self.dim)
        if self.mass[self.bodies.part[c].body] > 0.0:
            for k in range(self.bodies.part[c].count):
                i = self.bodies.ball(c, k)
                w = ti.cast(self.inverse_mass[i], self.wide)
                if w > 0.0:
                    total += (ti.cast(target[i], self.wide) - part * ti.cast(table[i].v, self.wide)) / w
        self.part[c].momentum = total

    @ti.func
    def share(self, table: ti.template(), target: ti.template(), held: ti.template()):
        """Velocities table.v of each body += what gives it the momentum that the velocities `target` (n) [m/s] have: they know
        nothing of its springs, which give it none. held: None, or HeldBalls, where surfaces allow only a part of that."""
        if ti.static(self.some):
            self._collect(table, target, 1.0)
            if ti.static(bool(held)):
                held.restrict(self)
            for i in range(self.n):
                if self.inverse_mass[i] > 0.0:
                    table[i].v = table[i].v + self.shift[self.bodies.of(i)]

    @ti.func
    def find_lack(self, table: ti.template(), target: ti.template()):
        """shift = the mean velocity that each free body lacks with the velocities table.v, of `target` (n) [m/s]."""
        if ti.static(self.some):
            self._collect(table, target, 1.0)

    @ti.func
    def add_change(self, dv: ti.template(), table: ti.template(), target: ti.template()):
        """dv (n) [m/s] += the change of the velocity of each body's centre of mass from table.v to `target`, which becomes
        `change`. 0 where a pin holds it: what acts on all of a free body alike deforms nothing."""
        if ti.static(self.some):
            self._collect(table, target, 1.0)
            ti.loop_config(serialize=ti.static(self.bodies.few))
            for b in range(self.bodies.count):
                self.change[b] = self.shift[b]
            for i in range(self.n):
                if self.inverse_mass[i] > 0.0:
                    dv[i] = dv[i] + self.change[self.bodies.of(i)]

    @ti.func
    def find_means(self, table: ti.template(), target: ti.template()):
        """The velocity of each body's centre of mass by `target`, for `shift`; until the next `share`. 0 where a pin holds it."""
        if ti.static(self.some):
            self._collect(table, target, 0.0)
