"""Bodies that fly with nothing acting on them: implicit methods find nothing to solve there but rounding."""

import warnings

import numpy as np
import pytest
from element_blocks import mesh
from physics_support import F64, simulate

import taichi_sim as ts

VELOCITY = (0.7, -3.0, 1.3)  # m/s


def bricks(scene, **place):
    ts.shapes.jelly(scene, size=(0.2, 0.3, 0.2), resolution=(3, 4, 3), density=300.0, young_modulus=2e4, **place)


def triangles(scene, **place):
    sheet = {"young_modulus": 3e5, "thickness": 1e-3, "mass_per_area": 0.2}
    ts.shapes.cloth(scene, (0.4, 0.3), (5, 4), **sheet, **place)


def springs(scene, **place):
    ts.shapes.cloth(scene, (0.4, 0.3), (5, 4), **place)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["implicit_euler", "tr_bdf2"])
@pytest.mark.parametrize("body", [bricks, triangles, springs])
def test_a_free_body_in_flight_is_solved_at_once(body, method):
    scene = ts.Scene(dim=3)
    body(scene, position=(0.3, 0.9, -0.4), velocity=VELOCITY)
    with simulate(scene, integrator=method, contacts="off") as sim:
        with warnings.catch_warnings():
            warnings.filterwarnings("error", message=".*of a stage unsolved")
            sim.step(200)
        report = sim.solver()
        assert report.misses == 0
        if F64 or body is bricks:  # single precision strains the others, where it places balls and rounds rest lengths
            assert report.worst == 0.0
        assert report.passes < 5 * report.stages
        rounding = (2e-16 if F64 else 1e-7) / sim.dt  # m/s for each metre from the origin
        assert np.abs(sim.velocity - VELOCITY).max() < 10.0 * rounding * np.abs(sim.position).max()


@pytest.mark.slow
@pytest.mark.once  # single precision is where it would turn
@pytest.mark.parametrize("method", ["implicit_euler", "tr_bdf2"])
@pytest.mark.parametrize("young_modulus", [3e4, 3e8])
def test_a_body_that_falls_does_not_begin_to_turn(young_modulus, method):
    points, corners = mesh((4, 2), off=0.3)
    scene = ts.Scene(dim=2, gravity=(2.0, -7.0))
    places = points * np.array([0.11, 0.07]) + 0.2
    scene.add_balls(places, mass=np.linspace(0.1, 0.7, len(places)), radius=0.01)
    scene.add_solids(corners, young_modulus=young_modulus, poisson_ratio=0.35)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that the step is long for what is stiff
        with simulate(scene, integrator=method, contacts="off", dt=0.02) as sim:
            sim.step(40)
            moved = sim.position - places
            report = sim.solver()
    fallen = np.linalg.norm(moved.mean(axis=0))
    assert fallen > 2.0
    assert np.abs(moved - moved.mean(axis=0)).max() < (1e-12 if F64 else 1e-5) * fallen
    assert report.misses == 0
    assert report.passes < 12 * report.stages
