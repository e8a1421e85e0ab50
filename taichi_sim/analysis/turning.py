"""Angular momentum that a method takes from bodies that turn. No Taichi.

The step of implicit Euler and of xpbd ends where the velocity v' = (x' - x) / h points along the chord of the way, not along the
tangent at its end. The internal forces are central, so L' = sum m x' x v = L - h sum m v x v', and v' is v turned by W h: a rigid
body loses h W^2 of its angular momentum a second, at any stiffness. Thus W falls as W / sqrt(1 + 2 h W^2 t). TR-BDF2, of order 2,
takes h^3 W^4 / 40: pairs that keep their length, solved to rounding, lost 0.0248 (h W)^4 a step at h W = 0.1, and 0.0225 at 1.5.
It gives that back to a body that no pin holds, see integrators.step_turns, unless it turns by more than 1.3 in a step.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.methods import TR_BDF2, VERLET, Method
from taichi_sim.geometry.graph import components
from taichi_sim.scene.scene import Scene

__all__ = ["Turn", "at_start", "cure", "fastest_turn", "sentence"]

SHOWS = 0.01  # of the angular momentum, in a second or in a turn: a loss that is worth a word
FLAT = 1e-9  # of the largest moment of inertia: about such an axis nothing turns

Floats = NDArray[np.float64]


class Turn(NamedTuple):
    """A body of springs that turns: its first ball, its angular speed [rad/s], and whether no pin holds it."""

    ball: int
    speed: float
    free: bool

    def rate(self, method: Method, h: float) -> float:
        """Part of its angular momentum that steps of h seconds take in a second."""
        kept = self.free and method.keeps_free_turns(self.speed, h)
        return 0.0 if kept else method.turning_loss(self.speed, h)

    def shows(self, method: Method, h: float) -> bool:
        """True if the loss of angular momentum is worth a word."""
        rate = self.rate(method, h)
        return self.speed > 0.0 and max(rate, rate * 2.0 * np.pi / self.speed) > SHOWS

    def kept(self, method: Method, h: float, seconds: float) -> float:
        """Part that is left after some seconds without other forces: the loss falls as that power of the speed."""
        power = 2 * method.order
        return float((1.0 + power * self.rate(method, h) * seconds) ** (-1.0 / power))


def fastest_turn(scene: Scene, position: Floats, velocity: Floats, method: Method, h: float) -> Turn | None:
    """The body that turns fastest of those that lose by it in steps of h seconds, as the rigid one of its angular momentum: about
    its centre of mass, or about the pinned ball where it has one. Bodies with two pinned balls or more are left out. position,
    velocity: (n, dim) [m], [m/s]. None where springs join nothing that can turn."""
    if not scene.n_springs:
        return None
    body, n = components(scene.n_balls, scene.pairs), scene.n_balls
    pins = np.bincount(body[scene.pinned], minlength=n)
    some = (np.bincount(body, minlength=n) > 1) & (pins < 2)
    if not some.any():
        return None
    flat = scene.dim == 2
    x, v = (np.pad(a, ((0, 0), (0, 1))) if flat else a for a in (position, velocity))
    weight = np.where(scene.pinned, 0.0, scene.mass)
    axle = np.where(scene.pinned, 1.0, np.where(pins[body] > 0, 0.0, scene.mass))  # what the centre is the mean of
    x = x - _sums(body, axle[:, None] * x, n)[body] / np.maximum(_sums(body, axle, n)[body], 1e-300)[:, None]
    v = v - _sums(body, axle[:, None] * v * ~scene.pinned[:, None], n)[body] / _sums(body, axle, n)[body][:, None]
    momentum = _sums(body, weight[:, None] * np.cross(x, v), n)[some]
    square = np.sum(x * x, axis=1)[:, None, None] * np.eye(3) - x[:, :, None] * x[:, None, :]
    inertia = _sums(body, (weight[:, None, None] * square).reshape(-1, 9), n)[some].reshape(-1, 3, 3)
    turn = np.einsum("nij,nj->ni", np.linalg.pinv(inertia, rcond=FLAT, hermitian=True), momentum)
    speed, free = np.linalg.norm(turn, axis=1), pins[some] == 0
    fastest = int(np.argmax(np.where(free & method.keeps_free_turns(speed, h), 0.0, speed)))
    return Turn(int(np.flatnonzero(some)[fastest]), float(speed[fastest]), bool(free[fastest]))


def at_start(scene: Scene, method: Method, h: float) -> Turn | None:
    """The body that turns fastest at the start; None where the method takes nothing from it in steps of h seconds."""
    if method.turning_loss(1.0, h) == 0.0:
        return None
    turn = fastest_turn(scene, scene.position, scene.velocity, method, h)
    return turn if turn is not None and turn.rate(method, h) > 0.0 else None


def _sums(body: NDArray[np.int64], values: Floats, n: int) -> Floats:
    """Sums of values (n,) or (n, k) over the balls of each body, stored at its first ball."""
    if values.ndim == 1:
        return np.bincount(body, values, n).astype(np.float64)
    return np.stack([np.bincount(body, column, n) for column in values.T], axis=1)


def sentence(turn: Turn, method: Method, h: float, seconds: float = 1.0) -> str:
    """The loss of a turning body in words."""
    left = turn.kept(method, h, seconds)
    return (
        f"{method} takes {turn.rate(method, h):.2g} of the angular momentum a second from the body of ball {turn.ball}, which"
        f" turns at {turn.speed:.3g} rad/s: if nothing else acts, {left:.2g} is left after {seconds:.3g} s"
    )


def cure(turn: Turn, method: Method, h: float) -> str:
    """The remedy, empty where the loss is small."""
    if not turn.shows(method, h):
        return ""
    both = not turn.shows(TR_BDF2, h)
    return f"take {TR_BDF2} or {VERLET}, which keep it" if both else f"take {VERLET}, which keeps it, or shorter steps"
