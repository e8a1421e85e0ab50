"""Simulation to one .npz file and back: the scene, all arguments, and where everything is."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields, replace
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common.atomic_file import replacing
from taichi_sim.common.errors import SceneError
from taichi_sim.common.npz import read_npz
from taichi_sim.common.plain import plain
from taichi_sim.common.warn import warn
from taichi_sim.files.source import checked_output
from taichi_sim.scene.document import document, fill, saved
from taichi_sim.scene.scene import Scene
from taichi_sim.scene.snapshot import Snapshot

__all__ = ["FORMAT", "digest", "parts_of", "restore_state", "save_state", "scene_of", "text_of"]

FORMAT = 7


def save_state(simulation: Any, path: str | PathLike[str]) -> None:
    """Write a simulation. Its integrator and contact rule must be built-in ones: an object of your own cannot be written to a
    file."""
    scene = simulation.scene
    if simulation.has_custom_parts:
        raise ValueError(
            "save: forces, contact rules, or an integrator with settings of your own, cannot be written to a file"
        )
    own = simulation.settings
    settings = {name.name: getattr(own, name.name) for name in fields(own)}
    # what has settled does so once
    settings.update(integrator=own.integrator.method.name, precision=simulation.backend.precision, settle=None)
    del settings["chosen"]
    snapshot = simulation.snapshot()
    about, arrays = parts_of(scene)
    about |= {"settings": settings, "time": snapshot.time, "stepping": snapshot.stepping}
    arrays = snapshot.arrays() | arrays
    about = plain(about)
    about["digest"] = digest(about, arrays)
    with replacing(path) as file:
        np.savez(file, about=text_of(about), **arrays)


def digest(about: Mapping[str, Any], arrays: Mapping[str, Any]) -> str:
    """SHA-256 of all that a state holds but this."""
    found = hashlib.sha256(json.dumps({k: v for k, v in about.items() if k != "digest"}, sort_keys=True).encode())
    for name in sorted(arrays):
        array = np.asarray(arrays[name])
        if name != "about":
            found.update(f"{name} {array.dtype.str} {array.shape}".encode())
            found.update(np.ascontiguousarray(array).data if array.dtype.kind in "biuf" else array.tobytes())
    return found.hexdigest()


def text_of(about: Mapping[str, Any]) -> NDArray[np.str_]:
    """The plain values of `parts_of`, and others beside them, as a file holds them: JSON in an array without a shape."""
    return np.array(json.dumps(plain(about)))


def parts_of(scene: Scene) -> tuple[dict[str, Any], dict[str, Any]]:
    """All that a scene is: plain values, and arrays. Raises SceneError for a user-defined collider that cannot be
    written, and for what `Scene.output` may not hold."""
    about, arrays = document(saved(scene))
    return {"format": FORMAT, **about, "output": checked_output(scene)}, arrays


def restore_state(kind: Any, path: str | PathLike[str], overrides: Mapping[str, Any]) -> Any:
    """A `kind` (Simulation) as `save_state` left it, with some arguments replaced. Raises SceneError for
    another file, or what names none."""
    if isinstance(path, Snapshot):
        raise SceneError(
            "path", says="a Snapshot is no file; make a Simulation of its scene, and call its resume(snapshot)"
        )
    if not isinstance(path, (str, PathLike)):
        raise SceneError("path", path, "the name of a file that Simulation.save wrote")
    try:
        arrays = read_npz(path)
    except FileNotFoundError:
        raise SceneError((), says="there is no such file", file=path) from None
    except SceneError as error:
        raise SceneError((), says=f"is not a state that Simulation.save wrote; it {error.says}", file=path) from None
    try:
        about = json.loads(str(arrays["about"]))
        found = about["format"]
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise SceneError((), says=f"is not a state that Simulation.save wrote ({error})", file=path) from None
    if found != FORMAT:
        raise SceneError("format", found, f"{FORMAT}, the one that this version reads and writes", file=path)
    try:
        scene = scene_of(about, arrays)
        snapshot = Snapshot.of_file(arrays, about["time"], about.get("stepping", {})).checked(scene)
        settings = dict(about["settings"])
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, RecursionError) as error:
        raise SceneError((), says=f"is not a state that Simulation.save wrote ({error})", file=path) from None
    # lists of contacts name balls and places of each other: what kernels follow is never taken from a stranger
    edited = about.get("digest") != digest(about, arrays)
    if edited:
        warn(
            f"{path}: was edited, or written by an earlier version: it goes on from its positions and velocities, and contacts"
            " find the load that they carry anew"
        )
    if edited or {"dt", "tolerance", "substeps", "integrator"} & set(overrides):
        settled = {} if edited else {"settled": snapshot.stepping.get("settled")}
        snapshot = replace(snapshot, stepping=settled, memory={})
    simulation = None
    try:
        simulation = kind(scene, **{**settings, **overrides})
        simulation.resume(snapshot)
    except BaseException as error:
        if simulation is not None:
            simulation.close()
        if isinstance(error, SceneError) and error.file is None:
            error.file = path
        raise
    return simulation


def scene_of(about: Mapping[str, Any], arrays: Mapping[str, Any]) -> Scene:
    """Rebuild a scene from what `parts_of` gave. Raises what the parts of a scene raise, and KeyError, TypeError, ... for
    what is damaged."""
    scene = Scene(about["dim"], about["gravity"])
    fill(scene, about, arrays)
    scene.output = about["output"]
    checked_output(scene)
    return scene
