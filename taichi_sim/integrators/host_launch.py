"""Launched: the implicit stage solver from the host, so that its loops run in parallel."""

from taichi_sim.device.engine import ti
from taichi_sim.integrators.newton_cg import StageSolver
from taichi_sim.integrators.newton_control import control

__all__ = ["Launched"]


@ti.data_oriented
class Launched:
    """A StageSolver, each part of it a kernel of its own."""

    solve = control

    def __init__(self, solver: StageSolver) -> None:
        self.solver = solver

    @ti.kernel
    def begin(self, stage: int):
        """See StageSolver."""
        self.solver.begin(stage)

    @ti.kernel
    def linearise(self, s: float, step: float):
        """See StageSolver."""
        self.solver.linearise(s, step)

    @ti.kernel
    def doubtful(self) -> int:
        """See StageSolver."""
        return self.solver.doubtful()

    @ti.kernel
    def compare(self, s: float, part: float):
        """See StageSolver."""
        self.solver.compare(s, part)

    @ti.kernel
    def raised(self) -> int:
        """See StageSolver."""
        return self.solver.raised()

    @ti.kernel
    def set_target(self):
        """See StageSolver."""
        self.solver.set_target()

    @ti.kernel
    def evaluate(self, s: float, step: float):
        """See StageSolver."""
        self.solver.evaluate(s, step)

    @ti.kernel
    def unsolved(self) -> int:
        """See StageSolver."""
        return self.solver.unsolved()

    @ti.kernel
    def aim(self):
        """See StageSolver."""
        self.solver.aim()

    @ti.kernel
    def searching(self) -> int:
        """See StageSolver."""
        return self.solver.searching()

    @ti.kernel
    def turn(self):
        """See StageSolver."""
        self.solver.turn()

    @ti.kernel
    def larger(self) -> int:
        """See StageSolver."""
        return self.solver.larger()

    @ti.kernel
    def end(self, stage: int):
        """See StageSolver."""
        self.solver.end(stage)
