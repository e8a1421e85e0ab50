"""Legend: what the colours of a picture mean."""

from collections.abc import Mapping
from typing import Any

from taichi_sim.analysis.frame import Frame
from taichi_sim.overlays.panel import Panel, Tints, to_bytes
from taichi_sim.overlays.plot import places_for, written
from taichi_sim.render.colouring import COLOUR_SCALE, Colouring
from taichi_sim.render.palette import body_colours

__all__ = ["legend"]

MOST, MOST_LETTERS = 12, 60  # names, and letters of each
UNITS = {"speed": "m/s", "strain": ""}


def legend(frame: Frame, style: Mapping[str, Any], text: float, tints: Tints, most: float) -> Panel | None:
    """The names of shapes and colliders with their colours in the first frame, or the scale of the style's `colour`; None where
    nothing has a name. text: height of the letters, most: width of the panel [pixels]."""
    colouring = Colouring.of(frame, style.get("colour") or "object", style.get("colour_range"))
    return _names(frame, text, tints, most) if colouring is None else _scale(colouring, text, tints)


def _names(frame: Frame, text: float, tints: Tints, most: float) -> Panel | None:
    colours = body_colours(frame) if len(frame.position) else frame.position
    named = [(one.name, colours[one.balls[0]]) for one in frame.objects if len(one.balls)]
    solid = [placed.collider for placed in frame.colliders]
    named += [(one.label, one.colour) for one in solid if one.label and one.colour is not None]
    if not named:
        return None
    rows = named[:MOST] + ([(f"and {len(named) - MOST} more", None)] if len(named) > MOST else [])
    rows = [(name[:MOST_LETTERS], colour) for name, colour in rows]
    width = min(max(Panel.length(name, text) for name, _ in rows) + 2.6 * text, most)
    panel = Panel((width, (1.35 * len(rows) + 0.5) * text), text, tints.ground)
    for k, (name, colour) in enumerate(rows):
        y = (1.35 * k + 0.925) * text
        if colour is not None:
            panel.disc((1.05 * text, y), 0.42 * text, to_bytes(colour), tints.faint, text / 20)
        panel.text((1.9 * text, y), name, tints.text, "lm")
    return panel


def _scale(colouring: Colouring, text: float, tints: Tints) -> Panel:
    unit = UNITS[colouring.quantity]
    title = f"{colouring.quantity} [{unit}]" if unit else colouring.quantity
    places = places_for(max(abs(colouring.low), abs(colouring.high))) - 1
    ends = [written(one, max(0, places)) for one in (colouring.low, colouring.high)]
    width = max(Panel.length(title, text), 9 * text) + 1.4 * text
    panel = Panel((width, 4.1 * text), text, tints.ground)
    panel.text((0.7 * text, 0.85 * text), title, tints.text, "lm")
    step = (width - 1.4 * text) / len(COLOUR_SCALE)
    for k, colour in enumerate(COLOUR_SCALE):
        left = 0.7 * text + k * step
        panel.box((left, 1.6 * text), (left + step, 2.4 * text), to_bytes(colour))
    panel.text((0.7 * text, 3.2 * text), ends[0], tints.text, "lm")
    panel.text((width - 0.7 * text, 3.2 * text), ends[1], tints.text, "rm")
    return panel
