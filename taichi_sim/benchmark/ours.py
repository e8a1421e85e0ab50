"""The program's side of the benchmark: the cases as scenes, stepped by Simulation, on the CPU where its peers run unless told."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.benchmark.cases import Balls, Cloth
from taichi_sim.device.engine import ti
from taichi_sim.scene.scene import Scene
from taichi_sim.scene.snapshot import Snapshot
from taichi_sim.simulation.simulation import Simulation


class Ours:
    """A Runner (see peers) around a Simulation in f32."""

    def __init__(self, scene: Scene, *, arch: str = "cpu", **settings: Any) -> None:
        self.simulation = Simulation(scene, arch=arch, precision="f32", **settings)
        self.close = self.simulation.close

    def reset(self) -> None:
        self.start(self.simulation.scene)

    def start(self, case: Any) -> None:
        """Begin anew from the positions and velocities of a scene or a case, compiled and primed."""
        self.simulation.resume(Snapshot(case.position, case.velocity))
        self.simulation.step(0)

    def step(self, steps: int) -> None:
        self.simulation.step(steps)  # ends with a search for non-finite balls, so it is done

    def result(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return self.simulation.position, self.simulation.velocity


def cloth_step(cloth: Cloth, arch: str = "cpu") -> Ours:
    """Symplectic Euler on a cloth without contacts, as its peers do it."""
    scene = Scene(dim=3, gravity=cloth.gravity)
    scene.add_balls(cloth.position, velocity=cloth.velocity, radius=1e-3)  # which plays no part
    scene.add_springs(cloth.pairs, stiffness=cloth.stiffness, rest_length=cloth.rest_length)
    return Ours(scene, arch=arch, integrator="symplectic_euler", contacts="off", dt=cloth.dt, driver="parallel")


def ball_scene(case: Balls) -> Scene:
    """The balls, and the walls of their box."""
    dim = case.position.shape[1]
    scene = Scene(dim=dim, gravity=(0.0, -case.gravity, 0.0)[:dim])
    material = scene.add_material("ball", restitution=case.restitution, friction=case.friction)
    scene.add_balls(case.position, velocity=case.velocity, radius=case.radius, material=material)
    if case.side:
        for axis, normal in enumerate(np.eye(dim)):
            scene.add_wall(normal, 0.0, material)
            if axis != 1 or case.lid:
                scene.add_wall(-normal, -case.side, material)
    return scene


def ball_step(case: Balls, **settings: Any) -> Ours:
    """Balls with the program's own defaults but for what is given."""
    return Ours(ball_scene(case), dt=case.dt, **settings)


@ti.data_oriented
class ContactPass(Ours):
    """The search for contacts from nothing and one iteration, as the kernels of a simulation do it, and no more."""

    def __init__(self, pack: Balls, rule: str, arch: str = "cpu") -> None:
        settings: dict[str, Any] = {"contacts": rule, "contact_iterations": 1, "dt": 1e-6, "driver": "parallel"}
        super().__init__(ball_scene(pack), arch=arch, **settings)
        parts = self.simulation.parts
        self.contacts, self.ball = parts.contacts, parts.state.ball

    @ti.kernel
    def _once(self):
        self.contacts.prime(self.ball)
        self.contacts.solve(self.ball, 0.0, 1, True)

    def step(self, steps: int) -> None:
        """`steps` iterations, each after a new search."""
        for _ in range(steps):
            self._once()
        ti.sync()
