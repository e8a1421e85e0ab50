"""Findings: what a report has to say, for the terminal and for the pages."""

from collections.abc import Iterator
from dataclasses import dataclass

from taichi_sim.analysis.methods import named as method_named
from taichi_sim.common.quantities import EXACT, measured
from taichi_sim.reports.speed_error.budget import Budget
from taichi_sim.reports.speed_error.compared import Compared
from taichi_sim.reports.speed_error.plan import PARTS, Plan, longest_step
from taichi_sim.reports.speed_error.reference import APART, LEAST, PARTED, Reference
from taichi_sim.reports.speed_error.rows import (
    CLEAR_OF_REFERENCE,
    ERROR_FALLS,
    LEFT_OUT,
    MUCH_LONGER,
    SAME_TIME,
    STABLE,
    UNSTABLE,
    Row,
    cheapest,
    coarser,
    pareto,
    stuck,
    tells,
)
from taichi_sim.reports.speed_error.statistics import Interval
from taichi_sim.scene.scene import Scene

MOST_NAMED = 3  # runs that are as fast as the best
LONG_RUN = "Of runs below, only those with steps that are safe in the long run count, as `tune` takes them:"
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-6)


@dataclass(frozen=True)
class Findings:
    """Rows are sorted, with their orders."""

    plan: Plan
    scene: Scene
    reference: Reference
    rows: list[Row]
    intervals: list[Interval]
    budget: Budget | None = None

    @property
    def front(self) -> list[Row]:
        """Rows that none beats in both speed and error."""
        return pareto(self.rows, self.reference.known)

    @property
    def floor(self) -> float | None:
        """The least error seen in single precision, as a part of the motion, where smaller steps did not lessen it and the same
        steps in double precision are better."""
        best = []
        for method in self.plan.methods:
            own = [row for row in self.rows if row.method == method and row.verdict == STABLE]
            single = {row.step: row.relative_error for row in own if row.precision == "f32" and row.relative_error}
            double = {row.step: row.relative_error for row in own if row.precision == "f64"}
            last = min(single, default=0.0)
            longer = coarser(last, [step for step in single if step > last])
            if longer is not None and single[last] > ERROR_FALLS * single[longer]:
                same = double.get(last)
                if same is not None and same < ERROR_FALLS * single[last]:
                    best.append(min(single.values()))
        return min(best, default=None)

    @property
    def exact(self) -> list[Row]:
        """Stable rows that agree to rounding with a reference that is known to rounding."""
        most = EXACT * self.reference.motion
        if not self.reference.parts or self.reference.known > most:
            return []
        return [
            row for row in self.rows if row.verdict == STABLE and row.rms_error is not None and row.rms_error <= most
        ]

    @property
    def dropped(self) -> list[Row]:
        """Stable rows whose errors say more of the reference than of the method."""
        return [row for row in self.rows if row.verdict == STABLE and not tells(row, self.reference.known)]

    @property
    def lasting(self) -> list[Row]:
        """Rows whose steps are safe in the long run, those that `tune` tries: only they are recommended."""
        most = {method: longest_step(self.scene, method) for method in dict.fromkeys(row.method for row in self.rows)}
        return [row for row in self.rows if row.step <= most[row.method]]

    def fastest(self, tolerances: tuple[float, ...] = TOLERANCES) -> Iterator[tuple[float, list[Row]]]:
        """The cheapest rows for each tolerance, that of the plan among them; several where they are equally fast."""
        for tolerance in sorted({*tolerances, self.plan.tolerance}, reverse=True):
            yield tolerance, cheapest(self.lasting, tolerance, self.reference.motion, self.reference.known)

    @property
    def compared(self) -> Compared:
        """Quantity that errors are of."""
        return Compared(self.scene, self.plan)

    def about(self) -> Iterator[str]:
        """Sentences on what was done, and on how well it is known."""
        plan, scene, reference = self.plan, self.scene, self.reference
        yield (
            f"Balls: {scene.n_balls}, springs: {scene.n_springs}, in {scene.dim}D; simulated: {plan.duration:g} s; size of the"
            f" scene: {reference.size:.3g} m."
        )
        if not scene.n_springs:
            yield "The scene has no springs: nothing limits the step."
        if reference.why:
            yield f"There is no reference, so errors are not known: {reference.why}."
            return
        if not reference.moves(scene):
            yield "Nothing moves in this scene: there is nothing to compare."
            return
        compared = self.compared
        if reference.parts and not reference.motion:
            yield f"{compared.name} stays 0 all along: there is nothing that an error could be relative to."
        elif reference.parts:
            yield (
                f"Errors are of {compared.name}, relative to the {compared.size_in_words(reference.parts)},"
                f" {measured(reference.motion, unit=compared.unit)}."
            )
            yield (
                f"Reference: {reference.method} in double precision at {2 * reference.step:.3g} s and {reference.step:.3g} s,"
                f" which differ by {reference.known / reference.motion:.1g} of that. Errors below"
                f" {CLEAR_OF_REFERENCE:g} times this difference are not used for orders, nor for the comparison of methods."
            )
            if reference.rests:
                yield (
                    f"{compared.name} moves by no more than what `settle` left, so that errors relative to its motion say little."
                )
            if self.budget is not None:
                yield from self.budget.lines()
        if not any(row.verdict == STABLE for row in self.rows):
            yield "No run was stable and within --limit."
        elif self.exact:
            yield (
                f"{len(self.exact)} runs agree with the reference to rounding, within {EXACT:g} of the motion: their methods are"
                " exact in this scene."
            )
        elif reference.parts and not any(tells(row, reference.known) for row in self.rows):
            yield (
                f"No method's error can be told: all lie within {CLEAR_OF_REFERENCE:g} times the uncertainty of the reference."
            )
        elif self.dropped and reference.parts:
            yield f"{len(self.dropped)} stable runs lie so near to the reference that their errors cannot be told."
        yield from self._stuck()
        whose = "the size"
        if compared.quantity is not None:
            whose = f"the motion of {compared.name}, or of {LEAST:g} of the size, whichever says less"
        grown = (
            f"Two runs that start {APART:g} of the size apart part by up to {reference.parting.max():.1g} of {whose}"
        )
        if not reference.chaotic:
            yield f"{grown}, so errors can be compared over the whole duration."
        elif reference.parts:
            horizon = reference.parts * plan.duration / PARTS
            yield (
                f"{grown}; the horizon, where it is {PARTED:g}, comes after {horizon:.3g} s. Errors are taken up to there only,"
                " and the rest is compared by statistics."
            )
        else:
            yield (
                f"{grown}, and more than {PARTED:g} after {plan.duration / PARTS:.3g} s already: no error means"
                " anything, and the runs are compared by statistics alone."
            )
        if self.floor is not None:
            yield f"In single precision smaller steps do not go below an error of {self.floor:.1g} of the motion."

    def _stuck(self) -> Iterator[str]:
        """Sentences on methods whose errors do not fall, and why: of those that pass through springs their softness."""
        methods = stuck(self.rows, self.reference.known)
        soft = [name for name in methods if method_named(name).single_pass and self.scene.n_springs]
        if soft:
            yield f"Errors do not fall with the step of {', '.join(soft)}: its passes leave springs too soft at these steps."
        others = [name for name in methods if name not in soft]
        if others:
            few = "contacts" if self.reference.contacts else "contacts between the moments compared, if there were any,"
            why = f": {few} begin and end with a step, and shorter steps may do so at the same moments"
            why = why if self.reference.touch else ""
            yield f"Errors do not fall with the step of {', '.join(others)}{why}."

    def lines(self) -> Iterator[str]:
        """Lines for the terminal."""
        yield f"report       {self.plan.name}"
        yield from self.about()
        if self.front:
            yield ""
            yield (
                f"Every stable run that is more accurate than one of these takes {MUCH_LONGER} than it"
                f" ({self.front[0].clock} per simulated second; times and errors are rounded here):"
            )
            head = in_unit("error", self.compared.unit)
            yield f"{'method':18}{'precision':>10}{'step':>12}{'s per s':>14}{head:>12}{'relative':>13}"
            for row in self.front:
                yield (
                    f"{row.method:18}{row.precision:>10}{row.step:>10.3g} s{row.seconds:>14.3g}{row.rms_error:>12.2g}"
                    f"{row.relative_error:>13.2g}"
                )
        if any(row.rms_error is not None for row in self.rows):
            yield ""
            if len(self.lasting) < len(self.rows):
                yield LONG_RUN
            for tolerance, best in self.fastest((1e-2, 1e-3, 1e-4)):
                yield f"fastest with an error below {100 * tolerance:g} %: {choice(best)}"
        for verdict, words in ((UNSTABLE, "became unstable"), (LEFT_OUT, "left out")):
            some = [row for row in self.rows if row.verdict == verdict]
            if some:
                if verdict == UNSTABLE:
                    words += _above_safe(some)
                yield f"{len(some)} of {len(self.rows)} runs {words}; the pages name them and the reasons."
        if self.intervals:
            yield f"The pages compare {len(self.intervals)} methods and steps by statistics over 8 starts."


