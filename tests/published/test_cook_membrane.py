"""Cook's membrane.

A tapered panel with the corners (0, 0), (48, 44), (48, 60), (0, 44) is held at its left side and loaded upward at its
right one (Cook, Journal of the Structural Division 100, 1974, 1851). With Poisson's ratio 1/3 in two dimensions (plane
stress) the middle of the right side rises by 23.96 F / E without its weight. With the panel's own weight, and in plane
strain with 0.49 and 0.4999, the reference is a finite element solution (nine nodes an element, 32 x 32). The
last one is brought to rest by implicit Euler at 20 ms.
"""

import tempfile
from pathlib import Path

import numpy as np
import pytest

import taichi_sim as ts
from tests.published.common import DEFAULTS, Row, hold, relax
from tests.published.elasticity import near, plane_moduli, solve

pytestmark = pytest.mark.long

UNIT, YOUNG, FORCE, G, DENSITY = 0.01, 1e4, 1.0, 10.0, 0.02  # m, N/m, N, m/s^2, kg/m^2
OUTLINE = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 48 60"><path d="M0 60 L48 16 L48 0 L0 16 Z" fill="#888"/></svg>'


def panel(unit):
    """Places of the unit square's points on the panel."""
    u, v = unit.T
    return np.stack([48 * u, 44 * u * (1 - v) + (44 + 16 * u) * v], axis=1)


def scene(file, spacing, poisson, plane):
    """The panel under a load upward, and the balls of its right side."""
    scene = ts.Scene(dim=2, gravity=(0, G))
    ts.shapes.svg(
        scene,
        file,
        height=60 * UNIT,
        spacing=spacing * UNIT,
        density=DENSITY,
        young_modulus=YOUNG,
        poisson_ratio=poisson,
        plane=plane,
    )
    x = scene.position[:, 0]
    scene.set_balls(np.flatnonzero(x < x.min() + 1e-6), pinned=True)
    right = np.flatnonzero(x > x.max() - 1e-6)
    scene.set_balls(right, mass=scene.mass[right] + FORCE / G / len(right))
    return scene, right


def rise(made, right, stiff):
    """Rise of the right side at rest in parts of F / E."""
    settings = {"integrator": "implicit_euler", "dt": 0.02} if stiff else {}
    with ts.Simulation(made, **settings) as sim:
        relax(sim, still=1e-6, longest=20.0, chunk=0.02 if stiff else 2e-3)
        return np.mean((sim.position - made.position)[right, 1]) * YOUNG / FORCE


def measure():
    """Rise of the right side; the mesh at the defaults has a spacing of 4."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "panel.svg"
        file.write_text(OUTLINE)
        for poisson, plane in ((1 / 3, "stress"), (0.49, "strain"), (0.4999, "strain")):
            long = (1 / (1 - poisson**2), poisson / (1 - poisson))
            moduli = plane_moduli(*long) if plane == "strain" else plane_moduli(1, poisson)
            own = (0, DENSITY * G * UNIT**2 / FORCE)
            mesh = solve((32, 32), panel, moduli, lambda u: u[:, 0] == 0, own, traction=(0, 1 / 16))
            exact = near(*mesh, (48, 52))[1]
            for spacing, allowed, settings in ((4, 0.05, DEFAULTS), (2, 0.02, "half the spacing")):
                found = rise(*scene(file, spacing, poisson, plane), poisson > 0.499)
                quantity = f"rise in plane {plane}, Poisson's ratio {poisson:.4g}"
                rows.append(Row(quantity, "F/E", exact, found, allowed, settings=settings))
    return rows


def test_rise():
    hold(measure())
