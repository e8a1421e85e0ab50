# mypy: ignore-errors
"""Discs in an open box in pymunk (Chipmunk 2D): serial, sequential impulses in double precision."""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.benchmark.cases import Balls
from taichi_sim.benchmark.peers import PeerMissingError

try:
    import pymunk
except ImportError:
    raise PeerMissingError("pymunk is not installed (pip install pymunk)") from None


class PilePymunk:
    """Pymunk multiplies the elasticities and frictions of two shapes, so each gets the root, and a wall 1 and the root."""

    def __init__(self, pile: Balls, *, iterations: int, hashed: bool) -> None:
        self._iterations, self._hashed = iterations, hashed
        self.start(pile)

    def start(self, pile: Balls) -> None:
        """Begin at the start of this pile."""
        self._pile = pile
        self.reset()

    def reset(self) -> None:
        pile, e, mu = self._pile, self._pile.restitution**0.5, self._pile.friction**0.5
        self._space = pymunk.Space()
        self._space.gravity, self._space.iterations = (0.0, -pile.gravity), self._iterations
        if self._hashed:
            self._space.use_spatial_hash(2.4 * pile.radius, 2 * len(pile.position))
        high = 4 * pile.position[:, 1].max()
        for a, b in (((-1, 0), (pile.side + 1, 0)), ((0, -1), (0, high)), ((pile.side, -1), (pile.side, high))):
            wall = pymunk.Segment(self._space.static_body, a, b, 0.0)
            wall.elasticity, wall.friction = e, mu
            self._space.add(wall)
        self._bodies = []
        for p in pile.position:
            body = pymunk.Body(1.0, pymunk.moment_for_circle(1.0, 0, pile.radius))
            body.position = tuple(p)
            disc = pymunk.Circle(body, pile.radius)
            disc.elasticity, disc.friction = e, mu
            self._space.add(body, disc)
            self._bodies.append(body)

    def step(self, steps: int) -> None:
        for _ in range(steps):
            self._space.step(self._pile.dt)

    def result(self) -> tuple[NDArray, NDArray]:
        return np.array([b.position for b in self._bodies]), np.array([b.velocity for b in self._bodies])

    def kinetic(self) -> float:
        """Kinetic energy [J], rotation included."""
        v, spin = self.result()[1], np.array([b.angular_velocity for b in self._bodies])
        return 0.5 * float(np.sum(v**2) + 0.5 * self._pile.radius**2 * np.sum(spin**2))
