"""STL, as text or binary: triangles, each with corners of its own."""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.geometry.polygons import FormatError, Polygons, real

__all__ = ["read"]

HEADER, ROW = 84, 50  # bytes of a binary file: of its head with the number of triangles, and of each triangle


def read(data: bytes) -> Polygons:
    """Return the triangles of an STL file. Raises FormatError."""
    count = int.from_bytes(data[HEADER - 4 : HEADER], "little")
    size = HEADER + ROW * count
    is_text = data.lstrip()[:5].lower() == b"solid" and len(data) != size and b"\0" not in data[:HEADER]
    if is_text:
        x = _text(data)
    elif len(data) == size or (count and len(data) > size):
        rows = np.frombuffer(data, dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")],
                             count=count, offset=HEADER)  # fmt: skip
        x = rows["corners"].reshape(-1, 3).astype(np.float64)
    else:
        raise FormatError(
            f"it is no text, which begins with solid, and no binary one: of {count} triangles that would have"
            f" {size} bytes, and it has {len(data)}"
        )
    return Polygons(x, np.arange(len(x)), np.full(len(x) // 3, 3))


def _text(data: bytes) -> NDArray[np.float64]:
    """The corners (3 t, 3) of the triangles of a text; the names behind solid and endsolid may be any words."""
    words: list[bytes] = []
    for line in data.splitlines():
        if not line.lstrip()[:8].lower().startswith((b"solid", b"endsolid")):
            words += line.lower().split()
    table = np.array(words, dtype=object)
    at = np.flatnonzero(table == b"vertex")
    facets = int(np.count_nonzero(table == b"facet"))
    if len(at) != 3 * facets:
        raise FormatError(f"it has {facets} facets, which must have three corners each, and {len(at)} corners")
    if len(at) and at[-1] + 3 >= len(table):
        raise FormatError("it ends within a corner")
    words = table[at[:, None] + np.arange(1, 4)].ravel().tolist() if len(at) else []
    return np.reshape([real(word) for word in words], (-1, 3))
