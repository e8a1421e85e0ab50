"""Frame: one moment of a simulation as plain NumPy arrays, all that an output or a renderer ever sees."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.scene.colliders import Collider
from taichi_sim.scene.embedded_surfaces import EmbeddedSurface
from taichi_sim.scene.objects import SceneObject

__all__ = ["Contacts", "Frame", "Placed", "frame_count"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


ENDLESS = 1e15  # frames: what is longer counts as that
NEARLY = 1e-3  # of a frame, that may lack: 0.333333 s are 10 frames at 30 a second


def frame_count(fps: float, duration: float) -> int:
    """Number of frames of a run, `fps` [1/s] for `duration` [s]: at its start, and at each k / fps up to the duration, not beyond
    it."""
    return math.floor(min(fps * duration, ENDLESS) + NEARLY) + 1


@dataclass(frozen=True, slots=True)
class Placed:
    """A collider where it is: centre (dim,) [m] and rotation (dim, dim) from its local frame."""

    collider: Collider
    centre: Floats
    rotation: Floats

    @property
    def box(self) -> tuple[Floats, Floats]:
        """Lowest and highest coordinates (dim,) [m]."""
        c = self.collider
        if c.is_meshed:
            corners = c.vertices @ self.rotation.T + self.centre
            return corners.min(axis=0), corners.max(axis=0)
        reach = np.abs(self.rotation) @ c.half + c.radius + c.hollow
        return self.centre - reach, self.centre + reach


def _empty(*shape: int, dtype: type = np.float64) -> NDArray:
    return np.zeros(shape, dtype=dtype)


class Contacts(NamedTuple):
    """The contacts of one moment: balls that overlap a stick, surfaces that overlap, and balls at most 1e-5 of their radii from
    another ball, a wall or a collider (at rest they may lie just on the surface). Two pinned balls, and a pinned one at a wall,
    are no contact."""

    number: int
    penetration: float  # m, the largest overlap
    mean_penetration: float  # m, over all contacts
    relative_penetration: float  # the largest as a part of the smaller radius
    mean_relative_penetration: float
    residual: float  # m/s: the largest normal speed with which two that touch still approach. What arrived just now counts too
    rms_residual: float  # m/s, root of the mean square over all contacts
    iterations: int  # of each solve
    substeps: int  # solves in a step
    largest_speed: float  # m/s, of a ball
    searches: int  # for neighbours, since the simulation was made or restored
    # m/s: the same of contacts that the last solve held already: what iterations left. Not known of sticks and surfaces, nor of
    # balls where nothing presses: 0
    unsolved: float = 0.0
    ball: int = -1  # one of the deepest contact as a part of its radius, -1 where nothing overlaps


@dataclass(slots=True)
class Frame:
    """One moment. n balls, m springs, t triangles, w walls, colliders in `dim` dimensions.

    What does not change from frame to frame (radius, springs, triangles, colour, ...) is shared between frames: read only.
    """

    time: float  # s
    position: Floats  # (n, dim) m
    velocity: Floats  # (n, dim) m/s
    radius: Floats  # (n,) m
    springs: Ints = field(default_factory=lambda: _empty(0, 2, dtype=np.int32))  # (m, 2) ball indices
    sticks: NDArray[np.bool_] = field(default_factory=lambda: _empty(0, dtype=np.bool_))  # (m,) True: balls bounce off
    strain: Floats = field(default_factory=lambda: _empty(0))  # (m,) (length - rest) / rest; 0 where rest is 0
    triangles: Ints = field(default_factory=lambda: _empty(0, 3, dtype=np.int32))  # (t, 3) ball indices
    torn_springs: Ints = field(default_factory=lambda: _empty(0, 2, dtype=np.int32))  # (k, 2) that are no more
    torn_triangles: Ints = field(default_factory=lambda: _empty(0, 3, dtype=np.int32))  # (j, 3) the same
    colour: Floats = field(default_factory=lambda: _empty(0, 3))  # (n, 3) sRGB in 0..1; (0, 3): the renderer chooses
    pinned: NDArray[np.bool_] = field(default_factory=lambda: _empty(0, dtype=np.bool_))  # (n,)
    walls: Floats = field(default_factory=lambda: _empty(0, 0))  # (w, dim + 1): unit normal, offset; solid below it
    colliders: tuple[Placed, ...] = ()  # where they are at `time`
    embedded_surfaces: tuple[EmbeddedSurface, ...] = ()  # surfaces drawn in place of balls
    objects: tuple[SceneObject, ...] = ()  # which balls are one thing, and its name; see `scene.objects.named`
    gravity: Floats = field(default_factory=lambda: _empty(0))  # (dim,) m/s^2; (0,): not known
    energy: tuple[float, float, float, float] | None = None  # J: kinetic, spring, gravity, total
    contacts: Contacts | None = None  # what `Simulation.contacts` said; only exports ask
    probes: Mapping[str, float] = field(default_factory=dict)  # what `Simulation.probes` said; the same

    def strains(self) -> "list[tuple[Ints, Floats]]":
        """Balls (e, k) and strains (e,) [1] of springs, where they are known, and of elements, see scene.strains."""
        return [(self.springs, self.strain)] if len(self.strain) == len(self.springs) else []

    @property
    def dim(self) -> int:
        """2 or 3."""
        return int(self.position.shape[1])
