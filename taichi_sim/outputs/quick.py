"""Videos and pictures from Python in one call."""

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from inspect import signature
from os import PathLike
from typing import Any

from taichi_sim.common.errors import unknown_key
from taichi_sim.common.progress import waiting
from taichi_sim.outputs import open_output
from taichi_sim.outputs.export import export
from taichi_sim.outputs.summary import Summary
from taichi_sim.scene.scene import Scene

__all__ = ["output_options", "picture", "video"]

DEFAULTS = {"fps": 60.0, "duration": 5.0, "size": (1280, 720)}


def output_options(scene: Scene, given: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of `export`: those given, None left out, over `scene.output` over DEFAULTS. Raises SceneError for what
    `scene.output` may not hold."""
    from taichi_sim.files.source import checked_output

    chosen = DEFAULTS | checked_output(scene) | {key: value for key, value in given.items() if value is not None}
    return {key: chosen.pop(key) for key in DEFAULTS} | {"style": chosen}


def video(
    what: Any,
    path: str | PathLike[str],
    *,
    duration: float | None = None,
    fps: float | None = None,
    size: tuple[int, int] | None = None,
    progress: bool = True,
    overwrite: bool = False,
    codec: str | None = None,
    style: dict[str, Any] | None = None,
    error: bool = False,
    **settings: Any,
) -> Summary:
    """Simulate and write what is seen: `ts.video(scene, "x.mp4", duration=3)`. Any ending that `ts.open_output` knows will do.

    Args:
        what: a Scene, or a Simulation, which goes on from where it is and stays open.
        duration [s], fps [1/s], size (width, height) [px], style (arguments of `Renderer`): what is left out is taken from
            `scene.output`, then 5 s, 60 frames a second, 1280 x 720.
        progress: a bar on standard error, or a line every few seconds where that is no terminal; False: none.
        overwrite, codec: see `ts.open_output`. error: see `ts.export`.
        settings: arguments of Simulation, where a Scene is given: dt, integrator, ...; and of `Renderer`, which go before
            those in `style`: camera, stage, ...

    Returns what the run did; `summary.lines()` says it in words, and a notebook shows it with the
    video. Raises what Simulation, `ts.open_output` and `ts.export` raise.
    """
    _require_known(settings)
    look = {name: settings.pop(name) for name in _looks() if name in settings}
    scene, context = _simulation(what, settings)
    options = output_options(scene, {"duration": duration, "fps": fps, "size": size})
    options["style"] |= (style or {}) | look
    with waiting("preparing the simulation", progress):  # which settling takes long for
        made = context()
    with made as simulation:
        output = open_output(path, fps=options["fps"], overwrite=overwrite, codec=codec)
        summary = export(simulation, output, progress=progress, error=error, **options)
    summary.video = str(path)
    return summary


def picture(what: Any, *, size: tuple[int, int] = (640, 360), **style: Any) -> Any:
    """The present moment of a Simulation, or the start of a Scene, as a Pillow image, which a notebook shows.

    Args: size (width, height) [px]; style: further arguments of `taichi_sim.render.Renderer`, and
    `overlay`; what is left out is taken from `scene.output`, but for its size.
    """
    from PIL import Image

    from taichi_sim.overlays import open_renderer

    scene, context = _simulation(what, {"contacts": "off"} if isinstance(what, Scene) else {})
    style = output_options(scene, {})["style"] | style
    with context() as simulation:
        frame = simulation.frame()
        if style.get("overlay"):
            frame.probes = simulation.probes()
        with open_renderer(frame, size, style) as renderer:
            return Image.fromarray(renderer.render(frame))


def _require_known(settings: Mapping[str, Any]) -> None:
    """Raise SceneError for a word that is no argument of `video`, nor of Simulation."""
    from taichi_sim.simulation.settings import DEFAULTS as SETTINGS

    own = [name for name in signature(video).parameters if name not in ("what", "settings")]
    further = [*SETTINGS, "forces", *_looks()]
    for name in settings:
        if name not in further:
            raise unknown_key(name, [*own, *further], "an argument of video")


def _looks() -> list[str]:
    """Names of what says how a scene looks: the arguments of `Renderer`, and the overlay."""
    from taichi_sim.render.renderer import Renderer

    return [*(name for name in signature(Renderer).parameters if name not in ("frame", "size")), "overlay"]


def _simulation(what: Any, settings: dict[str, Any]) -> tuple[Scene, Callable[[], Any]]:
    """The scene, and a context whose simulation is closed only where it was made here."""
    from taichi_sim.simulation.simulation import Simulation

    if isinstance(what, Scene):
        return what, lambda: Simulation(what, **settings)
    if not isinstance(what, Simulation):
        raise TypeError(f"{type(what).__name__} is neither a Scene nor a Simulation")
    if settings:
        raise ValueError(f"{', '.join(settings)}: a Simulation has its settings already; give a Scene with them")
    return what.scene, lambda: nullcontext(what)
