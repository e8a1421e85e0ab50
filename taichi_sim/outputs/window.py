"""A plain live window through ti.GUI, which needs a display but no OpenGL and no Vulkan."""

import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from taichi_sim.errors import BackendError

__all__ = ["require_display", "show"]

KEYS = "space: pause, s: step, r: reset, p: picture, esc: quit"


def require_display() -> None:
    """Raise BackendError where a window would end the process: on Linux without a display."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise BackendError("there is no display for a window; use `taichi-sim run SCENE -o x.mp4` instead")


def show(
    simulate: Callable[[], Any],
    *,
    fps: float,
    size: tuple[int, int],
    until: float | None = None,
    style: Mapping[str, Any] | None = None,
) -> None:
    """Show a simulation until the window is closed, at most as fast as real time; reset makes a fresh one.

    Args: simulate makes a `Simulation`; fps: pictures per simulated second; size px;
        until: simulated seconds, or for ever; style: further arguments of `Renderer`.
    """
    simulation = simulate()  # starts Taichi
    import taichi as ti

    window = ti.GUI(f"taichi_sim: {KEYS}", res=size, fast_gui=False)
    try:
        again = True
        while again:
            again = _play(window, simulation, fps, size, until, style or {})
            simulation.close()
            if again:
                simulation = simulate()
    finally:
        window.close()


def _play(
    window: Any, simulation: Any, fps: float, size: tuple[int, int], until: float | None, style: Mapping[str, Any]
) -> bool:
    """Show one simulation from its start; True when it is to be reset."""
    from taichi_sim.render import Renderer

    paused, due = False, time.perf_counter()
    frame = simulation.frame()
    with Renderer(frame, size=size, **style) as renderer:
        while window.running:
            step = False
            for key in _pressed(window):
                if key == window.ESCAPE:
                    return False
                if key == "r":
                    return True
                if key == "p":
                    _save(renderer.render(frame))
                paused = not paused if key == window.SPACE else paused
                step = step or key == "s"
            if (step or not paused) and (until is None or simulation.time < until):
                simulation.run(1.0 / fps)
                frame = simulation.frame()
            window.set_image(_upright(renderer.render(frame)))
            window.show()
            due = max(due + 1.0 / fps, time.perf_counter())
            time.sleep(max(0.0, due - time.perf_counter()))
    return False


def _pressed(window: Any) -> Iterator[str]:
    while window.get_event():
        if window.event.type == window.PRESS:
            yield window.event.key


def _upright(image: np.ndarray) -> np.ndarray:
    """A picture (height, width, 3), row 0 at the top, as ti.GUI has it: (x, y, 3) with y up, 0 to 1."""
    return np.ascontiguousarray(image[::-1].swapaxes(0, 1)).astype(np.float32) / 255.0


def _save(image: np.ndarray) -> None:
    """Write picture_000.png, picture_001.png, ... in the working folder: the first name that is free."""
    from PIL import Image

    number = 0
    while (path := Path(f"picture_{number:03d}.png")).exists():
        number += 1
    Image.fromarray(image).save(path)
