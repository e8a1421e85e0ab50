"""Arguments of the commands `report` and `tune`: a scene and options, checked before anything runs."""

import math
from collections.abc import Mapping
from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.probe_readings import quantity_of
from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.files.source import checked_output, demos, open_scene, resolve
from taichi_sim.reports.speed_error.plan import METHODS, PARTS, PRECISIONS, Plan, duration_of, longest_duration
from taichi_sim.scene.scene import Scene
from taichi_sim.simulation.settings import Settings

CLOSER = 0.01  # of the net force that `settle` leaves: less than meshes differ by


def read(
    name: str | None,
    *,
    methods: str | None = None,
    dts: str | None = None,
    precision: str | None = None,
    tolerance: float | str = 1e-3,
    duration: float | None = None,
    limit: float = 4.0,
    quantity: str | None = None,
    resolutions: bool = False,
    arch: str | None = None,
    threads: int | None = None,
    allow_outside: bool | None = None,
    parameters: Mapping[str, Any] | None = None,
) -> tuple[Path, Scene, Plan]:
    """The file, its scene, and the plan. Raises ValueError or OSError that names the option and what is allowed."""
    assert name is not None
    choices: dict[str, Any] = {
        "methods": _words("--methods", methods, METHODS),
        "precisions": _words("--precision", precision, PRECISIONS),
        "steps": None if dts is None else tuple(_positive("--dts", text) for text in _items("--dts", dts)),
        "tolerance": _share("--tolerance", tolerance),
        "most": _positive("--limit", limit),
    }
    if choices["tolerance"] >= 1.0:
        raise ValueError(f"--tolerance: {tolerance} is not allowed; it is a part of the motion, below 1, or like 1%")
    if duration is not None:
        _positive("--duration", duration)
    file = resolve(name)
    scene = open_scene(file, allow_outside=bool(allow_outside), parameters=parameters)
    if scene is None:
        raise SceneError(f"{file}: makes its own simulation(); methods and steps can be compared for a scene() only")
    if not scene.n_balls:
        raise SceneError(f"{file}: holds no ball; there is nothing to compare")
    checked_output(scene)
    rest = None
    if scene.settings.get("settle"):
        scene, rest = settled_scene(scene)
    process = {"arch": arch, "threads": threads}
    given = {key: value for key, value in process.items() if value is not None}
    with scene.in_file(given):
        Settings.resolve(scene, given)
    title = next((name for name, made in demos().items() if made == file), file.stem)
    most = longest_duration(scene)
    if duration is not None and duration > most * (1.0 + 1e-5):
        raise ValueError(
            f"--duration: {duration:g} is not allowed; the longest is {most:.6g} s in this scene, for which the reference takes"
            " about a quarter of an hour"
        )
    if quantity is not None:
        try:
            name = quantity_of(scene, quantity).name
        except SceneError as error:
            raise SceneError(f"--quantity: {error}") from None
        held = next(one for one in scene.probes if one.name == name.split(".")[0]).held_by(scene)
        if held:
            raise SceneError(f"--quantity: {name} never changes, for {held}; name another")
    choices |= {"quantity": quantity, "resolutions": resolutions, "rest": rest}
    plan = Plan(title, duration or duration_of(scene), **choices, arch=arch, threads=threads)
    longest = plan.duration / PARTS
    if plan.steps and max(plan.steps) > longest * (1.0 + 1e-5):
        raise ValueError(
            f"--dts: {max(plan.steps):g} is not allowed; the longest is {longest:g}, an eighth of the {plan.duration:g} s"
            " that are compared (--duration)"
        )
    return file, scene, plan


def settled_scene(scene: Scene) -> tuple[Scene, NDArray[np.float64]]:
    """The scene where it has come to rest, settled further to CLOSER of what `settle` leaves, and `Plan.rest`.

    Every method and step starts from there: in double precision, as the reference is, or in the one that the process runs
    already."""
    from taichi_sim.device import backend
    from taichi_sim.outputs.companion import settle_further
    from taichi_sim.simulation.simulation import Simulation

    precision = "f64" if backend.running() is None else None
    with Simulation(scene, precision=precision, arch=None, threads=None) as simulation:
        rest = position = simulation.position
        left = simulation.settled
        if settle_further(simulation, left, CLOSER):
            position = simulation.position
        elif left is not None and left.residual:
            rest = rest[:0]
    made = copy(scene)
    made.settings = {key: value for key, value in scene.settings.items() if key != "settle"}
    made.set_balls(position=position, velocity=np.zeros_like(position))
    return made, rest


def require_own_file(name: str, file: Path) -> None:
    """Raises SceneError where settings cannot be written into the scene."""
    python, own = file.suffix != ".toml", Path(name).is_file()
    if own and not python:
        return
    lines = "set scene.settings there to the lines that `taichi-sim tune` prints without --write"
    if own:
        raise SceneError(f"--write: {file} is Python and stays as it is; {lines}")
    raise SceneError(f"--write: {name} is a demo; copy {file} and {lines if python else 'tune the copy'}")


def _items(option: str, text: str) -> list[str]:
    items = [item.strip() for item in text.split(",")]
    if not all(items):
        raise ValueError(f"{option}: {text!r} is not allowed; give words or numbers with commas between them")
    return items


def _words(option: str, text: str | None, allowed: tuple[str, ...]) -> tuple[str, ...]:
    if text is None:
        return allowed
    words = _items(option, text)
    for word in words:
        if word not in allowed:
            raise ValueError(f"{option}: {word!r} is not allowed; it must be of {', '.join(allowed)}")
    return tuple(word for word in allowed if word in words)


def _share(option: str, value: float | str) -> float:
    """A number, or one in percent."""
    if isinstance(value, str) and value.endswith("%"):
        return _positive(option, value[:-1]) / 100.0
    return _positive(option, value)


def _positive(option: str, value: Any) -> float:
    try:
        return validation.number(option, float(value), high=math.inf, positive=True)
    except (TypeError, ValueError):
        raise ValueError(f"{option}: {value!r} is not allowed; it must be a number greater than 0") from None
