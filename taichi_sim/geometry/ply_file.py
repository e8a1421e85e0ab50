"""PLY, as text or binary: vertices, faces of any number of corners, strips of triangles."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.geometry.polygons import FormatError, Polygons, real

__all__ = ["read", "unrolled", "up_of"]

KINDS = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip
ENDS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
PLACES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))  # names of a vertex' place on a texture
NUMBERS = {"x", "y", "z", *sum(PLACES, ())}  # one for each vertex
CORNERS = ("vertex_indices", "vertex_index")
MOST_WHOLE = 1 << 53  # from here on not all whole numbers are numbers with a decimal point
MOST_DIGITS = 18


class Property(NamedTuple):
    """A column of an element: its name and type; of a list the type of its entries, and of their number."""

    name: str
    kind: str
    length: str = ""


class Column(NamedTuple):
    """Values of a property, row by row, and how many each row has: 1, or the length of its list."""

    values: NDArray
    counts: NDArray[np.int64]


def up_of(data: bytes) -> str:
    """The axis that a comment of the head, `comment up y`, calls up; "" where none does."""
    for line in data.partition(b"end_header")[0].splitlines():
        words = line.split()
        if words[:2] == [b"comment", b"up"] and len(words) == 3:
            return words[2].decode("ascii", "replace").lower()
    return ""


def read(data: bytes) -> Polygons:
    """Return the faces of a PLY file. Raises FormatError."""
    form, elements, body = _head(data)
    for name, _, columns in elements:
        for one in columns:
            if name == "vertex" and one.length and one.name in NUMBERS:
                raise FormatError(f"its {one.name} is a list, and no number")
    rows: _Rows = _Text(body) if form == "ascii" else _Binary(body, ENDS[form])
    found = {name: rows.element(name, number, columns) for name, number, columns in elements}
    vertex = found.get("vertex", {})
    if not {"x", "y", "z"} <= set(vertex):
        raise FormatError("it has no vertices with x, y and z")
    x = _table(vertex, "xyz")
    faces = [found["face"][name] for name in CORNERS if name in found.get("face", {})]
    faces += [_strips(found["tristrips"][name]) for name in CORNERS if name in found.get("tristrips", {})]
    corners = np.concatenate([np.zeros(0, dtype=np.int64), *(_whole(one.values) for one in faces)])
    counts = np.concatenate([np.zeros(0, dtype=np.int64), *(one.counts for one in faces)])
    uv = None
    for u, v in PLACES:
        if uv is None and {u, v} <= set(vertex) and ((corners >= 0) & (corners < len(x))).all():
            uv = _table(vertex, (u, v))[corners]
    return Polygons(x, corners, counts, uv)


def _table(columns: dict[str, Column], names: Iterable[str]) -> NDArray[np.float64]:
    """Columns of one number a row, side by side."""
    return np.stack([columns[name].values.astype(np.float64) for name in names], axis=1)


def _whole(values: NDArray) -> NDArray[np.int64]:
    """The numbers of vertices, or of what a list holds, which some write with a decimal point."""
    if values.dtype.kind == "f":
        wrong = ~(np.abs(values) < MOST_WHOLE) | (values != np.rint(values))
        if wrong.any():
            raise FormatError(f"{values[np.argmax(wrong)]:g} stands where a whole number must")
    return values.astype(np.int64)


def _strips(runs: Column) -> Column:
    """Triangles of strips, which -1 separates within a list."""
    cut = np.flatnonzero(runs.values == -1)
    triangles = [unrolled(part[part >= 0]) for part in np.split(_whole(runs.values), cut)]
    corners = np.concatenate(triangles) if triangles else np.zeros((0, 3), dtype=np.int64)
    return Column(corners.ravel(), np.full(len(corners), 3))


def unrolled(strip: NDArray) -> NDArray[np.int64]:
    """Triangles (t, 3) of a strip (t + 2,); every other one runs the other way around."""
    triangles = np.stack([strip[:-2], strip[1:-1], strip[2:]], axis=1).astype(np.int64)
    triangles[1::2] = triangles[1::2, ::-1]
    return triangles


def _head(data: bytes) -> tuple[str, list[tuple[str, int, list[Property]]], bytes]:
    """The format, the elements with their number of rows and columns, and what follows the head."""
    end = data.find(b"end_header")
    if not data.startswith(b"ply") or end < 0:
        raise FormatError("it has no head that begins with ply and ends with end_header")
    after = end + len(b"end_header")
    after += len(data[after : after + 2]) - len(data[after : after + 2].removeprefix(b"\r").removeprefix(b"\n"))
    form = ""
    elements: list[tuple[str, int, list[Property]]] = []
    for line in data[:end].decode("utf-8", "replace").splitlines()[1:]:
        words = line.split()
        match words:
            case ["format", form, *_]:
                pass
            case ["element", name, number]:
                elements.append((name, _rows_of(number), []))
            case ["property", "list", count, kind, name] if elements:
                _add(elements[-1][2], Property(name, _kind(kind), _kind(count)))
            case ["property", kind, name] if elements:
                _add(elements[-1][2], Property(name, _kind(kind)))
    if len({name for name, _, _ in elements}) < len(elements):
        raise FormatError("it has two elements of one name")
    if form not in ENDS:
        raise FormatError(f"its format {form!r} is none of {', '.join(ENDS)}")
    return form, elements, data[after:]


def _add(columns: list[Property], one: Property) -> None:
    if one.name in [other.name for other in columns]:
        raise FormatError(f"an element has two properties {one.name}")
    columns.append(one)


def _rows_of(word: str) -> int:
    if not word.isascii() or not word.isdigit() or len(word) > MOST_DIGITS:
        raise FormatError(f"{word!r} is not the number of rows of an element")
    return int(word)


def _kind(word: str) -> str:
    if word not in KINDS:
        raise FormatError(f"{word!r} is not a type; there are {', '.join(KINDS)}")
    return KINDS[word]


class _Rows:
    """Rows of elements, one element behind the other."""

    def read(self, name: str, kind: str, number: int) -> NDArray:
        """The next values of element `name`, so many of this type. Raises FormatError."""
        raise NotImplementedError

    def length(self, name: str, column: Property) -> int:
        """Number of values that the column has in this row."""
        return int(_whole(self.read(name, column.length, 1))[0]) if column.length else 1

    def alike(self, name: str, number: int, columns: list[Property]) -> dict[str, Column] | None:
        """Rows that all have as many values as the first one; None where they have not."""
        return None

    def element(self, name: str, number: int, columns: list[Property]) -> dict[str, Column]:
        """All rows of an element, by their columns."""
        if not columns or not number:
            return {column.name: Column(np.zeros(0), np.zeros(0, dtype=np.int64)) for column in columns}
        alike = self.alike(name, number, columns)
        if alike is not None:
            return alike
        found: dict[str, list] = {column.name: [] for column in columns}
        for _ in range(number):
            for column in columns:
                found[column.name].append(self.read(name, column.kind, self.length(name, column)))
        return {
            key: Column(np.concatenate(rows), np.array([len(row) for row in rows], dtype=np.int64))
            for key, rows in found.items()
        }


class _Binary(_Rows):
    """Rows of a binary file; end: "<" or ">" for its byte order."""

    def __init__(self, body: bytes, end: str) -> None:
        self._body, self._end, self._at = body, end, 0

    def read(self, name: str, kind: str, number: int) -> NDArray:
        made = np.dtype(self._end + kind)
        if number < 0 or number * made.itemsize > len(self._body) - self._at:
            raise FormatError(f"it ends within its element {name}")
        part = np.frombuffer(self._body, made, number, self._at)
        self._at += number * made.itemsize
        return part

    def alike(self, name: str, number: int, columns: list[Property]) -> dict[str, Column] | None:
        here, kinds, lengths = self._at, list[tuple](), dict[str, int]()
        for column in columns:
            length = self.length(name, column)
            self.read(name, column.kind, length)
            kinds += [(f"{column.name} length", self._end + column.length)] * bool(column.length)
            kinds.append((column.name, self._end + column.kind, (length,)))
            lengths[column.name] = length
        size, self._at = self._at - here, here
        if number * size > len(self._body) - here:
            return None
        table = np.frombuffer(self._body, np.dtype(kinds), number, here)
        if any((table[f"{one.name} length"] != lengths[one.name]).any() for one in columns if one.length):
            return None
        self._at = here + number * size
        return {key: Column(table[key].ravel(), np.full(number, length)) for key, length in lengths.items()}


class _Text(_Rows):
    """Rows of a text."""

    def __init__(self, body: bytes) -> None:
        self._words, self._at = body.split(), 0

    def read(self, name: str, kind: str, number: int) -> NDArray:
        if number < 0 or number > len(self._words) - self._at:
            raise FormatError(f"it ends within its element {name}")
        words = self._words[self._at : self._at + number]
        self._at += number
        try:
            return np.array([real(word) for word in words])
        except FormatError as error:
            raise FormatError(f"element {name}: {error}") from None

    def alike(self, name: str, number: int, columns: list[Property]) -> dict[str, Column] | None:
        if any(column.length for column in columns):
            return None
        table = self.read(name, "", number * len(columns)).reshape(number, len(columns))
        return {one.name: Column(table[:, k], np.ones(number, dtype=np.int64)) for k, one in enumerate(columns)}
