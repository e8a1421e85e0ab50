# mypy: ignore-errors
# (Newton is not always there to be checked against)
"""Newton's semi-implicit solver on the CPU, springs alone, in single precision."""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.benchmark.peers import PeerMissingError
from taichi_sim.benchmark.peers.warp_start import wp
from taichi_sim.scene.scene import Scene

try:
    import newton
    from newton.solvers import SolverSemiImplicit
except ImportError:
    raise PeerMissingError("Newton is not installed (pip install newton)") from None


class StiffNewton:
    """A scene's springs in steps of `h` [s]. Rest lengths are those of the start."""

    def __init__(self, scene: Scene, h: float) -> None:
        builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=tuple(scene.gravity))
        mass = np.where(scene.pinned, 0.0, scene.mass)
        for x, v, m in zip(scene.position, scene.velocity, mass):
            builder.add_particle(pos=wp.vec3(*x), vel=wp.vec3(*v), mass=float(m), radius=1e-3)
        for (i, j), k, c in zip(scene.pairs, scene.stiffness, scene.damping):
            builder.add_spring(int(i), int(j), float(k), float(c), 0.0)
        self._model = builder.finalize(device="cpu")
        self._model.particle_grid = None  # no contacts
        self._solver, self._control = SolverSemiImplicit(self._model), self._model.control()
        self._h = h

    def reset(self) -> None:
        self._now, self._next = self._model.state(), self._model.state()

    def step(self, steps: int) -> None:
        for _ in range(steps):
            self._now.clear_forces()
            self._solver.step(self._now, self._next, self._control, None, self._h)
            self._now, self._next = self._next, self._now
        wp.synchronize()

    def result(self) -> tuple[NDArray, NDArray]:
        return self._now.particle_q.numpy().astype(np.float64), self._now.particle_qd.numpy().astype(np.float64)
