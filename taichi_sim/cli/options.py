"""Options of the command line: those that several commands share, and what they mean."""

import inspect
from collections.abc import Callable, Iterable, Sequence
from typing import Annotated, Any, Literal

import typer

UNITS = {"s": 1.0, "m": 60.0, "h": 3600.0}  # s
SHARED: dict[str, Any] = {
    "size": Annotated[str | None, typer.Option(help="Size of the pictures in pixels, like 1280x720.")],
    "arch": Annotated[str | None, typer.Option(help="auto, cpu, cuda, vulkan or metal.")],
    "dt": Annotated[str | None, typer.Option("--dt", help="Time step in seconds, or auto.")],
    "tolerance": Annotated[
        float | None,
        typer.Option(
            help="Chooses the step: error allowed in a simulated second, the largest of any ball, as a part of the scene's"
            " longest side."
        ),
    ],
    "integrator": Annotated[
        str | None,
        typer.Option(help="auto, explicit_euler, symplectic_euler, verlet, rk4, xpbd, implicit_euler or tr_bdf2."),
    ],
    "contacts": Annotated[str | None, typer.Option(help="Contact rule: auto, gauss_seidel, jacobi, sum or off.")],
    "precision": Annotated[str | None, typer.Option(help="f32 or f64.")],
    "fps": Annotated[float | None, typer.Option(help="Frames per simulated second.")],
    "duration": Annotated[float | None, typer.Option(help="Simulated seconds.")],
    "threads": Annotated[int | None, typer.Option(help="CPU threads.")],
    "allow_outside": Annotated[
        bool | None,
        typer.Option("--allow-outside", help="Let the scene file name arrays and meshes outside its own folder."),
    ],
    "settle": Annotated[
        bool | None,
        typer.Option(
            "--settle", help="Bring SCENE to rest before its clock starts; the summary gives the net force left."
        ),
    ],
    "set": Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="PATH=VALUE",
            help="A value of the scene over its own, like materials.rubber.restitution=0.5, cloth[0].stiffness=300, gravity[1]=-5"
            " or an argument of scene() of a Python file. May be given several times.",
        ),
    ],
    "host": Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Of this machine, that pages are served on; 127.0.0.1 otherwise, 0.0.0.0: all of them.",
        ),
    ],
    "port": Annotated[int | None, typer.Option(help="That pages are served on; 8080 otherwise, 0: any that is free.")],
    "quantity": Annotated[
        str | None, typer.Option(help="What errors are of: a probe's number, like load.tension; positions otherwise.")
    ],
}


def share(command: Callable[..., None], names: Iterable[str]) -> Callable[..., None]:
    """The command with these shared options, None where they are not given; its **keywords take them."""
    parameters = {name: p for name, p in inspect.signature(command).parameters.items() if p.kind is not p.VAR_KEYWORD}
    for name in names:
        parameters[name] = inspect.Parameter(
            name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=SHARED[name]
        )
    # typer reads both; what follows an option with a default may have none, which Python itself would not allow
    ordered = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in parameters.values()]
    command.__signature__ = inspect.Signature(ordered)  # type: ignore[attr-defined]
    command.__annotations__ = {p.name: p.annotation for p in ordered}
    return command


def takes_only(context: typer.Context, names: Iterable[str], why: str) -> None:
    """Raise ValueError, which begins with `why`, where an option other than those named stands on the command line."""
    for option in context.command.params:
        source = None if option.name is None or option.name in names else context.get_parameter_source(option.name)
        if source is not None and source.name == "COMMANDLINE":
            raise ValueError(f"{why}, but {option.opts[0]} was given")


def positive(option: str, value: float | None) -> float | None:
    """A number above 0, or None where the option was not given. Raises ValueError."""
    if value is not None and not 0 < value < float("inf"):
        raise ValueError(f"{option}: {value:g} is not allowed; it must be a number greater than 0")
    return value


