"""Narrow wedges: a ball of a body that lands between walls comes to rest there, without energy from nothing."""

import numpy as np
import pytest
from physics_support import F64, simulate, vector

import taichi_sim as ts

G, R, LENGTH = 9.81, 0.07, 0.3


def wedge(dim, walls, friction, degrees, drop):
    """Two balls on a stiff spring, one above the other, and how high the lower one rests between the walls: a wedge of that
    angle, or, of three, a funnel."""
    half = np.radians(0.5 * degrees)
    scene = ts.Scene(dim=dim, gravity=vector(dim, 0.0, -G))
    scene.add_material("smooth", friction=friction)
    for k in range(walls):
        turn = 2.0 * np.pi * k / walls
        scene.add_wall(
            vector(dim, np.cos(half) * np.cos(turn), np.sin(half), np.cos(half) * np.sin(turn)), 0.0, "smooth"
        )
    rest = R / np.sin(half)
    place = [vector(dim, 0.0, rest + drop), vector(dim, 0.0, rest + drop + LENGTH)]
    scene.add_balls(place, mass=0.8, radius=R, material="smooth")
    scene.add_springs([(0, 1)], stiffness=1.5e4, damping=40.0)
    return scene, rest


@pytest.mark.long_in("f64")
@pytest.mark.parametrize(
    ("method", "dt", "dim", "walls", "friction"),
    [
        ("implicit_euler", 1 / 60, 2, 2, 0.0),
        ("symplectic_euler", 1 / 240, 2, 2, 0.2),
        pytest.param("xpbd", 1 / 240, 3, 2, 0.0, marks=pytest.mark.slow),
        pytest.param("verlet", 1 / 300, 3, 3, 0.2, marks=pytest.mark.slow),
        pytest.param("implicit_euler", 1 / 120, 3, 3, 0.0, marks=pytest.mark.slow),
    ],
)
def test_what_lands_in_a_wedge_rests_there(method, dt, dim, walls, friction):
    with simulate(wedge(dim, walls, friction, 60.0, 0.1)[0], integrator=method, dt=dt) as sim:
        for degrees in (37.0, 27.0, 16.0):
            for drop in (0.4, 0.0):
                scene, rest = wedge(dim, walls, friction, degrees, drop)
                sim.reset(scene)
                start, most, deepest = sim.energy().total, 0.0, 0.0
                for _ in range(round(2.0 / dt)):
                    sim.step(1)
                    most = max(most, sim.energy().total - start)
                    deepest = max(deepest, rest - sim.position[0, 1])
                where = f"{degrees} degrees, dropped by {drop} m"
                gain = 1e-3 if method == "xpbd" else 1e-9 if F64 else 1e-5  # its springs gain as much on a floor
                assert most < gain * start, f"{where}: {most:.2e} J more than {start:.1f} J"
                assert deepest < (1e-6 if F64 else 1e-3) * R, f"{where}: {deepest:.2e} m deep"
                assert abs(sim.velocity[0]).max() < (1e-5 if F64 else 1e-4), f"{where}: {sim.velocity[0]} m/s"
                assert sim.contacts().penetration < 1e-3
