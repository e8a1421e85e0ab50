"""Contents of a scene, in words and numbers."""

from html import escape
from typing import Any

from taichi_sim.scene.parts import PARTS

__all__ = ["as_html", "in_words", "parts_of"]


def parts_of(scene: Any) -> dict[str, int]:
    """Number of things of each kind that the scene has any of."""
    found: dict[str, int] = {}
    for part in PARTS:
        if part.is_simulated:
            found[part.words] = part.count(scene)
        if part.name == "balls":
            found["pinned"] = int(scene.pinned.sum())
        if part.name == "springs":
            found["sticks"] = int(scene.collides.sum())
    return {name: number for name, number in found.items() if number}


def in_words(scene: Any) -> str:
    """`Scene in 3D: 100 balls, 2 pinned, 342 springs; gravity (0, -9.81, 0) m/s^2`."""
    parts = ", ".join(f"{number} {_one(name) if number == 1 else name}" for name, number in parts_of(scene).items())
    gravity = ", ".join(f"{a:g}" for a in scene.gravity)
    return f"Scene in {scene.dim}D: {parts or 'empty'}" + (
        f"; gravity ({gravity}) m/s^2" if scene.gravity.any() else ""
    )


def _one(name: str) -> str:
    return name.removesuffix("es") if name.endswith("ses") else name.removesuffix("s")


def as_html(title: str, rows: dict[str, Any], picture: bytes | None = None) -> str:
    """A table of two columns, for notebooks, below a PNG picture."""
    from base64 import b64encode

    image = f'<img alt="" src="data:image/png;base64,{b64encode(picture).decode()}"><br>' if picture else ""
    cells = "".join(f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>" for name, value in rows.items())
    return f"{image}<table><caption>{escape(title)}</caption>{cells}</table>"
