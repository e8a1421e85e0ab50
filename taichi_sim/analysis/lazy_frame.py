"""Moments: frames of a scene, whose energy and strain are computed when they are asked for: both take long."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.analysis import diagnostics
from taichi_sim.analysis.frame import Frame, Placed
from taichi_sim.scene.scene import Scene
from taichi_sim.scene.strains import element_strains

__all__ = ["Moment", "MomentsOf"]


class Moment(Frame):
    """A frame of a scene; spin (n, 1 or 3) [1/s]: angular velocities; torn (m,): springs that it does not show, or None."""

    __slots__ = ("_energy", "_strain", "scene", "spin", "torn")

    def __init__(self, scene: Scene, spin: NDArray, torn: NDArray | None, **given: Any) -> None:
        super().__init__(objects=tuple(scene.objects), **given)
        self.scene, self.spin, self.torn = scene, spin, torn
        self._energy: Any = None  # not asked for yet
        self._strain: Any = None

    @property  # type: ignore[override]
    def energy(self) -> Any:
        """Kinetic, spring, gravity, total [J]."""
        if self._energy is None:
            scene = self.scene.at(self.time)
            self._energy = diagnostics.energy(scene, self.position, self.velocity, self.spin, self.torn)
        return self._energy

    @energy.setter
    def energy(self, value: Any) -> None:
        self._energy = value

    @property
    def known_energy(self) -> Any:
        """The energy where it has been asked for, or else None."""
        return self._energy

    @property  # type: ignore[override]
    def strain(self) -> Any:
        """(m,) (length - rest) / rest; 0 where rest is 0."""
        if self._strain is None:
            strain = diagnostics.strain(self.scene.at(self.time), self.position)
            self._strain = strain if self.torn is None else strain[~self.torn]
        return self._strain

    @strain.setter
    def strain(self, value: Any) -> None:
        self._strain = value

    def strains(self) -> Any:
        """Those of springs, triangles, bricks and solids."""
        return [*super().strains(), *element_strains(self.scene, self.position, self.torn)]


class MomentsOf:
    """Makes the frames of a scene, of what a simulation, or a file, says of their moments."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._last_torn: Any = None

    def at(
        self, time: float, position: NDArray, velocity: NDArray, spin: NDArray | None, torn: NDArray[np.bool_] | None
    ) -> Moment:
        """The frame of a moment [s] by its positions (n, dim) m, velocities (n, dim) m/s, angular velocities (n, 1 or 3) 1/s, or
        None for 0, and the springs (m,) that have torn, or None."""
        scene = self.scene
        springs, sticks, triangles, torn_springs, torn_triangles = self._shown(position, torn)
        return Moment(
            scene,
            np.zeros((scene.n_balls, 1 if scene.dim == 2 else 3)) if spin is None else spin,
            torn,
            time=time,
            position=position,
            velocity=velocity,
            radius=scene.radius,
            springs=springs,
            sticks=sticks,
            triangles=triangles,
            torn_springs=torn_springs,
            torn_triangles=torn_triangles,
            colour=scene.colour if scene.n_balls else np.zeros((0, 3)),
            pinned=scene.pinned,
            walls=np.array([[*w.normal, w.offset] for w in scene.walls]).reshape(-1, scene.dim + 1),
            colliders=tuple(Placed(c, *(part[0] for part in c.motion.at(time))) for c in scene.colliders),
            embedded_surfaces=tuple(scene.embedded_surfaces),
            gravity=scene.gravity,
        )

    def _shown(self, position: NDArray, torn: NDArray[np.bool_] | None) -> tuple[NDArray, ...]:
        """Springs (m, 2), which of them are sticks, and triangles; springs and triangles that have torn: the same arrays until
        there are more of these."""
        scene = self.scene
        gone = None if torn is None or not torn.any() else diagnostics.torn_open(scene, position, torn)
        if torn is None or gone is None:
            return scene.pairs, scene.collides, scene.triangles, scene.pairs[:0], scene.triangles[:0]
        last = self._last_torn
        if last is None or not (np.array_equal(last[0], torn) and np.array_equal(last[1], gone)):
            springs = scene.pairs[~torn], scene.collides[~torn]
            shown = *springs, scene.triangles[~gone], scene.pairs[torn], scene.triangles[gone]
            self._last_torn = torn, gone, shown
        return self._last_torn[2]  # type: ignore[no-any-return]
