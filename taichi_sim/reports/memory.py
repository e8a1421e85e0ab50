"""Memory of a simulation: bytes of every field that it has declared."""

from collections.abc import Iterator
from typing import Any

from taichi_sim.simulation.simulation import Simulation


def breakdown(simulation: Simulation) -> dict[str, int]:
    """Bytes of each field, the largest first, by the name of the object that made it and its own, like "Pairs.link"."""
    parts = simulation.parts
    found: dict[str, int] = {}
    seen: set[int] = set()

    def visit(owner: Any) -> None:
        for name, value in _each(vars(owner)):
            if id(value) in seen:
                continue
            size = parts.fields.size(value)
            if size:
                seen.add(id(value))
                found[f"{type(owner).__name__}.{name}"] = size
            elif type(value).__module__.startswith("taichi_sim.") and hasattr(value, "__dict__"):
                seen.add(id(value))
                visit(value)

    visit(parts)
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def _each(held: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Members of an object by name, and the entries of those that are lists."""
    for name, value in held.items():
        if isinstance(value, list):
            yield from ((f"{name}[{k}]", one) for k, one in enumerate(value))
        else:
            yield name, value
