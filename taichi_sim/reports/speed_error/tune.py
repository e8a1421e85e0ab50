"""Tune: the settings with which a scene meets a tolerance at the least cost, and how they get into its file."""

import math
import shutil
from codecs import BOM_UTF8
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from taichi_sim.analysis.methods import named
from taichi_sim.analysis.outcome import left_out, not_included
from taichi_sim.analysis.stability import stability
from taichi_sim.common.atomic_file import PartFile
from taichi_sim.common.errors import SceneError
from taichi_sim.common.progress import showing
from taichi_sim.common.quantities import EXACT, measured, percent
from taichi_sim.reports.speed_error import reference as references
from taichi_sim.reports.speed_error.compared import Compared
from taichi_sim.reports.speed_error.findings import equal
from taichi_sim.reports.speed_error.measure import measure
from taichi_sim.reports.speed_error.plan import Plan, Step, halved, longest_step, steps_of
from taichi_sim.reports.speed_error.reference import Reference
from taichi_sim.reports.speed_error.report import coarse, floor_of
from taichi_sim.reports.speed_error.rows import LEFT_OUT, UNSTABLE, Row, cheapest
from taichi_sim.reports.speed_error.runs import Runs
from taichi_sim.reports.speed_error.trial_process import TrialProcesses
from taichi_sim.reports.speed_error.trials import Trials
from taichi_sim.scene.scene import Scene
from taichi_sim.simulation.settings import Settings

MORE_HALVINGS = 6  # than a report makes
WELL_KNOWN = 4.0  # times better than the tolerance the reference is known
LIKELY_PASSES = 3.0  # times those that the best has time for that may still win: passes are not all alike
BY_PRECISION = 2.5  # times the time of the best, which another precision might make up for
SPARE_TIME = 1.25  # times that of the best so far that a run may take, for noise


def main(
    scene: Scene, plan: Plan, *, progress: bool = True, say: Callable[[str], None] = print
) -> dict[str, Any] | None:
    """Find the settings and say them, as lines for a scene file; None where no method meets the tolerance.

    Raises ValueError, OSError, BackendError.
    """
    runs = Runs()
    with showing(runs, progress), TrialProcesses(scene, plan, runs) as processes:
        runs.expect(references.RUNS + len(plan.methods) * len(plan.precisions))
        trials = Trials(scene, plan, processes)
        reference = references.make(trials, plan.tolerance / WELL_KNOWN)
        _require(trials, reference)
        trials = replace(trials, plan=_without_coarse(scene, plan, reference, say))
        rows, untried = _find(trials, reference, runs)
    compared = trials.compared
    allowed = measured(plan.tolerance * reference.motion, unit=compared.unit)
    until = plan.duration * reference.parts / len(reference.parting)
    if not rows:
        say(
            f"no method and step within --limit {plan.most:g} s keeps the error of {compared.name} below {allowed},"
            f" {percent(plan.tolerance)} of the {compared.size_in_words(reference.parts)}"
        )
        return None
    row = rows[0]
    settings = settings_of(scene, row)
    say(
        f"cheapest settings with an error of {compared.name} below {percent(plan.tolerance)} in the first {until:.3g} s:"
    )
    say("\n".join(["[simulation]", *(f"{key} = {_toml(value)}" for key, value in settings.items())]))
    say("\n".join(_outcome(scene, compared, reference, row, plan.tolerance)))
    if len(rows) > 1:
        say(f"{'as fast':12} {equal(rows)}")
    for k, (method, why) in enumerate(untried.items()):
        say(f"{'' if k else 'not tried':12} {method}: {why}")
    if reference.chaotic:
        say(
            f"after {until:.3g} s small differences have grown too far for any step to meet a tolerance; `taichi-sim report`"
            " compares statistics there"
        )
    return settings


