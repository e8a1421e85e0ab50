"""CameraPath: how the camera of pictures stands and moves, as [output.camera] of a scene file says it."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, Literal, TypedDict

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError, unknown_key
from taichi_sim.scene.keyframes import Checks, keyframes

__all__ = ["MOST_APERTURE", "CameraPath", "eased", "require_depth"]

Vector = tuple[float, ...]
MOST_APERTURE = 1e3  # m
KEYS_IN_2D = ("centre", "width", "follow", "fit")


class _Time(TypedDict):
    time: float
    eye: Vector
    target: Vector


class CameraKey(_Time, total=False):
    """A keyframe of the camera's path.

    Args:
        time: since the start [s]. eye: where it stands [m]. target: what it looks at [m].
        fov: vertical angle of view [degrees].
    """

    fov: float


@dataclass(frozen=True, slots=True)
class CameraPath:
    """Position and motion of the camera. An argument that is left out is chosen so that the scene fills the picture.

    Args:
        eye: in 3D, where it stands [m]. target: in 3D, what it looks at [m]. up: in 3D, what is up in the picture [1].
        fov: in 3D, vertical angle of view [degrees].
        azimuth: in 3D, in place of eye, angle about the vertical axis through the target [degrees].
        elevation: in 3D, in place of eye, angle above the target [degrees].
        distance: in 3D, in place of eye, from the target [m].
        orbit: in 3D, turning about the target [degrees per second].
        path: in 3D, in place of these, keyframes with time, eye, target and, if all have it, fov, which the camera passes through
            without overshooting; it rests before the first and after the last.
        follow: a ball or several, whose middle the camera moves along with, smoothly; in a file also a name.
        fit: what target, distance and the like show by default: "run" all of an export, "start" its first frame.
        centre: in 2D, middle of the picture [m]. width: in 2D, of what the picture shows [m].
    """

    eye: Vector | None = None
    target: Vector | None = None
    up: Vector = (0.0, 1.0, 0.0)
    fov: float | None = None
    azimuth: float | None = None
    elevation: float | None = None
    distance: float | None = None
    orbit: float = 0.0
    path: tuple[CameraKey, ...] = ()
    follow: NDArray[np.int32] | None = None
    fit: Literal["run", "start"] = "run"
    centre: Vector | None = None
    width: float | None = None

    @property
    def is_open(self) -> bool:
        """True if an argument is left out that is chosen from all frames of a run."""
        in_3d = (self.eye is None and self.distance is None) or self.target is None
        in_2d = self.centre is None or self.width is None
        return self.fit == "run" and not self.path and self.follow is None and in_3d and in_2d

    @classmethod
    def of(cls, given: Mapping[str, Any], dim: int, n_balls: int) -> "CameraPath":
        """Make a path from the keys of [output.camera]. Raises SceneError that names the key, the value and what is allowed."""
        known = KEYS_IN_2D if dim == 2 else [f.name for f in fields(cls) if f.name not in KEYS_IN_2D[:2]]
        if not isinstance(given, Mapping):
            raise SceneError("camera", given, f"a table with keys among {', '.join(known)}")
        for key in given:
            if key not in known:
                raise unknown_key(("camera", key), known, f"a key of a camera in {dim}D")
        values = {key: _value(key, value, dim, n_balls) for key, value in given.items()}
        for key, others in (
            ("path", ("eye", "target", "azimuth", "elevation", "distance", "orbit", "follow", "fov")),
            ("eye", ("azimuth", "elevation", "distance")),
        ):
            for other in others:
                if key in values and other in values:
                    raise SceneError(f"camera.{other}", says=f"does not go together with {key}; leave one of them out")
        if "eye" in values and values["eye"] == values.get("target"):
            raise SceneError("camera.target", list(values["target"]), "another point than eye")
        return cls(**values)

    def place(self, time: float) -> tuple[NDArray[np.float64], NDArray[np.float64], float | None]:
        """eye, target and fov at a time [s] along `path`."""
        times = np.array([key["time"] for key in self.path])
        columns = [[*key["eye"], *key["target"], *([key["fov"]] if "fov" in key else [])] for key in self.path]
        now = eased(times, np.array(columns, dtype=float), time)
        return now[:3], now[3:6], float(now[6]) if len(now) == 7 else None


def eased(times: NDArray, values: NDArray, time: float) -> NDArray[np.float64]:
    """Values (k, width) at rising times (k,), between them: a cubic with continuous slope that is 0 at both ends and overshoots
    no value (slopes are harmonic means, or 0 at an extremum; F. Fritsch, J. Butland, 1984)."""
    if time <= times[0] or time >= times[-1]:
        return np.array(values[0 if time <= times[0] else -1], dtype=float)
    span = np.diff(times)
    rise = np.diff(values, axis=0) / span[:, None]
    slope = np.zeros_like(values, dtype=float)
    before, after = rise[:-1], rise[1:]
    a, b = span[:-1, None] + 2 * span[1:, None], 2 * span[:-1, None] + span[1:, None]
    same = before * after > 0
    slope[1:-1][same] = ((a + b) * before * after)[same] / (a * after + b * before)[same]
    k = int(np.searchsorted(times, time, side="right")) - 1
    t, h = (time - times[k]) / span[k], span[k]
    start, end = values[k] * (1 + 2 * t) * (1 - t) ** 2, values[k + 1] * t**2 * (3 - 2 * t)
    return start + end + slope[k] * (h * t * (1 - t) ** 2) - slope[k + 1] * (h * t**2 * (1 - t))


def _value(key: str, value: Any, dim: int, n_balls: int) -> Any:
    where = f"camera.{key}"
    if key in ("eye", "target", "up", "centre"):
        checked = validation.direction if key == "up" else validation.vector
        return tuple(checked(where, value, dim).tolist())
    if key == "fit":
        if value not in ("run", "start"):
            raise SceneError(where, value, '"run" or "start"')
        return value
    if key == "fov":
        return validation.number(where, value, low=1, high=170)
    if key == "elevation":
        return validation.number(where, value, low=-90, high=90)
    if key in ("distance", "width"):
        return validation.number(where, value, positive=True)
    if key in ("azimuth", "orbit"):
        return validation.number(where, value)
    if key == "follow":
        if np.asarray(validation.as_array(value)).dtype.kind in "US":
            raise SceneError(where, value, "the number of a ball, or a list of them; names are for scene files")
        balls = validation.indices(where, np.atleast_1d(validation.as_array(value)), n_balls)
        if not len(balls):
            raise SceneError(where, value, "one ball or more")
        return balls
    return _keyframes(where, value)


def _keyframes(where: str, value: Any) -> tuple[Any, ...]:
    point, angle = partial(_vector, dim=3), partial(validation.number, low=1, high=170)
    checks: Checks = {"time": validation.number, "eye": point, "target": point, "fov": angle}
    frames = keyframes(where, value, checks, ("time", "eye", "target"))
    for k, frame in enumerate(frames):
        if frame["eye"] == frame["target"]:
            raise SceneError(f"{where}[{k}].target", list(frame["target"]), "another point than eye")
        if ("fov" in frame) != ("fov" in frames[0]):
            raise SceneError(f"{where}[{k}].fov", says="give one to all keyframes or to none")
    return tuple(frames)


def _vector(where: str, value: Any, dim: int) -> Vector:
    return tuple(validation.vector(where, value, dim).tolist())


def require_depth(aperture: float, dim: int) -> None:
    """Raise SceneError where a lens has an aperture [m] in a scene in which all is as far away."""
    if aperture and dim == 2:
        raise SceneError("aperture", aperture, says="is for scenes in 3D; in 2D all is as far away")
