"""A file of the frames of a simulation that are still to be drawn."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from taichi_sim.analysis.frame import Contacts, Frame
from taichi_sim.analysis.lazy_frame import MomentsOf
from taichi_sim.scene.scene import Scene

__all__ = ["load", "save"]


def save(path: Path, frames: Sequence[Any]) -> None:
    """Write what differs between frames, as `Simulation.frame` gives them, to an .npz."""
    names = ("position", "velocity", "spin")
    columns: dict[str, Any] = {name: np.stack([getattr(one, name) for one in frames]) for name in names}
    if frames[0].torn is not None:
        columns["torn"] = np.stack([one.torn for one in frames])
    said = [(one.contacts, dict(one.probes)) for one in frames]
    about = np.array(json.dumps(said, default=np.generic.item))
    np.savez(path, time=[one.time for one in frames], about=about, **columns)


def load(path: Path, scene: Scene) -> list[Frame]:
    """The frames, of the same scene."""
    with np.load(path) as file:
        columns = {name: file[name] for name in file.files}
    frames: list[Frame] = []
    moments = MomentsOf(scene)
    for k, (contacts, probes) in enumerate(json.loads(str(columns["about"]))):
        torn = columns["torn"][k] if "torn" in columns else None
        x, v, spin = (columns[name][k] for name in ("position", "velocity", "spin"))
        frame = moments.at(float(columns["time"][k]), x, v, spin, torn)
        frame.contacts, frame.probes = None if contacts is None else Contacts(*contacts), probes
        frames.append(frame)
    return frames
