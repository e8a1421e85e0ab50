"""RunChecks: looks at a run and warns, once of each kind, where it leaves what is safe. They change nothing of it."""

from collections.abc import Iterator, Mapping
from typing import Any
from weakref import proxy

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.outcome import DEEP, SHORTER, STARTS_DEEP, Scales, cure_of_depth, gained_in_steps, takers
from taichi_sim.analysis.rounding_heat import CURE, MARGIN, WHY, heat_of_rounding
from taichi_sim.analysis.spring_bounds import largest_eigenvalue
from taichi_sim.analysis.stability import explicit_parts, present_limit
from taichi_sim.analysis.strikes import unanswered
from taichi_sim.analysis.touching import overlap, overlap_at_start
from taichi_sim.common.warn import warn
from taichi_sim.kernels.contacts import statistics
from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.materials import max_restitution
from taichi_sim.scene.objects import pair_in_words
from taichi_sim.simulation.energy_monitor import LARGEST_PART, Growth, size

__all__ = ["RunChecks"]

UNSEEN = 256  # substeps between two looks at contacts
RUSH = 0.2  # of the smallest radius: moves in a substep, above which crowds lie deep in each other
RIGID = 1e3  # omega h of springs
LOOKS_PER_BOUND = 16  # from one bound for the present shape to the next, in scenes of at most
MOST_BOUNDED = 20_000  # balls and springs


