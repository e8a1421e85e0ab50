"""schema, materials, demos, course: what there is."""

from typing import Annotated, Any

import typer

from taichi_sim.cli.command import Quiet, echo, subcommand
from taichi_sim.cli.options import takes_only


@subcommand()
def schema() -> None:
    """Print the JSON Schema of scene files, by which editors complete and explain them: see docs/scenes.md."""
    import json

    from taichi_sim.files.json_schema import scene_schema

    echo(json.dumps(scene_schema(), indent=1))


@subcommand(name="materials")
def list_materials() -> None:
    """List the materials that scenes may name, with their numbers in SI units and where these come from."""
    from dataclasses import asdict

    from taichi_sim.scene.presets import PRESETS, UNITS

    for name, preset in PRESETS.items():
        known = {key: value for key, value in asdict(preset).items() if isinstance(value, float)}
        numbers = [f"{key} {value:.3g} {UNITS.get(key, '')}".rstrip() for key, value in known.items()]
        echo(f"{name}: {', '.join(numbers)}\n    {preset.source}")


@subcommand("size", "fps", "duration", name="demos")
def list_demos(
    context: typer.Context,
    everything: Annotated[bool, typer.Option("--all", help="Make videos of those that have none yet.")] = False,
    out: Annotated[str, typer.Option("--out", "-o", metavar="FOLDER", help="Where to, with --all.")] = "demos_out",
    copy: Annotated[
        str | None, typer.Option(metavar="NAME", help="Copy the file of a demo into this folder, to change it.")
    ] = None,
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """List the built-in scenes, one line each, make videos of them, or copy one."""
    from taichi_sim.files.source import built_in, demos

    known = demos()
    if everything:
        from taichi_sim.outputs.gallery import render_all

        raise typer.Exit(render_all(list(known), out, quiet=quiet, **options))
    if copy is not None:
        takes_only(context, ("quiet", "copy"), "demos: --copy takes no other option")
        from taichi_sim.files.source import copy_demo

        for file in copy_demo(copy):
            echo(f"written      {file}")
        return
    takes_only(context, ("quiet",), "demos: options are for --all")
    width = max(map(len, known), default=0)
    for name, file in known.items():
        echo(f"{name:{width}}  {built_in(file)}".rstrip())


@subcommand()
def course(
    out: Annotated[str | None, typer.Option("--out", "-o", metavar="FOLDER", help="A cache otherwise.")] = None,
    quiet: Quiet = False,
) -> None:
    """Write the course on simulation as HTML pages into a folder, and open them in a browser where there is a display."""
    from taichi_sim.reports.course import show, write

    page = write(out)
    echo(f"written      {page}")
    if not quiet:
        show(page)
