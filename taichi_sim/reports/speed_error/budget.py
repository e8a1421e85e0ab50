"""Sources of the error of a scene at its own settings: the step, the mesh, single precision."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from taichi_sim.analysis.outcome import has_mesh
from taichi_sim.analysis.richardson import error_from
from taichi_sim.common.quantities import EXACT, ROUNDED, measured
from taichi_sim.reports.speed_error.compared import Compared
from taichi_sim.reports.speed_error.plan import PARTS, Step, own_step
from taichi_sim.reports.speed_error.reference import Reference, settled_run
from taichi_sim.reports.speed_error.trial_process import Outcome
from taichi_sim.reports.speed_error.trials import Trials

ASSUMED_ORDER = 1.0  # where there is one difference only
HIDING_MESH = 10.0  # times the error of the step: that of the mesh hides it
LEAST_ORDER = 0.3  # order below which differences do not add up to an error
HIGHEST_ORDER = 3.0  # above it the finer difference is small by chance: springs and elements are of order 2


@dataclass(frozen=True)
class Budget:
    """Parts of an error, in the unit of what is compared; None: not measured, or not known. Each is that of the value, see
    `Compared.error_of_largest`.

    value: of what `name` says, nan where errors are of places alone. order: of the mesh, as observed. precision: the scene's own.
    """

    name: str
    unit: str
    value: float
    method: str
    step_length: float  # s
    step: float | None = None
    mesh: float | None = None
    order: float | None = None
    single: float | None = None
    why: str = ""  # the mesh's error is not known
    meshed: bool = True  # a body stands for one, whose mesh may be finer
    precision: str = "f32"
    missed: float = 0.0  # by which a peak between the moments compared may be larger
    settling: float | None = None  # of what `settle` leaves; None without it, infinite: not known
    given: float = 0.0  # s, the step that the scene would be run with; 0: this one

    @property
    def scale(self) -> float:
        """Size of the value, or of its largest error, which rounding is relative to."""
        if np.isnan(self.value):
            settling = self.settling if self.settling is not None and np.isfinite(self.settling) else 0.0
            return max(settling, self.mesh or 0.0, self.step or 0.0, self.single or 0.0)
        return abs(self.value)

    def lines(self) -> Iterator[str]:
        """Line of words: `12.3 +- 0.4 mm (mesh), +- 0.1 mm (step), +- 1.0 µm (single precision)`."""
        parts = {"step": self.step, "mesh": self.mesh, "single precision": self.single}
        if not self.meshed:
            del parts["mesh"]
        if self.settling is not None:
            parts["settling"] = self.settling if np.isfinite(self.settling) else None
        double = self.precision == "f64"
        if double:
            del parts["single precision"]
        known = sorted(((value, name) for name, value in parts.items() if value is not None), reverse=True)
        told = [one for one in known if one[0] > EXACT * self.scale]
        words = [f"+- {measured(value, unit=self.unit)} ({name})" for value, name in told]
        if not np.isnan(self.value):
            uncertain = told[0] if told else (None, "")
            words[:1] = [measured(self.value, uncertain[0], self.unit, uncertain[1])]
        if exact := [name for _, name in known[len(told) :]]:
            words.append(f"{' and '.join(exact)} {ROUNDED}")
        words += [f"{name} not known" for name, value in parts.items() if value is None]
        if self.missed > EXACT * self.scale:
            words.append(f"+- {measured(self.missed, unit=self.unit)} (between these times)")
        own = "the scene's own settings" + " in double precision" * double
        if self.given > self.step_length * (1.0 + 1e-6):
            own += f" (its {self.given:.4g} s, shortened so that steps end at these times)"
        yield (
            f"{self.name[:1].upper()}{self.name[1:]}, with {self.method} at {self.step_length:.3g} s, {own}:"
            f" {', '.join(words)}."
        )
        if double and self.single is not None:
            yield f"Single precision, which the scene does not use, would add +- {measured(self.single, unit=self.unit)}."
        if (
            self.mesh is not None
            and self.step is not None
            and self.mesh > HIDING_MESH * max(self.step, self.settling or 0.0)
        ):
            most, name = max((self.step, "step"), (self.settling or 0.0, "settling"))
            times = (
                f"{self.mesh / most:.2g} times that of the {name}"
                if most > EXACT * self.scale
                else "the only one beside rounding"
            )
            yield (
                f"The error of the mesh is {times}: only a finer resolution reduces it. The fastest settings below are for the"
                " motion of this mesh."
            )
        if self.why:
            yield f"The error of the mesh: {self.why}."
        elif self.order is not None:
            yield f"The error of the mesh falls with the order {self.order:.2f} of the spacing, as observed."
        elif self.mesh is None and self.meshed:
            yield "The error of the mesh was not measured; --resolutions does that for a scene file."


def made(
    trials: Trials, reference: Reference, method: str, step: Step, double: Outcome, single: Outcome | None
) -> Budget | None:
    """The error of the step, and of single precision, from runs with the scene's own settings; None without a reference."""
    parts, compared = reference.parts, trials.compared
    if not parts or not reference.motion:
        return None
    off = rounded = settling = None
    if _reached(double):
        off = compared.error_of_largest(double, reference, parts)
        if single is not None and _reached(single):
            rounded = compared.error_of_largest(single, double, parts)
    if trials.plan.rest is not None:
        settled = settled_run(trials, reference)
        settling = np.inf if settled is None else compared.error_of_largest(settled, reference, parts)
    value, name = _largest(compared, reference, settling is not None)
    meshed = trials.plan.resolutions or has_mesh(trials.scene)
    precision = trials.scene.settings.get("precision") or "f32"
    if "f32" not in trials.plan.precisions:  # nothing runs in it
        precision = "f64"
    return Budget(
        *(name, compared.unit, value, method, step.seconds, off),
        single=rounded,
        meshed=meshed,
        precision=precision,
        missed=reference.missed,
        settling=settling,
        given=own_step(trials.scene, method)[1],
    )


