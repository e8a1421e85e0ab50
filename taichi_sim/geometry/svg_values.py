"""Root, lengths and transforms of a drawing, judged before it is read: svgelements turns lengths below 0 round, and leaves out
what it does not know in a transform."""

import math
import re
from typing import Any

from taichi_sim.common.errors import short

__all__ = ["require_values"]

COUNTS = {  # numbers that each takes
    "matrix": (6,),
    "translate": (1, 2),
    "translatex": (1,),
    "translatey": (1,),
    "scale": (1, 2),
    "scalex": (1,),
    "scaley": (1,),
    "rotate": (1, 3),
    "skew": (1, 2),
    "skewx": (1,),
    "skewy": (1,),
}
LENGTHS = {  # that may not be below 0, of what is drawn
    "svg": ("width", "height"),
    "rect": ("width", "height", "rx", "ry"),
    "circle": ("r",),
    "ellipse": ("rx", "ry"),
}
ONE = re.compile(r"([a-z]{1,10})\s*\(([^()]*)\)[\s,]*")
NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*([a-z%]*)")
BETWEEN = re.compile(r"\s*,\s*|\s+|(?=[-+.])")


def require_values(root: Any) -> None:
    """Raises ValueError where the root is none of a drawing, and for the first length or transform of an element that is not as
    SVG has them."""
    if _name(root) != "svg":
        raise ValueError(f"its root is <{_name(root)}>, not <svg>")
    for element in root.iter():
        for key in LENGTHS.get(_name(element), ()):
            number = NUMBER.match(element.get(key, "").strip().lower())
            if number is not None and float(number[1]) < 0.0:
                raise ValueError(f"<{_name(element)}> has {key}={short(element.get(key))}, which SVG has from 0 on")
        text = element.get("transform")
        if text is not None and not _is_transform(text.lower()):
            raise ValueError(f"transform={short(text)} is not as SVG has them, like rotate(30) scale(2)")


def _name(element: Any) -> str:
    """Name of an element, without what it is of."""
    return str(element.tag).rpartition("}")[2]


def _is_transform(text: str) -> bool:
    text, at = text.strip(), 0
    while at < len(text) and text != "none":
        one = ONE.match(text, at)
        if one is None or not _takes(one[1], one[2].strip()):
            return False
        at = one.end()
    return True


def _takes(name: str, arguments: str) -> bool:
    """True where the numbers, which may have units, are as many as this transform takes, and finite."""
    at = count = 0
    while at < len(arguments):
        if count and (between := BETWEEN.match(arguments, at)):
            at = between.end()
        number = NUMBER.match(arguments, at)
        if number is None or not math.isfinite(float(number[1])):
            return False
        at, count = number.end(), count + 1
    return count in COUNTS.get(name, ())
