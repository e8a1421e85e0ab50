"""Text that no terminal takes for a command and no spreadsheet for a formula; standard streams in whatever state."""

import os
import re
import sys
from contextlib import suppress
from typing import Any, TextIO

__all__ = ["lead_nowhere", "no_formula", "printable", "settle_streams", "told"]

FORMULAS = ("=", "+", "-", "@", "\t", "\r")  # what they begin with
LINES = "\n\t"
# longer than any name of a file that is not made for this, and quoted texts with spaces
ENDLESS = re.compile(r"""'[^'\n]{1000,}'|"[^"\n]{1000,}"|\S{1000,}(?<![:;,.])""")
SHOWN = 60  # characters of such


def printable(text: str) -> str:
    """Text whose control sequences, and characters that hide or turn others, are shown by their codes. Names and values in it may
    be from a file of anybody's."""
    if text.isprintable():
        return text
    return "".join(
        one if one.isprintable() or one in LINES or (one.isspace() and one > "\x9f") else _code(one) for one in text
    )


def told(message: str) -> str:
    """A message that is `printable`, in which words and quoted texts without end are cut off."""
    return ENDLESS.sub(lambda found: f"{found[0][:SHOWN]}...", printable(message))


def _code(character: str) -> str:
    return character.encode("unicode_escape", "surrogatepass").decode("ascii")


def no_formula(value: Any) -> Any:
    """The cell of a table: a text that a spreadsheet would compute, such as `=1+1`, with a ' before it."""
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULAS) else value


def lead_nowhere(stream: TextIO) -> None:
    """Let a standard stream that nobody reads any more lead nowhere, with what it still holds."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def settle_streams() -> None:
    """Let standard streams that are closed lead nowhere, so that no file of the run takes their number; what an encoding lacks is
    shown by its code."""
    while True:
        descriptor = os.open(os.devnull, os.O_RDWR)
        if descriptor > 2:
            os.close(descriptor)
            break
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            nowhere = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115  # until the process ends
            setattr(sys, name, nowhere)
            setattr(sys, f"__{name}__", nowhere)
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