def interval(option: str, text: str | None) -> float | Literal["auto"] | None:
    """Seconds from 90, 90s, 1.5m or 2h, None for off, "auto" where the option was not given. Raises ValueError."""
    if text is None:
        return "auto"
    if text == "off":
        return None
    unit = UNITS.get(text[-1:])
    try:
        return positive(option, float(text[:-1] if unit else text) * (unit or 1.0))
    except ValueError:
        raise ValueError(f"{option}: {text!r} is not allowed; it must be like 90, 90s, 5m or 1h, or off") from None


def step(text: str | None) -> float | Literal["auto"] | None:
    """Seconds or auto. Raises ValueError."""
    if text is None or text == "auto":
        return text  # type: ignore[return-value]
    try:
        return positive("--dt", float(text))
    except ValueError:
        raise ValueError(f"--dt: {text!r} is not allowed; it must be a number greater than 0 or auto") from None


def pixels(text: str | None) -> tuple[int, int] | None:
    """Width and height from 1280x720. Raises ValueError."""
    if text is None:
        return None
    width, _, height = text.partition("x")
    if not (width.isascii() and width.isdigit() and height.isascii() and height.isdigit()):
        raise ValueError(f"--size: {text!r} is not allowed; it must be like 1280x720")
    if not all(16 <= side <= 8192 for side in (int(width), int(height))):
        raise ValueError(f"--size: {text!r} is not allowed; each side must be from 16 to 8192")
    return int(width), int(height)


def keys_and_values(option: str, texts: Sequence[str]) -> dict[str, Any]:
    """Tables of what texts like `camera.azimuth=40` say, values as in TOML, or plain words. Raises SceneError."""
    from taichi_sim.common.errors import SceneError
    from taichi_sim.files.toml_document import MOST_NESTED

    found: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not all(key.split(".")):
            raise SceneError(option, text, "KEY=VALUE, like colour=speed or camera.azimuth=40")
        *parents, last = key.split(".")
        plain = _value(option, text, value if len(parents) <= MOST_NESTED else None)
        table = found
        for parent in parents:
            table = table.setdefault(parent, {})
            if not isinstance(table, dict):
                raise SceneError(option, text, says=f"is within {parent}, which another {option} gives a value")
        if last in table:
            raise SceneError(option, text, says=f"is given twice; give {key} once")
        table[last] = plain
    return found


def paths_and_values(option: str, texts: Sequence[str]) -> dict[str, Any]:
    """Values by their paths of texts like `materials.rubber.restitution=0.5`, values as in TOML, or plain words. Raises
    SceneError."""
    from taichi_sim.common.errors import SceneError

    found: dict[str, Any] = {}
    for text in texts:
        path, equals, value = text.partition("=")
        path = path.strip()
        if not equals or not path:
            raise SceneError(option, text, "PATH=VALUE, like materials.rubber.restitution=0.5 or gravity[1]=-5")
        if path in found:
            raise SceneError(option, text, says=f"is given twice; give {path} once")
        found[path] = _value(option, text, value.strip())
    return found


def _value(option: str, text: str, value: str | None) -> Any:
    """A value in TOML, or the words themselves. Raises SceneError for one too deep (None is), and for several."""
    from taichi_sim.common.errors import SceneError
    from taichi_sim.files.toml_document import MOST_NESTED, nested, tomllib

    try:
        if value is not None:
            plain = tomllib.loads(f"x = {value}")
            if len(plain) > 1:
                raise SceneError(option, text, says=f"holds more than one value; give each a {option} of its own")
            if nested(plain["x"]) is None:
                return plain["x"]
    except SceneError:
        raise
    except ValueError:
        if value is not None and value.isprintable():
            return value
        raise SceneError(option, text, says="holds several lines, or characters that are not seen") from None
    except RecursionError:
        pass
    raise SceneError(option, text, says=f"has lists or tables within each other, more than {MOST_NESTED} deep")