def _outcome(scene: Scene, compared: Compared, reference: Reference, row: Row, tolerance: float) -> Iterator[str]:
    """Lines of the outcome: the value with its error, what error was allowed, what was found, and its cost."""
    off, unit = row.rms_error or 0.0, compared.unit
    settling = reference.settling or 0.0
    known = settling if np.isfinite(settling) else 0.0
    source = "step and settling" if known else "step"
    if reference.missed > off + known and reference.reads_peak:
        peak = measured(reference.motion + reference.missed, off + known, unit, source)
        yield f"{'peak':12} {peak}, at and between sample times"
    elif reference.missed > off + known:
        peak = measured(reference.motion, reference.missed + known, unit, "between sample times")
        yield f"{'peak':12} {peak}; `taichi-sim run --error` tells it"
    value = measured(reference.motion, off + known, unit, source)
    yield f"{'value':12} {compared.size_in_words(reference.parts)}: {value}"
    errors = list(left_out(scene))
    if settling != known:
        errors.append("the net force that `settle` left at the start")
    if errors:
        yield not_included(errors)
    yield f"{'allowed':12} {measured(tolerance * reference.motion, unit=unit)}, {percent(tolerance)} of the value"
    found = f"{measured(off, unit=unit)}, {percent(row.relative_error or 0.0)} of the value"
    if off <= EXACT * reference.motion:
        found = "0, exact to rounding"
    yield f"{'found':12} {found}, the largest of {reference.parts} sample times"
    yield f"{'':12} not seen: errors between these times"
    if known:
        much = ", more than allowed" if known > tolerance * reference.motion else ""
        yield f"{'settling':12} {measured(known, unit=unit)}{much}; a smaller `settle` reduces it"
    yield f"{'cost':12} {row.seconds:.3g} s of {row.clock}, {row.passes or 0.0:.4g} passes over the forces, per simulated second"


def _without_coarse(scene: Scene, plan: Plan, reference: Reference, say: Callable[[str], None]) -> Plan:
    """Single precision left out where it is too coarse, which is said before it is tried."""
    for words in coarse(scene, plan, reference):
        say(words)
    if floor_of(scene, plan, reference) <= plan.tolerance:
        return plan
    left = tuple(precision for precision in plan.precisions if precision != "f32")
    if not left:
        raise ValueError(f"--precision: f32 cannot meet --tolerance {plan.tolerance:g} in this scene; use f64")
    return replace(plan, precisions=left)


def _require(trials: Trials, reference: Reference) -> None:
    """Raises SceneError where there is nothing to tune by."""
    scene, plan = trials.scene, trials.plan
    if reference.why:
        raise SceneError(f"{plan.name}: there is no reference to measure errors from: {reference.why}")
    if not reference.moves(scene):
        raise SceneError(f"{plan.name}: nothing moves in the first {plan.duration:g} s, so every setting will do")
    if not reference.parts:
        raise SceneError(
            f"{plan.name}: small differences grow too fast for any step to meet a tolerance; a shorter --duration may do, and"
            " `taichi-sim report` compares statistics"
        )
    if not reference.motion:
        name = trials.compared.name
        raise SceneError(f"{plan.name}: {name} stays 0 in the first {plan.duration:g} s: there is nothing to compare")
    if reference.known > plan.tolerance * reference.motion:
        raise SceneError(
            f"{plan.name}: the reference itself is known to {reference.known / reference.motion:.1g} of the motion only, more"
            f" than --tolerance {plan.tolerance:g}; a shorter --duration may do"
        )


def _find(trials: Trials, reference: Reference, runs: Runs) -> tuple[list[Row], dict[str, str]]:
    """The cheapest rows that meet the tolerance, see `cheapest`, and why methods were not tried, in words by method.

    Those come first that promise most, and those that cannot win are passed over: where even the longest step goes through the
    forces too often. The second precision is tried of the methods that come near the best in the first, for it
    changes a factor of two at most; and of those that iterate to what rounding allows (implicit Euler: 15 on a cloth).
    """
    plan = trials.plan
    good: list[Row] = []
    untried: dict[str, str] = {}
    first = {trials.own_step()[0], reference.method}  # the compiler has seen them
    methods = sorted(plan.methods, key=lambda method: (method not in first, _least_passes(trials, method)))
    for precision in plan.precisions:
        if precision != plan.precisions[0]:
            best = min((row.seconds or 0.0 for row in good), default=0.0)
            near = {row.method for row in good if (row.seconds or 0.0) <= BY_PRECISION * best}
            methods = [method for method in methods if method in near or named(method).iterates]
        spare = SPARE_TIME if precision == plan.precisions[-1] else BY_PRECISION
        runs.expect(len(methods) - runs.to_come)
        for method in methods:
            fastest = min(good, key=lambda row: row.seconds or 0.0, default=None)
            if fastest is not None and method != fastest.method and (why := _cannot_win(trials, method, good)):
                untried[method if precision == plan.precisions[0] else f"{method} in {precision}"] = why
                continue
            longest = next((row.step for row in good if row.method == method), np.inf)
            row = _longest(trials, reference, precision, method, fastest, longest, spare)
            if row is not None:
                good.append(row)
    return cheapest(good, plan.tolerance, reference.motion, reference.known), untried


