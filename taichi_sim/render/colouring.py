"""Colouring: balls and surfaces by speed or strain, on a scale that stays the same from the first frame to the last."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.render.camera import robust_bounds
from taichi_sim.render.palette import to_linear

__all__ = ["COLOUR_SCALE", "Colouring"]

# sRGB from dark purple to yellow in steps that look equal: equal distances in the Oklab space, with lightness 0.30 to 0.92
COLOUR_SCALE = np.array(
    [
        [0.218, 0.031, 0.442],
        [0.207, 0.123, 0.512],
        [0.172, 0.197, 0.573],
        [0.104, 0.272, 0.608],
        [0.028, 0.341, 0.606],
        [0.039, 0.404, 0.594],
        [0.051, 0.467, 0.601],
        [0.063, 0.531, 0.612],
        [0.075, 0.595, 0.621],
        [0.087, 0.658, 0.621],
        [0.098, 0.719, 0.605],
        [0.182, 0.773, 0.566],
        [0.355, 0.817, 0.514],
        [0.527, 0.850, 0.466],
        [0.680, 0.877, 0.423],
        [0.823, 0.899, 0.393],
        [0.958, 0.918, 0.386],
    ]
)
TABLE_ENTRIES = 256  # of the table that kernels read
FULL_STRAIN = 0.1


@dataclass(frozen=True, slots=True)
class Colouring:
    """quantity: "strain" (the mean of the absolute strains of a ball's springs, triangles, bricks and solids) or "speed" [m/s];
    low, high: the values that get the first and the last colour. Beyond them the colour stays."""

    quantity: str
    low: float
    high: float

    @classmethod
    def of(cls, frame: Frame, colour: Any, colour_range: Any) -> "Colouring | None":
        """Make a colouring from the arguments of a Renderer and the first frame; None: each object its own colour. Raises
        ValueError.

        Without a range strain goes from 0 to 0.1; speed to that of the fastest balls of the first frame, or to what a fall
        through half the scene gives, whichever is more. No later frame changes it.
        """
        if colour not in ("object", "strain", "speed"):
            raise ValueError(f"colour: {colour!r} is not allowed; it must be object, strain or speed")
        if colour_range is not None:
            given = np.asarray(colour_range, dtype=float)
            if given.shape != (2,) or not np.all(np.isfinite(given)) or given[0] >= given[1]:
                raise ValueError(
                    f"colour_range: {colour_range!r} is not allowed; it must be two numbers, the lower first"
                )
            low, high = given.tolist()
        elif colour == "strain":
            low, high = 0.0, FULL_STRAIN
        else:
            low, high = 0.0, _usual_speed(frame) if colour == "speed" else 1.0
        return None if colour == "object" else cls(colour, low, high)

    def values(self, frame: Frame) -> NDArray[np.float64]:
        """Places (n,) of the balls on the scale, from 0 to 1."""
        n = len(frame.position)
        if self.quantity == "speed":
            value = np.sqrt(np.einsum("nd,nd->n", frame.velocity, frame.velocity))
        else:
            value, many = np.zeros(n), np.zeros(n)
            for balls, strain in frame.strains():
                value += np.bincount(balls.ravel(), np.repeat(np.abs(strain), balls.shape[1]), minlength=n)
                many += np.bincount(balls.ravel(), minlength=n)
            value /= np.maximum(many, 1)
        return np.clip((value - self.low) / (self.high - self.low), 0.0, 1.0)

    @staticmethod
    def shades(number: int) -> NDArray[np.float64]:
        """So many sRGB colours (number, 3) along the scale, evenly spread."""
        place = np.linspace(0.0, len(COLOUR_SCALE) - 1.0, number)
        return np.stack([np.interp(place, np.arange(len(COLOUR_SCALE)), COLOUR_SCALE[:, k]) for k in range(3)], axis=1)

    @staticmethod
    def table() -> NDArray[np.float32]:
        """Linear colours (TABLE_ENTRIES, 3) along the scale."""
        return to_linear(Colouring.shades(TABLE_ENTRIES)).astype(np.float32)


def _usual_speed(frame: Frame) -> float:
    """m/s; see Colouring.of."""
    size = robust_bounds(frame.position, frame.radius)[0].size
    speed = np.sqrt(np.einsum("nd,nd->n", frame.velocity, frame.velocity))
    fastest = float(np.quantile(speed, 0.98)) if len(speed) else 0.0
    fall = float(np.sqrt(np.linalg.norm(frame.gravity) * size))
    return max(fastest, fall) or size  # a second for its way through the scene, where nothing else is known
