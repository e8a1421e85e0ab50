"""All families, by name."""

from .bodies import BODIES
from .bounces import BOUNCES
from .run import Family

__all__ = ["FAMILIES"]

FAMILIES = {
    name: Family(name, draw, relations, batch) for name, (draw, relations, batch) in {**BOUNCES, **BODIES}.items()
}
