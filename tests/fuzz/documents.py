"""Plain values, as TOML and JSON hold them, and what can happen to them."""

import copy
import datetime
import math

from hypothesis import strategies as st

NUMBERS = [0, -1, 1, 2, 3, 7, 300, 2**31, -(2**31) - 1, 2**63 - 1, 2**64, 10**30, 10**400]
NUMBERS += [
    0.0,
    -0.0,
    5e-324,
    1e-300,
    1e-49,
    1e-9,
    0.5,
    1.5,
    -1.0,
    1e9,
    1e49,
    1e51,
    1e300,
    math.inf,
    -math.inf,
    math.nan,
]
TEXTS = [
    "",
    "a",
    "auto",
    "default",
    "../up.npz",
    "/etc/passwd",
    "/dev/zero",
    "nul\0",
    "é\u2028",
    "x" * 300,
    "sphere",
    "file",
]
WORDS = [
    "verlet",
    "rk4",
    "xpbd",
    "implicit_euler",
    "tr_bdf2",
    "explicit_euler",
    "sum",
    "off",
    "gauss_seidel",
    "f64",
    "rubber",
]
WORDS += [
    "pair",
    "skin",
    "wheel",
    "mesh.obj",
    "arrays.npz",
    "far_",
    "position",
    "length",
    "force",
    "impulse",
    "flux",
    "box",
]
OTHERS = [
    True,
    False,
    datetime.date(1979, 5, 27),
    datetime.time(7, 32),
    [],
    [[]],
    [[], []],
    {},
    {"a": 1},
    [{}],
    [0] * 1000,
]

odd_values = st.recursive(
    st.sampled_from(NUMBERS)
    | st.sampled_from(TEXTS)
    | st.sampled_from(WORDS)
    | st.sampled_from(OTHERS)
    | st.floats()
    | st.integers(-5, 20),
    lambda inner: st.lists(inner, max_size=4) | st.tuples(inner, inner, inner).map(list),
    max_leaves=6,
)


def places(value, path=()):
    """The paths of all that lies in a document."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield (*path, key)
        yield from places(item, (*path, key))


def at(document, path):
    """What lies there."""
    for key in path:
        document = document[key]
    return document


def _is_number(value):
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _times(value, factor):
    return value * factor if abs(value) < 1e200 else -value


@st.composite
def changed(draw, documents, values=odd_values):
    """One of the documents with up to four things changed in it."""
    document = copy.deepcopy(draw(st.sampled_from(documents)))
    for _ in range(draw(st.sampled_from([1, 1, 1, 2, 4]))):
        there = list(places(document))
        if not there:
            break
        plain = [path for path in there if _is_number(at(document, path))]
        path = draw(st.sampled_from(plain if plain and draw(st.booleans()) else there))
        inside, key = at(document, path[:-1]), path[-1]
        value = inside[key]
        if _is_number(value) and draw(st.booleans()):
            inside[key] = draw(
                st.sampled_from(NUMBERS)
                | st.sampled_from(
                    [_times(value, factor) for factor in (-1, 2, 3, 0.5, 10, 1e3, 1e-3, 1e7, 1e-7, 1e30, 1e-30)]
                )
            )
            continue
        what = draw(st.sampled_from(["put", "put", "put", "drop", "wrap", "again", "many", "name", "other"]))
        if what == "put":
            inside[key] = copy.deepcopy(draw(values))
        elif what == "drop":
            del inside[key]
        elif what == "wrap":
            inside[key] = [value]
        elif what == "again" and isinstance(inside, list):
            inside.insert(key, copy.deepcopy(value))
        elif what == "many" and isinstance(inside, list):
            inside += [copy.deepcopy(value) for _ in range(draw(st.integers(2, 40)))]
        elif what == "name" and isinstance(inside, dict):
            inside[draw(st.sampled_from(["mas", "radius", "file", "mesh", "balls", "path", "a.b", "name"]))] = (
                inside.pop(key)
            )
        else:
            inside[key] = copy.deepcopy(at(document, draw(st.sampled_from(there))) if path in there else value)
    return document


@st.composite
def damaged(draw, data):
    """Bytes with some cut, changed, put in or said twice."""
    for _ in range(draw(st.integers(0, 3))):
        begin = draw(st.integers(0, max(0, len(data) - 1)))
        end = min(len(data), begin + draw(st.sampled_from([0, 1, 1, 2, 4, 8, 50])))
        new = draw(
            st.binary(max_size=4)
            | st.sampled_from([b"\xff" * 4, b"\0" * 8, b"nan", b"1e999", b"-1", b"[" * 600, b"9" * 30])
        )
        data = data[:begin] + draw(st.sampled_from([new, new, b"", data[begin:end] * 3])) + data[end:]
        if draw(st.integers(0, 9)) == 0:
            data = data[:begin]
    return data


@st.composite
def mostly(draw, usual, seldom, one_in=6):
    """From the one strategy, and one time in so many from the other."""
    return draw(seldom if draw(st.integers(1, one_in)) == one_in else usual)
