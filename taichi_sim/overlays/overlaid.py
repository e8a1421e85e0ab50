"""Overlaid: a renderer whose pictures have an overlay. The renderer beneath it knows nothing of that."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from taichi_sim.analysis.frame import Frame
from taichi_sim.analysis.lazy_frame import Moment
from taichi_sim.analysis.probe_readings import units_of
from taichi_sim.overlays.legend import legend
from taichi_sim.overlays.panel import DARK, LIGHT, Panel, nice_step, to_bytes
from taichi_sim.overlays.plot import Plot, label_of, padded, places_for, written
from taichi_sim.render.camera import Camera
from taichi_sim.render.palette import PALETTE
from taichi_sim.render.renderer import Renderer
from taichi_sim.scene.overlay import ExpectedPlace, Overlay, ShownProbe

__all__ = ["Overlaid", "open_renderer"]

ORDER = (0, 3, 1, 2, 5, 6, 7)  # of the palette, for curves
DARK_STAGES, DARK_BACKGROUND = ("studio", "blueprint"), 0.4
LEAST_ROOM = 8.0  # of the height of the letters: rows of text are never narrower
MOST_TEXT = 0.25  # of the height of the picture
BAR = 0.2  # of the width of the picture: a scale bar is at most so long


def open_renderer(frame: Frame, size: tuple[int, int], style: Mapping[str, Any]) -> Any:
    """A Renderer for a first frame, with arguments of it and, under `overlay`, the keys of an Overlay: then its pictures have
    that. Raises ValueError for a bad argument."""
    style = dict(style)
    given = style.pop("overlay", None)
    if given is None:
        return Renderer(frame, size=size, **style)
    units = units_of(frame.scene) if isinstance(frame, Moment) else None
    overlay = Overlay.of(given, frame.dim, units)
    return Overlaid(Renderer(frame, size=size, **style), overlay, frame, style, units or {})


class Overlaid:
    """A renderer and the overlay of its pictures. It has what `export` needs of a Renderer."""

    def __init__(
        self, renderer: Renderer, overlay: Overlay, first: Frame, style: Mapping[str, Any], units: Mapping[str, str]
    ) -> None:
        self.renderer, self.overlay = renderer, overlay
        height = renderer.size[1]
        self._text = min(overlay.text_size or max(9.0, height / 30), MOST_TEXT * height)
        self._tints = DARK if _is_dark(style) else LIGHT
        self._units = units
        self._legend = legend(first, style, self._text, self._tints, renderer.size[0]) if overlay.legend else None
        colours = [PALETTE[ORDER[k % len(ORDER)]] for k in range(len(overlay.curves))]
        self._colours = [
            to_bytes(own if one.colour is None else one.colour) for one, own in zip(overlay.curves, colours)
        ]
        self._times: list[float] = []  # of the frames so far, and what the probes read then
        self._values: list[list[float]] = []
        self._reach: tuple[tuple[float, float], tuple[float, float]] | None = None  # of the plot over the whole run
        self._plot: tuple[Any, Plot] | None = None

    # What a Renderer has -----------------------------------------------------------------------------------------------

    def render(self, frame: Frame) -> NDArray[np.uint8]:
        """The picture of a frame with its overlay, as `Renderer.render` gives it."""
        pixels = self.renderer.render(frame)
        self._note(frame)
        picture = Image.fromarray(pixels)
        self._draw(picture, frame)
        return np.array(picture)

    def skip(self, frame: Frame) -> None:
        """Take note of a frame that is not drawn."""
        self.renderer.skip(frame)
        self._note(frame)

    def fit(self, frames: Sequence[Frame]) -> None:
        """Place the camera and the axes so that all of these frames are shown."""
        self.renderer.fit(frames)
        if frames and self.overlay.curves:
            values = np.array([self._read(frame, self.overlay.curves) for frame in frames])
            self._reach = (float(frames[0].time), float(frames[-1].time)), padded(self._with_expected(values))

    def memory(self) -> dict[str, Any]:
        """State from which pictures follow, beside their frame and the first one, as plain values for `recall`."""
        known = [[None if math.isnan(one) else one for one in row] for row in self._values]
        return {"renderer": self.renderer.memory(), "times": list(self._times), "values": known}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Go on as the one did that this is the memory of."""
        self.renderer.recall(memory["renderer"])
        self._times = [float(time) for time in memory["times"]]
        self._values = [[math.nan if one is None else float(one) for one in row] for row in memory["values"]]

    @property
    def camera(self) -> Any:
        """Camera of the pictures."""
        return self.renderer.camera

    def close(self) -> None:
        """Free the memory of the renderer."""
        self.renderer.close()

    def __enter__(self) -> Overlaid:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # Numbers -----------------------------------------------------------------------------------------------------------

    @staticmethod
    def _read(frame: Frame, probes: Sequence[ShownProbe]) -> list[float]:
        return [float(frame.probes.get(one.of, math.nan)) for one in probes]

    def _note(self, frame: Frame) -> None:
        """Remember what the probes read, each time once."""
        if self.overlay.probes and (not self._times or frame.time > self._times[-1]):
            self._times.append(float(frame.time))
            self._values.append(self._read(frame, self.overlay.probes))

    def _with_expected(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        expected = [np.asarray(one.expected)[:, 1] for one in self.overlay.curves if one.expected is not None]
        return np.concatenate([values.ravel(), *expected])

    # What is drawn -----------------------------------------------------------------------------------------------------

    def _draw(self, picture: Any, frame: Frame) -> None:
        for mark in self.overlay.marks:
            self._mark(picture, mark, frame.time)
        margin = 0.6 * self._text
        corner = {"top left": margin, "top right": margin, "bottom left": margin, "bottom right": margin}
        plot = self._curves()
        taken = plot.width + margin if plot is not None and self.overlay.plot == "top right" else 0.0
        words = self._words(frame, picture.width - 2 * margin - taken)
        panels = [(self.overlay.plot, plot), ("top left", words), ("bottom left", self._bar())]
        panels.append(("top right" if self.overlay.plot == "bottom right" else "bottom right", self._legend))
        for place, panel in panels:  # those in one corner lie one beyond the other
            if panel is not None:
                top = corner[place] if "top" in place else picture.height - panel.height - corner[place]
                left = margin if "left" in place else picture.width - panel.width - margin
                panel.onto(picture, left, top)
                corner[place] += panel.height + margin

    def _curves(self) -> Panel | None:
        curves = self.overlay.curves
        if not curves or not self._times:
            return None
        shown = [k for k, one in enumerate(self.overlay.probes) if one.curve]
        values = np.array(self._values)[:, shown]
        times, reach = self._reach or (self._until_now(), padded(self._with_expected(values)))
        reach = self.overlay.plot_range or reach
        times = times if times[1] > times[0] else (times[0], times[0] + 1.0)  # of a lone moment
        if self._plot is None or self._plot[0] != (times, reach):
            margin = 1.2 * self._text
            sides = zip(self.renderer.size, self.overlay.plot_size, Plot.least_size(self._text, len(curves)))
            size = tuple(max(1.0, min(max(share * side, least), side - margin)) for side, share, least in sides)
            label = self.overlay.plot_label
            if label is None:
                label = ", ".join(dict.fromkeys(f"[{unit}]" for one in curves if (unit := self._units.get(one.of))))
            tints = self._tints
            plot = Plot(size, self._text, tints, curves, self._colours, label, times, reach)  # type: ignore[arg-type]
            self._plot = (times, reach), plot
        return self._plot[1].at(self._times, values)

    def _until_now(self) -> tuple[float, float]:
        """Times that axes reach which do not know the end of the run: from the first to a round number."""
        first = self._times[0]
        ends = [np.asarray(one.expected)[-1, 0] for one in self.overlay.curves if one.expected is not None]
        if self._times[-1] > first:
            ends.append(first + nice_step(self._times[-1] - first, 1.0))
        return first, float(max(ends, default=first))

    def _words(self, frame: Frame, room: float) -> Panel | None:
        """Title, clock and values without a curve, in rows that are no wider than the room."""
        text = self._text
        most = max(room, LEAST_ROOM * text) - 1.4 * text
        rows = Panel.wrapped(self.overlay.title, text, most) if self.overlay.title else []
        if self.overlay.clock:
            rows.append(f"t = {written(frame.time, 2)} s")
        for k, one in enumerate(self.overlay.probes):
            if not one.curve and self._times:
                column = np.array(self._values)[:, k]
                places = places_for(float(np.nanmax(np.abs(column), initial=0.0)))
                unit = self._units.get(one.of, "")
                rows.append(f"{label_of(one)}: {written(self._values[-1][k], places)} {unit}".rstrip())
        if not rows:
            return None
        rows = [Panel.shortened(row, text, most) for row in rows]
        width = min(max(Panel.length(row, text) for row in rows) + 1.4 * text, self.renderer.size[0])
        panel = Panel((width, (1.35 * len(rows) + 0.5) * text), text, self._tints.ground)
        for k, row in enumerate(rows):
            panel.text((0.7 * text, (1.35 * k + 0.925) * text), row, self._tints.text, "lm")
        return panel

    def _bar(self) -> Panel | None:
        if not self.overlay.scale_bar:
            return None
        scale, text = self._scale(), self._text
        length = nice_step(BAR * self.renderer.size[0] / scale, 1.0)
        if length * scale > BAR * self.renderer.size[0]:
            length = nice_step(length / 2.5, 1.0)
        words, pixels = f"{length:g} m".replace("-", "\u2212"), length * scale
        width = max(Panel.length(words, text), pixels) + 1.4 * text
        panel = Panel((width, 2.3 * text), text, self._tints.ground)
        panel.text((width / 2, 0.85 * text), words, self._tints.text, "mm")
        left, right, y, thick = (width - pixels) / 2, (width + pixels) / 2, 1.75 * text, text / 8
        panel.line([(left, y), (right, y)], self._tints.text, thick)
        for x in (left, right):
            panel.line([(x, y - 0.25 * text), (x, y + 0.25 * text)], self._tints.text, thick)
        return panel

    def _mark(self, picture: Any, mark: ExpectedPlace, time: float) -> None:
        place = self.renderer.camera.see(mark.at(time)[None], self.renderer.size).at[0]
        if not (np.abs(place) < 1e4).all():  # nor behind the eye
            return
        text = self._text
        r, width = 0.6 * text, min(Panel.length(mark.label, text), self.renderer.size[0])
        panel = Panel((4 * r + width, 4 * r), text)
        for colour, thick in ((self._tints.ground, text / 4), (self._tints.mark, text / 9)):  # with a rim
            panel.disc((2 * r, 2 * r), r + thick / 2, None, colour, thick)
            for dx, dy in ((1, 0), (0, 1)):
                for side in (-1, 1):
                    ends = [(2 * r + side * dx * f * r, 2 * r + side * dy * f * r) for f in (0.5, 1.6)]
                    panel.line(ends, colour, thick)
        if mark.label:
            panel.box((3.8 * r, r), (3.8 * r + width, 3 * r), self._tints.ground)
            panel.text((3.8 * r, 2 * r), mark.label, self._tints.mark, "lm")
        panel.onto(picture, place[0] - 2 * r, place[1] - 2 * r)

    # From metres to pixels ---------------------------------------------------------------------------------------------

    def _scale(self) -> float:
        """Pixels per metre, in 3D at the target of the camera."""
        camera = self.renderer.camera
        if isinstance(camera, Camera):
            return camera.focal(self.renderer.size[1]) / camera.distance
        return float(camera.scale)


def _is_dark(style: Mapping[str, Any]) -> bool:
    background = style.get("background")
    if background is None:
        return style.get("stage") in DARK_STAGES
    return float(np.mean(background)) < DARK_BACKGROUND
