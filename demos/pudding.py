"""A pudding of half a million bricks wobbles on a plate that is shaken."""

import numpy as np

import taichi_sim as ts

SPACING = 0.009  # m between balls
HEIGHT, WIDE, NARROW, FLUTES = 0.62, 0.52, 0.36, 12
RINGS, AROUND = 25, 144
SHAKE, RATE, UNTIL = 0.045, 1.5, 2.0  # m, 1/s, s
VISCOSITY = 1.0  # Pa s: so that the damping of a spring is the same material at every spacing


def mould():
    """(vertices, triangles) of a fluted cone whose upper rim is rounded, the lower one drawn in: a sharp one folds under."""
    up, turn = np.linspace(0.0, 1.0, RINGS), 2 * np.pi * np.arange(AROUND) / AROUND
    rim = np.sqrt(1.0 - 0.55 * (np.maximum(0.0, up - 0.72) / 0.28) ** 2.6)
    rim *= 1.0 - 0.08 * np.exp(-up / 0.04)
    reach = ((WIDE + (NARROW - WIDE) * up) * rim)[:, None] * (1.0 + 0.055 * np.cos(FLUTES * turn))
    side = np.stack(
        [reach * np.cos(turn), np.repeat(HEIGHT * up, AROUND).reshape(reach.shape), reach * np.sin(turn)], -1
    )
    vertices = np.concatenate([side.reshape(-1, 3), [[0, 0, 0], [0, HEIGHT, 0]]])
    here = np.arange(RINGS * AROUND).reshape(RINGS, AROUND)
    a, b, c, d = here[:-1], np.roll(here, -1, 1)[:-1], here[1:], np.roll(here, -1, 1)[1:]
    below, above = np.full(AROUND, here.size), np.full(AROUND, here.size + 1)
    parts = [(a, c, b), (b, c, d), (a[0], b[0], below), (d[-1], c[-1], above)]
    return vertices, np.concatenate([np.stack([corner.ravel() for corner in part], 1) for part in parts])


def scene(spacing=SPACING, young_modulus=4.5e4, viscosity=VISCOSITY, shake=SHAKE, rate=RATE):
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    scene.output = {"fps": 60, "duration": 3, "size": (1280, 720)}
    scene.add_material("custard", friction=0.9)
    scene.add_wall((0, 1, 0), -0.3, material="custard")
    custard = {"young_modulus": young_modulus, "density": 1000, "damping": viscosity * spacing, "material": "custard"}
    colour = (0.9, 0.62, 0.2)
    ts.shapes.jelly(scene, mesh=mould(), spacing=spacing, position=(0, spacing / 2, 0), colour=colour, **custard)
    time = np.arange(0.0, 9.0, 0.05)
    x = shake * np.sin(2 * np.pi * rate * time) * np.minimum(time / 0.4, 1.0) * (time <= UNTIL)
    path = [(t, (shift, 0, 0)) for t, shift in zip(time, x)]
    plate = {"material": "custard", "path": path, "colour": (0.85, 0.87, 0.9)}
    scene.add_collider(ts.Box((0, -0.05, 0), (1.35, 0.08, 1.35), **plate))
    return scene


def check(sim):
    x = sim.position
    assert sim.inverted() == 0
    assert np.abs(x[:, [0, 2]]).max() < 1.35 / 2  # it has slid a little, and stands on the plate
    np.testing.assert_allclose(x[:, 1].min(), 0.25 * SPACING - 0.01, atol=0.003)
    assert 0.75 * HEIGHT < x[:, 1].max() < 1.05 * HEIGHT
    np.testing.assert_allclose(np.ptp(x[:, [0, 2]], axis=0), 2.1 * WIDE, rtol=0.15)
