"""The taichi-sim command. It imports nothing heavy before it knows what to do."""

import functools
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from typing import Annotated, Any

import typer

from taichi_sim.cli.options import interval, keys_and_values, pixels, positive, share, step, takes_only
from taichi_sim.common.errors import BackendError, UnstableError
from taichi_sim.common.signals import INTERRUPTED, TERMINATED, insistent_signals, leave
from taichi_sim.common.version import __version__

FAILED, BAD_INPUT, UNSTABLE = 1, 2, 3
SHOWN = 5  # failed points of a sweep
NAMES = (
    "x.mp4, x.webm, x.gif or x.webp; folder/ for PNG frames; x.npz arrays; x.usdc or x.usda for Blender and others;"
    " x.pvd for ParaView; x.gsd for OVITO; x.csv energies and probes; x.ply or x.obj meshes"
)

main = typer.Typer(
    help="Simulate balls, springs, sticks, walls, cloth and jelly. SCENE is a TOML file, a Python file with scene() or"
    " simulation(), or the name of a demo.",
    epilog="Exit status: 0 done, 1 a hard case failed, tune or fit found nothing or verify found a fault, 2 bad input,"
    " 3 the simulation became unstable, 130 interrupted.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _flag(name: str, what: str) -> Any:
    return typer.Option(f"--{name}", help=what)


def _scene(metavar: str) -> Any:
    return typer.Argument(metavar=metavar, help="A TOML file, a Python file, or a demo's name.")


SceneName = Annotated[str, _scene("SCENE")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar, no summary.")]
Precisions = Annotated[str | None, typer.Option(help="f64, f32, or f64,f32, which is the default.")]
Compared = Annotated[float | None, typer.Option(help="Simulated seconds to compare; chosen by size otherwise.")]
Codec = Annotated[str | None, typer.Option(help="Of a video: h264 (usual) or h265 for x.mp4, vp9 for x.webm.")]
Transparent = Annotated[bool, _flag("transparent", "PNG frames without background and ground, with alpha.")]
Workers = Annotated[int | None, typer.Option(help="Processes; one for each core otherwise, 0: this one alone.")]
Scheduler = Annotated[str | None, typer.Option(metavar="ADDRESS", help="Of a Dask scheduler, instead.")]
Limit = Annotated[float, typer.Option(help="Wall seconds that one run may take.")]
SIMULATION = ("arch", "dt", "tolerance", "integrator", "precision")  # with "threads", arguments of a Simulation


def _command(*shared: str, name: str | None = None) -> Callable[[Callable[..., None]], None]:
    """Make a function a command, which takes the shared options named, and whose errors are one line."""

    def add(function: Callable[..., None]) -> None:
        @functools.wraps(function)
        def command(**given: Any) -> None:
            with _plain_errors():
                function(**given)

        main.command(name=name)(share(command, shared))

    return add


@main.callback(invoke_without_command=True)
def _options(version: Annotated[bool, _flag("version", "Show it.")] = False) -> None:
    if version:
        typer.echo(f"taichi-sim {__version__}")
        raise typer.Exit


# Commands ----------------------------------------------------------------------------------------------------------


@_command("size", *SIMULATION, "fps", "duration", "threads", "allow_outside")
def run(
    scene: SceneName,
    out: Annotated[
        list[str] | None,
        typer.Option("--out", "-o", metavar="NAME", help=f"{NAMES}. May be given several times."),
    ] = None,
    overwrite: Annotated[bool, _flag("overwrite", "Replace the frames in a folder that is not empty.")] = False,
    resume: Annotated[
        bool,
        _flag(
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
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """Simulate SCENE and write a video, pictures, arrays or files for other programs; without --out show the summary only."""
    from taichi_sim.outputs import export, open_outputs
    from taichi_sim.outputs.resumable import Resumable

    job = _Job(scene, options)
    if round(job.output["fps"] * job.output["duration"]) < 1:
        raise ValueError("fps times duration is less than one frame; raise one of them")
    if transparent:
        job.output["style"]["transparent"] = True
    every = interval("--checkpoint", checkpoint)
    if workers is not None or scheduler is not None:
        if not out or resume or checkpoint:
            raise ValueError("--workers and --scheduler need --out, and go neither with --resume nor with --checkpoint")
        _drawn_apart(job, out, (scheduler, workers), overwrite, codec, quiet)
        return
    targets = open_outputs(out or [], fps=job.output["fps"], overwrite=overwrite, resume=resume, codec=codec)
    if resume:
        for name, target in zip(out or [], targets):
            if isinstance(target, Resumable) and not target.log.resumes:
                typer.echo(f"{name}: nothing is kept of it; it begins at the first frame", err=True)
    if not targets and (overwrite or resume or codec or transparent or checkpoint):
        raise ValueError("--overwrite, --resume, --checkpoint, --codec and --transparent need --out")
    try:
        with _waiting("reading the scene", not quiet):
            sim = job.simulation()
        with sim:
            summary = export(sim, targets, progress=not quiet, checkpoint=every, **job.output)
    except BaseException as error:
        for name, target in zip(out or [], targets):
            if isinstance(error, UnstableError) and target.frames:
                typer.echo(f"{name}: holds the {target.frames} frames until then", err=True)
                continue
            target.discard()
            if target.frames:
                typer.echo(f"{name}: {target.frames} frames are kept; --resume goes on with them", err=True)
            elif target.simulated:
                says = f"{target.simulated} frames are simulated, and kept; --resume goes on with them"
                typer.echo(f"{name}: {says}", err=True)
        raise
    if not quiet:
        written = [target.pattern or name for name, target in zip(out or [], targets)]
        typer.echo("\n".join([*summary.lines(), *(f"written      {name}" for name in written)]))


def _drawn_apart(
    job: "_Job",
    out: Sequence[str],
    where: tuple[str | None, int | None],
    overwrite: bool,
    codec: str | None,
    quiet: bool,
) -> None:
    """Simulate into a recording beside the first output, and draw that by many processes."""
    from pathlib import Path
    from time import perf_counter

    from taichi_sim.common.atomic_file import locking
    from taichi_sim.outputs import export, open_outputs
    from taichi_sim.outputs.base import require_alpha
    from taichi_sim.outputs.quick import picture
    from taichi_sim.outputs.recording import require_drawable
    from taichi_sim.sweeps.cluster import require_workers
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
                overwrite=overwrite, codec=codec, precision=precision, progress=not quiet, say=_quiet if quiet else typer.echo,
            )  # fmt: skip
        except BaseException:
            typer.echo(f"{recording}: holds the run; `taichi-sim render` draws it", err=True)
            raise
        recording.unlink(missing_ok=True)
    if end is not None:
        raise end
    spent = perf_counter() - start
    summary.drawing += spent
    summary.wall += spent
    if not quiet:
        typer.echo("\n".join([*summary.lines(), *(f"written      {name}" for name in out)]))


@_command("size", "fps")
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
    overwrite: Annotated[bool, _flag("overwrite", "Replace the frames in a folder that is not empty.")] = False,
    codec: Codec = None,
    transparent: Transparent = False,
    workers: Workers = None,
    scheduler: Scheduler = None,
    precision: Annotated[str | None, typer.Option(help="f32 or f64, as of the run; f32 otherwise.")] = None,
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """Draw a run that was written as arrays, without simulating again: in another style, by many processes."""
    from taichi_sim.sweeps.pictures import draw

    chosen = keys_and_values("--style", style or ())
    if transparent:
        chosen["transparent"] = True
    count = draw(
        recording, out, size=pixels(options["size"]), style=chosen, fps=positive("--fps", options["fps"]), workers=workers,
        scheduler=scheduler, overwrite=overwrite, codec=codec, precision=precision, progress=not quiet,
        say=_quiet if quiet else typer.echo,
    )  # fmt: skip
    if not quiet:
        typer.echo("\n".join(f"written      {name}: {count} frames" for name in out))


@_command("size", *SIMULATION, "fps", "duration", "threads", "allow_outside")
def view(scene: SceneName, quiet: Quiet = False, **options: Any) -> None:
    """Show SCENE live: drag balls, turn and zoom the view with the mouse; space pauses, h lists the keys, esc quits."""
    from taichi_sim.viewer.window import require_display, show

    require_display()
    job = _Job(scene, options)
    output = {key: job.output[key] for key in ("fps", "size", "style")}
    output["style"].pop("transparent", None)
    show(job.simulation, **output, until=options["duration"], say=_quiet if quiet else typer.echo)


@_command(*SIMULATION, "fps", "duration", "threads", "allow_outside")
def check(scene: SceneName, quiet: Quiet = False, **options: Any) -> None:
    """Say which time step is safe for SCENE, and what limits it, before anything runs."""
    from taichi_sim.reports import check as stability_report

    with _Job(scene, options).simulation() as sim:
        typer.echo("\n".join(stability_report.lines(sim)))


@_command("quantity", "arch", "threads", "allow_outside")
def report(
    context: typer.Context,
    scene: Annotated[str | None, _scene("[SCENE]")] = None,
    hard_cases: Annotated[
        bool, _flag("hard-cases", "Instead: verdicts on the hard cases, for each contact rule and method.")
    ] = False,
    methods: Annotated[str | None, typer.Option(help="Integrators, like verlet,rk4; all of them otherwise.")] = None,
    dts: Annotated[str | None, typer.Option(help="Steps in seconds, like 1e-3,5e-4; halvings otherwise.")] = None,
    precision: Precisions = None,
    tolerance: Annotated[str, typer.Option(help="An error that you would accept, relative to the motion.")] = "1e-3",
    resolutions: Annotated[bool, _flag("resolutions", "Find the error of the mesh, too.")] = False,
    duration: Compared = None,
    limit: Limit = 4.0,
    out: Annotated[str | None, typer.Option("--out", "-o", help="Folder of the pages; NAME_report otherwise.")] = None,
    overwrite: Annotated[bool, _flag("overwrite", "Replace a report of something else in that folder.")] = False,
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """Speed against error of SCENE, for methods, steps and precisions; an interrupted report goes on when it is run again.
    With --hard-cases: verdicts on what breaks simulators; exit status 1 if a case passes with none."""
    if hard_cases:
        if scene is not None:
            raise ValueError(f"report: --hard-cases takes no scene, but {scene!r} was given")
        takes_only(context, ("hard_cases", "scene"), "report: --hard-cases takes no other option")
        from taichi_sim.reports.hard_cases import contacts as cases

        if not cases.main():
            raise typer.Exit(FAILED)
        return
    if scene is None:
        raise ValueError("report: give a SCENE, or --hard-cases")
    from pathlib import Path

    from taichi_sim.reports.speed_error import command

    options |= {"methods": methods, "dts": dts, "precision": precision, "tolerance": tolerance, "duration": duration}
    file, made, plan = command.read(scene, limit=limit, resolutions=resolutions, **options)
    from taichi_sim.reports.speed_error.report import main as make
    from taichi_sim.reports.speed_error.resolution import finer

    meshes = finer(file) if resolutions else []
    folder = Path(out or f"{file.stem}_report")
    say = _quiet if quiet else typer.echo
    make(made, plan, folder, meshes=meshes, overwrite=overwrite, progress=not quiet, say=say)


@_command("quantity", "arch", "threads", "allow_outside")
def tune(
    scene: SceneName,
    tolerance: Annotated[str, typer.Option(help="The error that you accept, relative to the motion.")] = "1e-2",
    methods: Annotated[str | None, typer.Option(help="Integrators to choose from, like verlet,rk4.")] = None,
    precision: Precisions = None,
    duration: Compared = None,
    limit: Limit = 4.0,
    write: Annotated[bool, _flag("write", "Write the settings into the scene file.")] = False,
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """Find the method, step and precision that meet a tolerance in SCENE at the least cost."""
    from taichi_sim.reports.speed_error import command
    from taichi_sim.reports.speed_error import tune as tuning

    options |= {"methods": methods, "precision": precision, "tolerance": tolerance, "duration": duration}
    file, made, plan = command.read(scene, limit=limit, **options)
    if write:
        command.require_own_file(scene, file)
    settings = tuning.main(made, plan, progress=not quiet, say=typer.echo)
    if settings is None:
        raise typer.Exit(FAILED)
    if write:
        tuning.write_settings(file, settings)
        typer.echo(f"written      {file}")


@_command(*SIMULATION, "fps", "duration", "allow_outside")
def sweep(
    scene: SceneName,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            help="PATH=VALUES, like materials.rubber.restitution=0.1:0.9:9, cloth[0].stiffness=1e2:1e4:5:log or dt=1e-3,5e-4; a"
            " range like 0.1:0.9 for designs that sample. May be given several times."
        ),
    ] = None,
    seeds: Annotated[int | None, typer.Option(help="How often each point is run, with other chance.")] = None,
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
    luck: Annotated[int, typer.Option(help="Seed of the sample.")] = 0,
    workers: Workers = None,
    scheduler: Scheduler = None,
    overwrite: Annotated[bool, _flag("overwrite", "Replace another sweep in that folder.")] = False,
    retry: Annotated[bool, _flag("retry", "Run points that failed once more.")] = False,
    yes: Annotated[bool, _flag("yes", "Run more than 100 000 points.")] = False,
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """Run SCENE many times, with other parameters and seeds, into a table; the same command goes on where it was interrupted."""
    from pathlib import Path

    from taichi_sim.files.source import resolve
    from taichi_sim.sweeps.sweep import sweep as run_all

    given = _given(options)
    folder = Path(out or f"{resolve(scene).stem}_sweep")
    say = _quiet if quiet else typer.echo
    try:
        done = run_all(
            scene, vary or (), seeds=seeds, measure=measure, design=design, points=points, luck=luck, folder=folder,
            workers=workers, scheduler=scheduler, overwrite=overwrite, retry=retry, yes=yes, progress=not quiet, say=say, **given,
        )  # fmt: skip
    except (KeyboardInterrupt, SystemExit):
        if folder.is_dir():
            typer.echo(f"{folder}: keeps the points that are done; the same command goes on", err=True)
        raise
    if not quiet:
        for row in done.failed[:SHOWN]:
            at = ", ".join(f"{name} {value}" for name, value in row.parameters.items())
            typer.echo(f"failed       {at}: {row.error}")
        if len(done.failed) > SHOWN:
            typer.echo(f"failed       {len(done.failed) - SHOWN} more, see the table")
        typer.echo(f"written      {folder}: {len(done)} points, {len(done.failed)} of them failed; see report.html")


@_command(*SIMULATION, "fps", "duration", "allow_outside")
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
        int | None, typer.Option(help="How often each point is run, with other chance; the mean counts.")
    ] = None,
    luck: Annotated[int, typer.Option(help="Seed of what is chosen by chance.")] = 0,
    out: Annotated[
        str | None, typer.Option("--out", "-o", help="Folder that keeps all runs; the same command goes on.")
    ] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    overwrite: Annotated[bool, _flag("overwrite", "Replace another fit in that folder.")] = False,
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """Find the parameters by which SCENE measures given values, and how well these tell them; exit status 1 where none do."""
    from taichi_sim.common.errors import SceneError
    from taichi_sim.sweeps.fit import fit as find

    given = _given(options)
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
        workers=workers, scheduler=scheduler, overwrite=overwrite, say=_quiet if quiet else typer.echo, **given,
    )  # fmt: skip
    for line in found.lines():
        typer.echo(line)
    if not found.reached:
        raise typer.Exit(FAILED)


@_command()
def devices() -> None:
    """List what this machine can compute on, and test whether it computes right."""
    from time import perf_counter

    from rich.console import Console
    from rich.table import Table

    from taichi_sim.device import backend, devices
    from taichi_sim.device.engine import ENGINE, VERSION

    table = Table("arch", "device", "memory", "precision", "self-test")
    for arch in reversed(backend.AUTOMATIC):
        device = devices.find(arch)
        if device is None:
            table.add_row(arch, "none found")
            continue
        start = perf_counter()
        wrong = devices.verdict(device, f"{ENGINE} {VERSION}", again=True)
        said = wrong or f"passed in {perf_counter() - start:.1f} s"
        if device.software:
            said += "; in software, so never taken without being asked for"
        memory = f"{device.memory / 2**30:.1f} GiB" if device.memory else "?"
        table.add_row(arch, device.words, memory, "f32, f64" if arch in backend.WIDE_ARCHES else "f32", said)
    Console().print(table)


@_command("arch")
def verify(**options: Any) -> None:
    """Test an installation: small scenes against stored results. To be sent with a bug report.

    What a scene is off by: its positions as a part of its size, or its energy as a part of that exchanged, whichever is more.
    """
    from taichi_sim.reports import verify as verification

    off, ran = [], 0
    for result in verification.results(options["arch"]):
        if result.failed:
            said = result.failed
        elif result.deviation is None:
            said = "runs on a CPU alone"
        else:
            said = f"off by {result.deviation:.1e} of its size or energy, allowed {verification.TOLERANCE:.0e}"
        typer.echo(f"{'passed' if result.passed else 'WRONG':7} {result.name}: {said}")
        off += [] if result.passed else [result.name]
        ran += result.failed != "" or result.deviation is not None
    typer.echo(verification.installation())
    if off:
        _fail(f"{len(off)} of {ran} failed: {'; '.join(off)}", FAILED)
    typer.echo(f"all {ran} passed")


@_command("arch")
def bench(
    names: Annotated[list[str] | None, typer.Argument(metavar="[CASE ...]")] = None,
    quick: Annotated[bool, _flag("quick", "Tiny sizes, to try it out.")] = False,
    json: Annotated[str | None, typer.Option(metavar="FILE", help="Where all numbers go.")] = None,
    checks: Annotated[
        bool,
        _flag(
            "checks", "First the device's self-test, and in a source folder its tests; exit status 1 where one fails."
        ),
    ] = False,
    **options: Any,
) -> None:
    """Run the benchmark, beside its reference implementations: on the CPU, or the device that --arch names."""
    from taichi_sim.reports.bench import main as benchmark

    arch = options["arch"] or "cpu"
    if not benchmark.main(names or [], quick=quick, arch=arch, file=json, checks=checks):
        raise typer.Exit(FAILED)


@_command()
def schema() -> None:
    """Print the JSON Schema of scene files, by which editors complete and explain them: see docs/scenes.md."""
    import json

    from taichi_sim.files.json_schema import scene_schema

    typer.echo(json.dumps(scene_schema(), indent=1))


@_command(name="materials")
def list_materials() -> None:
    """List the materials that scenes may name, with their numbers in SI units and where these come from."""
    from dataclasses import asdict

    from taichi_sim.scene.presets import PRESETS

    for name, preset in PRESETS.items():
        numbers = [f"{key} {value:.3g}" for key, value in asdict(preset).items() if isinstance(value, float)]
        typer.echo(f"{name}: {', '.join(numbers)}\n    {preset.source}")


@_command("size", "fps", "duration", name="demos")
def list_demos(
    context: typer.Context,
    everything: Annotated[bool, typer.Option("--all", help="Make videos of those that have none yet.")] = False,
    out: Annotated[str, typer.Option("--out", "-o", metavar="FOLDER", help="Where to, with --all.")] = "demos_out",
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """List the built-in scenes, one line each, or make videos of them."""
    from taichi_sim.files.source import built_in, demos

    known = demos()
    if everything:
        from taichi_sim.outputs.gallery import render_all

        raise typer.Exit(render_all(list(known), out, quiet=quiet, **options))
    takes_only(context, ("quiet",), "demos: options are for --all")
    width = max(map(len, known), default=0)
    for name, file in known.items():
        typer.echo(f"{name:{width}}  {built_in(file)}".rstrip())


# What they share ---------------------------------------------------------------------------------------------------


def _given(options: dict[str, Any]) -> dict[str, Any]:
    """The options that were given, the step as a number."""
    given = {key: value for key, value in options.items() if value is not None}
    return given | {"dt": step(given["dt"])} if "dt" in given else given


class _Job:
    """A scene, how to simulate it and how to show it: command line over scene file over defaults."""

    def __init__(self, name: str, options: dict[str, Any]) -> None:
        from taichi_sim.files.source import open_scene, resolve
        from taichi_sim.outputs.quick import output_options

        asked = {key: positive(f"--{key}", options[key]) for key in ("fps", "duration")}
        asked["size"] = pixels(options.get("size"))  # type: ignore[assignment]
        self.options = {**options, "dt": step(options["dt"])}
        self.file = resolve(name)
        self.scene = open_scene(self.file, allow_outside=bool(options["allow_outside"]))
        self.made = self._made() if self.scene is None else None
        shown: Any = self.scene if self.made is None else self.made.scene
        self.output = output_options(shown, asked)

    def simulation(self, forces: Sequence[Any] = ()) -> Any:
        """The Simulation, with the command line's options over the scene's own; one that a file makes takes no forces."""
        from taichi_sim.simulation.simulation import Simulation

        scene: Any = self.scene
        return self.made or Simulation(scene, forces=forces, **self._given())

    def _given(self) -> dict[str, Any]:
        return {key: self.options[key] for key in (*SIMULATION, "threads") if self.options[key] is not None}

    def _made(self) -> Any:
        """What simulation() of the file returns."""
        from taichi_sim.device import backend
        from taichi_sim.files.source import open_simulation

        given = self._given()
        for key in ("dt", "tolerance", "integrator"):
            if key in given:
                raise ValueError(f"--{key}: {self.file} makes its own simulation(); set it there")
        if given:
            backend.start(**given)
        made = open_simulation(self.file)
        from taichi_sim.simulation.simulation import Simulation

        if not isinstance(made, Simulation):
            raise ValueError(
                f"{self.file}: simulation() returned {type(made).__name__}; it must return a ts.Simulation"
            )
        return made


@contextmanager
def _waiting(what: str, shown: bool) -> Iterator[None]:
    """On a terminal, say meanwhile what is waited for."""
    from rich.console import Console

    console = Console(stderr=True)
    with console.status(what) if shown and console.is_terminal else nullcontext():
        yield


def _quiet(line: str) -> None:
    pass


@contextmanager
def _plain_errors() -> Iterator[None]:
    """Errors as one line on standard error with the exit status they stand for; warnings as one line, too."""
    showwarning = warnings.showwarning
    warnings.showwarning = lambda message, category, *_: typer.echo(f"warning: {message}", err=True)
    try:
        with insistent_signals():
            yield
    except UnstableError as error:
        _fail(str(error), UNSTABLE)
    except BrokenPipeError:  # whoever read has gone: click ends quietly
        raise
    except (ValueError, BackendError, OSError, ArithmeticError) as error:  # SceneError is a ValueError
        if isinstance(error, OSError) and error.filename is not None:  # as the system gave it
            _fail(f"{error.filename}: {error.strerror}", BAD_INPUT)
        _fail(str(error), BAD_INPUT)
    except MemoryError as error:
        _fail(f"not enough memory for this scene: {error}", BAD_INPUT)
    except KeyboardInterrupt:
        typer.echo("taichi-sim: interrupted", err=True)
        leave(INTERRUPTED)
    except SystemExit as end:
        if end.code == TERMINATED:
            leave(TERMINATED)
        raise
    finally:
        warnings.showwarning = showwarning


def _fail(message: str, status: int) -> None:
    typer.echo(f"taichi-sim: {message}", err=True)
    raise typer.Exit(status)


if __name__ == "__main__":
    main()
