"""What options of the command line mean."""

from typing import Literal

__all__ = ["pixels", "positive", "step"]


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
