"""Exposure: pictures that are means of several, over the time a shutter is open and over the opening of a lens."""

import copy
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame, Placed
from taichi_sim.common import validation
from taichi_sim.render.palette import to_linear
from taichi_sim.scene.camera_path import MOST_APERTURE

__all__ = ["EXPOSURES", "Exposure", "Mean"]

MOST_SHUTTER = 1e4  # s, of a scene with the fewest frames a second that films have
EXPOSURES, MOST_EXPOSURES = 16, 256  # pictures in the mean of one
GOLDEN = math.pi * (3 - 5**0.5)  # angle [rad] between a point and the next one of a disc that is filled evenly
LINEAR = to_linear(np.arange(256) / 255).astype(np.float32)
SRGB = np.rint(255 * np.interp(np.arange(65536) / 65535, LINEAR, np.arange(256) / 255)).astype(np.uint8)


@dataclass(frozen=True, slots=True)
class Exposure:
    """Exposure of a picture: shutter [s], how long it is open, about the time of the frame, for motion blur; aperture [m], the
    diameter of the lens, for depth of field; exposures: pictures in the mean. Raises ValueError."""

    shutter: float = 0.0
    aperture: float = 0.0
    exposures: int = EXPOSURES

    def __post_init__(self) -> None:
        validation.number("shutter", self.shutter, low=0, high=MOST_SHUTTER)
        validation.number("aperture", self.aperture, low=0, high=MOST_APERTURE)
        validation.whole("exposures", self.exposures, 1, MOST_EXPOSURES)

    @property
    def is_sharp(self) -> bool:
        """True where all pictures in the mean would be the same."""
        return self.exposures == 1 or not (self.shutter or self.aperture)

    def moments(self, frame: Frame) -> Iterator[tuple[Frame, tuple[float, float]]]:
        """The frames, and the places [m] beside the middle of the lens, to the right and up, of the pictures in the mean. Balls
        move on evenly; the camera stands still."""
        n = self.exposures
        for k, place in enumerate(_shuffled(n)):
            away = 0.5 * self.aperture * math.sqrt((k + 0.5) / n)
            time = self.shutter * ((place + 0.5) / n - 0.5)
            yield _later(frame, time), (away * math.cos(GOLDEN * k), away * math.sin(GOLDEN * k))


class Mean:
    """Mean of pictures in linear light, those with alpha weighted by it."""

    def __init__(self) -> None:
        self._total: NDArray[np.float32] | None = None
        self._number = 0

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Take a picture (h, w, 3 or 4) into the mean."""
        light = LINEAR[picture]
        if picture.shape[2] == 4:
            light[..., 3] = picture[..., 3] / np.float32(255)
            light[..., :3] *= light[..., 3:]
        self._total = light if self._total is None else self._total + light
        self._number += 1

    def picture(self) -> NDArray[np.uint8]:
        """Return the mean as a picture."""
        assert self._total is not None
        mean = self._total / self._number
        if mean.shape[2] == 3:
            return SRGB[np.rint(65535 * mean).astype(np.int64)]
        alpha = mean[..., 3:]
        colour = np.divide(mean[..., :3], alpha, out=np.zeros_like(mean[..., :3]), where=alpha > 0)
        return np.concatenate(
            [SRGB[np.rint(65535 * np.minimum(colour, 1)).astype(np.int64)], np.rint(255 * alpha).astype(np.uint8)],
            axis=2,
        )


def _later(frame: Frame, time: float) -> Frame:
    """A frame whose balls and colliders have moved on for a time [s]; what it says of its own time stays."""
    if time == 0.0:
        return frame
    moved = copy.copy(frame)
    moved.position = frame.position + time * frame.velocity
    moved.colliders = tuple(
        Placed(one.collider, *(part[0] for part in one.collider.motion.at(frame.time + time)))
        for one in frame.colliders
    )
    return moved


def _shuffled(n: int) -> list[int]:
    """The numbers from 0 to n - 1, those of neighbours far apart: the ranks of radical inverses of base 2."""
    mirrored = [int(f"{k:08b}"[::-1], 2) for k in range(n)]  # of as many bits as MOST_EXPOSURES has
    order = sorted(mirrored)
    return [order.index(one) for one in mirrored]
