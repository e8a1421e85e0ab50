"""Cantilever under its own weight.

It bends far, and is clamped level by its first two rows of balls.
Source: Bickley, "The heavy elastica", Phil. Mag. 17 (1934); Romero, Ly, Rasheed, Charrondiere, Lazarus, Neukirch, Bertails-
Descoubes, "Physical validation of simulators in computer graphics", ACM Trans. Graph. 40 (2021), test "cantilever".
Formula: theta'' + Gamma (1 - s) cos theta = 0, theta(0) = theta'(1) = 0, Gamma = m g L^3 / EI; what is compared is the depth of
the tip over its reach, H / W.
Reference: that boundary value problem, solved by SciPy.
Defaults: 0.5 % at 16 meshes, and a quarter of that at 32.
"""

import numpy as np
import pytest
from scipy.integrate import solve_bvp

import taichi_sim as ts
from tests.published.common import Row, hold
from tests.support.drag import Drag

G, LOADS = 9.81, (1.0, 10.0)


def reference(load):
    """H / W of a heavy elastica with that Gamma."""
    s, y = np.linspace(0, 1, 101), np.zeros((4, 101))
    for gamma in np.geomspace(0.1, load, 8):  # from a small load on, each from the last

        def slope(s, y, gamma=gamma):
            return np.array([y[1], -gamma * (1 - s) * np.cos(y[0]), np.sin(y[0]), np.cos(y[0])])

        solved = solve_bvp(slope, lambda a, b: np.array([a[0], b[1], a[2], a[3]]), s, y, tol=1e-8)
        assert solved.success
        s, y = solved.x, solved.y
    return y[2, -1] / y[3, -1]


def measure():
    """Ropes and sheets of 1 m that hang from a clamp, all in one scene."""
    scene, made = ts.Scene(dim=3, gravity=(0, -G, 0)), []
    for load in LOADS:
        for n in (16, 32):
            a, place = 1 / n, (0.0, 0.0, 2.0 * len(made))
            rod = {"mass_per_length": 0.1, "EI": 0.1 * G / load, "EA": 1e3, "pinned": [0, 1]}
            body = ts.shapes.rope(scene, (-a, 0, 0), (1, 0, 0), n + 2, radius=0.01, position=place, **rod)
            made.append(("rope", load, n, body.balls))
        sheet = {"mass_per_area": 0.2, "bending_rigidity": 0.2 * G / load, "stretch_stiffness": 1e3, "pinned": "left"}
        a, place = 1 / 16, (-1 / 16, 0.0, 2.0 * len(made))
        body = ts.shapes.cloth(scene, (1 + a, 2 * a), (18, 3), position=place, **sheet | {"pinned": list(range(6))})
        made.append(("sheet", load, 16, body.balls[1::3]))
    with ts.Simulation(scene, forces=[Drag(8.0)], contacts="off") as sim:
        sim.run(2.5)
        x = sim.position
    for kind, load, n, balls in made:
        tip = x[balls[-1]] - x[balls[1]]
        yield Row(
            f"{kind}, Gamma = {load:g}",
            "",
            reference(load),
            -tip[1] / tip[0],
            0.02 if n == 16 else 0.005,
            settings=f"{n} meshes",
        )


@pytest.mark.slow
def test_a_cantilever_hangs_as_the_elastica():
    rows = list(measure())
    hold(rows)
    for load in LOADS:
        coarse, fine = (row.error for row in rows if row.quantity == f"rope, Gamma = {load:g}")
        assert 2.5 < coarse / fine < 6.0, (coarse, fine)  # of second order
