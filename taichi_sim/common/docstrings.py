"""Descriptions of arguments in docstrings: the one place where these are described serves help(), editors and the docs.

The part after `Args:` has entries `name: text` or `name, other: text`, each on a line of its own or after a semicolon or a full
stop. A unit stands in brackets, `[m/s]`, or first, after the shape: `(n, dim) m, one per ball`; `[1]` marks plain numbers.
"""

import inspect
import re
from collections.abc import Iterable

__all__ = ["described", "unit_of"]

_NEWTONS = r"N(?: m\^2| s?/?m|/m| s)?|Pa(?: s)?"
_UNIT = rf"(?:1|kg(?:/m(?:\^[23])?)?|m(?:\^[23]|/s(?:\^2)?)?|{_NEWTONS}|J|1/s|s|degrees(?: per second)?|pixels)"
_FIRST = re.compile(rf"(?:\([^)]*\) )?({_UNIT})(?![\w/^])")
_BRACKETS = re.compile(rf"\[({_UNIT})(?:, in 2D [^\]]*)?\]")


def described(doc: str | None, names: Iterable[str]) -> dict[str, str]:
    """Descriptions of each of these arguments in a docstring, as sentences without their full stop; perhaps not of all of
    them."""
    _, _, text = inspect.cleandoc(doc or "").partition("Args")
    flat = " ".join(text.partition(":")[2].split("\n\n")[0].split())
    name = "|".join(map(re.escape, names))
    entries = list(re.finditer(rf"(?:^|(?<=[;.] )|(?<=\.\) ))((?:{name})(?:, (?:{name}))*): ", flat))
    ends = [entry.start() for entry in entries[1:]] + [len(flat)]
    found: dict[str, str] = {}
    for entry, end in zip(entries, ends):
        for one in entry[1].split(", "):
            found.setdefault(one, flat[entry.end() : end].strip().rstrip(";.").strip())
    return found


def unit_of(text: str) -> str:
    """The unit that such a text gives, "1" for plain numbers; empty where there is none."""
    found = _FIRST.match(text) or _BRACKETS.search(text)
    return found[1] if found else ""
