"""The report: plan, reference, every method with every step in each precision, statistics where nothing else holds, pages."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np

from taichi_sim.reports.speed_error import budget as budgets
from taichi_sim.reports.speed_error import reference as references
from taichi_sim.reports.speed_error import rows as table
from taichi_sim.reports.speed_error import statistics
from taichi_sim.reports.speed_error.budget import Budget
from taichi_sim.reports.speed_error.compared import worst
from taichi_sim.reports.speed_error.findings import Findings
from taichi_sim.reports.speed_error.folder import Folder
from taichi_sim.reports.speed_error.measure import measure, row_of
from taichi_sim.reports.speed_error.plan import Plan, fitting, key_of, own_step, steps_of
from taichi_sim.reports.speed_error.reference import Reference
from taichi_sim.reports.speed_error.resolution import Finer
from taichi_sim.reports.speed_error.rows import LEFT_OUT
from taichi_sim.reports.speed_error.runs import Runs, progress_bar
from taichi_sim.reports.speed_error.study import Study
from taichi_sim.reports.speed_error.worker import Outcome, Workers
from taichi_sim.scene.scene import Scene

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

    with closing(Folder(out, key_of(scene, plan), overwrite)) as folder:
        with progress_bar(progress) as runs, Workers(scene, plan, runs) as workers:
            findings = _run_all(Study(scene, plan, workers, folder.outcomes), folder, say, runs, meshes)
        write_pages(findings, folder)
        if folder.rows:
            folder.complete(findings.rows)
        folder.outcomes.forget()
    say("\n".join(findings.lines()))
    say(f"written      {out / 'report.html'}, report.md, rows.csv, error.svg, error.png")
    return findings


def _run_all(study: Study, folder: Folder, say: Say, progress: Runs, meshes: Sequence[Finer]) -> Findings:
    """All runs that the folder does not hold yet."""
    scene, plan = study.scene, study.plan
    steps = sum(len(steps_of(scene, method, plan)) for method in plan.methods)
    progress.expect(references.RUNS + len(plan.precisions) * (steps + 1) + len(meshes))
    reference = folder.reference()
    if reference is None:
        reference = references.make(study)
        folder.keep_reference(reference)
    seeds: list[statistics.Seed] = []
    budget = folder.budget()
    if reference.moves(scene):
        own, step = study.own_step()
        runs: dict[str, Outcome] = {}
        for precision in plan.precisions:
            if precision == "f32":
                for words in coarse(scene, plan, reference):
                    say(words)
            _rows(study, folder, reference, precision, progress)
            if budget is None:
                runs[precision] = study.run(precision, own, step)
            if _needs_statistics(reference, folder.rows):
                progress.expect(len(statistics.steps_of_seeds(study)) * statistics.SEEDS)
                seeds = _seeds(study, folder, precision)
        if budget is None:
            double = runs.get("f64") or study.run("f64", own, step)
            budget = budgets.made(study, reference, own, step, double, runs.get("f32"))
        if meshes and budget is not None and budget.mesh is None and not budget.why:
            budget = _with_mesh(study, reference, budget, meshes, progress)
        if budget is not None:
            folder.keep_budget(budget)
    asked = [row for row in folder.rows if row.method in plan.methods and row.precision in plan.precisions]
    ordered = table.with_orders(asked, reference.known)
    return Findings(plan, scene, reference, ordered, statistics.intervals(seeds), budget)


def _with_mesh(study: Study, reference: Reference, budget: Budget, meshes: Sequence[Finer], progress: Runs) -> Budget:
    """The error of the mesh, from the same with finer ones at a safe step; compared at the balls of the coarse one."""
    plan, before = study.plan, reference
    differences: list[float] = []
    for mesh in meshes:
        step = fitting(plan.duration, own_step(mesh.scene, reference.method)[1])
        with Workers(mesh.scene, plan, progress) as workers:
            finer = Study(mesh.scene, plan, workers)
            outcome = finer.run("f64", reference.method, step, most=MESH_PATIENCE * plan.most)
        failed = outcome.unstable or outcome.left_out
        if failed and not differences:
            return replace(budget, why=f"not known: the run at half of the spacing {failed}")
        if failed:
            break
        outcome = outcome._replace(position=[x[mesh.balls] for x in outcome.position])
        differences.append(worst(study.compared.errors(before, outcome)[: reference.parts]))
        before = outcome  # type: ignore[assignment]
    error, order, why = budgets.mesh_error(differences)
    return replace(budget, mesh=error, order=order, why=why)


def _rows(study: Study, folder: Folder, reference: Reference, precision: str, progress: Runs) -> None:
    """Each method from its longest step on, until one takes too long: those after it take longer still."""
    for method in study.plan.methods:
        too_long = None
        for step in steps_of(study.scene, method, study.plan):
            row = next((row for row in folder.rows if row.key == (precision, method, step.seconds)), None)
            if row is not None or too_long is not None:
                progress.expect(-1)
            if row is None:
                if too_long is None:
                    row = measure(study, reference, precision, method, step)
                else:
                    words = f"a step of {too_long.step:.3g} s takes too long already"
                    row = row_of(
                        study, reference, Outcome(too_long.device, [], [], [], left_out=words), precision, method, step
                    )
                folder.add(row)
            if row.verdict == LEFT_OUT and too_long is None:
                too_long = row


def _needs_statistics(reference: Reference, rows: list[table.Row]) -> bool:
    """Whether errors of positions alone do not tell: chaos, contacts seen, or contacts between samples, that keep errors up."""
    stuck = reference.touch and table.stuck(table.with_orders(rows, reference.known), reference.known)
    return reference.chaotic or bool(reference.contacts or stuck)


def _seeds(study: Study, folder: Folder, precision: str) -> list[statistics.Seed]:
    seeds = folder.table("seeds.csv", statistics.Seed)
    for method, step in statistics.steps_of_seeds(study):
        for number in range(statistics.SEEDS):
            own = [seed for seed in seeds if seed.key[:3] == (precision, method, step.seconds)]
            if not any(seed.failed or seed.seed == number for seed in own):
                seeds.append(statistics.one_seed(study, precision, method, step, number))
                folder.keep_table("seeds.csv", statistics.Seed, seeds)
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
