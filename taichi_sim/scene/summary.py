"""What a scene holds, in words and numbers."""

from html import escape
from typing import Any

__all__ = ["as_html", "in_words", "parts_of"]


def parts_of(scene: Any) -> dict[str, int]:
    """How many there are of each kind of thing that the scene has any of."""
    found = {
        "balls": scene.n_balls,
        "pinned": int(scene.pinned.sum()),
        "springs": scene.n_springs,
        "sticks": int(scene.collides.sum()),
        "triangles": len(scene.triangles),
        "cells": len(scene.cells),
        "bends": len(scene.bends),
        "motors": len(scene.motors),
        "walls": len(scene.walls),
        "colliders": len(scene.colliders),
        "probes": len(scene.probes),
    }
    return {name: number for name, number in found.items() if number}


def in_words(scene: Any) -> str:
    """`Scene in 3D: 100 balls, 2 pinned, 342 springs; gravity (0, -9.81, 0) m/s^2`."""
    parts = ", ".join(
        f"{number} {name[:-1] if number == 1 and name != 'pinned' else name}"
        for name, number in parts_of(scene).items()
    )
    gravity = ", ".join(f"{a:g}" for a in scene.gravity)
    return f"Scene in {scene.dim}D: {parts or 'empty'}" + (
        f"; gravity ({gravity}) m/s^2" if scene.gravity.any() else ""
    )


def as_html(title: str, rows: dict[str, Any], picture: bytes | None = None) -> str:
    """A table of two columns, for notebooks, below a PNG picture."""
    from base64 import b64encode

    image = f'<img alt="" src="data:image/png;base64,{b64encode(picture).decode()}"><br>' if picture else ""
    cells = "".join(f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>" for name, value in rows.items())
    return f"{image}<table><caption>{escape(title)}</caption>{cells}</table>"
