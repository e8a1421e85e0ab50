"""Tune: the settings with which a scene meets a tolerance at the least cost, and how they get into its file."""

import math
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from taichi_sim.errors import SceneError
from taichi_sim.files import PartFile
from taichi_sim.reports.speed_error import reference as references
from taichi_sim.reports.speed_error.compared import Compared
from taichi_sim.reports.speed_error.findings import equal
from taichi_sim.reports.speed_error.measure import measure
from taichi_sim.reports.speed_error.plan import FRAME, Plan, Step, fitting, halved, steps_of
from taichi_sim.reports.speed_error.reference import Reference
from taichi_sim.reports.speed_error.report import coarse, floor_of, progress_bar
from taichi_sim.reports.speed_error.rows import LEFT_OUT, UNSTABLE, Row, as_fast, cheapest
from taichi_sim.reports.speed_error.worker import Workers
from taichi_sim.scene import Scene
from taichi_sim.settings import Settings, part_of_bound
from taichi_sim.stability import stability

__all__ = ["find", "main", "settings_of", "write_settings"]

MORE_HALVINGS = 6  # than a report makes
SPARE = 1.2  # times the time of the best so far that a run may take, for noise

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def main(
    scene: Scene, plan: Plan, *, progress: bool = True, say: Callable[[str], None] = print
) -> dict[str, Any] | None:
    """Find the settings and say them, as lines for a scene file; None where no method meets the tolerance.

    Raises ValueError, OSError, BackendError.
    """
    with progress_bar(progress) as step_done, Workers(scene, plan, step_done) as workers:
        reference = references.make(scene, plan, workers("f64"))
        _require(scene, plan, reference)
        plan = _without_coarse(scene, plan, reference, say)
        rows = find(scene, plan, reference, workers)
    compared = Compared.of(scene, plan)
    most = f"{plan.tolerance * reference.motion:.3g} {compared.unit}".rstrip()
    asked = f"{plan.tolerance:g} of the {compared.size_in_words()} ({most})"
    until = plan.duration * reference.parts / len(reference.parting)
    if not rows:
        say(f"no method and step within --limit {plan.most:g} s meets an error of {asked} over {until:.3g} s")
        return None
    row = rows[0]
    settings = settings_of(scene, row)
    say(f"cheapest for an error of {asked} over the first {until:.3g} s:")
    say("\n".join(["[simulation]", *(f"{key} = {_toml(value)}" for key, value in settings.items())]))
    say(
        f"its error is {row.relative_error:.2g} of that at the worst of {reference.parts} moments, and it takes"
        f" {row.seconds:.3g} s per simulated second"
    )
    if len(rows) > 1:
        say(f"as fast, within {equal(rows)}")
    if reference.chaotic:
        say(
            "beyond that time small differences have grown too far for any step: see the statistics of `taichi-sim report`"
        )
    return settings


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


def _require(scene: Scene, plan: Plan, reference: Reference) -> None:
    """Raises SceneError where there is nothing to tune by."""
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
        name = Compared.of(scene, plan).name
        raise SceneError(f"{plan.name}: {name} stays 0 in the first {plan.duration:g} s: there is nothing to compare")
    if reference.known > plan.tolerance * reference.motion:
        raise SceneError(
            f"{plan.name}: the reference itself is known to {reference.known / reference.motion:.1g} of the motion only, more"
            f" than --tolerance {plan.tolerance:g}; a shorter --duration may do"
        )


def find(scene: Scene, plan: Plan, reference: Reference, workers: Workers) -> list[Row]:
    """The cheapest rows that meet the tolerance, see `cheapest`. Each method goes from its longest safe step on, until it meets
    the tolerance or costs more than the best so far: smaller steps cost more still."""
    good: list[Row] = []
    best: Row | None = None
    for precision in plan.precisions:
        for method in plan.methods:
            for step in _steps(scene, method, plan):
                allowed = (
                    plan.most if best is None else min(plan.most, SPARE * (best.seconds or 0.0) * plan.duration + 1e-3)
                )
                row = measure(
                    scene, replace(plan, most=allowed), reference, workers(precision), precision, method, step
                )
                if row.verdict == LEFT_OUT or (best and not as_fast(row, best)):
                    break
                if row.verdict == UNSTABLE:  # a shorter step may do
                    continue
                if cheapest([row], plan.tolerance, reference.motion, reference.known):
                    good.append(row)
                    best = min(good, key=lambda row: row.seconds or 0.0)
                    break
    return cheapest(good, plan.tolerance, reference.motion, reference.known)


def _steps(scene: Scene, method: str, plan: Plan) -> Iterator[Step]:
    """The longest step that is safe in the long run, the steps of a report below it, and more halvings."""
    most = part_of_bound(scene, method) * stability(scene, method).dt_any_shape
    steps = steps_of(scene, method, plan)
    if plan.steps is None:
        for _ in range(MORE_HALVINGS):
            steps.append(halved(plan.duration, steps[-1]))
        if 0.0 < most < np.inf:
            steps.insert(0, fitting(plan.duration, min(FRAME, most)))
    return (step for step in dict.fromkeys(steps) if step.seconds <= most)


def settings_of(scene: Scene, row: Row) -> dict[str, Any]:
    """A row as keys of [simulation]; dt [s] is rounded down to three digits."""
    unit = 10.0 ** (math.floor(math.log10(row.step)) - 2)
    dt = float(f"{math.floor(row.step / unit * (1 + 1e-12)) * unit:.3g}")
    settings: dict[str, Any] = {"integrator": row.method, "dt": dt, "precision": row.precision}
    resolved = Settings.resolve(scene, {"integrator": row.method, "dt": dt})
    if resolved.time_step(scene, stability(scene, row.method))[1] != 1:
        settings["substeps"] = 1
    return settings


def _toml(value: Any) -> str:
    return f'"{value}"' if isinstance(value, str) else f"{value:g}"


def write_settings(file: Path, settings: dict[str, Any]) -> None:
    """Set keys of [simulation] in a scene file; its comments and all else stay, but for a `tolerance`, in whose place dt is.
    The file is replaced whole, or not at all."""
    import tomlkit

    from taichi_sim.scene_file import load_scene

    text = file.read_bytes().decode()
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
    scene = load_scene(file)
    scene.settings = after["simulation"]
    Settings.resolve(scene, {})  # what does not go together is refused before the file changes
    part = PartFile(file.resolve())  # what a link points to
    try:
        part.file.write(changed.encode())
        shutil.copymode(file, part.part)
        part.finish()
    finally:
        part.discard()