class RunChecks:
    """Checks of one run, a Stepper, and its decisions.

    decisions: what was decided on the way, in words, each with its time. fastest: speed of the fastest ball [m/s] in all looks.
    drivers: parts that may add energy to the scene or take it, in words.
    """

    def __init__(self, run: Any) -> None:
        scene, parts = run.scene, run.parts
        self.run: Any = proxy(run)  # no circle: what is dropped frees its memory at once
        self.scene, self.size = scene, size(scene)
        self.decisions: list[str] = []
        self.warned: set[str] = set()
        self.fastest = 0.0
        self._looks, self._unseen = 0, 0
        moves = parts.colliders is not None and parts.colliders.moves
        self.drivers = tuple(self._drivers(moves))
        self.squeezes = parts.contacts.active and (moves or bool(scene.moving_pins))
        self._rush = RUSH * float(scene.radius.min()) if parts.plan.pairs else np.inf  # m a substep
        self._single = parts.backend.precision == "f32"
        self._solves = parts.integrator.solver_report() is not None
        # each step, see EnergyMonitor.gain_of_step: a look costs up to as much as a cheap step, so only where steps may gain;
        # without restitution by methods above order 1, which also go by forces from before what touches came to be held, and
        # where contacts of balls strain bodies after the stage
        touched = max_restitution(scene) > 0.0 or run.method.order > 1 or bool(unanswered(scene, run.method, run.h)[0])
        gains = (parts.contacts.active and touched) or self._is_rigid()
        self.watches_steps = self._solves and not self.drivers and gains
        # beyond the bound for every shape the present one decides; where nothing is safe that was said at the start
        is_bounded = scene.n_balls + scene.n_springs <= MOST_BOUNDED
        self._strays = is_bounded and self.part_of_bound > 1.0 + 1e-9

    def _drivers(self, colliders_move: bool) -> Iterator[str]:
        scene = self.scene
        if colliders_move:
            yield "moving colliders"
        if scene.moving_pins:
            yield "moving pins"
        if scene.motors:
            yield "motors"
        yield from (element.name for element in ELEMENTS if element.gives_energy and element.count(scene))
        if self.run.own:
            forces = self.run.parts.arguments[4]
            yield "forces of your own" if forces else "a method or contact rule of your own"

    def _is_rigid(self) -> bool:
        """True if springs swing so fast beside a step that its solution knows their energy to a part of the motion's alone."""
        return self.run.h * np.sqrt(largest_eigenvalue(self.scene, self.scene.stiffness)[0]) > RIGID

    @property
    def part_of_bound(self) -> float:
        """Substep in parts of the largest that is safe in every shape; 0 where none is."""
        safe = self.run.safe.dt_any_shape
        return self.run.h / safe if safe > 0 else 0.0

    def scales(self) -> Scales:
        """Scales by which the run is judged."""
        run, method = self.run, self.run.method
        touches, torn = run.parts.contacts.active, run.parts.torn
        gains, cure = self._why_energy_grows()
        return Scales(
            slow=2.0 * float(np.linalg.norm(self.scene.gravity)) * run.h,
            drivers=self.drivers,
            takers=takers(self.scene, touches, torn is not None and bool(torn.any())),
            motion=max(run.monitor.most, run.largest_motion),
            swing=1.0 - 1.0 / method.swing(min(self.part_of_bound, LARGEST_PART)),
            swing_power=method.swing_power,
            squeezes=self.squeezes,
            starts_deep=STARTS_DEEP in self.warned,
            damps="" if method.conserves else method.name,
            gains=gains,
            cure=cure,
            held=run.monitor.held,
            risen=run.monitor.risen,
            gained=run.division.gained,
            climbed=run.division.climbed,
            rounding=run.monitor.rounding,
            heat=self.heat(),
            touches=touches,
            rows=bool(self.scene.solid.any() or self.scene.collides.any()),
        )

    def heat(self) -> float:
        """The most energy [J] that rounding of places may have added to what is stiff, by an explicit method."""
        run, limit = self.run, self.run.method.limit
        if not self._single or limit is None or not limit.by_springs:
            return 0.0
        power = heat_of_rounding(self.scene, run.h, elements=not run.parts.forces.refined)
        return MARGIN * power * float(run.time - run.begin)

    def is_heat(self, growth: Growth) -> bool:
        """True if rounding of places explains a growth that nothing else does: shorter steps would hardly lessen it."""
        return growth.sure and growth.after - growth.before <= self.heat()

    # Looks -----------------------------------------------------------------------------------------------------------

    def after(self, substeps: int) -> None:
        """Check the run after so many substeps."""
        self._check_solver()
        self._check_steps()
        if self._strays and self._looks % LOOKS_PER_BOUND == 0:
            self._check_bound()
        self._looks += 1
        self._unseen += substeps
        if self._unseen >= UNSEEN:
            self.look_at_depth()

    def look_at_depth(self) -> None:
        """Warn where balls lie deep in something, if anything here may bring them there: what moves, or speed."""
        if self._unseen and (self.squeezes or self._rushes):
            self._unseen = 0
            self.contact_statistics()

    @property
    def _rushes(self) -> bool:
        """True if a ball has been so fast that contacts may not have held it."""
        return self.fastest * self.run.h > self._rush

    def contact_statistics(self) -> NDArray[np.float64]:
        """Statistics of all contacts, see kernels.contacts.statistics. Warns once, where steps have brought balls deep into
        something."""
        totals = self.run.parts.contact_statistics()
        part = float(totals[statistics.LARGEST_PART])
        if part > DEEP and (self.run.moved or self.run.time == 0.0):
            self._warn_of_depth(int(totals[statistics.BALL]), part)
        return totals

    def _warn_of_depth(self, ball: int, part: float) -> None:
        scene, position, time = self.scene, self.run.parts.state.position, self.run.time
        began = overlap_at_start(scene, position, time, ball, part)
        if began > DEEP:
            where = overlap(scene, scene.position, 0.0, ball, began)
            self.warn(STARTS_DEEP, f"at the start {where}: {STARTS_DEEP}")
        elif self.run.moved:
            where = overlap(scene, position, time, ball, part)
            cure = cure_of_depth(self.squeezes, self._rush / self.fastest if self._rushes else None)
            self.warn("depth", f"at t = {time:.6g} s {where}; {cure}")

    def _check_solver(self) -> None:
        """Warn if an implicit method has left a stage unsolved."""
        if not self._solves or "solver" in self.warned:
            return
        found = self.run.parts.integrator.solver_report()
        if found is not None and found.misses:
            single = '; single precision may be what stands in the way: try "f64"' if self._single else ""
            self.warn(
                "solver",
                f"{self.run.method} left {found.worst:.2g} of the impulses of a stage unsolved by t = {self.run.time:.6g} s,"
                f" more than ten times its tolerance of {found.tolerance:g}: take shorter steps{single}",
            )

    def _check_steps(self) -> None:
        """Warn if steps of an implicit method have gained energy."""
        known = self.run.division
        if known.gained or known.climbed:
            words = gained_in_steps(known.gained, known.climbed, *self._why_energy_grows())
            self.warn("gain", f"by t = {self.run.time:.6g} s {self.run.method} {words}")

    def _check_bound(self) -> None:
        """Warn if the shape has stiffened so that the step is not safe, where it is not safe in every shape."""
        if self.warned & {"bound", "growth"}:
            return
        limit, spring = self._present()
        if self.run.h > limit:
            self.warn(
                "bound",
                f"at t = {self.run.time:.6g} s the step of {self.run.h:.6g} s is not safe: in this shape"
                f" {self.limiting(spring, limit)}",
            )

    # Warnings: one of a kind -----------------------------------------------------------------------------------------

    def warn_of(self, growth: Growth, repeats: bool = True) -> None:
        """Warn of energy that came from nowhere, where the step was the user's choice. One that only may be wrong is judged by
        the bound, and, where balls are that fast, by a run of the chunk with half of it."""
        if "growth" in self.warned:
            return
        run = self.run
        limited = 0.0 < run.safe.dt_any_shape < np.inf
        limit, spring = self._present() if limited else (np.inf, -1)
        grew = f"energy grew {growth} by t = {run.time:.6g} s"
        if not growth.sure and run.h <= limit:
            sample = run.parts.state_probe.sample()
            if repeats and sample.speed * run.h > self.size and not run.retry.works(growth):
                self.warn(
                    "growth",
                    f"{grew}, and a ball goes further than the scene is wide in a step of {run.h:.6g} s; half of it gives another"
                    " energy: user-defined forces act explicitly; take shorter steps",
                )
            run.monitor.begin(sample)
            return
        if run.h > limit:
            too_long = f"the step of {run.h:.6g} s is too long: in this shape {self.limiting(spring, limit)}"
            self.warn("growth", f"{grew}, because {too_long}")
            return
        why, cure = (WHY, CURE) if self.is_heat(growth) else self._why_energy_grows()
        cause = f"as {why}" if why else "which nothing explains"
        more = ", or more contact_iterations" if run.parts.contacts.active and not why else ""
        self.warn("growth", f"{grew}, {cause}; {run.h:.6g} s is used: {cure}{more}")

    def look_at_energy(self, sample: Any) -> None:
        """Warn where a sample that is kept shows more energy than the start has, by a method that only loses it."""
        rise = self.run.monitor.rise(sample)
        if rise is not None:
            self.warn_of(rise)

    def _why_energy_grows(self) -> tuple[str, str]:
        """The reason why steps may give energy, empty where there is none, and the cure."""
        run = self.run
        if run.parts.contacts.active:
            why, cure = unanswered(self.scene, run.method, run.h)
            if why:
                return why, cure
        return run.method.why_energy_grows(), SHORTER

    def limiting(self, spring: int, limit: float) -> str:
        """Words on the spring that limits the step to so many seconds, or, below 0, on what else does."""
        method = self.run.method
        if spring < 0:
            parts = explicit_parts(self.scene, method, self.run.parts.forces.declared)
            return f"{method} takes {parts} explicitly, which limits it to {limit:.6g} s"
        ends = pair_in_words(self.scene.objects, *self.scene.pairs[spring].tolist())
        return f"spring {spring} ({ends}) limits {method} to {limit:.6g} s"

    def _present(self) -> tuple[float, int]:
        """Largest step that is safe in the present shape [s], and the spring that limits it."""
        run, parts = self.run, self.run.parts
        scene = self.scene.at(run.time)
        return present_limit(scene, run.method, parts.state.position, parts.forces.declared, parts.torn)

    def warn(self, kind: str, text: str) -> None:
        """Warn, if nothing of this kind was said before."""
        if kind not in self.warned:
            self.warned.add(kind)
            warn(text)

    # To a snapshot and back ------------------------------------------------------------------------------------------

    def stored(self) -> dict[str, Any]:
        """Plain values from which the checks of a run go on."""
        return {"warned": sorted(self.warned), "decisions": self.decisions, "looks": [self._looks, self._unseen]}

    def read(self, plain: Mapping[str, Any]) -> tuple[set[str], list[str], int, int]:
        """Values of what `stored` gave. Raises KeyError, TypeError or ValueError for anything else."""
        looks, unseen = (int(one) for one in plain["looks"])
        return set(map(str, plain["warned"])), list(map(str, plain["decisions"])), looks, unseen

    def put_back(self, plain: Mapping[str, Any]) -> None:
        """Go on from what `stored` gave."""
        self.warned, self.decisions, self._looks, self._unseen = self.read(plain)