def _cannot_win(trials: Trials, method: str, good: list[Row]) -> str:
    """Why a method cannot be cheaper than the best of the rows: words that follow its name; empty where it may. A pass over the
    forces is taken to cost what the cheapest of theirs does."""
    passes = _least_passes(trials, method)
    if not np.isfinite(passes):
        return "has no step that is safe in the long run"
    best = min(row.seconds or 0.0 for row in good)
    each = min(((row.seconds or 0.0) / row.passes for row in good if row.passes), default=0.0)
    if passes * each <= LIKELY_PASSES * best:
        return ""
    return f"makes {passes * each / best:.2g} times as many passes as the best has time for, even at its longest step"


def _longest(
    trials: Trials, reference: Reference, precision: str, method: str, best: Row | None, first: float, spare: float
) -> Row | None:
    """The row of the longest step, of at most `first` [s], with which a method meets the tolerance; None where that costs more
    than `spare` times the best so far, for smaller steps cost more still."""
    plan = trials.plan
    for step in _steps(trials, method):
        if step.seconds > first * (1.0 + 1e-9):
            continue
        most = plan.most if best is None else min(plan.most, spare * (best.seconds or 0.0) * plan.duration + 1e-3)
        row = measure(trials, reference, precision, method, step, most)
        if row.verdict == LEFT_OUT or (best and (row.seconds or 0.0) > spare * (best.seconds or 0.0)):
            return None
        if row.verdict != UNSTABLE and cheapest([row], plan.tolerance, reference.motion, reference.known):
            return row  # where it was unstable a shorter step may do
    return None


def _least_passes(trials: Trials, method: str) -> float:
    """Over the forces, per simulated second, with the longest step."""
    step = next(_steps(trials, method), None)
    return np.inf if step is None else named(method).passes(trials.scene, step.seconds) / step.seconds


def _steps(trials: Trials, method: str) -> Iterator[Step]:
    """The steps of a report that are safe in the long run, and more halvings."""
    scene, plan = trials.scene, trials.plan
    most = longest_step(scene, method)
    steps = steps_of(scene, method, plan)
    if plan.steps is None:
        for _ in range(MORE_HALVINGS):
            steps.append(halved(plan.duration, steps[-1]))
    return (step for step in steps if step.seconds <= most)


def settings_of(scene: Scene, row: Row) -> dict[str, Any]:
    """A row as keys of [simulation]; dt [s] is rounded down to three digits."""
    unit = 10.0 ** (math.floor(math.log10(row.step)) - 2)
    dt = float(f"{math.floor(row.step / unit * (1 + 1e-12)) * unit:.3g}")
    settings: dict[str, Any] = {"integrator": row.method, "dt": dt, "precision": row.precision}
    resolved = Settings.resolve(scene, {"integrator": row.method, "dt": dt})
    if resolved.time_step(scene, stability(scene, resolved.integrator.method))[1] != 1:
        settings["substeps"] = 1
    return settings


def _toml(value: Any) -> str:
    return f'"{value}"' if isinstance(value, str) else f"{value:g}"


def write_settings(file: Path, settings: dict[str, Any]) -> None:
    """Set keys of [simulation] in a scene file; its comments and all else stay, but for a `tolerance`, in whose place dt is.
    The file is replaced whole, or not at all."""
    import tomlkit

    from taichi_sim.files.toml_document import tomllib
    from taichi_sim.files.toml_reader import load_scene

    given = file.read_bytes()
    text = given.decode("utf-8-sig")
    document = tomlkit.parse(text)
    if "simulation" not in document:
        if text.strip():
            document.add(tomlkit.nl())
        document.add("simulation", tomlkit.table())
    table: Any = document["simulation"]
    gone = {"tolerance"} if "dt" in settings else set()
    for key in gone & set(table):
        table.remove(key)
    for key, value in settings.items():
        table[key] = value
    changed = tomlkit.dumps(document)
    before, after = tomllib.loads(text), tomllib.loads(changed)
    kept = {key: value for key, value in before.get("simulation", {}).items() if key not in gone}
    if after != {**before, "simulation": {**kept, **settings}}:
        raise SceneError(f"{file}: cannot be changed without changing more than [simulation]; put the lines in by hand")
    scene = load_scene(file, allow_outside=True)  # as it was read before, or refused
    scene.settings = after["simulation"]
    Settings.resolve(scene, {})  # what does not go together is refused before the file changes
    part = PartFile(file.resolve())  # what a link points to
    try:
        part.file.write(changed.encode("utf-8-sig" if given.startswith(BOM_UTF8) else "utf-8"))
        shutil.copymode(file, part.part)
        part.finish()
    finally:
        part.discard()
