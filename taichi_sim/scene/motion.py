"""Motion: where a collider or a group of pins is at any time, along keyframes or with constant velocities. Imports no Taichi.

Keyframes say by how far a body has moved and turned from where it starts, so that a path suits any body, and none jumps.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.scene.keyframes import check_repeat, keyframe, keyframes

__all__ = [
    "TICKS",
    "Keyframe",
    "Motion",
    "counted",
    "moments",
    "plain_path",
    "turn_matrix",
    "turn_vector",
]

Floats = NDArray[np.float64]
TICKS = 256  # substeps for which motions are worked out at a time
KEYS = ("time", "position", "rotation")  # of a keyframe
ROUNDED = 1e-6  # a rotation matrix may be given with so few digits
SAME = 1e-9  # of a scene: a repeated path that ends where it began


class _Time(TypedDict):
    time: float


class Keyframe(_Time, total=False):
    """Displacement and rotation of a body from where it starts, at a time. In the first keyframe both are 0.

    Args:
        time: since the start [s].
        position: (dim,) by how far it has moved [m].
        rotation: by how much it has turned about its centre [degrees]: one number in 2D, three about x, y and z in 3D; or a
            matrix.
    """

    position: ArrayLike
    rotation: ArrayLike


@dataclass(frozen=True, slots=True)
class Motion:
    """Position (dim,) [m] and rotation (dim, dim) of a body as functions of time.

    k keyframes: times (k,) [s], positions (k, dim) [m], rotations (k, dim, dim), turns (k, 1 or 3) [1/s]: the constant angular
    velocity from each keyframe to the next, positions in between on a line. Before the first and after the last nothing
    moves, unless the path repeats. With one keyframe, velocity (dim,) [m/s] and turns[0] act for ever, about `pivot` [m].
    """

    times: Floats
    positions: Floats
    rotations: Floats
    turns: Floats
    velocity: Floats
    pivot: Floats
    repeat: bool

    @property
    def moves(self) -> bool:
        """True if the body ever moves."""
        parts = (np.diff(self.positions, axis=0), self.turns, self.velocity)
        return any(bool(np.any(part)) for part in parts)

    def at(self, time: Any) -> tuple[Floats, Floats]:
        """Positions (m, dim) and rotations (m, dim, dim) at the times (m,) [s]."""
        t = np.atleast_1d(np.asarray(time, dtype=np.float64))
        if len(self.times) == 1:
            turn = turn_matrix(self.turns[0] * t[:, None])
            arm = self.positions[0] - self.pivot
            return self.pivot + self.velocity * t[:, None] + turn @ arm, turn @ self.rotations[0]
        t = self._within(t)
        t = np.clip(t, self.times[0], self.times[-1])
        k = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.times) - 2)
        since = t - self.times[k]
        part = (since / (self.times[k + 1] - self.times[k]))[:, None]
        x = self.positions[k] + part * (self.positions[k + 1] - self.positions[k])
        return x, turn_matrix(self.turns[k] * since[:, None]) @ self.rotations[k]

    def steps(self, time: float, h: float, first: int, steps: int) -> tuple[Floats, Floats, Floats, Floats]:
        """Positions and rotations at `time` + first h, ..., (first + steps) h, and the velocities (steps + 1, dim) [m/s] and
        angular velocities (steps + 1, 1 or 3) [1/s] that lead from each exactly to the next."""
        t = moments(time, h, first, steps + 1)
        x, turn = self.at(t)
        return x[:-1], turn[:-1], self._velocities(t, x, turn), turn_vector(turn[1:] @ turn[:-1].swapaxes(1, 2)) / h

    def _velocities(self, t: NDArray[Any], x: Floats, turn: Floats) -> Floats:
        """Velocities [m/s] from each of the times to the next; exactly those given where they hold all the way."""
        h = np.diff(t)[:, None]
        if len(self.times) == 1:
            arm = self.rotations[0].T @ (self.positions[0] - self.pivot)
            return self.velocity + np.diff(turn @ arm, axis=0) / h
        t = self._within(t)
        k = np.searchsorted(self.times, t, side="right")
        given = np.zeros((len(self.times) + 1, x.shape[1]))
        given[1:-1] = np.diff(self.positions, axis=0) / np.diff(self.times)[:, None]
        one = ((k[1:] == k[:-1]) & (t[1:] > t[:-1]))[:, None]
        return np.where(one, given[k[:-1]], np.diff(x, axis=0) / h)

    def _within(self, t: Floats) -> Floats:
        """Times of a path that repeats, as those of its first round; it begins at the first keyframe."""
        if not self.repeat:
            return t
        return self.times[0] + np.mod(np.maximum(t - self.times[0], 0.0), self.times[-1] - self.times[0])

    def fastest(self, extent: float) -> tuple[float, int]:
        """Largest speed [m/s] of a point within `extent` [m] of the centre, and the keyframe at which that begins."""
        turn = np.linalg.norm(self.turns, axis=1)
        if len(self.times) == 1:
            arm = float(np.linalg.norm(self.positions[0] - self.pivot))
            return float(np.linalg.norm(self.velocity) + turn[0] * (arm + extent)), 0
        speed = np.linalg.norm(np.diff(self.positions, axis=0), axis=1) / np.diff(self.times) + turn[:-1] * extent
        return float(speed.max()), int(speed.argmax())

    @classmethod
    def of(cls, where: str, dim: int, position: Floats, given: Mapping[str, Any], *, named: bool = True) -> "Motion":
        """Make a motion from the arguments of a shape, checked: rotation, velocity, rotation_rate, pivot, path, repeat.
        Raises SceneError.

        named: the user gave the position; a path that leaves it out at first could be meant to go on from there.
        """
        rotation = rotation_matrix(f"{where}.rotation", given["rotation"], dim)
        width = 1 if dim == 2 else 3
        velocity = np.zeros(dim)
        if given["velocity"] is not None:
            velocity = validation.vector(f"{where}.velocity", given["velocity"], dim)
        turn = np.zeros(width)
        if given["rotation_rate"] is not None:
            name, value = f"{where}.rotation_rate", given["rotation_rate"]
            rate = [validation.number(name, value)] if dim == 2 else validation.vector(name, value, 3)
            turn = np.radians(rate)
        pivot = position if given["pivot"] is None else validation.vector(f"{where}.pivot", given["pivot"], dim)
        path = given["path"]
        check_repeat(where, path, given["repeat"])
        if path is None or (isinstance(path, (list, tuple)) and not path):
            one = np.zeros(1), position[None], rotation[None], turn[None]
            return cls(*one, velocity, pivot, False)
        for name in ("velocity", "rotation_rate", "pivot"):
            if given[name] is not None:
                raise SceneError(f"{where}.{name}", says="is given together with a path; give one of them")
        place = f"{where}.path"
        keys = keyframes(place, path, {"time": validation.number, "position": _as_it_is, "rotation": _as_it_is})
        begins_at_rest(place, keys, named and bool(np.any(position)), bool(np.any(rotation != np.eye(dim))))
        return cls._along(where, dim, position, rotation, keys, given["repeat"])

    @classmethod
    def _along(
        cls, where: str, dim: int, position: Floats, rotation: Floats, keys: Sequence[Mapping[str, Any]], repeat: bool
    ) -> "Motion":
        moves: list[Floats] = []
        rotations: list[Any] = []
        for k, key in enumerate(keys):
            place = f"{where}.path[{k}]"
            by, turned = key.get("position"), key.get("rotation")
            moves.append(np.zeros(dim) if by is None else validation.vector(f"{place}.position", by, dim))
            if dim == 3:
                _check_turn(place, keys[k - 1] if k else None, turned)
            turned = (0.0 if dim == 2 else None) if turned is None else turned
            rotations.append(rotation_matrix(f"{place}.rotation", turned, dim, whole=True))
        if dim == 2:
            first = float(np.arctan2(rotation[1, 0], rotation[0, 0]))
            turned_by = np.diff(rotations)[:, None]
            matrices = turn_matrix(first + np.array(rotations)[:, None])
        else:
            matrices = np.array(rotations) @ rotation
            turned_by = turn_vector(matrices[1:] @ matrices[:-1].swapaxes(1, 2))
        t, x = np.array([key["time"] for key in keys]), position + np.array(moves)
        if repeat:
            size = 1.0 + float(np.abs(x).max())
            if np.abs(x[-1] - x[0]).max() > SAME * size or np.abs(matrices[-1] - matrices[0]).max() > SAME:
                says = "a path that repeats must end where it begins, or it would jump"
                raise SceneError(f"{where}.path[{len(t) - 1}]", says=says)
        turns = np.concatenate([turned_by / np.diff(t)[:, None], np.zeros((1, turned_by.shape[1]))])
        motion = cls(t, x, matrices, turns, np.zeros(dim), x[0], repeat)
        (place_0,), (turn_0,) = motion.at(0.0)
        if (
            np.abs(place_0 - x[0]).max() > SAME * (1.0 + float(np.abs(x).max()))
            or np.abs(turn_0 - matrices[0]).max() > SAME
        ):
            says = "is such that the path is on its way at time 0, and the body would jump; let it begin at time 0 or later"
            raise SceneError(f"{where}.path[0].time", t[0], says=says)
        return motion


def plain_path(path: Sequence[Any]) -> list[dict[str, Any]]:
    """Keyframes that were checked, as tables of plain values."""
    tables = (keyframe("", given, KEYS) for given in path)
    return [
        {key: validation.as_array(value).tolist() for key, value in table.items() if value is not None}
        for table in tables
    ]


def begins_at_rest(where: str, keys: Sequence[Mapping[str, Any]], placed: bool, turned: bool) -> None:
    """Raise SceneError where the first keyframe is not where a body starts.

    placed, turned: its place and rotation are not 0, so that keyframes which give its own ones would mean something else; then
        the first one has to say where others do.
    """
    for name, own in (("position", placed), ("rotation", turned)):
        first = keys[0].get(name)
        given = np.zeros(1) if first is None else validation.as_array(first)
        none = np.eye(*given.shape) if given.ndim == 2 else 0
        if given.dtype.kind in "iuf" and given.ndim <= 2 and np.any(given != none):
            says = "is where the path begins, and it would jump there: keyframes say by how far it has moved or turned since"
            raise SceneError(f"{where}[0].{name}", first, says=f"{says} the start; the first must be 0")
        if first is None and own and any(name in key for key in keys):
            says = f"is missing: keyframes say by how far it has moved and turned since the start; begin with {name} 0"
            raise SceneError(f"{where}[0].{name}", says=says)


def moments(time: float, h: float, first: int, steps: int) -> Floats:
    """`time` + first h, ..., (first + steps) h [s], the same to the last bit wherever a run is divided."""
    begin, before = counted(time, h)
    return begin + h * np.arange(before + first, before + first + steps + 1, dtype=np.float64)


def counted(time: float, h: float) -> tuple[float, int]:
    """Start [s] from which steps of h that meet `time` are counted, and number of steps before it. The start is 0 where
    `time` is a whole number of steps."""
    whole = round(time / h)
    return (0.0, whole) if abs(whole * h - time) <= 1e-9 * time else (time, 0)


def _as_it_is(_: str, value: Any) -> Any:
    """Return the value unchecked: it is checked later, in view of the dimensions and of the keyframe before."""
    return value


def _check_turn(place: str, before: Mapping[str, Any] | None, turned: Any) -> None:
    """Raise SceneError where angles in 3D say a turn by half or more: which way around, no two rotations tell."""
    if before is None:
        return
    last, turned = (np.zeros(3) if one is None else one for one in (before.get("rotation"), turned))
    if any(validation.as_array(one).ndim != 1 for one in (last, turned)):
        return
    by = np.abs(
        validation.vector(f"{place}.rotation", turned, 3) - validation.vector(f"{place}.rotation", last, 3)
    ).max()
    if by >= 180.0:
        raise SceneError(
            f"{place}.rotation",
            turned,
            says=f"turns by {by:g} degrees since the keyframe before, and a turn in 3D takes the shorter way around; put"
            " keyframes between, less than half a turn apart, or use rotation_rate",
        )


def rotation_matrix(where: str, rotation: Any, dim: int, whole: bool = False) -> Any:
    """(dim, dim) from degrees (a number in 2D, three about x, y and z in this order in 3D) or from a matrix.

    whole: in 2D the angle [rad] itself, which may be more than a full turn. Raises SceneError for what is no rotation.
    """
    if rotation is None:
        return np.eye(dim)
    try:
        matrix = np.array(rotation, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.ndim == 2:
        good = matrix.shape == (dim, dim) and bool(np.isfinite(matrix).all())
        if not good or np.abs(matrix @ matrix.T - np.eye(dim)).max() > ROUNDED or np.linalg.det(matrix) < 0:
            raise SceneError(where, matrix, says="is no rotation; its rows must be unit vectors at right angles")
        u, _, v = np.linalg.svd(matrix)
        result: Floats = matrix if np.abs(matrix @ matrix.T - np.eye(dim)).max() < 1e-15 else u @ v
        return float(np.arctan2(result[1, 0], result[0, 0])) if whole and dim == 2 else result
    if dim == 2:
        angle = float(np.radians(validation.number(where, rotation)))
        return angle if whole else turn_matrix(np.array([[angle]]))[0]
    result = np.eye(3)
    for axis, degrees in zip(np.eye(3), validation.vector(where, rotation, 3)):
        result = turn_matrix(np.radians(degrees) * axis[None])[0] @ result
    return result


def turn_matrix(turn: Floats) -> Floats:
    """Rotations (m, dim, dim) by the angles (m, 1) in 2D or the rotation vectors (m, 3) [rad]."""
    if turn.shape[1] == 1:
        c, s = np.cos(turn[:, 0]), np.sin(turn[:, 0])
        return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
    angle = np.linalg.norm(turn, axis=1)
    n = np.divide(turn, angle[:, None], out=np.zeros_like(turn), where=angle[:, None] > 0)
    cross = np.zeros((len(turn), 3, 3))
    cross[:, [2, 0, 1], [1, 2, 0]] = n
    cross -= cross.swapaxes(1, 2)
    return np.eye(3) + np.sin(angle)[:, None, None] * cross + (1 - np.cos(angle))[:, None, None] * (cross @ cross)


def turn_vector(matrix: Floats) -> Floats:
    """Angles (m, 1) or rotation vectors (m, 3) [rad] of rotations (m, dim, dim): the shortest way."""
    if matrix.shape[1] == 2:
        return np.arctan2(matrix[:, 1, 0] - matrix[:, 0, 1], matrix[:, 0, 0] + matrix[:, 1, 1])[:, None]
    skew = 0.5 * (matrix - matrix.swapaxes(1, 2))
    axis = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, 0.5 * (np.trace(matrix, axis1=1, axis2=2) - 1.0))
    factor = np.divide(angle, sine, out=np.ones_like(sine), where=sine > 1e-9)
    result = axis * factor[:, None]
    for k in np.flatnonzero((sine <= 1e-6) & (angle > 1.0)):  # half a turn: the axis is the eigenvector of 1
        b = 0.5 * (matrix[k] + np.eye(3))
        column = b[:, int(np.argmax(np.diag(b)))]
        result[k] = angle[k] * column / np.linalg.norm(column)
    return result
