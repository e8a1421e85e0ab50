"""Views that a mouse moves: about a 3D scene, or over a 2D one. Plain numbers; no window.

Pixels are counted from the top left of the picture, as real numbers: the middle of the first one is (0.5, 0.5).
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.render.camera import Camera, Flat, Seen, rotated, triple

TURN = 160.0  # degrees for a drag over the height of the picture
POLE = 2.0  # degrees: no nearer to the view straight down or up
NOTCH = 1.12  # by which a notch of the wheel brings things nearer
MOST_ZOOM = 200.0  # nearer or farther than at first
REACH = 8.0  # px from which a thin or small thing is still hit

Floats = NDArray[np.float64]


class Orbit:
    """A camera that turns about its target. size: (width, height) px."""

    def __init__(self, camera: Camera, size: tuple[int, int]) -> None:
        self.camera, self.size = camera, size
        self._first = self.camera.distance

    def turn(self, dx: float, dy: float) -> None:
        """The scene turns with a drag of dx, dy px: the eye goes round the target, never over its poles."""
        up = np.asarray(self.camera.up, dtype=float) / np.linalg.norm(self.camera.up)
        back = np.subtract(self.camera.eye, self.camera.target)
        per_px = math.radians(TURN) / self.size[1]
        from_pole = math.acos(float(np.clip(back @ up / np.linalg.norm(back), -1.0, 1.0)))
        low, high = math.radians(POLE), math.pi - math.radians(POLE)
        lift = from_pole - float(np.clip(from_pole - dy * per_px, low, high))
        back = rotated(back, self.camera.axes()[0], -lift)
        back = rotated(back, up, -dx * per_px)
        self._place(np.asarray(self.camera.target), back)

    def pan(self, dx: float, dy: float) -> None:
        """Move the camera so that points as deep as the target follow a drag of dx, dy px."""
        right, up, _ = self.camera.axes()
        shift = (dy * up - dx * right) * self.camera.distance / self.camera.focal(self.size[1])
        back = np.subtract(self.camera.eye, self.camera.target)
        self._place(np.asarray(self.camera.target) + shift, back)

    def zoom(self, notches: float, at: tuple[float, float]) -> None:
        """Nearer to the target for notches > 0; `at` does not matter here."""
        back = np.subtract(self.camera.eye, self.camera.target)
        wanted = np.clip(self.camera.distance / NOTCH**notches, self._first / MOST_ZOOM, self._first * MOST_ZOOM)
        self._place(np.asarray(self.camera.target), back * (wanted / self.camera.distance))

    def _place(self, target: Floats, back: Floats) -> None:
        eye = target + back
        self.camera = replace(self.camera, eye=triple(eye), target=triple(target))

    def point(self, at: tuple[float, float], depth: float) -> Floats:
        """The point (3,) m at a pixel and a depth."""
        right, up, forward = self.camera.axes()
        x, y = (np.array(at) - np.array(self.size) / 2) * depth / self.camera.focal(self.size[1])
        return np.asarray(self.camera.eye) + right * x - up * y + forward * depth


class Slide:
    """A camera of a 2D scene with the functions of `Orbit`; there is one depth and nothing turns."""

    def __init__(self, camera: Flat, size: tuple[int, int]) -> None:
        self.camera, self.size = camera, size
        self._first = camera.scale

    def turn(self, dx: float, dy: float) -> None:
        """Pan by a drag of dx, dy px, since nothing turns in 2D."""
        self.pan(dx, dy)

    def pan(self, dx: float, dy: float) -> None:
        """The scene follows a drag of dx, dy px."""
        low = np.asarray(self.camera.low) + np.array([-dx, dy]) / self.camera.scale
        self.camera = Flat(tuple(low.tolist()), self.camera.scale)

    def zoom(self, notches: float, at: tuple[float, float]) -> None:
        """Larger for notches > 0; what is at pixel `at` stays there."""
        fixed = self.point(at, 0.0)
        scale = float(np.clip(self.camera.scale * NOTCH**notches, self._first / MOST_ZOOM, self._first * MOST_ZOOM))
        low = fixed - np.array([at[0], self.size[1] - at[1]]) / scale
        self.camera = Flat(tuple(low.tolist()), scale)

    def point(self, at: tuple[float, float], depth: float) -> Floats:
        """The point (2,) m at a pixel."""
        return np.asarray(self.camera.low) + np.array([at[0], self.size[1] - at[1]]) / self.camera.scale


def view_of(camera: Camera | Flat, size: tuple[int, int]) -> Orbit | Slide:
    """The view that begins with this camera."""
    return Slide(camera, size) if isinstance(camera, Flat) else Orbit(camera, size)


def pick(view: Orbit | Slide, frame: Frame, at: tuple[float, float]) -> int | None:
    """The ball that a click at a pixel means, or None: the foremost disc or surface there, of a surface its nearest corner; else
    what is nearest within a few px. Pinned balls are not picked, but hide what lies behind them."""
    if not len(frame.position):
        return None
    seen = view.camera.see(frame.position, view.size)
    away = np.linalg.norm(seen.at - at, axis=1)
    skin = np.zeros(len(away), dtype=bool)
    skin[frame.triangles.ravel()] = True
    gap = away - np.where(skin, 0.0, frame.radius * seen.scale)  # to a disc or a corner
    discs = np.flatnonzero(~skin & (gap <= 0))
    found = [(float(seen.depth[i] - (frame.dim == 3) * frame.radius[i]), int(i)) for i in discs]
    found += _surface(seen, frame.triangles, at, away)
    if found:  # in 2D the disc drawn last lies on top
        ball = min(found, key=lambda hit: (hit[0], -hit[1]))[1]
    else:
        ball = int(np.argmin(np.where(np.isnan(gap), np.inf, gap)))
        if not gap[ball] <= REACH:
            return None
    return None if len(frame.pinned) and frame.pinned[ball] else ball


def _surface(
    seen: Seen, triangles: NDArray[np.int32], at: tuple[float, float], away: Floats
) -> list[tuple[float, int]]:
    """Depth and nearest corner of each triangle that covers a pixel."""
    if not len(triangles):
        return []
    a, b, c = (seen.at[triangles[:, k]] - at for k in range(3))
    parts = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)
    hit = np.flatnonzero((np.all(parts >= 0, axis=1) | np.all(parts <= 0, axis=1)) & (parts.sum(axis=1) != 0))
    hit = hit[~np.isnan(parts[hit]).any(axis=1)]
    share = parts[hit] / parts[hit].sum(axis=1, keepdims=True)
    depth = np.sum(share * seen.depth[triangles[hit]], axis=1)
    nearest = triangles[hit, np.argmin(away[triangles[hit]], axis=1)]
    return list(zip(depth.tolist(), nearest.tolist()))


def _cross(a: Floats, b: Floats) -> Floats:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
