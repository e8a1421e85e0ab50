"""run, render, view: scenes into pictures, files or a window."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import typer

from taichi_sim.cli.command import (
    SIMULATION,
    Codec,
    Job,
    Quiet,
    SceneName,
    Scheduler,
    Transparent,
    Workers,
    echo,
    flag,
    say_nothing,
    subcommand,
)
from taichi_sim.cli.options import interval, keys_and_values, pixels, positive
from taichi_sim.common.errors import UnstableError
from taichi_sim.common.progress import waiting

PAGES = ("host", "port")  # options of those that are served
NAMES = (
    "x.mp4, x.webm, x.gif or x.webp; folder/ for PNG frames; x.npz arrays; x.usdc or x.usda for Blender and others;"
    " x.glb for browsers and others; x.pvd for ParaView; x.gsd for OVITO; x.csv energies and probes; x.ply or x.obj meshes"
)


@subcommand("size", *SIMULATION, "fps", "duration", "threads", "set", "allow_outside", *PAGES)
def run(
    scene: SceneName,
    out: Annotated[
        list[str] | None,
        typer.Option("--out", "-o", metavar="NAME", help=f"{NAMES}. May be given several times."),
    ] = None,
    overwrite: Annotated[bool, flag("overwrite", "Replace the frames in a folder that is not empty.")] = False,
    resume: Annotated[
        bool,
        flag(
            "resume", "Go on with an output that was cut off, from its last checkpoint, with the frames that are kept."
        ),
    ] = False,
    checkpoint: Annotated[
        str | None,
        typer.Option(
            help="Wall time between checkpoints, like 60s or 5m, or off; 60s from the second minute on otherwise."
        ),
    ] = None,
    codec: Codec = None,
    transparent: Transparent = False,
    workers: Annotated[
        int | None, typer.Option(help="Processes that draw, once all is simulated; this one, meanwhile, otherwise.")
    ] = None,
    scheduler: Scheduler = None,
    error: Annotated[
        bool,
        flag(
            "error", "Run SCENE a second time at half the step, and give results with the error of step and rounding."
        ),
    ] = False,
    watch: Annotated[
        bool, flag("watch", "Show the run in a browser, here or elsewhere, while it goes on; needs the extra web.")
    ] = False,
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """Simulate SCENE and write a video, pictures, arrays or files for other programs; without --out show the summary only."""
    from taichi_sim.analysis.frame import frame_count
    from taichi_sim.analysis.outcome import MESH
    from taichi_sim.outputs import export, open_outputs

    page = _page(options, "--watch", watch)
    job = Job(scene, options)
    count = frame_count(job.output["fps"], job.output["duration"])
    if count < 2:
        raise ValueError("fps times duration is less than one frame; raise one of them")
    if transparent:
        job.output["style"]["transparent"] = True
    every = interval("--checkpoint", checkpoint)
    if error and resume:
        raise ValueError("--error: the error of a run that is resumed cannot be estimated; leave --resume out")
    if workers is not None or scheduler is not None:
        if not out or resume or checkpoint or error or watch:
            raise ValueError(
                "--workers and --scheduler need --out, and exclude --resume, --checkpoint, --error and --watch"
            )
        _drawn_apart(job, out, (scheduler, workers), overwrite, codec, quiet)
        return
    names = out or []
    targets: Sequence[Any] = open_outputs(names, fps=job.output["fps"], overwrite=overwrite, resume=resume, codec=codec)
    if transparent and targets and not any(one.needs_image for one in targets):
        for one in targets:
            one.discard()
        raise ValueError(f"--transparent: {names[0]} holds no pictures; write PNG frames, to a folder/")
    if resume and targets:
        names, targets = _to_resume(names, targets, count)
        if not targets:
            return
    if not targets and (overwrite or resume or codec or transparent or checkpoint):
        raise ValueError("--overwrite, --resume, --checkpoint, --codec and --transparent need --out")
    try:
        with ExitStack() as stack:
            view = None
            if watch:
                from taichi_sim.viewer.web import LiveView

                view = stack.enter_context(LiveView(**page, title=job.file.stem, style=job.output["style"]))
                echo(f"open         {view.url}")
            begin = perf_counter()
            with waiting("reading the scene", not quiet):
                sim = stack.enter_context(job.simulation())
            reading = perf_counter() - begin
            if view is not None:
                view.wait(sim, pictures=any(one.needs_image for one in targets))
            see = None if view is None else view.show
            summary = export(sim, targets, progress=not quiet, checkpoint=every, error=error, watch=see, **job.output)
    except BaseException as ended:
        for name, target in zip(names, targets):
            if isinstance(ended, UnstableError) and target.frames:
                echo(f"{name}: holds the {_frames(target.frames)} until then", err=True)
                continue
            target.discard()
            if says := _kept(target, error):
                echo(f"{name}: {says}", err=True)
        raise
    if not quiet:
        summary.reading = reading
        written = [target.pattern or name for name, target in zip(names, targets)]
        lines = [*summary.lines(), *(f"written      {name}" for name in written)]
        if MESH in summary.left_out:
            from taichi_sim.reports.speed_error.resolution import advice

            lines += advice(job.file, job.parameters)
        echo("\n".join(lines))


def _kept(target: Any, error: bool) -> str:
    """Words on what is kept of an output whose run was interrupted; empty where nothing is. error: its error was asked for."""
    on = "--resume without --error goes on with" if error else "--resume goes on with"
    whole = target.path is not None and target.frames
    number = target.frames if whole else target.simulated
    if not number:
        return ""
    are, them = ("is", "it") if number == 1 else ("are", "them")
    if whole and target.log.checkpoint is not None:
        return f"{_frames(number)} and a checkpoint are kept; {on} them"
    return f"{_frames(number)} {are} {'kept' if whole else 'simulated, and kept'}; {on} {them}"


def _frames(number: int) -> str:
    return f"{number} frame{'s' * (number != 1)}"


def _to_resume(names: Sequence[str], targets: Sequence[Any], count: int) -> tuple[list[str], list[Any]]:
    """Names and outputs that are still to be written, of those to be resumed; what there is of each is said here."""
    left = []
    for name, target in zip(names, targets):
        if target.path is not None and target.is_finished(count):
            echo(f"{name}: is complete, and is left as it is; without --resume it is made anew", err=True)
            target.leave_as_it_is()
            continue
        left.append((name, target))
        if target.path is not None and not target.log.resumes:
            there = "nothing is kept of the run that wrote it; it is made anew" if Path(name).exists() else ""
            echo(f"{name}: {there or 'nothing is kept of it; it begins at the first frame'}", err=True)
    return [name for name, _ in left], [target for _, target in left]


def _drawn_apart(
    job: Job,
    out: Sequence[str],
    where: tuple[str | None, int | None],
    overwrite: bool,
    codec: str | None,
    quiet: bool,
) -> None:
    """Simulate into a recording beside the first output, and draw that by many processes."""
    from taichi_sim.common.atomic_file import locking
    from taichi_sim.outputs import export, open_outputs
    from taichi_sim.outputs.base import require_alpha
    from taichi_sim.outputs.quick import picture
    from taichi_sim.outputs.recording import require_drawable
    from taichi_sim.studies.workers import require_workers
    from taichi_sim.sweeps.pictures import draw

    first = Path(out[0])
    recording = first.with_name(f".{first.name}.states.npz")
    options = {**job.output}
    style, size = options.pop("style"), options["size"]
    # what is not allowed is refused before anything runs
    opened = open_outputs(out, fps=job.output["fps"], overwrite=overwrite, codec=codec)
    for one in opened:
        one.discard()
    require_alpha(opened, style)
    require_workers(*where)
    end: UnstableError | None = None
    # nobody else writes, or draws, the recording before this has drawn it
    with locking(first.with_name(f".{first.name}.lock"), f"{first}: another run is writing it; wait for it"):
        with job.simulation() as sim:
            require_drawable(sim.scene)
            precision = sim.backend.precision
            if any(one.needs_image for one in opened):
                picture(sim, size=size, **style)
            try:
                summary = export(
                    sim, open_outputs([recording], fps=options["fps"]), progress=not quiet, checkpoint=None, **options
                )
            except UnstableError as error:
                if not recording.is_file():
                    raise
                end = error  # the frames until then are drawn
        start = perf_counter()
        try:
            draw(
                recording, out, size=size, style=style, fps=job.output["fps"], scheduler=where[0], workers=where[1],
                overwrite=overwrite, codec=codec, precision=precision, progress=not quiet,
                say=say_nothing if quiet else echo,
            )  # fmt: skip
        except BaseException:
            echo(f"{recording}: holds the run; `taichi-sim render` draws it", err=True)
            raise
        recording.unlink(missing_ok=True)
    if end is not None:
        raise end
    spent = perf_counter() - start
    summary.drawing += spent
    summary.wall += spent
    if not quiet:
        echo("\n".join([*summary.lines(), *(f"written      {name}" for name in out)]))


@subcommand("size", "fps")
def render(
    recording: Annotated[str, typer.Argument(metavar="STATES.npz", help="What `run SCENE -o STATES.npz` wrote.")],
    out: Annotated[
        list[str], typer.Option("--out", "-o", metavar="NAME", help=f"{NAMES}. May be given several times.")
    ],
    style: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUE",
            help="A key of [output] over the scene's, like colour=speed or camera.azimuth=40. May be given several times.",
        ),
    ] = None,
    overwrite: Annotated[bool, flag("overwrite", "Replace the frames in a folder that is not empty.")] = False,
    codec: Codec = None,
    transparent: Transparent = False,
    workers: Workers = None,
    scheduler: Scheduler = None,
    precision: Annotated[str | None, typer.Option(help="f32 or f64, as of the run; f32 otherwise.")] = None,
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """Draw a run that was written as arrays, without simulating again: in another style, by many processes. All its frames are
    drawn; --fps shows them faster or slower."""
    from taichi_sim.sweeps.pictures import draw

    chosen = keys_and_values("--style", style or ())
    if transparent:
        chosen["transparent"] = True
    count = draw(
        recording, out, size=pixels(options["size"]), style=chosen, fps=positive("--fps", options["fps"]), workers=workers,
        scheduler=scheduler, overwrite=overwrite, codec=codec, precision=precision, progress=not quiet,
        say=say_nothing if quiet else echo,
    )  # fmt: skip
    if not quiet:
        echo("\n".join(f"written      {name}: {_frames(count)}" for name in out))


@subcommand("size", *SIMULATION, "fps", "duration", "threads", "set", "allow_outside", *PAGES)
def view(
    scene: SceneName,
    web: Annotated[
        bool, flag("web", "In a browser, here or elsewhere, instead of a window; needs the extra web.")
    ] = False,
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """Show SCENE live: drag balls, turn and zoom the view with the mouse; space pauses, h lists the keys, esc quits."""
    page = _page(options, "--web", web)
    if not web:
        from taichi_sim.viewer.window import require_display

        require_display()
    job = Job(scene, options)
    style = {key: value for key, value in job.output["style"].items() if key not in ("transparent", "overlay")}
    shown = {"fps": job.output["fps"], "style": style, "until": options["duration"]}
    if web:
        from taichi_sim.viewer import web as browser

        browser.show(job.simulation, **shown, **page, title=job.file.stem, say=echo)
        return
    from taichi_sim.viewer import window

    window.show(job.simulation, **shown, size=job.output["size"], say=say_nothing if quiet else echo)


def _page(options: dict[str, Any], option: str, is_wanted: bool) -> dict[str, Any]:
    """The options of PAGES that were given. Raises ValueError where there are to be no pages."""
    given = {key: value for key in PAGES if (value := options.pop(key)) is not None}
    if given and not is_wanted:
        raise ValueError(f"--{next(iter(given))} needs {option}")
    return given
