"""A file of the frames of a simulation that are still to be drawn."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis.frame import Contacts, Frame
from taichi_sim.analysis.lazy_frame import MomentsOf
from taichi_sim.common.atomic_file import replacing
from taichi_sim.common.npz import read_npz
from taichi_sim.outputs.kept_files import judged
from taichi_sim.scene.scene import Scene

__all__ = ["load", "save"]


def save(path: Path, frames: Sequence[Any]) -> None:
    """Write what differs between frames, as `Simulation.frame` gives them, to an .npz, whole before it appears."""
    names = ("position", "velocity", "spin")
    columns: dict[str, Any] = {name: np.stack([getattr(one, name) for one in frames]) for name in names}
    if frames[0].torn is not None:
        columns["torn"] = np.stack([one.torn for one in frames])
    said = [(one.contacts, dict(one.probes)) for one in frames]
    about = np.array(json.dumps(said, default=np.generic.item))
    with replacing(path) as file:
        np.savez(file, time=[one.time for one in frames], about=about, **columns)


def load(path: Path, scene: Scene, count: int) -> list[Frame]:
    """The frames, so many, of the same scene. Raises SceneError where the file is damaged."""
    frames: list[Frame] = []
    moments = MomentsOf(scene)
    with judged(path):
        columns = read_npz(path)
        said = json.loads(str(columns["about"]))
        _check(columns, said, scene, count)
        for k, (contacts, probes) in enumerate(said):
            torn = columns["torn"][k] if "torn" in columns else None
            x, v, spin = (columns[name][k] for name in ("position", "velocity", "spin"))
            frame = moments.at(float(columns["time"][k]), x, v, spin, torn)
            frame.contacts = None if contacts is None else Contacts(*contacts)
            frame.probes = {name: float(value) for name, value in probes.items()}
            frames.append(frame)
    return frames


def _check(columns: Mapping[str, NDArray], said: Any, scene: Scene, count: int) -> None:
    """Raise ValueError where these are not so many frames of the scene."""
    n, dim = scene.n_balls, scene.dim
    shapes = {"time": (count,), "position": (count, n, dim), "velocity": (count, n, dim)}
    shapes |= {"spin": (count, n, 1 if dim == 2 else 3), "torn": (count, scene.n_springs)}
    if not isinstance(said, list) or len(said) != count:
        raise ValueError(f"about is not that of {count} frames")
    for name, column in columns.items():
        if name == "about":
            continue
        if column.shape != shapes[name] or column.dtype.kind != ("b" if name == "torn" else "f"):
            raise ValueError(f"{name} is {column.dtype} {column.shape}, not {shapes[name]}")
        if not np.isfinite(column).all():
            raise ValueError(f"{name} is not finite")
