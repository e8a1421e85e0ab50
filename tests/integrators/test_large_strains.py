"""Bodies that are strained by as much as their length: implicit methods call no wrong stage solved."""

import numpy as np
import pytest
from physics_support import F64, simulate

import taichi_sim as ts
from taichi_sim.device.engine import ti
from taichi_sim.integrators import ImplicitEuler


@ti.data_oriented
class Guided(ImplicitEuler):
    """Implicit Euler that starts each step after a change of the state from a `guess` (n, dim) of what it changes [m/s]."""

    def allocate(self, fields):
        super().allocate(fields)
        self.guess = fields.vectors(self.model.n, self.model.dim)

    @ti.func
    def _forget(self, role: ti.template(), h, time):
        self.fresh[0] = 1
        for i in range(self.model.n):
            self.solver.last[i] = self.guess[i]


def springs(scene):
    ts.shapes.cloth(scene, (0.4, 0.3), (5, 4), stiffness=900.0, mass=0.05)


def triangles(scene):
    ts.shapes.cloth(scene, (0.4, 0.3), (5, 4), young_modulus=3e5, thickness=1e-3, mass_per_area=0.2)


def bricks(scene):
    ts.shapes.jelly(scene, size=(0.3, 0.2, 0.2), resolution=(4, 3, 3), density=300.0, young_modulus=2e4)


@pytest.mark.slow
@pytest.mark.parametrize("body", [springs, triangles, bricks])
def test_stages_at_large_strains_are_solved(body):
    """Each of eight steps, of a body that is let go, against the solution to rounding that is next to it: a body that folds as it
    comes back has several. What is left counts for more along directions that resist least, so that single
    steps may differ."""
    scene = ts.Scene(dim=3)
    body(scene)
    rest, left = scene.position, scene.position[:, 0].min()
    scene.set_balls(np.flatnonzero(rest[:, 0] < left + 1e-6), pinned=True)
    free, mass = ~scene.pinned, scene.mass[:, None]
    settings = {"dt": 8e-3, "substeps": 1, "contacts": "off"}
    jitter = 0.01 * np.random.default_rng(2).normal(size=rest.shape) * free[:, None]
    exactly = Guided(tolerance=1e-10 if F64 else 1e-6)
    for strain in (0.5, 1.0, 3.0):
        errors = []
        with (
            simulate(scene, integrator=ImplicitEuler(), **settings) as sim,
            simulate(scene, integrator=exactly, **settings) as reference,
        ):
            sim.set_position(rest + [strain, 0.0, 0.0] * (rest - [left, 0.0, 0.0]) + jitter)
            reference.step(0)
            for _ in range(8):
                velocity = sim.velocity
                reference.set_position(sim.position)
                reference.set_velocity(velocity)
                sim.step()
                reference.parts.integrator.guess.from_numpy(sim.velocity - velocity)
                reference.step()
                changes = (sim.velocity - reference.velocity, reference.velocity - velocity)
                error, change = (np.sum(mass * one**2) for one in changes)
                errors.append(np.sqrt(error / change))
            assert sim.solver().misses == 0
        assert np.median(errors) < 1.5 * ImplicitEuler.tolerance
