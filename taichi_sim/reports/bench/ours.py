"""The program's side of the benchmark: the cases as scenes, stepped by Simulation on the CPU, where its peers run."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import ti
from taichi_sim.reports.bench.cases import Box, Cloth, Grains, Pack, Pile
from taichi_sim.scene.scene import Scene
from taichi_sim.scene.snapshot import Snapshot
from taichi_sim.simulation.simulation import Simulation

__all__ = [
    "ContactPass",
    "OurPile",
    "Ours",
    "cloth_scene",
    "granular_step",
    "pack_scene",
    "pile_step",
    "small_step",
    "springs_step",
]


class Ours:
    """A Runner (see peers) around a Simulation in f32."""

    def __init__(self, scene: Scene, **settings: Any) -> None:
        self.simulation = Simulation(scene, arch="cpu", precision="f32", **settings)

    def reset(self) -> None:
        """Back to the start, compiled and primed."""
        self.place(self.simulation.scene.position, self.simulation.scene.velocity)

    def place(self, position: NDArray, velocity: NDArray) -> None:
        """Begin anew from positions [m] and velocities [m/s], each (n, dim)."""
        self.simulation.resume(Snapshot(position, velocity))
        self.simulation.step(0)

    def step(self, steps: int) -> None:
        """`steps` steps; returns when they are done, because each call ends with a look for non-finite balls."""
        self.simulation.step(steps)

    def result(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Position and velocity, each (n, dim)."""
        return self.simulation.position, self.simulation.velocity

    def close(self) -> None:
        """Free its fields."""
        self.simulation.close()


def cloth_scene(cloth: Cloth) -> Scene:
    """The cloth's balls and springs; the radius plays no part."""
    scene = Scene(dim=3, gravity=cloth.gravity)
    scene.add_balls(cloth.position, velocity=cloth.velocity, radius=1e-3)
    scene.add_springs(cloth.pairs, stiffness=cloth.stiffness, rest_length=cloth.rest_length)
    return scene


def springs_step(cloth: Cloth, **settings: Any) -> Ours:
    """Symplectic Euler on a cloth without contacts, as its peers do it."""
    chosen = {"integrator": "symplectic_euler", "contacts": "off", "dt": cloth.dt, "driver": "parallel", **settings}
    return Ours(cloth_scene(cloth), **chosen)


def pack_scene(pack: Pack) -> Scene:
    """The pack's balls in empty space."""
    scene = Scene(dim=3)
    scene.add_material("ball", restitution=pack.restitution)
    scene.add_balls(pack.position, velocity=pack.velocity, radius=pack.radius, material="ball")
    return scene


@ti.data_oriented
class ContactPass(Ours):
    """The search for contacts from nothing and one pass of impulses, as the kernels of a simulation do it, and no more."""

    def __init__(self, pack: Pack, rule: str) -> None:
        super().__init__(pack_scene(pack), contacts=rule, contact_iterations=1, dt=1e-6, driver="parallel")
        parts = self.simulation._parts
        self.contacts, self.ball = parts.contacts, parts.state.ball

    @ti.kernel
    def _once(self):
        self.contacts.prime(self.ball)
        self.contacts.solve(self.ball, 0.0, 1, True)

    def step(self, steps: int) -> None:
        """`steps` passes, each after a new search; returns when they are done."""
        for _ in range(steps):
            self._once()
        ti.sync()


def small_step(box: Box, driver: str, **settings: Any) -> Ours:
    """Discs in a box with the program's own defaults, by one of the two drivers."""
    scene = Scene(dim=2, gravity=box.gravity)
    scene.add_material("disc", restitution=box.restitution)
    scene.add_balls(box.position, velocity=box.velocity, radius=box.radius, material="disc")
    for normal, offset in (((1, 0), 0.0), ((-1, 0), -box.side), ((0, 1), 0.0), ((0, -1), -box.side)):
        scene.add_wall(normal, offset, material="disc")
    return Ours(scene, dt=box.dt, driver=driver, **settings)


class OurPile(Ours):
    """A Runner for piles of one kind; `start` chooses which."""

    def start(self, pile: Pile) -> None:
        """From the start of this pile on, compiled and primed."""
        self.place(pile.position, np.zeros_like(pile.position))


def pile_step(pile: Pile, **settings: Any) -> OurPile:
    """Discs that fall into an open box, with the program's own defaults."""
    scene = Scene(dim=2, gravity=pile.gravity)
    scene.add_material("disc", restitution=pile.restitution, friction=pile.friction)
    scene.add_balls(pile.position, radius=pile.radius, material="disc")
    for normal, offset in (((0, 1), 0.0), ((1, 0), 0.0), ((-1, 0), -pile.side)):
        scene.add_wall(normal, offset, material="disc")
    return OurPile(scene, dt=pile.dt, **settings)


def granular_step(grains: Grains, passes: int) -> Ours:
    """Balls in an open box, one substep of `passes` passes a step."""
    scene = Scene(dim=3, gravity=(0.0, -grains.gravity, 0.0))
    scene.add_material("grain", restitution=grains.restitution, friction=grains.friction)
    scene.add_balls(grains.position, radius=grains.radius, material="grain")
    scene.add_wall((0, 1, 0), 0.0, material="grain")
    for axis in (0, 2):
        scene.add_wall(np.eye(3)[axis], 0.0, material="grain")
        scene.add_wall(-np.eye(3)[axis], -grains.side, material="grain")
    return Ours(scene, dt=grains.dt, substeps=1, contact_iterations=passes)
