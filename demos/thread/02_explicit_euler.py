"""Thrown balls by explicit Euler in steps of 50 ms: it moves with the old velocity and ends g t h / 2 above Verlet, in grey."""

import numpy as np

import taichi_sim as ts

ACROSS, UP, G, DURATION = np.linspace(-4, 4, 9), 10.0, 10.0, 2.0  # m/s, m/s, m/s^2, s


def verlet(h):
    """Places (steps + 1, 2) [m] of a ball that is thrown up, by Verlet's method: for constant gravity they are exact."""
    x, v, places = 0.0, UP, [0.0]
    for _ in range(round(DURATION / h)):
        x += h * v - 0.5 * h**2 * G
        v -= h * G
        places.append(x)
    return np.array(places)


def scene(dt=0.05, integrator="explicit_euler"):
    scene = ts.Scene(dim=2, gravity=(0, -G))
    scene.settings = {"dt": dt, "integrator": integrator, "contacts": "off"}
    scene.output = {"fps": 1 / dt, "duration": DURATION, "size": (1280, 720)}
    scene.add_balls(np.zeros((9, 2)), velocity=np.stack([ACROSS, np.full(9, UP)], axis=1), radius=0.25)
    grey = {"radius": 0.16, "pinned": True, "colour": (0.7, 0.72, 0.75)}
    for across in ACROSS:  # led along what Verlet's method finds
        ball = scene.add_balls([0, 0], **grey)
        scene.add_moving_pins(ball, path=[(k * dt, (across * k * dt, y)) for k, y in enumerate(verlet(dt))])
    scene.add_balls(np.stack([2 * ACROSS, 0 * ACROSS], axis=1), **grey)  # where they come down
    return scene


def check(sim):
    above = G * DURATION * sim.dt / 2
    np.testing.assert_allclose(sim.position[:9], np.stack([2 * ACROSS, 0 * ACROSS + above], axis=1), atol=6e-4)
    np.testing.assert_allclose(sim.position[9:18], sim.position[18:], atol=1e-5)
    np.testing.assert_allclose(sim.velocity[:9, 1], -UP, rtol=1e-4)
