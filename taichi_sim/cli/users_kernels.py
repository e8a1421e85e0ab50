"""Errors in kernels of the user, which are compiled when a run begins. Imports no Taichi."""

import re
from pathlib import Path

__all__ = ["place_of_error"]

PACKAGE = Path(__file__).parent.parent
OURS = (PACKAGE, PACKAGE.parent / "kernels")  # the second of a checkout
FRAME = re.compile(
    r'File "(?P<file>[^"\n]+)", line (?P<line>\d+), in (?P<name>\w+):\n(?P<source>[^\n]*)\n(?:[ ^~]*\n)?'
)
ENGINES = ("taichi", "quadrants")


def place_of_error(error: Exception) -> str | None:
    """One line on what the compiler says of a function of the user: its file, line, name and source. None where the error is
    another one, or in this package."""
    frames = list(FRAME.finditer(str(error)))
    if type(error).__module__.partition(".")[0] not in ENGINES or not frames:
        return None
    last = frames[-1]
    if any(Path(last["file"]).resolve().is_relative_to(folder) for folder in OURS):
        return None
    said = " ".join(str(error)[last.end() :].split())
    return f"{last['file']}, line {last['line']}, in {last['name']}: {said}, in `{last['source'].strip()}`"
