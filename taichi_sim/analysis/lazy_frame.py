"""Moment: a frame of a simulation, whose energy and strain are computed when they are asked for: both take long."""

from typing import Any

from numpy.typing import NDArray

from taichi_sim.analysis import diagnostics
from taichi_sim.analysis.frame import Frame
from taichi_sim.scene.scene import Scene

__all__ = ["Moment"]


class Moment(Frame):
    """A frame of a scene; spin (n, 1 or 3) [1/s]: angular velocities; torn (m,): springs that it does not show, or None."""

    __slots__ = ("_energy", "_scene", "_strain", "spin", "torn")

    def __init__(self, scene: Scene, spin: NDArray, torn: NDArray | None, **given: Any) -> None:
        super().__init__(objects=tuple(scene.objects), **given)
        self._scene, self.spin, self.torn = scene, spin, torn
        self._energy: Any = None  # not asked for yet
        self._strain: Any = None

    @property  # type: ignore[override]
    def energy(self) -> Any:
        """Kinetic, spring, gravity, total [J]."""
        if self._energy is None:
            self._energy = diagnostics.energy(self._scene, self.position, self.velocity, self.spin, self.torn)
        return self._energy

    @energy.setter
    def energy(self, value: Any) -> None:
        self._energy = value

    @property  # type: ignore[override]
    def strain(self) -> Any:
        """(m,) (length - rest) / rest; 0 where rest is 0."""
        if self._strain is None:
            strain = diagnostics.strain(self._scene, self.position)
            self._strain = strain if self.torn is None else strain[~self.torn]
        return self._strain

    @strain.setter
    def strain(self, value: Any) -> None:
        self._strain = value
