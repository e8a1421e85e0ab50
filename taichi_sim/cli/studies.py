"""sweep, fit: one scene many times."""

from typing import Annotated, Any

import typer

from taichi_sim.cli.command import (
    FAILED,
    SIMULATION,
    Quiet,
    SceneName,
    Scheduler,
    Workers,
    echo,
    flag,
    given_of,
    say_nothing,
    subcommand,
)

SHOWN = 5  # failed points of a sweep


@subcommand(*SIMULATION, "fps", "duration", "allow_outside")
def sweep(
    scene: SceneName,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            help="PATH=VALUES, like materials.rubber.restitution=0.1:0.9:9, cloth[0].stiffness=1e2:1e4:5:log or"
            " simulation.dt=1e-3,5e-4; a range like 0.1:0.9 for designs that sample. May be given several times."
        ),
    ] = None,
    seeds: Annotated[int | None, typer.Option(help="Runs of each point, each with another seed.")] = None,
    measure: Annotated[
        list[str] | None,
        typer.Option(
            help="probes.NAME, energy.total, penetration, ..., with .max, .min or .mean for that of all frames, or"
            " module:function; all probes otherwise. May be given several times."
        ),
    ] = None,
    out: Annotated[str | None, typer.Option("--out", "-o", help="Folder of the table; NAME_sweep otherwise.")] = None,
    design: Annotated[str, typer.Option(help="product, random, latin or sobol.")] = "product",
    points: Annotated[int | None, typer.Option(help="How many, of designs that sample.")] = None,
    luck: Annotated[int, typer.Option(help="Random seed of the sample.")] = 0,
    workers: Workers = None,
    scheduler: Scheduler = None,
    overwrite: Annotated[bool, flag("overwrite", "Replace another sweep in that folder.")] = False,
    retry: Annotated[bool, flag("retry", "Run points that failed once more.")] = False,
    yes: Annotated[bool, flag("yes", "Run more than 100 000 points.")] = False,
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """Run SCENE many times, with other parameters and seeds, into a table; the same command goes on where it was interrupted."""
    from pathlib import Path

    from taichi_sim.files.source import resolve
    from taichi_sim.sweeps.sweep import sweep as run_all

    given = given_of(options)
    folder = Path(out or f"{resolve(scene).stem}_sweep")
    say = say_nothing if quiet else echo
    try:
        done = run_all(
            scene, vary or (), seeds=seeds, measure=measure, design=design, points=points, luck=luck, folder=folder,
            workers=workers, scheduler=scheduler, overwrite=overwrite, retry=retry, yes=yes, progress=not quiet, say=say, **given,
        )  # fmt: skip
    except (KeyboardInterrupt, SystemExit):
        if folder.is_dir():
            echo(f"{folder}: keeps the points that are done; the same command goes on", err=True)
        raise
    if not quiet:
        for line in done.lines():
            echo(line)
        for row in done.failed[:SHOWN]:
            at = ", ".join(f"{name} {value}" for name, value in row.parameters.items())
            echo(f"failed       {at}: {row.error}")
        if len(done.failed) > SHOWN:
            echo(f"failed       {len(done.failed) - SHOWN} more, see the table")
        echo(f"written      {folder}: {len(done)} points, {len(done.failed)} of them failed; see report.html")


@subcommand(*SIMULATION, "fps", "duration", "allow_outside")
def fit(
    scene: SceneName,
    vary: Annotated[
        list[str] | None,
        typer.Option(help="PATH=RANGE, like cloth[0].stiffness=1e2:1e4:log. May be given several times."),
    ] = None,
    target: Annotated[
        list[str] | None,
        typer.Option(
            metavar="MEASURE=VALUE",
            help="What is measured, as of sweep, and what it should be, like probes.tip.y=-0.12. May be given several times.",
        ),
    ] = None,
    method: Annotated[
        str, typer.Option(help="nelder-mead, or evolution where there may be several optima.")
    ] = "nelder-mead",
    misfit: Annotated[float, typer.Option(help="How far from the target it may be, relative.")] = 1e-3,
    runs: Annotated[int, typer.Option(help="Points at most.")] = 100,
    seeds: Annotated[
        int | None, typer.Option(help="Runs of each point, each with another seed; their mean counts.")
    ] = None,
    luck: Annotated[int, typer.Option(help="Seed of what is chosen by chance.")] = 0,
    out: Annotated[
        str | None, typer.Option("--out", "-o", help="Folder that keeps all runs; the same command goes on.")
    ] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    overwrite: Annotated[bool, flag("overwrite", "Replace another fit in that folder.")] = False,
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """Find the parameters by which SCENE measures given values, and how well these tell them; exit status 1 where none do."""
    from taichi_sim.common.errors import SceneError
    from taichi_sim.sweeps.fit import fit as find

    given = given_of(options)
    goal: dict[str, float] = {}
    for text in target or ():
        name, _, value = text.rpartition("=")
        if name in goal:
            raise SceneError("target", text, says=f"gives {name} another value than before; give it once")
        try:
            goal[name] = float(value)
        except ValueError:
            raise SceneError("target", text, "MEASURE=VALUE, like probes.tip.y=-0.12") from None
    found = find(
        scene, vary or (), goal, method=method, misfit=misfit, runs=runs, seeds=seeds, luck=luck, folder=out,
        workers=workers, scheduler=scheduler, overwrite=overwrite, say=say_nothing if quiet else echo, **given,
    )  # fmt: skip
    for line in found.lines():
        echo(line)
    if not found.reached:
        raise typer.Exit(FAILED)
