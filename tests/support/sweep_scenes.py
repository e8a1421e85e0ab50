"""Small scenes for sweeps, as functions that other processes import."""

import multiprocessing
import os
import signal

import numpy as np

import taichi_sim as ts


def heap_file(side, duration):
    """Text of a scene file: side x side balls over a floor, for so many seconds."""
    return f"""format = 1
dim = 2
gravity = [0.0, -10.0]
[[materials]]
name = "rubber"
restitution = 0.5
[[pile]]
name = "heap"
resolution = [{side}, {side}]
radius = 0.05
position = [0.0, 0.1]
material = "rubber"
jitter = 0.1
[[walls]]
normal = [0.0, 1.0]
[output]
duration = {duration}
"""


def heap(restitution=0.5, friction=0.3, speed=0.0, seed=0):
    """Nine balls over a floor."""
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_material("rubber", restitution=restitution, friction=friction)
    x = np.stack(np.meshgrid(np.arange(3) * 0.12, 0.06 + np.arange(3) * 0.12), -1).reshape(-1, 2)
    x += np.random.default_rng(seed).uniform(-0.005, 0.005, x.shape)
    scene.add_balls(x, radius=0.05, velocity=(speed, 0.0), material="rubber")
    scene.add_wall((0, 1), 0.0, "rubber")
    scene.add_probe("floor", "force", wall=0)
    scene.output["duration"] = 0.1
    return scene


def slow(restitution=0.5):
    """The same, but nobody knows for how long."""
    scene = heap(restitution)
    scene.output["duration"] = "long"
    return scene


def mortal(restitution=0.5):
    """The same, but for restitution 0.5 it kills the worker that makes it."""
    if restitution == 0.5 and multiprocessing.parent_process() is not None:
        os.kill(os.getpid(), signal.SIGKILL)
    return heap(restitution)


def square(side=2):
    """A ball whose mass nobody can work out where `side` is 0."""
    scene = heap()
    scene.add_balls([[5.0, 5.0]], radius=0.05, mass=1 / side)
    return scene


def springs(stiffness=100.0, mass=1.0):
    """A ball on a damped spring, which ends where m g = k x."""
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_balls([[0, 0]], radius=0.05, pinned=True)
    scene.add_balls([[0, -1]], radius=0.05, mass=mass)
    scene.add_springs([[0, 1]], stiffness=stiffness, damping=2.0 * np.sqrt(stiffness * mass))
    scene.add_probe("sag", "length", spring=0)
    scene.output["duration"] = 2.0
    scene.settings["contacts"] = "off"
    return scene


def top(simulation):
    """Height of the uppermost ball [m]."""
    return simulation.position[:, 1].max()


def both(simulation):
    """Two numbers."""
    return {"x": simulation.position[:, 0].mean(), "time": simulation.time}


def load(simulation):
    """Weight of what hangs on the spring of `springs` [N]."""
    return simulation.scene.mass[1] * 10.0


class UnspeakableError(Exception):
    """What it says cannot be read."""

    def __str__(self):
        raise KeyError


def hostile(simulation):
    """Ends in another way at each speed; from 4 m/s on numbers whose squares overflow."""
    speed = round(simulation.scene.velocity[0, 0])
    if speed == 1:
        raise UnspeakableError
    if speed == 2:
        raise SystemExit(3)
    if speed == 3:
        raise ValueError("a lone \udc80 surrogate")
    return 1.7e308 * (-1) ** speed
