"""Wavefront OBJ: vertices, faces and places on a texture; all else that a file may hold is passed over."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from taichi_sim.geometry.polygons import FormatError, Polygons, real, shown

__all__ = ["read"]


def read(data: bytes) -> Polygons:
    """Return the faces of an OBJ file. Raises FormatError, which names the line."""
    vertices: list[float] = []
    places: list[float] = []
    corners: list[int] = []
    mapped: list[int] = []
    counts: list[int] = []
    lines: list[int] = []  # of each face, for messages
    for line, words in _lines(data):
        kind = words[0]
        try:
            if kind == b"v":
                if len(words) < 4:
                    raise FormatError("a vertex needs three numbers")
                vertices += map(real, words[1:4])
            elif kind == b"vt":
                places += map(real, (*words[1:3], b"0", b"0")[:2])
            elif kind == b"f":
                for word in words[1:]:
                    vertex, _, rest = word.partition(b"/")
                    place, _, _ = rest.partition(b"/")
                    corners.append(_index(vertex, len(vertices) // 3, "vertex"))
                    mapped.append(_index(place, len(places) // 2, "place on a texture") if place else -1)
                counts.append(len(words) - 1)
                lines.append(line)
        except FormatError as error:
            raise FormatError(f"line {line}: {error}") from None
    sizes = np.array(counts, dtype=np.int64)
    of_corner = np.repeat(np.array(lines, dtype=np.int64), sizes)
    uv = np.concatenate([np.reshape(places, (-1, 2)), [[np.nan, np.nan]]])  # the last one: of what has none
    return Polygons(
        np.reshape(np.array(vertices), (-1, 3)),
        _known(corners, len(vertices) // 3, "vertex", of_corner),
        sizes,
        uv[_known(mapped, len(places) // 2, "place on a texture", of_corner)] if places else None,
    )


def _lines(data: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """The words of each line and its number, without comments; a line that ends with a backslash goes on in the next one."""
    held: list[bytes] = []
    for line, text in enumerate(data.splitlines(), 1):
        words = text.partition(b"#")[0].split()
        if words and words[-1].endswith(b"\\"):
            held += [word for word in (*words[:-1], words[-1][:-1]) if word]
            continue
        if held or words:
            yield line, held + words
            held = []
    if held:
        yield line, held


def _index(word: bytes, there: int, of: str) -> int:
    """The index, from 0, that a face means: counted from 1, or backward from the last one before it where it is negative."""
    if not word.removeprefix(b"-").isdigit() or len(word) > 18:
        raise FormatError(f"{shown(word)} is not the number of a {of}")
    index = int(word)
    if index == 0 or index < -there:
        raise FormatError(f"{of} {index} does not exist; there are {there} before it")
    return index - 1 if index > 0 else there + index


def _known(indices: list[int], there: int, of: str, lines: NDArray[np.int64]) -> NDArray[np.int64]:
    """The indices as an array. Raises FormatError, which names the line, for one of what a file does not hold."""
    found = np.array(indices, dtype=np.int64)
    if (found >= there).any():
        wrong = int(np.argmax(found >= there))
        raise FormatError(f"line {lines[wrong]}: {of} {found[wrong] + 1} does not exist; there are {there}")
    return found
