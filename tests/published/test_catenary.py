"""Hanging rope.

Its two supports are at one height, and it is longer than their distance. Source: Huygens, Leibniz and Johann Bernoulli
(1691); Irvine, "Cable Structures" (1981), chapter 1. Formula: y = c cosh(x / c) with 2 c sinh(D / (2 c)) = L for a rope
that does not stretch; the sag is c (cosh(D / (2 c)) - 1). A rod has the bending stiffness EI and is clamped level at
both ends. Then EI theta'' = H sin theta + w (L / 2 - s) cos theta, w its weight per length, H the horizontal force,
from an end to the lowest point. Reference: the catenary's parameter by bisection; the rod's boundary value problem by
SciPy. Defaults: the rope, 0.3 % too deep at 16 pieces and 0.1 % at 64; its own weight makes it 0.05 % longer.
"""

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.optimize import brentq

import taichi_sim as ts
from tests.published.common import Row, hold
from tests.support.drag import Drag

G, LENGTH, APART = 9.81, 1.2, 1.0
PIECES = (16, 32, 64)
WEIGHT, STIFF = 0.1 * G, 0.005  # N/m, N m^2


def reference():
    """Sag [m] of the catenary."""
    c = brentq(lambda c: 2 * c * np.sinh(APART / (2 * c)) - LENGTH, 0.1, 10.0, xtol=1e-14)
    return c * (np.cosh(APART / (2 * c)) - 1)


def clamped_reference():
    """Sag [m] of a rod that is as long, clamped level at both ends; half of it, from the clamp to the lowest point."""
    half = LENGTH / 2

    def slope(s, y, p):  # angle, its rate, x, y; p: horizontal force
        moment = p[0] * np.sin(y[0]) + WEIGHT * (half - s) * np.cos(y[0])
        return np.array([y[1], moment / STIFF, np.cos(y[0]), np.sin(y[0])])

    s = np.linspace(0, half, 201)
    start = np.array([-0.6 * np.sin(np.pi * s / half), 0 * s, s / LENGTH * APART, -0.2 * s / half])
    ends = solve_bvp(
        slope, lambda a, b, p: np.array([a[0], b[0], a[2], a[3], b[2] - APART / 2]), s, start, p=[WEIGHT / 4], tol=1e-8
    )
    assert ends.success
    return -ends.y[3, -1]


def measure():
    """Ropes at defaults, but for mass and length, and rods, of 16 to 64 pieces in one scene: bent to a V, let go, and dragged."""
    scene, made = ts.Scene(dim=3, gravity=(0, -G, 0)), []
    for kind in ("rope", "clamped rod"):
        for n in PIECES:
            a = LENGTH / n
            if kind == "rope":
                body, held, more = ts.shapes.rope(scene, (0, 0, 0), (LENGTH, 0, 0), n + 1), 0, {}
            else:
                more = {"EI": STIFF, "start": (-a, 0, 0), "end": (LENGTH + a, 0, 0), "n": n + 3}
                body, held = ts.shapes.rope(scene, **more), 1
            s = scene.position[body.balls, 0]
            across = np.clip(s, 0.0, LENGTH) / LENGTH * APART + np.minimum(s, 0) + np.maximum(s - LENGTH, 0)
            down = np.sqrt(LENGTH**2 - APART**2) / LENGTH * np.minimum(s, LENGTH - s).clip(0)
            scene.set_balls(body.balls, position=np.stack([across, -down, 0 * s + 2.0 * len(made)], axis=1))
            ends = [*range(held + 1), *range(-held - 1, 0)]
            scene.set_balls(body.balls[ends], pinned=True)
            made.append((kind, n, body.balls))
    with ts.Simulation(scene, forces=[Drag(6.0)], contacts="off") as sim:
        sim.run(3.0)
        y = sim.position[:, 1]
    for kind, n, balls in made:
        want, allowed = (reference(), 0.005) if kind == "rope" else (clamped_reference(), 0.02)
        yield Row(f"sag, {kind}", "m", want, -y[balls].min(), allowed, settings=f"{n} pieces")


@pytest.mark.slow
def test_a_rope_hangs_as_a_catenary():
    rows = list(measure())
    hold(rows)
    for kind in ("rope", "clamped rod"):
        coarse, middle, fine = (row.found for row in rows if row.quantity == f"sag, {kind}")
        assert 3.0 < (coarse - fine) / (middle - fine) < 8.0, (coarse, middle, fine)  # of second order: 5
