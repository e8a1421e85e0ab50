"""Wavefront OBJ: vertices, faces and places on a texture; all else that a file may hold is passed over."""

from collections.abc import Iterator

import numpy as np

from taichi_sim.geometry.polygons import Polygons

__all__ = ["read"]


def read(data: bytes) -> Polygons:
    """Return the faces of an OBJ file. Raises ValueError that names the line."""
    vertices: list[float] = []
    places: list[float] = []
    corners: list[int] = []
    mapped: list[int] = []
    counts: list[int] = []
    lines: list[int] = []  # of each face, for messages
    for number, words in _lines(data):
        kind = words[0]
        if kind == b"v":
            if len(words) < 4:
                raise ValueError(f"line {number}: a vertex needs three numbers")
            vertices += [_number(word, number) for word in words[1:4]]
        elif kind == b"vt":
            places += [_number(word, number) for word in (*words[1:3], b"0", b"0")[:2]]
        elif kind == b"f":
            for word in words[1:]:
                vertex, _, rest = word.partition(b"/")
                place, _, _ = rest.partition(b"/")
                corners.append(_index(vertex, len(vertices) // 3, number))
                mapped.append(_index(place, len(places) // 2, number) if place else -1)
            counts.append(len(words) - 1)
            lines.append(number)
    n = len(vertices) // 3
    found = np.array(corners, dtype=np.int64)
    if (found >= n).any():
        wrong = int(np.argmax(found >= n))
        line = lines[int(np.searchsorted(np.cumsum(counts), wrong, side="right"))]
        raise ValueError(f"line {line}: vertex {corners[wrong] + 1} does not exist; there are {n}")
    uv = np.concatenate([np.reshape(places, (-1, 2)), [[np.nan, np.nan]]])
    at = np.array(mapped, dtype=np.int64)
    at[(at < 0) | (at >= len(uv))] = len(uv) - 1
    return Polygons(
        np.reshape(np.array(vertices), (-1, 3)),
        found,
        np.array(counts, dtype=np.int64),
        uv[at] if len(places) else None,
    )


def _lines(data: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """The words of each line and its number, without comments; a line that ends with a backslash goes on in the next one."""
    held: list[bytes] = []
    for number, line in enumerate(data.splitlines(), 1):
        words = line.partition(b"#")[0].split()
        if words and words[-1].endswith(b"\\"):
            held += [word for word in (*words[:-1], words[-1][:-1]) if word]
            continue
        if held or words:
            yield number, held + words
            held = []
    if held:
        yield number, held


def _number(word: bytes, line: int) -> float:
    try:
        return float(word)
    except ValueError:
        raise ValueError(f"line {line}: {_shown(word)} is not a number") from None


def _index(word: bytes, there: int, line: int) -> int:
    """The index, from 0, that a face means: counted from 1, or backward from the last one before it where it is negative."""
    try:
        index = int(word)
    except ValueError:
        raise ValueError(f"line {line}: {_shown(word)} is not the number of a vertex") from None
    if index == 0 or index < -there:
        raise ValueError(f"line {line}: vertex {index} does not exist; there are {there} before it")
    return index - 1 if index > 0 else there + index


def _shown(word: bytes) -> str:
    return repr(word.decode("utf-8", "replace")[:40])
