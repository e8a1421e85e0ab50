"""Lines of keys in a TOML text: a look-up for messages, right for the usual ways to write a scene file."""

import re
from collections.abc import Iterator, Sequence

__all__ = ["deepest_line", "line_of"]

_HEADER = re.compile(r"^\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(#.*)?$")


def line_of(text: str, path: Sequence[str | int]) -> int | None:
    """The line, counted from 1, of the value at `path`, or of the nearest thing around it; None: not found."""
    lines = text.splitlines()
    if not path:
        return None
    path = _dotted(lines, path)
    first, last, rest = _table(lines, path)
    if not rest:
        return first or None
    key = re.compile(rf"^\s*[\"']?{re.escape(str(rest[0]))}[\"']?\s*[=.]")
    for number in range(first, last):
        if key.match(lines[number]):
            return _element(lines, number, rest[1:]) if len(rest) > 1 else number + 1
    return first or None


def deepest_line(text: str) -> int:
    """The line, counted from 1, in which most brackets, braces and dots stand: what nests too deeply to be read."""
    lines = text.splitlines()
    return 1 + max(range(len(lines)), key=lambda number: sum(map(lines[number].count, "[{.")), default=0)


def _dotted(lines: list[str], path: Sequence[str | int]) -> Sequence[str | int]:
    """The path with its first names joined where a header joins them: [output.camera], [[output.camera.path]]."""
    headers = {m[2] for line in lines if (m := _HEADER.match(line))}
    for depth in (3, 2):
        name = ".".join(str(part) for part in path[:depth])
        if len(path) >= depth and name in headers:
            return (name, *path[depth:])
    return path


def _table(lines: list[str], path: Sequence[str | int]) -> tuple[int, int, Sequence[str | int]]:
    """The lines [first, last) that follow the header of the table which holds `path`, and the path within it."""
    headers = [(n, m[1], m[2]) for n, line in enumerate(lines) if (m := _HEADER.match(line))]
    ends = [n for n, _, _ in headers[1:]] + [len(lines)]
    wanted = path[1] if len(path) > 1 and isinstance(path[1], int) else 0
    seen = 0
    for (number, brackets, name), end in zip(headers, ends):
        if name.strip("\"'") != path[0]:
            continue
        if seen == wanted:
            return number + 1, end, path[2 if brackets == "[[" else 1 :]
        seen += 1
    return 0, headers[0][0] if headers else len(lines), path


def _element(lines: list[str], number: int, rest: Sequence[str | int]) -> int:
    """The line (from 1) of element rest[0] of the array that begins on line `number` (from 0)."""
    wanted = next((part for part in rest[:1] if isinstance(part, int)), 0)
    depth = index = 0
    for line, character in _characters(lines, number):
        if character in "[{":
            depth += 1
        elif character in "]}":
            depth -= 1
            if depth <= 0:
                break
        elif character == "," and depth == 1:
            index += 1
        elif not character.isspace() and (depth == 0 or (depth == 1 and index == wanted)):
            return line + 1
        if depth == 2 and index == wanted:
            return line + 1
    return number + 1


def _characters(lines: list[str], number: int) -> Iterator[tuple[int, str]]:
    """The characters after the = of line `number`, without comments, each with its line."""
    start = lines[number].find("=") + 1
    for line in range(number, len(lines)):
        for character in lines[line][start:].split("#", 1)[0]:
            yield line, character
        start = 0
