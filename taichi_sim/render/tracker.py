"""Tracker: the camera of each frame along a CameraPath."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.render.camera import AZIMUTH, ELEVATION, FOV, Camera, rotated, triple
from taichi_sim.scene.camera_path import CameraPath

__all__ = ["Follower", "Tracker"]

FOLLOWING_RATE = 5.0  # 1/s: how fast a camera catches up with what it follows


class Follower:
    """The middle of some balls, smoothed: x'' = w^2 (g - x) + 2 w (g' - x'), critically damped, for a middle g that moves evenly
    between two frames, solved exactly. Nothing lags behind what moves evenly, and no speed jumps."""

    def __init__(self, balls: NDArray[np.int32], frame: Frame) -> None:
        self._balls = balls
        self.begin = self._middle(frame)
        self._begin_at(frame)

    def _begin_at(self, frame: Frame) -> None:
        self.place = self._goal = self._middle(frame)
        self._time = frame.time
        self._speed = np.zeros_like(self.place)
        if len(frame.velocity):
            self._speed = frame.velocity[self._balls].mean(axis=0)

    def memory(self) -> list[Any]:
        """State from which the next place follows, as plain values for `recall`."""
        return [self._time, self.place.tolist(), self._goal.tolist(), self._speed.tolist()]

    def recall(self, memory: Sequence[Any]) -> None:
        """Go on from there."""
        self._time = memory[0]
        self.place, self._goal, self._speed = (np.array(one) for one in memory[1:])

    def at(self, frame: Frame) -> NDArray[np.float64]:
        """Place (dim,) [m] at a frame; frames come in order of time, or all begins again."""
        elapsed = frame.time - self._time
        if elapsed < 0:  # it was put back
            self._begin_at(frame)
        if elapsed > 0:
            goal, w = self._middle(frame), FOLLOWING_RATE
            even = (goal - self._goal) / elapsed
            off, drift = self.place - self._goal, self._speed - even
            pull, fade = drift + w * off, math.exp(-w * elapsed)
            self.place = goal + (off + pull * elapsed) * fade
            self._speed = even + (drift - w * pull * elapsed) * fade
            self._goal, self._time = goal, frame.time
        return self.place

    def _middle(self, frame: Frame) -> NDArray[np.float64]:
        return np.array(frame.position[self._balls].mean(axis=0), dtype=float)


class Tracker:
    """camera: fixed, or a CameraPath or the keys of one, or None; what that leaves open is placed by the first frame or by `fit`.

    Calls of `at` are in order of time, also for frames that are not drawn. Raises ValueError.
    """

    def __init__(self, frame: Frame, camera: Any, aspect: float) -> None:
        self.follower: Follower | None = None
        self._path: CameraPath | None = None
        if isinstance(camera, Camera):
            self.first = camera
            return
        if isinstance(camera, Mapping):
            camera = CameraPath.of(camera, 3, len(frame.position))
        path = self._path = camera or CameraPath()
        self._aspect = aspect
        if path.follow is not None:
            self.follower = Follower(path.follow, frame)
        self.fit([frame])

    @property
    def is_open(self) -> bool:
        """True if an argument is left out that is chosen from all frames of a run."""
        return self._path is not None and self._path.is_open

    def fit(self, frames: Sequence[Frame]) -> None:
        """Place what the path leaves open so that all of these frames are shown."""
        path = self._path
        if path is None:
            return
        self.first = (
            self._along(path.path[0]["time"]) if path.path else _placed(path, frames, self._aspect, self.follower)
        )
        self.first.axes()  # refuses what has no direction

    def at(self, frame: Frame) -> Camera:
        """The camera of a frame."""
        path = self._path
        if path is None:
            return self.first
        if path.path:
            return self._along(frame.time)
        eye, target = np.array(self.first.eye), np.array(self.first.target)
        if path.orbit:
            eye = target + rotated(eye - target, np.array(path.up), math.radians(path.orbit * frame.time))
        if self.follower is not None:
            shift = self.follower.at(frame) - self.follower.begin
            eye, target = eye + shift, target + shift
        return Camera(triple(eye), triple(target), self.first.up, self.first.fov)

    def _along(self, time: float) -> Camera:
        assert self._path is not None
        eye, target, fov = self._path.place(time)
        return Camera(triple(eye), triple(target), triple(self._path.up), FOV if fov is None else fov)


def _placed(path: CameraPath, frames: Sequence[Frame], aspect: float, follower: Follower | None) -> Camera:
    """The camera at the start: as given, and where what frames show fills the picture otherwise."""
    azimuth = AZIMUTH if path.azimuth is None else path.azimuth
    elevation = ELEVATION if path.elevation is None else path.elevation
    fov = FOV if path.fov is None else path.fov
    middle = path.target if follower is None or path.target is not None else triple(follower.begin)
    fit = Camera.fit(frames, aspect, azimuth, elevation, fov, middle, path.orbit)
    target = np.array(fit.target)
    back = np.subtract(fit.eye, fit.target)
    if path.distance is not None:
        back *= path.distance / np.linalg.norm(back)
    eye = target + back if path.eye is None else np.array(path.eye)
    return Camera(triple(eye), triple(target), triple(np.array(path.up)), fov)
