"""Snapshot: where a simulation is, all that it goes on from."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.common import validation
from taichi_sim.common.errors import SceneError
from taichi_sim.scene.probes import bodies_of
from taichi_sim.scene.scene import Scene

__all__ = ["Snapshot"]

Floats = NDArray[np.float64]
MEMORY = "stepping."  # before the names of memories in a file


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The state of a simulation, see `Simulation.snapshot` and `Simulation.resume`; by hand, positions and velocities do.

    Arrays are in the order of the scene. With `stepping` and `memory`, as `Simulation.snapshot` gives them, a run with the same
    settings goes on with the same bits. Without them contacts find the load that they carry anew, within a few steps: a pile that
    rests goes on resting.
    """

    position: Floats  # (n, dim) m
    velocity: Floats  # (n, dim) m/s
    time: float = 0.0  # s
    low_position: Floats | None = None  # (n, dim) m, what single precision rounded off; None: 0
    low_velocity: Floats | None = None  # (n, dim) m/s, likewise
    surface_speed: Floats | None = None  # radius times spin, (n, 1) m/s, in 3D (n, 3); None: 0
    torn: NDArray[np.bool_] | None = None  # (m,) springs; None: none
    impulses: Floats | None = None  # (b, dim) N s since the start, on `probes.bodies_of`; None: 0
    stepping: Mapping[str, Any] = field(default_factory=dict)  # plain values of the run; empty: one begins here
    memory: Mapping[str, NDArray[Any]] = field(
        default_factory=dict
    )  # fields from which the run is begun anew, see Moments

    def checked(self, scene: Scene) -> "Snapshot":
        """Return a copy with arrays in float64. Raises SceneError that names what does not fit the scene."""
        n, dim = scene.n_balls, scene.dim
        shapes = dict.fromkeys(("position", "velocity", "low_position", "low_velocity"), (n, dim))
        shapes |= {"surface_speed": (n, 1 if dim == 2 else 3), "impulses": (len(bodies_of(scene)), dim)}
        for name in ("stepping", "memory"):
            if not isinstance(getattr(self, name), Mapping):
                raise SceneError(name, getattr(self, name), "a mapping, as Simulation.snapshot makes it")
        if (self.low_position is None) != (self.low_velocity is None):
            raise SceneError("low_position", says="goes together with low_velocity; give both or none")
        given = {name: getattr(self, name) for name in shapes}
        vectors: dict[str, Any] = {
            name: _exactly(name, value, shapes[name])
            for name, value in given.items()
            if value is not None or name in ("position", "velocity")
        }
        return replace(
            self,
            **vectors,
            time=validation.number("time", self.time, low=0),
            torn=None if self.torn is None else validation.flags("torn", self.torn, scene.n_springs),
            memory={name: _plain(name, array) for name, array in self.memory.items()},
        )

    def arrays(self) -> dict[str, NDArray]:
        """All arrays that there are, by their names in a file."""
        own = {one.name: getattr(self, one.name) for one in fields(self)}
        own |= {MEMORY + name: array for name, array in self.memory.items()}
        return {name: value for name, value in own.items() if isinstance(value, np.ndarray)}

    @classmethod
    def of_file(cls, arrays: Mapping[str, NDArray], time: float, stepping: Mapping[str, Any]) -> "Snapshot":
        """Rebuild a snapshot from what `arrays` gave, among other arrays, and the plain values."""
        own = {one.name: arrays[one.name] for one in fields(cls) if one.name in arrays}
        memory = {name.removeprefix(MEMORY): array for name, array in arrays.items() if name.startswith(MEMORY)}
        return cls(**own, time=time, stepping=stepping, memory=memory)


def _plain(name: str, value: Any) -> NDArray[Any]:
    """An array of numbers, finite ones where they say how balls move."""
    array = np.asarray(value)
    if array.dtype.kind not in "iuf" or (not name.startswith("counter") and not np.isfinite(array).all()):
        raise SceneError((MEMORY + name,), says="is no array of finite numbers")
    return array


def _exactly(name: str, value: Any, shape: tuple[int, int]) -> Floats:
    """Vectors of just this shape: one for all would put all balls in one place."""
    array = validation.vectors(name, value, None, shape[1])
    if array.shape != shape:
        raise SceneError(name, says=f"shape {array.shape} does not fit; it must be {shape}")
    return array
