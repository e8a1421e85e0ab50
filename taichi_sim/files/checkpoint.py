"""Simulation to one .npz file and back: the scene, all arguments, and where everything is."""

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from os import PathLike
from typing import Any
from zipfile import BadZipFile

import numpy as np

from taichi_sim.common import validation
from taichi_sim.common.atomic_file import replacing
from taichi_sim.common.errors import SceneError
from taichi_sim.scene.colliders import shape_of
from taichi_sim.scene.collision_groups import Groups
from taichi_sim.scene.probes import bodies_of
from taichi_sim.scene.scene import Material, Scene, Wall

__all__ = ["restore_state", "save_state"]

FORMAT = 1
MESH = ("vertices", "triangles")
STEPPING = "stepping."  # arrays of the method's memory, and of the second solution by which the error is measured
LOW = ("low_position", "low_velocity")  # what single precision rounded off: without it a run goes on with other bits


def save_state(simulation: Any, path: str | PathLike[str]) -> None:
    """Write a simulation. Its integrator and contact rule must be built-in ones: an object of your own cannot be written to a
    file.

    What contacts hold from the last step is not kept: a pile that is restored finds it anew within a few steps.
    """
    scene = simulation.scene
    if simulation.has_custom_parts:
        raise ValueError(
            "save: forces, contact rules, or an integrator with settings of your own, cannot be written to a file"
        )
    own = simulation.settings
    settings = {name.name: getattr(own, name.name) for name in fields(own)}
    settings.update(
        integrator=own.integrator.name,
        dt="auto" if own.tolerance is not None else simulation.dt,
        substeps="auto" if own.tolerance is not None else simulation.substeps,
        precision=simulation.backend.precision,
    )
    stepping, moments = simulation.stepping()
    about = {
        "format": FORMAT,
        "dim": scene.dim,
        "gravity": scene.gravity.tolist(),
        "materials": [asdict(material) for material in scene.materials],
        "groups": scene.groups.names,
        "walls": [asdict(wall) for wall in scene.walls],
        "colliders": [{k: v for k, v in collider.given.items() if k != "mesh"} for collider in scene.colliders],
        "settings": settings,
        "output": scene.output,
        "time": simulation.time,
        "stepping": stepping,
        "elements": scene.elements(),
    }
    state = {"position": simulation.position, "velocity": simulation.velocity}
    state.update({STEPPING + name: array for name, array in moments.items()})
    if simulation.rounded_off is not None:
        state.update(zip(LOW, simulation.rounded_off))
    if np.any(simulation.surface_speed):
        state["surface_speed"] = simulation.surface_speed
    if simulation.torn is not None:
        state["torn"] = simulation.torn
    if len(simulation.impulses):
        state["impulses"] = simulation.impulses
    for k, collider in enumerate(scene.colliders):
        if "mesh" in collider.given:
            state.update({f"colliders.{k}.{name}": getattr(collider, name) for name in MESH})
    with replacing(path) as file:
        text = np.array(json.dumps(about, default=np.ndarray.tolist))
        np.savez(file, about=text, **state, **scene.to_arrays(), **scene.element_arrays())


def restore_state(kind: Any, path: str | PathLike[str], overrides: Mapping[str, Any]) -> Any:
    """A `kind` (Simulation) as `save_state` left it, with some arguments replaced. Raises SceneError for another file."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
    except FileNotFoundError:
        raise SceneError(f"{path}: there is no such file") from None
    except (BadZipFile, ValueError, EOFError, OSError):
        raise SceneError(f"{path}: is not a state that Simulation.save wrote") from None
    try:
        about = json.loads(str(arrays["about"]))
        if about["format"] != FORMAT:
            raise SceneError(f"{path}: format {about['format']!r} is not known; this version reads {FORMAT}")
        scene = _scene(about, arrays)
        n, dim = scene.n_balls, scene.dim
        x, v = (validation.vectors(name, arrays[name], n, dim) for name in ("position", "velocity"))
        time = validation.number("time", about["time"], low=0)
        low = None
        if LOW[0] in arrays:
            low = (
                validation.vectors(LOW[0], arrays[LOW[0]], n, dim),
                validation.vectors(LOW[1], arrays[LOW[1]], n, dim),
            )
        turning = None
        if "surface_speed" in arrays:
            turning = validation.vectors("surface_speed", arrays["surface_speed"], n, 1 if dim == 2 else 3)
        impulses = arrays.get("impulses")
        if impulses is not None:
            impulses = validation.vectors("impulses", impulses, len(bodies_of(scene)), dim)
        if "torn" in arrays:
            validation.flags("torn", arrays["torn"], scene.n_springs)
        stepping = about.get("stepping", {})
        moments = {
            name.removeprefix(STEPPING): validation.vectors(name, array, n, dim)
            for name, array in arrays.items()
            if name.startswith(STEPPING)
        }
        settings = {key: about["settings"][key] for key in about["settings"]}
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        if isinstance(error, SceneError) and str(error).startswith(str(path)):
            raise
        raise SceneError(f"{path}: is not a state that Simulation.save wrote ({error})") from None
    simulation = kind(scene, **{**settings, **overrides})
    simulation.resume(x, v, time, low, turning, arrays.get("torn"), impulses)
    if not {"dt", "tolerance", "substeps", "integrator"} & set(overrides):
        simulation.set_stepping(stepping, moments)
    return simulation


def _scene(about: dict[str, Any], arrays: dict[str, Any]) -> Scene:
    scene = Scene(about["dim"], about["gravity"])
    for material in about["materials"]:
        material["colour"] = material["colour"] and tuple(material["colour"])
    scene.materials[:] = [Material(**material) for material in about["materials"]]
    scene.groups = Groups(about["groups"])
    scene.walls.extend(Wall(**{**wall, "normal": tuple(wall["normal"])}) for wall in about["walls"])
    for k, given in enumerate(about["colliders"]):
        mesh = {name: arrays[f"colliders.{k}.{name}"] for name in MESH} if given["shape"] == "mesh" else {}
        scene.add_collider(shape_of(given | mesh))
    scene.from_arrays(arrays)
    if "elements" in about:
        scene.set_elements(about["elements"], arrays)
    named = [*scene.material.tolist(), *(wall.material for wall in scene.walls)]
    if any(not 0 <= index < len(scene.materials) for index in set(named)):
        raise SceneError(f"a material is named that is none of the {len(scene.materials)} there are")
    scene.output = about["output"]
    return scene
