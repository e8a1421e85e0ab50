"""A ring of jelly, a mesh filled with it, is pressed by a piston, swells and springs back."""

import numpy as np
from taichi_sim.demos.shell import LARGE, SMALL, ring

import taichi_sim as ts

PRESSED = (1.4, 1.8)  # s, between which the piston rests on it


def scene(young_modulus=1e5, density=400.0, lowest=0.42):
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.output = {"fps": 60, "duration": 4, "size": (1280, 720)}
    scene.add_material("rubber", friction=0.5)
    scene.add_wall((0, 1, 0), material="rubber")
    ts.shapes.jelly(
        scene,
        mesh=ring(),
        spacing=0.1,
        young_modulus=young_modulus,
        density=density,
        poisson_ratio=0.25,  # bricks at the corners of steps turn inside out where it presses further or swells more
        damping=1.0,
        radius=0.02,
        material="rubber",
        position=(0, SMALL + 0.03, 0),
        rotation=(90, 0, 0),
        colour=(0.9, 0.3, 0.35),
    )
    top = 1.2
    begin, end = PRESSED
    path = [(0.0, 0.0), (0.2, 0.0), (begin, lowest - top), (end, lowest - top), (end + 0.4, 0.0), (9.0, 0.0)]
    scene.add_collider(
        ts.Box((0, top, 0), (1.7, 0.2, 1.7), path=[(time, (0, y, 0)) for time, y in path], colour=(0.45, 0.5, 0.55))
    )
    return scene


def check(sim):
    assert sim.inverted() == 0
    sides = np.sort(np.ptp(sim.position, axis=0))
    np.testing.assert_allclose(sides, [2 * SMALL, 2 * (LARGE + SMALL), 2 * (LARGE + SMALL)], atol=0.1)  # a ring again
    with ts.Simulation(sim.scene) as again:
        crushed = [again.inverted() for _ in again.frames(fps=30, duration=PRESSED[0])]
        height, *across = np.sort(np.ptp(again.position, axis=0))
        crushed += [again.inverted() for _ in again.frames(fps=30, duration=1.0)]
    assert max(crushed) == 0
    assert height < 0.75 * sides[0]
    assert min(across) > 1.05 * sides[-1]  # it swells
