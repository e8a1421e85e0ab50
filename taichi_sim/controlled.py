"""Controlled: steps whose number of substeps is chosen by their error.

Each step is made twice: with n substeps by a companion solution, and with 2 n by the one that is kept. Both go on by themselves
for a window of steps, so that what one step adds to the error, and what the motion makes of it later, is seen as the user will
see it: in positions. Their largest distance over 2^p - 1, p the order of the method, is the error of the better one (Richardson).
At the end of a window the companion is set to the solution that is kept, and the substeps for the next one are chosen.

Asked: at most tolerance x size of the scene for each simulated second, of any ball; size: the longest side of the box around all
balls. A window that has more than its share ends at once. A step that adds much ends it too, and if it does so by itself, it is
repeated with twice as many substeps. Where that gains less than half of the powers of two that the order promises, twice in a
row (four times where there are no contacts, and fast motion may only not be resolved yet), the motion is not smooth there (an
impact, a contact that closes) and no shorter step helps: the step is accepted, counted as rough, and the window ends.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.assembly import Assembly
from taichi_sim.companion import AHEAD, COARSE, FINE, LIVE, Companion
from taichi_sim.scene import Scene
from taichi_sim.settings import Settings
from taichi_sim.stability import Stability, coarsest_spring
from taichi_sim.stepper import Stepper
from taichi_sim.watch import size

__all__ = ["Controlled", "StepError", "check_digits", "size"]

WINDOW = 64  # steps between two meetings
HEAD = 16  # steps' worth of error that the first of a window may use up
JUMP = 4  # steps' worth that one step may add by itself
AIM = 0.6  # of the tolerance
DOUBLINGS = 12  # of the substeps, from what stability asks
IMPACT_DOUBLINGS = 6  # the same where there are contacts
ROUNDINGS = 4.0  # units of rounding that a window, or a substep, may add by itself


KEPT = ("coarse", "error", "past", "rough", "age", "taken", "rough_steps", "repeated", "seen", "least", "most")


class StepError(NamedTuple):
    """What error control found. `tolerance`: asked, parts of `size` [m] a simulated second; `estimate`: error so far,
    in parts of `size`, the sum over all windows, rough steps among them; `rough`: what these added at most, `rough_steps`: their
    number; `least`, `most`: substeps of a step; `repeated`: tries that were thrown away."""

    tolerance: float
    size: float
    estimate: float
    rough: float
    rough_steps: int
    least: int
    most: int
    repeated: int


def check_digits(scene: Scene, tolerance: float, precision: str, dt: float, substeps: int, compensated: bool) -> None:
    """Raise ValueError where rounding alone adds more than the tolerance: a window about the rounding of positions, and, where
    sums are not compensated, each substep as much, in random directions; and where springs are so stiff that their load does not
    show in single precision, so that both solutions are off alike and their distance tells nothing."""
    eps = float(np.finfo(np.float32 if precision == "f32" else np.float64).eps)
    far = float(np.max(np.abs(scene.position), initial=0.0))
    least = ROUNDINGS * eps * far * np.sqrt(1 if compensated else WINDOW * substeps) / (WINDOW * dt * size(scene))
    if tolerance < least:
        cure = 'use precision "f64"' if precision == "f32" else "build the scene nearer to the origin"
        raise ValueError(
            f"tolerance: {tolerance:g} is less than what rounding leaves in {precision}, {least:.2g} of the scene's size a"
            f" second; {cure}"
        )
    found = coarsest_spring(scene) if precision == "f32" else None
    if found is not None:
        spring, stretch, rounding = found
        raise ValueError(
            f"tolerance: cannot be met in f32: the weight at spring {spring} stretches it by {stretch:.2g} m, and positions there"
            f' are told {rounding:.2g} m apart; use precision "f64", or softer springs'
        )


class Controlled(Stepper):
    """See above. `substeps`: of the solution that is kept, twice those of the companion."""

    def __init__(
        self, scene: Scene, settings: Settings, parts: Assembly, dt: float, substeps: int, safe: Stability, own: bool
    ) -> None:
        super().__init__(scene, settings, parts, dt, substeps, safe, own)
        assert settings.tolerance is not None
        self.may_shorten = False  # it does so all the time
        self.size = size(scene)
        self.share = settings.tolerance * self.size * dt  # m, of one step
        self.floor = substeps // 2  # of the companion: stability, and what piles need
        self.coarse = self.floor
        self.ceiling = self.floor << (IMPACT_DOUBLINGS if parts.contacts.active else DOUBLINGS)
        self.order = max(1, settings.integrator.order)
        if (
            settings.integrator.implicit_damping
            and np.bincount(scene.pairs[scene.damping > 0].ravel()).max(initial=0) > 1
        ):
            self.order = 1  # of the damping halves in a network
        self.error = self.past = self.rough = 0.0  # m: of this window so far, of those before, of rough steps
        self.age = self.taken = 0  # steps of this window, and of all
        self.rough_steps = self.repeated = 0
        self.least, self.most = substeps, substeps
        self.seen = 0  # rough steps before this window
        self.remembers = False

    def report(self) -> StepError:
        """What was asked and what was found."""
        unit = self.size
        return StepError(
            self.share / (unit * self.dt),
            unit,
            (self.past + self.error) / unit,
            self.rough / unit,
            self.rough_steps,
            self.least,
            self.most,
            self.repeated,
        )

    # One step --------------------------------------------------------------------------------------------------------

    def prime(self) -> None:
        """Where positions were set from outside, the companion starts there too."""
        if not self.primed:
            super().prime()
            self.remembers = False
            self._companion.copy(FINE, LIVE)
            self._meet()

    def advance(self, steps: int) -> None:
        """Each step by itself."""
        for _ in range(steps):
            self._one()

    def _one(self) -> None:
        """One step, with substeps doubled where it adds too much at once, until they do not help."""
        start, before, poor = self.coarse, np.inf, 0
        patience = 2 if self.parts.contacts.active else 4
        while True:
            look, error = self._try()
            if (
                self._sudden(error) and self.age
            ):  # what the window brought along may grow by itself: look at this step alone
                self._meet()
                look, error = self._try()
            if not self._sudden(error):
                self._take(error, look)
                return
            poor = poor + 1 if error > before * 2.0 ** (-0.5 * self.order) else 0
            if not np.isfinite(error) and self.coarse >= self.ceiling:
                self._fail(0 if look.bad is None else look.bad)
            if np.isfinite(error) and (poor == patience or self.coarse >= self.ceiling):
                break
            before = error
            self.repeated += 1
            self.coarse *= 2
        self.rough += max(0.0, error - self.error)
        self.rough_steps += 1
        self.coarse = start if poor else self.coarse
        self._take(error, look)

    def _allowed(self) -> float:
        """The error [m] that this window may have after this step: at first some more than its share."""
        left = self.share * (self.taken + HEAD) - self.past
        own = self.share * (self.age + 1)
        return max(own, min(self.share * HEAD, left))

    def _sudden(self, error: float) -> bool:
        """Whether a step makes the window's error too large, and added much to it by itself."""
        return not (error <= self._allowed() or error <= self.error + JUMP * self.share)

    def _try(self) -> tuple[Any, float]:
        """The companion goes one step ahead, then the solution; a look at it, and its error [m]."""
        self._from(COARSE, self.coarse)
        self._companion.copy(AHEAD, LIVE)
        self._from(FINE, 2 * self.coarse)
        return self.parts.gauge.look(), self._companion.apart() / (2.0**self.order - 1.0)

    @property
    def _companion(self) -> Companion:
        assert self.parts.companion is not None
        return self.parts.companion

    def _from(self, moment: int, substeps: int) -> None:
        """A step from a stored moment, with so many substeps; anew where contacts did not fit."""
        needed: Any = True
        while needed is not None:
            self._companion.copy(LIVE, moment)
            self._divide(substeps)
            if self.remembers:
                self._companion.remember(moment)  # lists may have grown: all but the state is new then
                self.parts.integrator.recall()
            self.parts.run(substeps, self.h, self.time)
            needed = self.parts.lacking()
            if needed is not None:
                self.parts = self.parts.with_room(needed)

    def _take(self, error: float, look: Any) -> None:
        """Accept the step."""
        self._companion.copy(FINE, LIVE)
        self._companion.copy(COARSE, AHEAD)
        self.remembers = bool(self.parts.integrator.memory())
        growth = self.watch.judge(look)
        if growth is not None:
            self._warn_of(growth, self.time + self.dt)
        self._accept(1)
        self.least, self.most = min(self.least, self.substeps), max(self.most, self.substeps)
        over = error > self._allowed()
        self.error = max(self.error, error)
        self.age += 1
        self.taken += 1
        if over or self.age == WINDOW:
            self._adapt()
            self._meet()

    def _adapt(self) -> None:
        """Substeps of the next window, by what this one came to, unless one impact made most of it."""
        if self.error > 0.0 and self.rough_steps == self.seen:
            used = (self.error / (AIM * self.share * self.age)) ** (1.0 / self.order)
            wanted = int(np.ceil(self.coarse * float(np.clip(used, 0.1, 4.0))))
            self.coarse = min(max(self.floor, wanted), self.ceiling)
        self.seen = self.rough_steps

    def _meet(self) -> None:
        """A new window: the companion is where the solution is."""
        self._companion.copy(COARSE, FINE)
        self.past += self.error
        self.error, self.age = 0.0, 0
        if self.past > self.share * max(self.taken, 1.0 / self.dt):  # of the first second, or of all of them
            self._warn(
                "tolerance",
                f"the error is {self.past / self.size:.2g} of the scene's size by t = {self.time:.6g} s, more than the"
                f" {self.share / (self.size * self.dt):g} a second that were asked: {self.rough_steps} steps were rough,"
                " and shorter ones did not help",
            )

    # To a file and back ----------------------------------------------------------------------------------------------

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray]]:
        """The window, where its companion is, and a method's own memory in both solutions."""
        self.prime()
        return {name: getattr(self, name) for name in KEPT}, self._companion.arrays(self.remembers)

    def set_state(self, state: dict[str, Any], arrays: dict[str, NDArray]) -> None:
        """The same window."""
        self.prime()
        if arrays and set(state) == set(KEPT):
            for name in KEPT:
                setattr(self, name, type(getattr(self, name))(state[name]))
            self.remembers = self._companion.write(arrays)
