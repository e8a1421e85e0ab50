"""Cusick's drape test: a disc of fabric of 30 cm hangs over a support of 18 cm.

Its drape coefficient is the part of the ring beyond the support that its shadow covers; its folds are the maxima of the shadow's
radius. The weight is let go in 2 s, as by the platform of the instrument that is lowered: let go at once, a fabric crumples.
Source of what was measured: Matsudaira, Masuda, Wada, Yokura 2015, J. Textile Eng. 61, 69-73; threads are estimated.
"""

import numpy as np
import pytest
from drag import Drag
from physics_support import F64, simulate

import taichi_sim as ts
from taichi_sim.device.engine import ti
from taichi_sim.integrators import ImplicitEuler
from taichi_sim.scene.presets import KES_BENDING, KES_SHEAR, KES_WEIGHT

G, SUPPORT, RIM, RELEASE = 9.81, 0.09, 0.15, 2.0  # m/s^2, m, m, s
ANGLES = 720  # at which the shadow is measured
MEASURED = {  # gf cm^2/cm, mg/cm^2, drape coefficient
    "wool tropical": (0.067, 16.29, 0.498),
    "polyester tropical": (0.077, 11.65, 0.507),
    "polyester faille": (0.019, 10.43, 0.283),
}


@ti.data_oriented
class Release:
    """Force that bears the weight, less and less until RELEASE."""

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        for i in range(model.n):
            w = model.inverse_mass[i]
            if w > 0.0:
                impulse[i].y += h * G / w * ti.max(0.0, 1.0 - time / RELEASE)

    def damping_rate(self, scene):
        return 0.0


def disc(spacing):
    """Vertices and triangles of a ring of triangles with nearly equal sides, its two inner rows on the support."""
    n, rows = round(np.pi * (SUPPORT + RIM) / spacing), round((RIM - SUPPORT) / (spacing * np.sqrt(0.75)))
    r = SUPPORT + (RIM - SUPPORT) / rows * np.arange(-1, rows + 1)[:, None]
    a = 2 * np.pi / n * (np.arange(n) + 0.5 * (np.arange(rows + 2) % 2)[:, None])
    place = np.stack([r * np.cos(a), 0 * a, r * np.sin(a)], axis=-1).reshape(-1, 3)
    index = np.arange(len(place)).reshape(-1, n)
    here, there, even = index[:-1], index[1:], (np.arange(rows + 1) % 2 == 0)[:, None]
    here_on, there_on = (np.roll(one, -1, axis=1) for one in (here, there))
    corners = [here, there, np.where(even, here_on, there_on)], [np.where(even, there, here), there_on, here_on]
    return place, np.concatenate([np.stack([c.ravel() for c in three], axis=1) for three in corners])


def hang(scene, spacing, fabric, middle, start):
    """Add a disc of fabric there; its shape, and by how much each ball is lifted at first: start(angle) [m] at the rim."""
    place, triangles = disc(spacing)
    radius = np.linalg.norm(place, axis=1)
    bending, weight, _ = MEASURED[fabric]
    law = {
        "warp": 2000.0,
        "shear": KES_SHEAR,
        "bending_rigidity": bending * KES_BENDING,
        "mass_per_area": weight * KES_WEIGHT,
    }
    held = np.flatnonzero(radius < SUPPORT + 1e-6).tolist()
    shape = ts.shapes.cloth(scene, mesh=(place, triangles), pinned=held, radius=1e-3, position=middle, **law)
    beyond = np.maximum(radius - SUPPORT, 0.0) / (RIM - SUPPORT)
    return shape, beyond**2 * start(np.arctan2(place[:, 2], place[:, 0]))


def shadow(x, triangles):
    """Drape coefficient and number of folds of a disc at x (n, 3)."""
    far, part = np.full(ANGLES, SUPPORT), np.linspace(0.0, 1.0, 24)[:, None, None]
    ends = np.concatenate([triangles[:, [i, j]] for i, j in ((0, 1), (1, 2), (2, 0))])
    on = (x[ends[:, 0]] * (1 - part) + x[ends[:, 1]] * part)[..., [0, 2]].reshape(-1, 2)
    at = (np.arctan2(on[:, 1], on[:, 0]) / (2 * np.pi) * ANGLES).astype(int) % ANGLES
    np.maximum.at(far, at, np.linalg.norm(on, axis=1))
    waves = np.fft.rfft(far)
    waves[25:] = 0.0
    smooth = np.fft.irfft(waves, ANGLES)
    folds = np.count_nonzero((smooth > np.roll(smooth, 1)) & (smooth >= np.roll(smooth, -1)))
    return (np.mean(far**2) - SUPPORT**2) / (RIM**2 - SUPPORT**2), folds


def noise(seed, height):
    rng = np.random.default_rng(seed)
    waves = [(k, rng.normal(), rng.uniform(0, 2 * np.pi)) for k in range(2, 13)]
    return lambda angle: height * sum(size * np.cos(k * angle + phase) for k, size, phase in waves)


def five(angle):
    return 4e-3 * np.cos(5 * angle) + noise(0, 1e-4)(angle)


@pytest.mark.long
@pytest.mark.skipif(not F64, reason="single precision leaves such steps unsolved, and says so")
def test_cusicks_drape():
    """From the same five folds coefficients are within 3 points with triangles of 10 and 6 mm. Those of three fabrics, whose
    threads are estimated and whose friction within is left out, are the measured ones within 10 points, and in their order."""
    cases = [(name, 0.01, noise(0, 5e-4)) for name in ("polyester tropical", "polyester faille")]
    cases += [("wool tropical", spacing, five) for spacing in (0.01, 0.006)]
    scene = ts.Scene(dim=3, gravity=(0.0, -G, 0.0))
    made, lifts = zip(*(hang(scene, h, name, (k, 0, 0), start) for k, (name, h, start) in enumerate(cases)))
    first = scene.position.copy()
    first[:, 1] += np.concatenate(lifts)
    method = ImplicitEuler(tolerance=1e-3)
    with simulate(scene, integrator=method, dt=1 / 120, contacts="off", forces=[Release(), Drag(2.0)]) as sim:
        sim.set_position(first)
        sim.run(RELEASE + 1.0)
        x = sim.position
    found = [shadow(x[one.balls] - [k, 0.0, 0.0], one.triangles - one.balls[0]) for k, one in enumerate(made)]
    for (name, *_), (coefficient, folds) in zip(cases, found):
        assert coefficient == pytest.approx(MEASURED[name][2], abs=0.1), name
        assert 4 <= folds <= 11
    assert found[0][0] > found[2][0] > found[1][0]  # the stiffer for its weight, the more
    assert abs(found[3][0] - found[2][0]) < 0.03
