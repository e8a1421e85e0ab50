"""Views of pages: each as its own shape wants it, and farther away as soon as something leaves its picture."""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.geometry.spheres import icosphere
from taichi_sim.render.camera import Camera, embedded_vertices, robust_bounds, triple
from taichi_sim.render.renderer2d import flat_view
from taichi_sim.render.tracker import Tracker
from taichi_sim.scene.camera_path import CameraPath
from taichi_sim.viewer.web_waiting import PHONE

__all__ = ["Framing", "holding"]

PICTURE = (1280, 880)  # px of a page whose shape is not known
LEAST_PAGE, LARGEST_PAGE = 100, 20_000  # px
PANEL = 330  # px of a page wider than PHONE, which the panel covers at the right
FLAT_FOV = 20.0  # degrees: a flat scene is seen from afar
SAMPLED = 1_000  # balls that are looked at for each picture
BEYOND = 0.1  # of what left the picture: room that is made about it, so that the next moment fits, too
MOST_AWAY = 4.0  # times the first distance: what flies farther leaves the picture
NEAREST_EYE, FARTHEST_EYE = 1e-6, 1e9  # in the unit of pages: cameras that they may have
TURNED = 0.01  # of the distance: a page that looks from farther off where it was put was turned by its user


@dataclass
class _Page:
    """A page's free part, in halves of the picture from its middle, and the cameras that it was given, in the unit of pages."""

    aspect: float
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    given: list[Camera] = field(default_factory=list)


