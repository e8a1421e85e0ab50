"""The order in which an implicit stage is solved, and the stage solver from the host, so that its loops run in parallel."""

from functools import partial

from taichi_sim.device.engine import ti
from taichi_sim.integrators.newton_decisions import solve_stage

__all__ = ["Launched"]


@ti.data_oriented
class Launched:
    """A StageSolver, each part of it a kernel of its own."""

    solve = solve_stage

    def __init__(self, solver: object) -> None:
        self.solver = solver
        for launch, names in (
            (self._run, ("set_target", "start_search", "search")),
            (self._run_stage, ("begin", "end")),
            (self._run_step, ("linearise", "evaluate", "compare")),
            (self._ask, ("doubtful", "raised", "unsolved", "searching", "larger")),
        ):
            for name in names:
                setattr(self, name, partial(launch, name))

    @ti.kernel
    def _run(self, name: ti.template()):
        ti.static(getattr(self.solver, name))()

    @ti.kernel
    def _run_stage(self, name: ti.template(), stage: int):
        ti.static(getattr(self.solver, name))(stage)

    @ti.kernel
    def _run_step(self, name: ti.template(), s: float, part: float):
        ti.static(getattr(self.solver, name))(s, part)

    @ti.kernel
    def _ask(self, name: ti.template()) -> int:
        return ti.static(getattr(self.solver, name))()
