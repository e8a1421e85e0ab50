"""Frames on pages: balls, surfaces, springs, colliders and walls, as parts of a viser scene."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Frame
from taichi_sim.geometry.spheres import icosphere
from taichi_sim.outputs.parts import Parts, Surface, in_3d, placed
from taichi_sim.outputs.wall_squares import wall_squares
from taichi_sim.overlays.legend import UNITS
from taichi_sim.render.camera import robust_bounds
from taichi_sim.render.colouring import Colouring
from taichi_sim.scene.looks import Look, Subjects
from taichi_sim.viewer.overlay import PULL
from taichi_sim.viewer.player import Rows
from taichi_sim.viewer.web_framing import Framing
from taichi_sim.viewer.web_server import WebServer
from taichi_sim.viewer.web_surface import WebSurface, textured, to_bytes

__all__ = ["COLOURS", "WebStage"]

Grip = Callable[[str, int, Any, NDArray], None]  # phase of a drag, page, a function that says which ball, place [m]

COLOURS = ("object", "speed", "strain")
MOST_SPHERES = 50_000  # loose balls from which on they are drawn as points, which cannot be dragged
MOST_BALLS, MOST_SPRINGS, MOST_TRIANGLES = 200_000, 100_000, 400_000  # more are thinned
ROUND = ((500, 2), (20_000, 1), (MOST_SPHERES, 0))  # so many spheres at most have triangles cut so often
SCALE = to_bytes(Colouring.shades(256))  # of colours, sRGB
SIZES = 8  # of points
FARTHEST = 100.0  # of the size of the scene: nothing is dragged farther
LEAST_BALL = 0.006  # of the size of the scene: balls without a radius
WALL = (0.82, 0.83, 0.85)  # sRGB
LIGHT = 0.5  # of what viser lights surfaces with beside its lamps, which alone makes colours pale


def _like_sizes(radius: NDArray) -> list[tuple[float, NDArray]]:
    """At most SIZES radii, and which of all radii (n,) come close to each."""
    if not len(radius):
        return []
    sizes = np.unique(np.quantile(radius, (np.arange(SIZES) + 0.5) / SIZES, method="nearest"))
    kind = np.searchsorted((sizes[1:] + sizes[:-1]) / 2, radius)
    return [(float(size), np.flatnonzero(kind == k)) for k, size in enumerate(sizes)]


class WebStage:
    """The scene of all pages of a server, made from the first frame; `show` puts it to another one.

    Pages have the unit of the size of the scene, and its middle as origin: it may be of any size, and anywhere. style: arguments
    of a `Renderer`; grip: called when a ball is dragged, None: nothing can be dragged; notes: what is not shown, in words.
    """

    def __init__(self, server: WebServer, first: Frame, style: Mapping[str, Any], grip: Grip | None = None) -> None:
        self.server, self.scene, self._grip = server, server.viser.scene, grip
        labels = (one.collider.label for one in first.colliders)
        known = getattr(first, "scene", first).triangles
        subjects = Subjects.of(first.dim, first.objects, known, first.embedded_surfaces, labels)
        looks = Look.listed(style.get("looks"), subjects, read=False)
        self._sheets = subjects.sheets
        self._images = {look.of: look for look in looks if look.texture is not None}
        self._parts, self._first, self._style = Parts(first, self._images), first, style
        bounds, _ = robust_bounds(in_3d(first.position), first.radius)
        self._centre, self._size = bounds.centre, bounds.size
        self.notes: list[str] = []
        self._shown: dict[str, Any] = {}  # handles by their names
        self._kept: tuple[Any, Any] = (None, None)  # springs of a frame, and those that are shown
        self._colourings = {colour: self._colouring(colour) for colour in COLOURS}
        self._own = to_bytes(self._parts.colour)
        self._look()
        self._choose()
        self._walls(first)

    # Places and colours --------------------------------------------------------------------------------------------

    def _to_page(self, x: NDArray) -> NDArray[np.float32]:
        return ((in_3d(x) - self._centre) / self._size).astype(np.float32)

    def _to_scene(self, x: Any) -> NDArray[np.float64]:
        return (np.asarray(x) * self._size + self._centre)[: self._first.dim]

    def _look(self) -> None:
        self.scene.set_up_direction("+y")
        self.scene.configure_environment_map(environment_intensity=LIGHT)
        if self.server.framing is None:  # told again, pages that are open would forget what fits their own shape
            self.server.framing = Framing(self.server, self._first, self._style, self._to_page)

    def _colouring(self, colour: str) -> Colouring | None:
        reach = self._style.get("colour_range") if colour == self._style.get("colour") else None
        return Colouring.of(self._first, colour, reach)

    def legend(self, colour: str) -> Rows:
        """Words on the scale of colours, where there is one, and the notes."""
        scale = self._colourings[colour]
        words = [] if scale is None else [f"dark {scale.low:.3g} to light {scale.high:.3g} {UNITS[colour]}".rstrip()]
        return (*((colour, one) for one in words), *(("", note) for note in self.notes))

    # Choices, made once --------------------------------------------------------------------------------------------

    def _choose(self) -> None:
        parts = self._parts
        triangles = sum(len(faces) for faces in parts.triangles(self._first))
        self._surfaces = [self._surface(k, one) for k, one in enumerate(parts.surfaces)]
        loose = parts.loose
        if triangles > MOST_TRIANGLES:
            self.notes.append(f"surfaces are drawn as points: {triangles} triangles are too many")
            self._surfaces, loose = [], np.arange(len(parts.hidden))
        self._balls = self._thinned("balls", loose, MOST_BALLS)
        radius = self._first.radius[self._balls] / self._size
        self._radius = np.where(radius > 0, radius, LEAST_BALL).astype(np.float32)
        self._cuts = next((cuts for most, cuts in ROUND if len(self._balls) <= most), None)
        if self._cuts is None and self._grip is not None:
            self.notes.append(f"more than {MOST_SPHERES} balls are drawn as points, which cannot be dragged")
        self._sizes = _like_sizes(self._radius)

    def _surface(self, k: int, surface: Surface) -> WebSurface:
        if surface.name in self._images:
            sheet = self._parts.triangles(self._first)[k] if surface.name in self._sheets else None
            surface = textured(surface, self._images[surface.name], sheet)
        corners = np.unique(surface.corners)

        def nearest(frame: Frame, event: Any) -> int:
            away = frame.position[corners] - self._to_scene(event.start_position)
            return int(corners[np.einsum("ni,ni->n", away, away).argmin()])

        return WebSurface(
            f"/surface{k}", surface, self.scene.add_mesh_simple, lambda mesh: self._let_drag(mesh, nearest)
        )

    def _thinned(self, name: str, items: NDArray, most: int) -> NDArray:
        """At most so many of them, evenly spread, which a note says."""
        every = -(-len(items) // most) if len(items) else 1
        note = f"1 of {every} {name} is drawn: {len(items)} are too many"
        if every > 1 and note not in self.notes:
            self.notes.append(note)
        return items[::every]

    # A frame -------------------------------------------------------------------------------------------------------

    def show(self, frame: Frame, colour: str = "object", held: Any = None) -> None:
        """Put all pages to a frame. colour: one of COLOURS; held: places (dim,) [m] of a ball and of what it is drawn to."""
        colouring = self._colourings[colour]
        values = None if colouring is None else colouring.values(frame)
        tint = self._own if values is None else SCALE[np.rint(255 * values).astype(np.int64)]
        with self.server.viser.atomic():
            self._show_balls(frame, tint)
            faces = self._parts.triangles(frame)
            for k, one in enumerate(self._surfaces):
                one.show(self._to_page(one.surface.points(in_3d(frame.position))), faces[k], values)
            self._show_springs(frame, tint)
            for k, (centre, rotation) in enumerate(placed(frame)):
                self._show_body(k, centre, rotation)
            self._show_hand(held)
        self.server.framing.hold(frame)

    def _show_balls(self, frame: Frame, tint: NDArray[np.uint8]) -> None:
        balls = self._balls
        if not len(balls):
            return
        at, tint = self._to_page(frame.position[balls]), tint[balls]
        if self._cuts is None:
            self._show_points(at, tint)
        elif "balls" in self._shown:
            self._shown["balls"].batched_positions, self._shown["balls"].batched_colors = at, tint
        else:
            ball = icosphere(self._cuts)
            upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(balls), 1)).astype(np.float32)
            self._shown["balls"] = self.scene.add_batched_meshes_simple(
                "/balls", ball.vertices, ball.triangles, upright, at, batched_scales=self._radius, batched_colors=tint,
                lod="off", cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
            self._let_drag(self._shown["balls"], lambda frame, event: int(balls[event.instance_index or 0]))

    def _show_points(self, at: NDArray, tint: NDArray) -> None:
        """Balls as discs, those of like sizes together."""
        for k, (size, mine) in enumerate(self._sizes):
            name = f"points{k}"
            if name in self._shown:
                self._shown[name].points, self._shown[name].colors = at[mine], tint[mine]
            else:
                self._shown[name] = self.scene.add_point_cloud(
                    f"/{name}", at[mine], tint[mine], point_size=size, point_shape="circle", precision="float32"
                )

    def _show_springs(self, frame: Frame, tint: NDArray[np.uint8]) -> None:
        if self._kept[0] is not frame.springs:
            pairs, _ = self._parts.springs(frame)
            self._kept = frame.springs, self._thinned("springs", pairs, MOST_SPRINGS)
        pairs = self._kept[1]
        ends, tint = self._to_page(frame.position)[pairs], tint[pairs]
        line = self._shown.get("springs")
        if line is not None and len(line.points) == len(ends):
            line.points, line.colors = ends, tint
        elif line is not None or len(ends):
            self._shown["springs"] = self.scene.add_line_segments(
                "/springs", ends, tint, thickness=2.0, thickness_units="screen"
            )

    def _show_body(self, k: int, centre: NDArray, rotation: NDArray) -> None:
        from scipy.spatial.transform import Rotation

        name, body = f"collider{k}", self._parts.bodies[k]
        if name not in self._shown:
            is_hollow = self._first.colliders[k].collider.hollow > 0
            self._shown[name] = self.scene.add_mesh_simple(
                f"/{name}", body.vertices / self._size, body.triangles, color=to_bytes(np.array(body.colour)),
                side="back" if is_hollow and self._first.dim == 3 else "double", cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
        x, y, z, w = Rotation.from_matrix(rotation).as_quat()
        self._shown[name].wxyz, self._shown[name].position = (w, x, y, z), self._to_page(centre[None])[0]

    def _show_hand(self, held: Any) -> None:
        line = self._shown.get("hand")
        if held is None:
            if line is not None:
                line.visible = False
            return
        ends = self._to_page(np.stack(held))[None]
        if line is None:
            self._shown["hand"] = self.scene.add_line_segments(
                "/hand", ends, PULL, thickness=4.0, thickness_units="screen"
            )
        else:
            line.points, line.visible = ends, True

    def _walls(self, first: Frame) -> None:
        for k, one in enumerate(wall_squares(first)):
            name, wall, corners = f"/wall{k}", one.body, self._to_page(one.body.vertices)
            if first.dim == 3:
                self.scene.add_mesh_simple(
                    name, corners, wall.triangles, color=to_bytes(np.array(WALL)), side="front", cast_shadow=False
                )
            else:
                ends = (corners[:2] * np.array([1.0, 1.0, 0.0], np.float32))[None]
                self.scene.add_line_segments(
                    name, ends, to_bytes(0.7 * np.array(WALL)), thickness=3.0, thickness_units="screen"
                )

    def _let_drag(self, handle: Any, ball: Any) -> None:
        """Give drags of a part of the scene to `grip`. ball: which one, of the present frame and viser's event. A page may say
        anything, so what it says is looked at."""
        grip, number = self._grip, max(1, len(self._balls))
        if grip is None:
            return

        async def drag(event: Any) -> None:
            places = event.start_position, event.end_position
            if (np.abs(places) < FARTHEST).all() and 0 <= (event.instance_index or 0) < number:
                to = self._to_scene(event.end_position)
                self.server.later(lambda: grip(event.phase, event.client_id, lambda frame: ball(frame, event), to))

        handle.on_drag("left")(drag)
