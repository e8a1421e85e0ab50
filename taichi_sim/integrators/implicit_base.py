"""Base of the implicit methods."""

from collections.abc import Callable, Sequence
from numbers import Real
from typing import Any

import numpy as np

from taichi_sim.common.errors import SceneError
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import NUMPY_TYPES, Fields
from taichi_sim.device.parts import PRIME, STEP, Part
from taichi_sim.forces.gases import Gases
from taichi_sim.integrators.base import Integrator, SolverStatistics
from taichi_sim.integrators.host_launch import Launched
from taichi_sim.integrators.newton_cg import StageSolver
from taichi_sim.scene.scene import Scene

__all__ = ["FRESH", "KNOWN", "STRUCK", "Implicit"]

# what is known of the forces at the start of a step: nothing; what the last stage came to; that, but for bodies that bounced
FRESH, KNOWN, STRUCK = 1, 0, 2
LARGEST_TOLERANCE = 0.05  # a stage that leaves ten times as much is missed: at 0.1 that would be all there is


@ti.data_oriented
class Implicit(Integrator):
    """A method of stages, each solved implicitly; springs, elements and their damping are stable at any step.

    A method gives `begin(stage, h, time)`, which sets solver.base and solver.q, `end(stage, h)`, and `finishing`, parts that
    move. `part`: the length of a stage in steps. `takes_springs`, `takes_gas`: springs, and gas, are solved for. `opening`: how
    many of the `stages` run only in a step after `prime`. `ends`: when each stage ends, in steps since the step before.
    `past_parts`: s w, see forces.corners.Corners, over the way to where each stage begins. `carries`: weight of what the
    stage before gave in the places where a stage ends; that of its own is 1. tolerance: of each solution, see StageSolver.
    """

    each_once = True
    hosted = True
    stages = 1
    opening = 0
    part = 1.0
    ends: tuple[float, ...] = (1.0,)
    carries: tuple[float, ...] = (0.0,)
    past_parts: tuple[float, ...] = (0.0,)
    takes_springs = True
    takes_gas = False
    tolerance = 1e-3
    begin: Callable[..., None]
    end: Callable[..., None]
    finishing: Callable[..., list[Part]]

    def __init__(self, tolerance: float | None = None) -> None:
        if tolerance is None:
            return
        if not isinstance(tolerance, (Real, np.number)) or not 0.0 < float(tolerance) <= LARGEST_TOLERANCE:
            says = f"above 0 and at most {LARGEST_TOLERANCE}, or stages that were not solved could not be told"
            raise SceneError("tolerance", tolerance, says)
        self.tolerance = float(tolerance)

    def refines(self, scene: Scene) -> bool:
        """True."""
        return True

    def allocate(self, fields: Fields) -> None:
        """The solver and its fields."""
        self.fresh = fields.integers(1)
        springs = self.forces.springs if self.takes_springs else None
        elements = [one for one in self.forces.elements if one.implicit]
        self.solves = springs is not None or bool(elements)
        gas = self.forces.of_kind(Gases) if self.takes_gas and self.solves else None
        self.forces.take([gas, *elements])
        self.solver = StageSolver(self.model, springs, gas, elements, fields, self)
        self.launched = Launched(self.solver)

    def solver_report(self) -> SolverStatistics | None:
        """Statistics from the numbers that the solver keeps; None without springs and elements: nothing to solve."""
        if not self.solves:
            return None
        n = self.solver.tally[0]
        return SolverStatistics(self.tolerance, int(n.solved), int(n.passes), float(n.worst), int(n.misses))

    def counters(self) -> list[Any]:
        """The numbers that the solver keeps."""
        return [self.solver.tally] if self.solves else []

    def remembers(self) -> bool:
        """True after the first step."""
        return bool(self.fresh[0] != FRESH)

    def parts(self) -> list[Part]:
        """All stages, then contacts and the move, for one thread; see `advance`."""
        self.last_parts = tuple(self.finishing())
        staged = [Part(self, "_forget", PRIME), Part(self, "_solve_stages", STEP)] if self.stages else []
        return [*staged, *self.last_parts]

    @property
    def launched_parts(self) -> Sequence[Part]:
        """The parts after the stages."""
        return (Part(self, "_forget", PRIME), *self.last_parts)

    @ti.func
    def _forget(self, role: ti.template(), h, time):  # what the step before left is void
        self.fresh[0] = FRESH
        if ti.static(self.solves):
            for i in range(self.model.n * self.stages):
                self.solver.last[i] = ti.Vector.zero(float, self.model.dim)
                if ti.static(self.solver.rubs):
                    self.solver.held.last_most[i] = 0.0
            if ti.static(self.solver.swings):
                for i in range(self.model.n):
                    self.model.swing[i] = ti.Matrix.zero(float, self.model.dim, self.model.dim)

    @ti.func
    def _solve_stages(self, role: ti.template(), h, time):
        for stage in range(ti.select(self.fresh[0] == KNOWN, self.opening, 0), self.stages):
            self.begin(stage, h, time)
            if ti.static(self.solves):
                self.solver.solve(ti.select(self.fresh[0] == STRUCK and stage == 0, h, self.part * h), stage)
            else:
                self._free()
            self.end(stage, h)
        self.fresh[0] = KNOWN

    def advance(self, number: int, h: float, time: float) -> None:
        """Advance by substep `number` of those of h seconds from `time` on, from the host, with loops that run in parallel."""
        real: Any = NUMPY_TYPES[self.ball.v.dtype]
        length = float(real(self.part) * real(h))  # of a stage, rounded as in kernels
        before = int(self.fresh[0])
        for stage in range(self.opening if before == KNOWN else 0, self.stages):
            self._begin(stage, number, h, time)
            if self.solves:
                self.launched.solve(h if before == STRUCK and stage == 0 else length, stage)
            else:
                self._launch_free()
            self._end(stage, h)
        self.launches.run(STEP, number, h, time)

    @ti.func
    def begin_at(self, i, shift):
        """Begin the stage of ball i `shift` [m] from its place, and keep what rounding takes from that."""
        x = self.ball[i].x
        begun = x + shift
        low = shift - (begun - x)
        if ti.static(self.state.compensated):
            low += self.state.low[i].x
        self.solver.base[i].x = begun
        self.solver.low[i] = low

    @ti.func
    def _free(self):
        """Solve the stage where nothing is implicit."""
        for i in range(self.model.n):
            self.solver.first[i] = self.solver.base[i].v
            self.solver.base[i].v = self.solver.q[i]

    @ti.kernel
    def _launch_free(self):
        self._free()

    @ti.kernel
    def _begin(self, stage: int, number: int, h: float, time: float):
        self.begin(stage, h, time + number * h)

    @ti.kernel
    def _end(self, stage: int, h: float):
        self.end(stage, h)
        self.fresh[0] = KNOWN