def _above_safe(rows: list[Row]) -> str:
    """End of a sentence: that rows are of steps above the safe one, or some of them; empty where none is."""
    above = sum((row.part_of_safe_step or 0.0) > 1.0 + 1e-9 for row in rows)
    of_them = f"{above} of them " if above < len(rows) else ""
    words = f", {of_them}at {'steps' if above > 1 else 'a step'} above the safe one" if above else ""
    without = sum(row.part_of_safe_step is None for row in rows)
    return f"{words}, {without} of them by methods that have no safe step here" if without else words


def in_unit(word: str, unit: str) -> str:
    """A heading with its unit, where there is one."""
    return f"{word} [{unit}]" if unit else word


def choice(rows: list[Row]) -> str:
    """The cheapest rows as advice."""
    if not rows:
        return "none of these"
    first = rows[0]
    words = f"{named(first)}, {first.seconds:.3g} s of {first.clock} per simulated second"
    return words + (f"; equally fast: {equal(rows)}" if len(rows) > 1 else "")


def named(row: Row) -> str:
    """A row in words."""
    return f"{row.method} at {row.step:.3g} s in {row.precision}"


def equal(rows: list[Row]) -> str:
    """Some of the rows after the first, the best of each method, how many more there are, and how their times compare."""
    best: dict[str, Row] = {}
    for row in rows:
        best.setdefault(row.method, row)
    others = [row for row in best.values() if row is not rows[0]][:MOST_NAMED] or rows[1:2]
    more = len(rows) - 1 - len(others)
    within = f"times within {100.0 * (SAME_TIME - 1.0):.0f} % are taken as equal"
    rest = f" and {more} more run{'s' if more > 1 else ''}" if more else ""
    return f"{', '.join(map(named, others))}{rest} ({within})"
