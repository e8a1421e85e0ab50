"""The report: plan, reference, every method with every step in each precision, statistics where nothing else holds, pages."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np

from taichi_sim.common.progress import showing
from taichi_sim.common.quantities import measured
from taichi_sim.reports.speed_error import budget as budgets
from taichi_sim.reports.speed_error import reference as references
from taichi_sim.reports.speed_error import rows as table
from taichi_sim.reports.speed_error import statistics
from taichi_sim.reports.speed_error.budget import Budget
from taichi_sim.reports.speed_error.findings import Findings
from taichi_sim.reports.speed_error.measure import measure, row_of
from taichi_sim.reports.speed_error.plan import Plan, about, fitting, own_step, steps_of
from taichi_sim.reports.speed_error.reference import Reference
from taichi_sim.reports.speed_error.report_folder import ReportFolder
from taichi_sim.reports.speed_error.resolution import Finer
from taichi_sim.reports.speed_error.rows import LEFT_OUT
from taichi_sim.reports.speed_error.runs import Runs
from taichi_sim.reports.speed_error.trial_process import Outcome, TrialProcesses
from taichi_sim.reports.speed_error.trials import Trials
from taichi_sim.scene.scene import Scene
from taichi_sim.studies.records import packed

Say = Callable[[str], None]
HARDLY_MOVES = 0.1  # of the motion: rounding from which a scene is at rest rather than in motion
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

    with closing(ReportFolder(out, about(scene, plan), overwrite)) as folder:
        runs = Runs()
        with showing(runs, progress), TrialProcesses(scene, plan, runs) as processes:
            findings = _run_all(Trials(scene, plan, processes, folder), folder, say, runs, meshes)
        write_pages(findings, folder)
        folder.complete(findings.rows)
    say("\n".join(findings.lines()))
    say(f"written      {out / 'report.html'}, report.md, rows.csv, error.svg, error.png")
    return findings


def _run_all(trials: Trials, folder: ReportFolder, say: Say, progress: Runs, meshes: Sequence[Finer]) -> Findings:
    """All runs that the folder does not hold yet."""
    scene, plan = trials.scene, trials.plan
    steps = sum(len(steps_of(scene, method, plan)) for method in plan.methods)
    progress.expect(references.RUNS + len(plan.precisions) * (steps + 1) + len(meshes))
    reference = folder.record_in("reference.npz", Reference)
    if reference is None:
        reference = references.make(trials)
        folder.write("reference.npz", packed(vars(reference)))
    seeds: list[statistics.Seed] = []
    budget = folder.record_in("budget.npz", Budget)
    if reference.moves(scene):
        own, step = trials.own_step()
        runs: dict[str, Outcome] = {}
        for precision in plan.precisions:
            if precision == "f32":
                for words in coarse(scene, plan, reference):
                    say(words)
            _rows(trials, folder, reference, precision, progress)
            if budget is None:
                runs[precision] = trials.run(precision, own, step)
            if _needs_statistics(reference, folder.rows):
                progress.expect(len(statistics.steps_of_seeds(trials)) * statistics.SEEDS)
                seeds = _seeds(trials, folder, precision)
        if budget is None:
            double = runs.get("f64") or trials.run("f64", own, step)
            budget = budgets.made(trials, reference, own, step, double, runs.get("f32"))
        if meshes and budget is not None and budget.mesh is None and not budget.why:
            budget = _with_mesh(trials, reference, budget, meshes, progress)
        if budget is not None:
            folder.write("budget.npz", packed(vars(budget)))
    asked = [row for row in folder.rows if row.method in plan.methods and row.precision in plan.precisions]
    ordered = table.with_orders(asked, reference.known)
    return Findings(plan, scene, reference, ordered, statistics.intervals(seeds), budget)


def _with_mesh(trials: Trials, reference: Reference, budget: Budget, meshes: Sequence[Finer], progress: Runs) -> Budget:
    """The error of the mesh, from the same with finer ones at a safe step; compared at the balls of the coarse one."""
    plan, before = trials.plan, reference
    differences: list[float] = []
    for mesh in meshes:
        if mesh.overlap:
            break
        step = fitting(plan.duration, own_step(mesh.scene, reference.method)[1])
        with TrialProcesses(mesh.scene, plan, progress) as processes:
            finer = Trials(mesh.scene, plan, processes)
            outcome = finer.run("f64", reference.method, step, most=MESH_PATIENCE * plan.most)
        failed = outcome.unstable or outcome.left_out
        if failed and not differences:
            return replace(budget, why=f"not known: the run at half of the spacing {failed}")
        if failed:
            break
        outcome = outcome._replace(position=[x[mesh.balls] for x in outcome.position])
        differences.append(trials.compared.error_of_largest(before, outcome, reference.parts))
        before = outcome  # type: ignore[assignment]
    overlaps = [mesh.overlap for mesh in meshes if mesh.overlap]
    if not differences:
        return replace(budget, why=f"not known: with half of the spacing {overlaps[0]}")
    error, order, why = budgets.mesh_error(differences, budget.unit)
    if overlaps:
        why += f"; with a quarter of the spacing {overlaps[0]}"
    return replace(budget, mesh=error, order=order, why=why)


def _rows(trials: Trials, folder: ReportFolder, reference: Reference, precision: str, progress: Runs) -> None:
    """Each method from its longest step on, until one takes too long: those after it take longer still."""
    for method in trials.plan.methods:
        too_long = None
        for step in steps_of(trials.scene, method, trials.plan):
            row = next((row for row in folder.rows if row.key == (precision, method, step.seconds)), None)
            if row is not None or too_long is not None:
                progress.expect(-1)
            if row is None:
                if too_long is None:
                    row = measure(trials, reference, precision, method, step)
                else:
                    words = f"a step of {too_long.step:.3g} s takes too long already"
                    row = row_of(
                        trials, reference, Outcome(too_long.device, [], [], [], left_out=words), precision, method, step
                    )
                folder.add(row)
            if row.verdict == LEFT_OUT and too_long is None:
                too_long = row


def _needs_statistics(reference: Reference, rows: list[table.Row]) -> bool:
    """True if errors of positions alone do not tell: chaos, contacts seen, or contacts between samples, that keep errors up."""
    stuck = reference.touch and table.stuck(table.with_orders(rows, reference.known), reference.known)
    return reference.chaotic or bool(reference.contacts or stuck)


def _seeds(trials: Trials, folder: ReportFolder, precision: str) -> list[statistics.Seed]:
    seeds = folder.rows_in("seeds.jsonl", statistics.Seed)
    for method, step in statistics.steps_of_seeds(trials):
        for number in range(statistics.SEEDS):
            own = [seed for seed in seeds if seed.key[:3] == (precision, method, step.seconds)]
            if not any(seed.failed or seed.seed == number for seed in own):
                seeds.append(statistics.one_seed(trials, precision, method, step, number))
                folder.keep_table("seeds", seeds)
    return seeds


def floor_of(scene: Scene, plan: Plan, reference: Reference) -> float:
    """Least error that single precision can resolve, as a part of the motion: the rounding of the farthest position, which
    grows along the way like any other small difference. 0 for a quantity, for which it is not known before it runs."""
    if plan.quantity is not None or not reference.motion:
        return 0.0
    rounding = 2.0**-24 * float(np.max(np.abs(scene.position), initial=0.0)) / reference.motion
    return rounding * max(1.0, reference.growth)


def coarse(scene: Scene, plan: Plan, reference: Reference) -> Iterator[str]:
    """A line where single precision cannot meet the tolerance, to be said before it is tried."""
    floor = floor_of(scene, plan, reference)
    if "f32" in plan.precisions and floor > plan.tolerance:
        yield f"note: single precision resolves about {floor:.1g} of the motion, more than the tolerance {plan.tolerance:g}"
        if floor > HARDLY_MOVES:
            moved = measured(reference.motion, unit="m")
            yield f"note: balls move by {moved} only, so what rests is hardly judged by that; name what you want by --quantity"
