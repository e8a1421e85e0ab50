"""Hundreds of small random clusters of balls, sticks and walls in one compiled scene, far apart: each is one trial.

Topology, masses and materials belong to a place; positions, velocities and spins are drawn anew for every batch.
"""

import numpy as np
from physics_support import vector

import taichi_sim as ts

PLACES, BALLS, SPACING = 400, 6, 1.0
MATERIALS = 12
WIDTH = 0.16  # m, of the box that a cluster's balls are drawn from; radii are 0.03 to 0.08 m


class Clusters:
    """A scene of PLACES clusters of BALLS overlapping balls; masses 1, or 1e-4 to 1e4 kg; one ball in six is pinned.

    One cluster in four lies on the floor, one in four at a wall, some in a corner of four walls, two of them coplanar. Half
    hold a stick. bounce: restitution of all, or None for many from 0 to 1, also within one cluster.
    """

    def __init__(self, dim: int, *, friction: bool, bounce: float | None = None) -> None:
        rng = self.rng = np.random.default_rng(0)
        scene = self.scene = ts.Scene(dim=dim)
        self.dim, names = dim, []
        for k in range(MATERIALS):
            rough = {"friction": rng.choice([0.0, 0.3, 1.5]), "viscous_friction": rng.choice([0.0, 0.0, 300.0])}
            e = (0.0, 1.0, 0.5, rng.uniform())[k % 4] if bounce is None else bounce
            names.append(scene.add_material(f"m{k}", restitution=e, **(rough if friction else {})))
        self.origin = self._places()
        n = PLACES * BALLS
        self.place = np.repeat(np.arange(PLACES), BALLS)
        radius, mass = rng.uniform(0.03, 0.08, n), 10 ** rng.uniform(-4, 4, n)
        mass[self.place % 3 == 0] = 1.0
        material = np.repeat(rng.integers(MATERIALS, size=PLACES), BALLS)
        mixed = self.place % 4 == 3
        material[mixed] = rng.integers(MATERIALS, size=n)[mixed]
        pinned = rng.uniform(size=n) < 1 / 6
        for i in range(n):
            at = self.origin[self.place[i]]
            scene.add_balls(at, radius=radius[i], mass=mass[i], pinned=bool(pinned[i]), material=names[material[i]])
        ends = np.arange(0, n, 2 * BALLS)
        scene.add_springs(np.stack([ends, ends + 1], axis=1), stiffness=0.0, collides=True)
        for normal, k in (((0.0, 1.0), 0), ((0.0, 1.0), 1), ((1.0, 0.0), 2), ((0.6, 0.8), 3)):
            scene.add_wall(vector(dim, *normal), 0.0, names[k])

    def _places(self) -> np.ndarray:
        at = np.zeros((PLACES, self.dim))
        side = int(np.ceil(PLACES ** (1 / 2)))
        for c in range(PLACES):
            i, j = divmod(c, side)
            at[c] = vector(self.dim, SPACING * (i + 2), SPACING * (j + 2))
            if c % 4 == 0:
                at[c] = vector(self.dim, SPACING * (c // 4 + 1))
            elif c % 4 == 1:
                at[c] = vector(self.dim, 0.0, SPACING * (c // 4 + 1))
            elif c % 16 == 2 and (self.dim == 3 or c == 2):
                at[c] = vector(self.dim, 0.0, 0.0, SPACING * (c // 16))
        return at

    def draw(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions and velocities (n, dim), surface speeds (n, 1 or 3) of a new batch."""
        n, rng, free = self.scene.n_balls, self.rng, ~self.scene.pinned[:, None]
        x = rng.uniform(0.0, WIDTH, (n, self.dim))
        v = (rng.normal(size=(n, self.dim)) - 4.0 * (x / WIDTH - 0.5)) * free
        return self.origin[self.place] + x, v, rng.normal(size=(n, 1 if self.dim == 2 else 3)) * free

    def energy(self, sim: ts.Simulation) -> np.ndarray:
        """Kinetic energy (PLACES,) [J], spin included."""
        m = np.where(self.scene.pinned, 0.0, self.scene.mass)
        surface_speed = sim.snapshot().surface_speed
        assert surface_speed is not None
        v, surface = np.sum(sim.velocity**2, axis=1), np.sum(surface_speed**2, axis=1)
        return np.bincount(self.place, 0.5 * m * (v + (0.5 if self.dim == 2 else 0.4) * surface), PLACES)

    def gains(self, sim: ts.Simulation, batches: int) -> np.ndarray:
        """Relative change of kinetic energy in one step, (batches, PLACES)."""
        out = []
        for _ in range(batches):
            x, v, surface = self.draw()
            sim.resume(ts.Snapshot(x, v, surface_speed=surface))
            before = self.energy(sim)
            sim.step()
            change = self.energy(sim) - before
            out.append(np.divide(change, before, out=np.zeros(PLACES), where=before > 0))
        return np.array(out)