def _largest(compared: Compared, reference: Reference, settled: bool) -> tuple[float, str]:
    """The number that errors are of, and its name. What has settled elsewhere may move alike: errors are of where it is then."""
    parts, quantity = reference.parts, compared.quantity
    sizes = compared.sizes(reference)[:parts]
    at = int(np.argmax(sizes))
    if quantity is None:
        name = compared.sampled("rms displacement", parts)
        return (np.nan, f"places at the {name}") if reference.rests else (float(sizes[at]), name)
    if not quantity.from_start:
        return float(sizes[at]), compared.sampled(compared.name, parts)
    if not settled:  # where it is says nothing
        return float(sizes[at]), compared.sampled(f"motion of {compared.name}", parts)
    value, moved = reference.quantity[at], f"{compared.name} at its {compared.sampled('motion', parts)}"
    return (
        (float(value[0]), f"value of {moved}")
        if len(value) == 1
        else (float(np.linalg.norm(value)), f"size of {moved}")
    )


def _reached(outcome: Outcome) -> bool:
    return not outcome.left_out and not outcome.unstable and len(outcome.position) == PARTS


def mesh_error(differences: Sequence[float], unit: str) -> tuple[float | None, float | None, str]:
    """Error of the coarsest mesh, the order observed, and why one of them is not known. differences: in `unit`.

    Where the error is C h^p, the differences between h, h/2 and h/4 are in the ratio 2^p. With one difference the order is
    taken to be 1.
    """
    first = differences[0]
    if len(differences) == 1:
        return error_from(first, ASSUMED_ORDER), None, f"from two meshes alone, its order taken to be {ASSUMED_ORDER:g}"
    if first == 0.0 or differences[1] == 0.0:
        return first, None, "the meshes give the same"
    order = math.log2(first / differences[1])
    if LEAST_ORDER <= order <= HIGHEST_ORDER:
        return error_from(first, order), order, ""
    one, other = (measured(difference, unit=unit) for difference in differences)
    why = "it does not fall yet with the spacing"
    if order > HIGHEST_ORDER:
        why = "no mesh converges so fast, use finer ones"
    return (
        *(None, order),
        f"not known, at least {one}: {why}; the differences between h, h/2 and h/4 are {one} and {other}",
    )
