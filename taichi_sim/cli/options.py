"""What options of the command line mean."""

from collections.abc import Iterable
from typing import Literal

import typer

__all__ = ["pixels", "positive", "step", "takes_only"]


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
