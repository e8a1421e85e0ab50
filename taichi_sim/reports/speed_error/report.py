"""The report: plan, reference, every method with every step in each precision, statistics where nothing else holds, pages."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from taichi_sim.reports.speed_error import budget as budgets
from taichi_sim.reports.speed_error import csv_table, statistics
from taichi_sim.reports.speed_error import reference as references
from taichi_sim.reports.speed_error import rows as table
from taichi_sim.reports.speed_error.budget import Budget
from taichi_sim.reports.speed_error.compared import Compared, worst
from taichi_sim.reports.speed_error.findings import Findings
from taichi_sim.reports.speed_error.folder import Folder
from taichi_sim.reports.speed_error.measure import measure, row_of
from taichi_sim.reports.speed_error.plan import Plan, fitting, key_of, own_step, steps_of
from taichi_sim.reports.speed_error.reference import Reference
from taichi_sim.reports.speed_error.resolution import Finer
from taichi_sim.reports.speed_error.rows import LEFT_OUT
from taichi_sim.reports.speed_error.worker import Outcome, Trial, Workers
from taichi_sim.scene.scene import Scene

__all__ = ["coarse", "floor_of", "main", "progress_bar", "run_all"]

Say = Callable[[str], None]
MESH_PATIENCE = 15.0  # times --limit that the run of a finer mesh may take


def main(
    scene: Scene,
    plan: Plan,
    out: Path,
    *,
    meshes: Sequence[Finer] = (),
    overwrite: bool = False,
    progress: bool = True,
    say: Say = print,
) -> Findings:
    """Make or finish the report of a scene in the folder `out`; `say` gets the lines for the terminal. meshes: the scene with
    finer ones.

    Raises ValueError, OSError, BackendError.
    """
    from taichi_sim.reports.speed_error.pages import write_pages

    folder = Folder(out, key_of(scene, plan), overwrite)
    with progress_bar(progress) as step_done:
        findings = run_all(scene, plan, folder, say, step_done, meshes)
    write_pages(findings, folder.open())
    if folder.rows:
        folder.complete(findings.rows)
    say("\n".join(findings.lines()))
    say(f"written      {out / 'report.html'}, report.md, rows.csv, error.svg, error.png")
    return findings


def run_all(
    scene: Scene,
    plan: Plan,
    folder: Folder,
    say: Say,
    step_done: Callable[[str], None],
    meshes: Sequence[Finer] = (),
) -> Findings:
    """All runs that the folder does not hold yet."""
    with Workers(scene, plan, step_done) as workers:
        reference = folder.reference()
        if reference is None:
            reference = references.make(scene, plan, workers("f64"))
            folder.keep(reference)
        seeds: list[statistics.Seed] = []
        budget = folder.budget()
        if reference.moves(scene):
            own, seconds = own_step(scene)
            step = fitting(plan.duration, seconds)
            runs: dict[str, Outcome] = {}
            for precision in plan.precisions:
                if precision == "f32":
                    for words in coarse(scene, plan, reference):
                        say(words)
                _rows(scene, plan, folder, reference, workers, precision)
                if budget is None:
                    runs[precision] = workers(precision)(Trial(own, step))
                if _needs_statistics(plan, reference, folder.rows):
                    seeds = _seeds(scene, plan, folder, workers, precision)
            if budget is None:
                double = runs.get("f64") or workers("f64")(Trial(own, step))
                budget = budgets.made(scene, plan, reference, own, step.seconds, double, runs.get("f32"))
            if meshes and budget is not None and budget.mesh is None and not budget.why:
                budget = _with_mesh(scene, plan, reference, budget, meshes, step_done)
            if budget is not None:
                folder.keep_budget(budget)
    asked = [row for row in folder.rows if row.method in plan.methods and row.precision in plan.precisions]
    ordered = table.with_orders(asked, reference.known)
    return Findings(plan, scene, reference, ordered, statistics.intervals(seeds), budget)


def _with_mesh(
    scene: Scene,
    plan: Plan,
    reference: Reference,
    budget: Budget,
    meshes: Sequence[Finer],
    step_done: Callable[[str], None],
) -> Budget:
    """The error of the mesh, from the same with finer ones at a safe step; compared at the balls of the coarse one."""
    compared, before = Compared.of(scene, plan), reference
    differences: list[float] = []
    for mesh in meshes:
        step = fitting(plan.duration, own_step(mesh.scene, reference.method)[1])
        with Workers(mesh.scene, plan, step_done) as workers:
            outcome = workers("f64")(Trial(reference.method, step, most=MESH_PATIENCE * plan.most))
        failed = outcome.unstable or outcome.left_out
        if failed and not differences:
            return replace(budget, why=f"not known: the run at half of the spacing {failed}")
        if failed:
            break
        outcome = outcome._replace(position=[x[mesh.balls] for x in outcome.position])
        differences.append(worst(compared.errors(before, outcome)[: reference.parts]))
        before = outcome  # type: ignore[assignment]
    error, order, why = budgets.mesh_error(differences)
    return replace(budget, mesh=error, order=order, why=why)


def _rows(scene: Scene, plan: Plan, folder: Folder, reference: Reference, workers: Workers, precision: str) -> None:
    """Each method from its longest step on, until one takes too long: those after it take longer still."""
    for method in plan.methods:
        too_long = None
        for step in steps_of(scene, method, plan):
            known = [row for row in folder.rows if row.key == (precision, method, step.seconds)]
            if known:
                row = known[0]
            elif too_long is not None:
                outcome = Outcome(
                    too_long.device, [], [], [], left_out=f"a step of {too_long.step:.3g} s takes too long already"
                )
                row = row_of(scene, plan, reference, outcome, precision, method, step)
            else:
                row = measure(scene, plan, reference, workers(precision), precision, method, step)
            if not known:
                folder.add(row)
            if row.verdict == LEFT_OUT and too_long is None:
                too_long = row


def _needs_statistics(plan: Plan, reference: Reference, rows: list[table.Row]) -> bool:
    """Whether errors of positions alone do not tell: chaos, contacts seen, or contacts between looks, that keep errors up."""
    stuck = reference.touch and table.stuck(table.with_orders(rows, reference.known), reference.known)
    return reference.chaotic or bool(reference.contacts or stuck)


def _seeds(scene: Scene, plan: Plan, folder: Folder, workers: Workers, precision: str) -> list[statistics.Seed]:
    path = folder.path / "seeds.csv"
    seeds = csv_table.read(path, statistics.Seed)
    done = {seed.key for seed in seeds}
    failed = {seed.key[:3] for seed in seeds if seed.failed}
    for method, step in statistics.steps_of_seeds(scene, plan):
        for number in range(statistics.SEEDS):
            key = (precision, method, step.seconds)
            if (*key, number) not in done and key not in failed:
                seeds.append(statistics.one_seed(scene, plan, workers(precision), precision, method, step, number))
                done.add(seeds[-1].key)
                if seeds[-1].failed:
                    failed.add(key)
                csv_table.write(folder.open() / "seeds.csv", statistics.Seed, seeds)
    return seeds


def floor_of(scene: Scene, plan: Plan, reference: Reference) -> float:
    """What single precision can resolve, as a part of the motion: the rounding of the farthest position, which grows along the
    way like any other small difference. 0 for a quantity, of which that is not known before it runs."""
    if plan.quantity is not None or not reference.motion:
        return 0.0
    rounding = 2.0**-24 * float(np.max(np.abs(scene.position), initial=0.0)) / reference.motion
    return rounding * max(1.0, reference.growth)


def coarse(scene: Scene, plan: Plan, reference: Reference) -> Iterator[str]:
    """A line where single precision cannot meet the tolerance, to be said before it is tried."""
    floor = floor_of(scene, plan, reference)
    if "f32" in plan.precisions and floor > plan.tolerance:
        yield f"note: single precision resolves about {floor:.1g} of the motion, more than the tolerance {plan.tolerance:g}"


@contextmanager
def progress_bar(shown: bool) -> Iterator[Callable[[str], None]]:
    """A line on standard error with the run in progress and the time it all has taken."""
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (SpinnerColumn(), TimeElapsedColumn(), TextColumn("run {task.completed:.0f}: {task.description}"))
    with Progress(*columns, console=console, transient=True, disable=not (shown and console.is_terminal)) as progress:
        task = progress.add_task("starting", total=None)

        def step_done(what: str) -> None:
            progress.update(task, advance=1, description=what)

        yield step_done
