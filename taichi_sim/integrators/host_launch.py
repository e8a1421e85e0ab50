"""The order in which an implicit stage is solved, and the stage solver from the host, so that its loops run in parallel."""

from functools import partial
from typing import Any

from taichi_sim.device.engine import ti
from taichi_sim.integrators.newton_decisions import (
    CODES,
    JUDGE_CHANGE,
    JUDGE_GUESS,
    NEXT_ITERATION,
    SEARCH_ON,
    solve_stage,
)

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
    """

    _solve = solve_stage

    def __init__(self, solver: Any) -> None:
        self.solver = solver
        self.searches: dict[tuple[int, int], int] = {}  # by stage and iteration: how many it took last
        self.doubtful_stages: set[int] = set()  # whose guess was in doubt before
        for launch, names in (
            (self._run, ("set_target", "start_search", "search", "open_stage")),
            (self._run_stage, ("begin", "end")),
            (self._run_step, ("linearise", "evaluate", "compare", "take_back", "judge_guess")),
            (self._ask, ("doubtful", "raised", "unsolved", "searching", "larger", "report")),
        ):
            for name in names:
                setattr(self, name, partial(launch, name))

    def solve(self, s: float, stage: int) -> None:
        """A stage of s seconds."""
        if self.solver.gated:
            self._run_ahead(s, stage)
        else:
            self._solve(s, stage)

    def _run_ahead(self, s: float, stage: int) -> None:
        launched: Any = self  # whose kernels have names
        launched.begin(stage)
        launched.linearise(s, 1.0)
        launched.open_stage()
        if stage in self.doubtful_stages:
            launched.judge_guess(s, -1.0)
        iteration, follows = 0, NEXT_ITERATION
        while follows == NEXT_ITERATION:
            launched.start_search()
            follows = self._search(s, stage, iteration)
            if follows == JUDGE_GUESS:
                self.doubtful_stages.add(stage)
                launched.judge_guess(s, -1.0)
                follows = NEXT_ITERATION
                continue
            part = 1.0
            while follows == JUDGE_CHANGE:  # it goes on only where the potential was raised
                launched.compare(s, part)
                part = 0.5 * part
                launched.take_back(s, -part)
                follows = launched.report() % CODES
            iteration += 1
        launched.end(stage)

    def _search(self, s: float, stage: int, iteration: int) -> int:
        """Find the change of an iteration and look at it; what has to follow."""
        launched: Any = self
        known = self.searches.get((stage, iteration))
        batch = FIRST_SEARCHES if known is None else known + max(1, known // SPARE_PART)
        follows = SEARCH_ON
        while follows == SEARCH_ON:
            for _ in range(batch):
                launched.search()
            launched.evaluate(s, 1.0)
            taken, follows = divmod(launched.report(), CODES)
            batch = max(FIRST_SEARCHES, taken // MORE_PART)
            if follows != JUDGE_GUESS:
                self.searches[stage, iteration] = taken
        return follows

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