class Framing:
    """The views of all pages of a server. place: puts points (n, dim) [m] into the unit of pages."""

    def __init__(self, server: Any, first: Frame, style: Mapping[str, Any], place: Callable[..., NDArray]) -> None:
        self._viser, self._first, self._camera, self._place = server.viser, first, style.get("camera"), place
        path = self._camera or CameraPath()
        if isinstance(path, Mapping):
            path = CameraPath.of(path, first.dim, len(first.position))
        self._follows = isinstance(path, CameraPath) and path.is_open
        self._ways = icosphere(1).vertices  # directions in which the farthest of all so far is kept
        self._farthest: NDArray[np.float64] | None = None
        self._pages: dict[int, _Page] = {}
        self._lock = threading.Lock()  # pages come in threads of the server
        seen, start = self._seen(*PICTURE), server.viser.initial_camera
        start.up, start.fov = seen.up, float(np.radians(seen.fov))
        start.position, start.look_at = seen.eye, seen.target
        self.hold(first)
        server.viser.on_client_connect(self._fit)

    def _seen(self, width: int, height: int) -> Camera:
        """The camera of a page of so many px, which shows the scene beside the panel; as pictures are seen that wide."""
        panel = _panel(width)
        free = (width - panel, height)
        if self._first.dim == 3:
            seen = Tracker(self._first, self._camera, free[0] / free[1]).first
        else:
            low, scale = flat_view([self._first], free)
            middle = np.array([*(low + np.array(free) / 2 / scale), 0.0])
            away = (0.0, 0.0, free[1] / 2 / scale / np.tan(np.radians(FLAT_FOV / 2)))
            seen = Camera(triple(middle + away), triple(middle), fov=FLAT_FOV)
        if self._camera is None:
            aside = panel / height * np.tan(np.radians(seen.fov / 2)) * seen.distance * seen.axes()[0]
            seen = replace(seen, eye=triple(seen.eye + aside), target=triple(seen.target + aside))
        eye, target = self._place(np.array([seen.eye, seen.target]))
        return replace(seen, eye=triple(eye), target=triple(target))

    def _fit(self, client: Any) -> None:
        """Let a page that was just opened look as its own shape wants it. A page may say anything: one whose camera, or size, is
        none is left as it is."""
        its, low, high = client.camera, LEAST_PAGE, LARGEST_PAGE
        if not _is_camera(its):
            return
        width, height = (int(np.clip(one, low, high)) for one in (its.image_width, its.image_height))
        with self._lock:
            if client.client_id in self._pages:
                return
            page = _Page(width / height, np.array([-1.0, -1.0]), np.array([1.0 - 2.0 * _panel(width) / width, 1.0]))
            self._pages[client.client_id] = page
            page.given.append(self._seen(width, height))
            _look(client, page.given[0])
            self._widen(client, page)
        client.camera.on_update(lambda _: self._again(client))

    def hold(self, frame: Frame) -> None:
        """Let every page that was not turned show this frame, too."""
        if not self._follows or not len(frame.position):
            return
        every = max(1, len(frame.position) // SAMPLED)
        position, radius = frame.position[::every], frame.radius[::every]
        bounds, kept = robust_bounds(position, radius)
        drawn = embedded_vertices(frame, bounds)
        points = self._place(np.concatenate([position[kept], drawn])).astype(float)
        scale = np.linalg.norm(self._place(bounds.high[None]) - self._place(bounds.low[None])) / bounds.size
        sizes = np.concatenate([radius[kept], np.zeros(len(drawn))]) * scale
        if not np.isfinite(points).all():
            return
        if self._farthest is not None:
            points, sizes = np.concatenate([points, self._farthest]), np.append(sizes, np.zeros(len(self._farthest)))
        with self._lock:
            far = (self._ways @ points.T + sizes).argmax(axis=1)
            self._farthest = points[far] + sizes[far, None] * self._ways
            for number, client in self._viser.get_clients().items():
                if number in self._pages:
                    self._widen(client, self._pages[number])

    def _again(self, client: Any) -> None:
        """Put a page anew that says that it looks from where all begin: it may hear of that after what fits its own shape."""
        with self._lock:
            self._widen(client, self._pages[client.client_id])

    def _widen(self, client: Any, page: _Page) -> None:
        if not _is_camera(client.camera):
            return
        seen, at = page.given[-1], np.array(client.camera.position)
        distance = page.given[0].distance
        start = self._viser.initial_camera.position
        if min(np.linalg.norm(at - eye) for eye in (start, *(one.eye for one in page.given))) > TURNED * distance:
            return
        if self._farthest is not None:
            seen = holding(seen, self._farthest, page.aspect, page.low, page.high, MOST_AWAY * distance)
        if seen is not page.given[-1]:
            page.given.append(seen)
        if np.linalg.norm(at - seen.eye) > 1e-3 * TURNED * distance:
            _look(client, seen)


def _is_camera(its: Any) -> bool:
    """True where a page's camera is one that viser can move."""
    try:
        vectors = np.array([its.position, its.look_at, its.up_direction], dtype=np.float64)
        sizes = np.array([its.image_width, its.image_height], dtype=np.float64)
    except (TypeError, ValueError):
        return False
    if vectors.shape != (3, 3) or not (np.abs(vectors) < FARTHEST_EYE).all() or not np.isfinite(sizes).all():
        return False
    return bool(np.linalg.norm(vectors[1] - vectors[0]) > NEAREST_EYE and vectors[2].any())


def _panel(width: int) -> int:
    """Pixels that the panel covers of a page so wide."""
    return min(PANEL, width // 2) if width > PHONE else 0


def _look(client: Any, camera: Camera) -> None:
    with client.atomic():
        client.camera.position, client.camera.look_at = camera.eye, camera.target


def holding(
    camera: Camera, points: NDArray, aspect: float, low: NDArray, high: NDArray, most: float = np.inf
) -> Camera:
    """A camera of the same direction, moved as little as shows points (n, 3), and never nearer; the same one where it shows them.

    aspect: width over height of the picture; low, high (2,): the free part of it, in halves from its middle; most: distance of
    the target that is not exceeded.
    """
    axes, tall = camera.axes(), np.tan(np.radians(camera.fov / 2))
    slopes = np.array([tall * aspect, tall])
    local = (points - camera.eye) @ axes.T
    across, depth = local[:, :2], local[:, 2:]
    if (depth > 0).all() and (across >= low * slopes * depth).all() and (across <= high * slopes * depth).all():
        return camera
    middle, half = (low + high) / 2, (high - low) / 2 / (1.0 + BEYOND)
    left, right = (middle - half) * slopes, (middle + half) * slopes  # of the free part less its border, at depth 1
    least, largest = (across - left * depth).min(axis=0), (across - right * depth).max(axis=0)
    back = min(0.0, float(((least - largest) / (right - left)).min()))
    aside = np.clip(0.0, largest + right * back, least + left * back)
    eye = camera.eye + np.array([*aside, back]) @ axes
    distance = camera.distance - back
    return camera if distance > most else replace(camera, eye=triple(eye), target=triple(eye + distance * axes[2]))
