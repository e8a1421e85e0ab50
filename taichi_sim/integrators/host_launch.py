"""The order in which an implicit stage is solved, and the stage solver from the host, so that its loops run in parallel."""

from functools import partial
from typing import Any

from taichi_sim.device.engine import ti
from taichi_sim.integrators.newton_decisions import compare_potentials, solve_stage
from taichi_sim.integrators.newton_numbers import (
    CODES,
    DOUBTFUL,
    HEAVY_ITERATIONS,
    READY,
    SEARCHING,
    SOLVED,
    TRIED,
    WITHDRAWN,
)
from taichi_sim.kernels import reductions

__all__ = ["Launched"]

FIRST_SEARCHES = 4  # launched before it is known how many are needed
SPARE_PART = 4  # a part of those that were needed before is launched beyond them
MORE_PART = 2  # a part of those that have been made follows where they were too few


@ti.data_oriented
class Launched:
    """A StageSolver, each part of it a kernel of its own.

    On a device every question costs a wait until all that was launched is done. There, launches run ahead: as many iterations of
    conjugate gradients as the same iteration of Newton's method took in the step before, and some more, and the look at what they
    found; what turns out to be too much does nothing. One question follows, the only one unless something is out of the ordinary.
    A body that is done with its search goes on with the next one while others still search.
    """

    _solve, compare = solve_stage, compare_potentials

    def __init__(self, solver: Any) -> None:
        self.solver, self.holds, self.deflates = solver, solver.holds, solver.deflates
        self.searches: dict[tuple[int, int], int] = {}  # by stage and iteration: how many it took last
        self.doubtful_stages: set[int] = set()  # whose guess was in doubt before
        for launch, names in (
            (self._run, ("deflate", "start_search", "search", "evaluate", "judge_potentials", "release")),
            (self._run_stage, ("end",)),
            (self._run_step, ("move", "linearise")),
            (self._ask, ("foremost", "any_heavy", "report")),
        ):
            for name in names:
                setattr(self, name, partial(launch, name))

    def solve(self, s: float, stage: int) -> None:
        """A stage of s seconds."""
        if reductions.on_device():
            self._run_ahead(s, stage)
        else:
            self._solve(s, stage)

    def _run_ahead(self, s: float, stage: int) -> None:
        launched: Any = self  # whose kernels have names
        launched.begin(s, stage)
        launched.move(s)
        launched.linearise(s)
        iteration, starts, taken, phase = 0, 0, 0, DOUBTFUL if stage in self.doubtful_stages else READY
        while phase != SOLVED:
            if phase == DOUBTFUL:
                self.doubtful_stages.add(stage)
                launched.compare(s)
            if phase in (DOUBTFUL, WITHDRAWN):
                launched.move(s)
                launched.linearise(s)
            if phase == TRIED:
                launched.compare(s)
            elif phase == SEARCHING:
                self._search(stage, iteration, taken, starts)
            else:
                self._search(stage, iteration, 0, starts)
                starts += 1
            launched.move(s)
            launched.evaluate()
            if self.holds:
                launched.release()
            taken, phase = divmod(launched.report(), CODES)
            if phase in (READY, SOLVED):
                self.searches[stage, iteration] = taken
                iteration += 1
        launched.end(stage)

    def _search(self, stage: int, iteration: int, taken: int, starts: int) -> None:
        """Launch as many iterations of conjugate gradients as may be needed; `taken` have been made.
        starts: so many were started before."""
        launched: Any = self
        known = self.searches.get((stage, iteration))
        batch = FIRST_SEARCHES if known is None else known + max(1, known // SPARE_PART)
        if taken:
            batch = max(FIRST_SEARCHES, taken // MORE_PART)
        else:
            if self.deflates and starts >= HEAVY_ITERATIONS:  # until then no body has made so many
                launched.deflate()
            launched.start_search()
        for _ in range(batch):
            launched.search()

    @ti.kernel
    def _run(self, name: ti.template()):
        ti.static(getattr(self.solver, name))()

    @ti.kernel
    def begin(self, s: float, stage: int):
        self.solver.begin(s, stage)

    @ti.kernel
    def _run_stage(self, name: ti.template(), stage: int):
        ti.static(getattr(self.solver, name))(stage)

    @ti.kernel
    def _run_step(self, name: ti.template(), s: float):
        ti.static(getattr(self.solver, name))(s)

    @ti.kernel
    def weigh(self, s: float, taken: float):
        self.solver.weigh(s, taken)

    @ti.kernel
    def _ask(self, name: ti.template()) -> int:
        return ti.static(getattr(self.solver, name))()
