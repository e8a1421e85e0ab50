"""check, report, tune: which step is safe, and what accuracy costs."""

from typing import Annotated, Any

import typer

from taichi_sim.cli.command import (
    FAILED,
    SIMULATION,
    Compared,
    Job,
    Limit,
    Precisions,
    Quiet,
    SceneName,
    echo,
    flag,
    say_nothing,
    scene_argument,
    subcommand,
)
from taichi_sim.cli.options import paths_and_values, takes_only
from taichi_sim.common.progress import waiting


@subcommand(*SIMULATION, "fps", "duration", "threads", "set", "allow_outside")
def check(scene: SceneName, quiet: Quiet = False, **options: Any) -> None:
    """Say which time step is safe for SCENE, and what limits it, before anything runs."""
    from taichi_sim.reports import check as stability_report

    job = Job(scene, options)
    job.options["settle"] = False  # the step that is safe is so at rest, too
    with job.simulation() as sim:
        sim.contacts()  # warns of balls that overlap deeply at the start
        echo("\n".join(stability_report.lines(sim)))


@subcommand("quantity", "arch", "threads", "set", "allow_outside")
def report(
    context: typer.Context,
    scene: Annotated[str | None, scene_argument("[SCENE]")] = None,
    hard_cases: Annotated[
        bool, flag("hard-cases", "Instead: verdicts on the hard cases, for each contact rule and method.")
    ] = False,
    methods: Annotated[str | None, typer.Option(help="Integrators, like verlet,rk4; all of them otherwise.")] = None,
    dts: Annotated[str | None, typer.Option(help="Steps in seconds, like 1e-3,5e-4; halvings otherwise.")] = None,
    precision: Precisions = None,
    tolerance: Annotated[str, typer.Option(help="An error that you would accept, relative to the motion.")] = "1e-3",
    resolutions: Annotated[bool, flag("resolutions", "Find the error of the mesh, too.")] = False,
    duration: Compared = None,
    limit: Limit = 4.0,
    out: Annotated[str | None, typer.Option("--out", "-o", help="Folder of the pages; NAME_report otherwise.")] = None,
    overwrite: Annotated[bool, flag("overwrite", "Replace a report of something else in that folder.")] = False,
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """Speed against error of SCENE, for methods, steps and precisions; an interrupted report goes on when it is run again.
    With --hard-cases: verdicts on what breaks simulators; exit status 1 if a case passes with none."""
    if hard_cases:
        if scene is not None:
            raise ValueError(f"report: --hard-cases takes no scene, but {scene!r} was given")
        takes_only(context, ("hard_cases", "scene"), "report: --hard-cases takes no other option")
        from taichi_sim.benchmark.hard_cases import contact_cases

        if not contact_cases.main():
            raise typer.Exit(FAILED)
        return
    if scene is None:
        raise ValueError("report: give a SCENE, or --hard-cases")
    from pathlib import Path

    from taichi_sim.reports.speed_error import command

    options |= {"methods": methods, "dts": dts, "precision": precision, "tolerance": tolerance, "duration": duration}
    parameters = paths_and_values("--set", options.pop("set") or ())
    from taichi_sim.reports.speed_error.report import main as make
    from taichi_sim.reports.speed_error.resolution import finer

    with waiting("reading the scene", not quiet):  # which settling takes long for
        file, made, plan = command.read(scene, limit=limit, resolutions=resolutions, parameters=parameters, **options)
        meshes = finer(file, parameters=parameters) if resolutions else []
    folder = Path(out or f"{file.stem}_report")
    say = say_nothing if quiet else echo
    make(made, plan, folder, meshes=meshes, overwrite=overwrite, progress=not quiet, say=say)


@subcommand("quantity", "arch", "threads", "set", "allow_outside")
def tune(
    scene: SceneName,
    tolerance: Annotated[str, typer.Option(help="The error that you accept, relative to the motion.")] = "1e-2",
    methods: Annotated[str | None, typer.Option(help="Integrators to choose from, like verlet,rk4.")] = None,
    precision: Precisions = None,
    duration: Compared = None,
    limit: Limit = 4.0,
    write: Annotated[bool, flag("write", "Write the settings into the scene file.")] = False,
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """Find the method, step and precision that meet a tolerance in SCENE at the least cost."""
    from taichi_sim.analysis.outcome import has_mesh
    from taichi_sim.reports.speed_error import command
    from taichi_sim.reports.speed_error import tune as tuning
    from taichi_sim.reports.speed_error.resolution import advice

    options |= {"methods": methods, "precision": precision, "tolerance": tolerance, "duration": duration}
    parameters = paths_and_values("--set", options.pop("set") or ())
    with waiting("reading the scene", not quiet):
        file, made, plan = command.read(scene, limit=limit, parameters=parameters, **options)
    if write and parameters:
        raise ValueError(
            "--write: the settings would be of a scene that the file does not hold; leave --set or --write out"
        )
    if write:
        command.require_own_file(scene, file)
    settings = tuning.main(made, plan, progress=not quiet, say=echo)
    if settings is None:
        raise typer.Exit(FAILED)
    if has_mesh(made):
        for line in advice(file, parameters):
            echo(line)
    if write:
        tuning.write_settings(file, settings)
        echo(f"written      {file}")
