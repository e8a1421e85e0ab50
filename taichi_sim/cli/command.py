"""Parts that all commands share: the application, options that several take, a scene with its options, errors of one line."""

import functools
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any

import typer

from taichi_sim.cli.options import paths_and_values, pixels, positive, share, step
from taichi_sim.cli.users_kernels import place_of_error
from taichi_sim.common.atomic_file import naming
from taichi_sim.common.errors import BackendError, UnstableError
from taichi_sim.common.printable import lead_nowhere, printable, told
from taichi_sim.common.progress import log_to
from taichi_sim.common.signals import ENDED, INTERRUPTED, insistent_signals, leave
from taichi_sim.common.version import __version__

FAILED, BAD_INPUT, UNSTABLE = 1, 2, 3  # exit status

main = typer.Typer(
    help="Simulate balls, springs, sticks, walls, cloth and jelly. SCENE is a TOML file, a Python file with scene() or"
    " simulation(), or the name of a demo.",
    epilog="Exit status: 0 done, 1 a hard case failed, tune or fit found nothing or verify found a fault, 2 bad input,"
    " 3 the simulation became unstable, 130 interrupted.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def flag(name: str, what: str) -> Any:
    """An option without a value."""
    return typer.Option(f"--{name}", help=what)


def scene_names(incomplete: str) -> list[str]:
    """Names that a shell may complete to a scene: demos, scene files and folders. Nothing is read."""
    from taichi_sim.files.source import demos

    path = Path(incomplete)
    folder = path if incomplete.endswith("/") else path.parent
    with suppress(OSError):
        there = [one for one in sorted(folder.iterdir()) if one.is_dir() or one.suffix in (".toml", ".py")]
        files = [f"{one}/" if one.is_dir() else str(one) for one in there if not one.name.startswith(".")]
        return [name for name in (*demos(), *files) if name.startswith(incomplete)]
    return [name for name in demos() if name.startswith(incomplete)]


def scene_argument(metavar: str) -> Any:
    """Required, or not where metavar is in brackets and it has a default."""
    says = "A TOML file, a Python file, or a demo's name."
    return typer.Argument(metavar=metavar, help=says, autocompletion=scene_names)


SceneName = Annotated[str, scene_argument("SCENE")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar, no summary.")]
Precisions = Annotated[str | None, typer.Option(help="f64, f32, or f64,f32, which is the default.")]
Compared = Annotated[float | None, typer.Option(help="Simulated seconds to compare; chosen by size otherwise.")]
Codec = Annotated[str | None, typer.Option(help="Of a video: h264 (usual) or h265 for x.mp4, vp9 for x.webm.")]
Transparent = Annotated[bool, flag("transparent", "PNG frames without background and ground, with alpha.")]
Workers = Annotated[int | None, typer.Option(help="Processes; one for each core otherwise, 0: this one alone.")]
Scheduler = Annotated[str | None, typer.Option(metavar="ADDRESS", help="Of a Dask scheduler, instead.")]
Limit = Annotated[float, typer.Option(help="Seconds of processor time that one run may take.")]
# with "threads", arguments of a Simulation; those of PROCESS are given to whatever runs in it
SIMULATION = ("arch", "dt", "tolerance", "integrator", "contacts", "precision", "settle")
PROCESS = ("arch", "precision", "threads")


def subcommand(*shared: str, name: str | None = None) -> Callable[[Callable[..., None]], None]:
    """Make a function a command, which takes the shared options named, and whose errors are one line."""

    def add(function: Callable[..., None]) -> None:
        @functools.wraps(function)
        def command(**given: Any) -> None:
            with plain_errors(), log_to(sys.stdout):
                function(**given)

        main.command(name=name)(share(command, shared))

    return add


@main.callback(invoke_without_command=True)
def _options(version: Annotated[bool, flag("version", "Show it.")] = False) -> None:
    if version:
        with plain_errors():
            echo(f"taichi-sim {__version__}")
        raise typer.Exit


def given_of(options: dict[str, Any]) -> dict[str, Any]:
    """The options that were given, the step as a number."""
    given = {key: value for key, value in options.items() if value is not None}
    return given | {"dt": step(given["dt"])} if "dt" in given else given


class Job:
    """A scene, how to simulate it and how to show it: command line over scene file over defaults."""

    def __init__(self, name: str, options: dict[str, Any]) -> None:
        from taichi_sim.files.source import open_scene, resolve
        from taichi_sim.outputs.quick import output_options

        asked = {key: positive(f"--{key}", options[key]) for key in ("fps", "duration")}
        asked["size"] = pixels(options.get("size"))  # type: ignore[assignment]
        self.options = {**options, "dt": step(options["dt"])}
        self.file = resolve(name)
        self.parameters = paths_and_values("--set", options.get("set") or ())
        self.scene = open_scene(self.file, allow_outside=bool(options["allow_outside"]), parameters=self.parameters)
        self.made = self._made() if self.scene is None else None
        shown: Any = self.scene if self.made is None else self.made.scene
        self.output = output_options(shown, asked)

    def simulation(self, forces: Sequence[Any] = ()) -> Any:
        """The Simulation, with the command line's options over the scene's own; one that a file makes takes no forces."""
        from taichi_sim.simulation.simulation import Simulation

        scene: Any = self.scene
        return self.made or Simulation(scene, forces=forces, **self._given())

    def _given(self) -> dict[str, Any]:
        return {key: self.options[key] for key in (*SIMULATION, "threads") if self.options.get(key) is not None}

    def _made(self) -> Any:
        """Return the Simulation that simulation() of the file makes. Raises ValueError where options or its result do not
        fit."""
        from taichi_sim.device import backend
        from taichi_sim.files.source import open_simulation

        given = self._given()
        for key in given:
            if key not in PROCESS:
                raise ValueError(f"--{key}: {self.file} makes its own simulation(); set it there")
        if given:
            backend.start(**given)
        made = open_simulation(self.file, self.parameters)
        from taichi_sim.simulation.simulation import Simulation

        if not isinstance(made, Simulation):
            raise ValueError(
                f"{self.file}: simulation() returned {type(made).__name__}; it must return a ts.Simulation"
            )
        return made


def echo(text: str, err: bool = False) -> None:
    """A line on standard output or standard error, without control sequences that names in it may hold. Where whoever read has
    gone, as after `| head`, the work goes on unread. Raises OSError where standard output cannot be written."""
    with suppress(OSError) if err else naming("standard output"):  # of errors that nobody reads nothing can be said
        try:
            typer.echo(told(text) if err else printable(text), err=err)
        except BrokenPipeError:
            lead_nowhere(sys.stderr if err else sys.stdout)


def say_nothing(line: str) -> None:
    """Drop a line that would be told on the way, for --quiet."""


@contextmanager
def plain_errors() -> Iterator[None]:
    """Errors as one line on standard error with the exit status they stand for; warnings as one line, too."""
    showwarning = warnings.showwarning
    warnings.showwarning = lambda message, category, *_: echo(f"warning: {message}", err=True)
    try:
        with insistent_signals():
            yield
    except UnstableError as error:
        fail(str(error), UNSTABLE)
    except BrokenPipeError:  # of a table: click ends quietly
        raise
    except Exception as error:
        if (said := _words_of(error)) is None:
            raise
        fail(said, BAD_INPUT)
    except KeyboardInterrupt:
        echo("taichi-sim: interrupted", err=True)
        leave(INTERRUPTED)
    except SystemExit as end:
        if end.code in ENDED:
            echo("taichi-sim: interrupted", err=True)
            leave(int(end.code))
        raise
    finally:
        warnings.showwarning = showwarning


def _words_of(error: Exception) -> str | None:
    """Words on an error that input or the machine is the cause of; None for others."""
    if isinstance(error, OSError) and error.filename is not None:  # as the system gave it
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, (ValueError, BackendError, OSError, ArithmeticError)):  # SceneError is a ValueError
        return str(error)
    if isinstance(error, MemoryError):
        return f"not enough memory for this scene: {error}"
    return place_of_error(error)


def fail(message: str, status: int) -> None:
    """End with one line."""
    echo(f"taichi-sim: {message}".replace("\n", "\\n"), err=True)
    raise typer.Exit(status)
