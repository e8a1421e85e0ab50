"""All families, by name."""

from .bodies import BODIES
from .bounces import BOUNCES
from .continua import CONTINUA
from .run import Family
from .solids import SOLIDS

__all__ = ["FAMILIES"]

DRAWN = {**BOUNCES, **BODIES, **SOLIDS, **CONTINUA}
FAMILIES = {name: Family(name, draw, relations, batch) for name, (draw, relations, batch) in DRAWN.items()}
