"""Scenes of which a run has one trajectory, however it is divided: every integrator, every rule of contacts, wind, moving pins,
control of the error, tearing, colliders, surfaces, lists that grow.

    python tests/support/trajectories.py [NAME ...]

runs each whole, in pieces, and from ten moments that were saved, and prints those whose bits differ.
"""

import hashlib
import os
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
import reference_bits as bits

import taichi_sim as ts
from taichi_sim.contacts import pairs
from taichi_sim.simulation import stepper

STEPS = 300


def led_by_pins():
    """A cloth of springs whose corners are led along paths; the step is left to the program."""
    scene = ts.Scene(dim=3, gravity=(0, -9.81, 0))
    sheet = ts.shapes.cloth(scene, size=(0.6, 0.6), resolution=(7, 7), stiffness=400.0, damping=0.3, pinned=[0, 6])
    scene.add_moving_pins(sheet.balls[[0, 6]], path=[(0.02, (0, 0, 0)), (0.1, (0.1, 0.2, 0)), (0.3, (-0.3, 0.1, 0.1))])
    return scene, {"contacts": "off"}


def in_the_wind():
    scene = ts.Scene(dim=3, gravity=(0, -9.81, 0))
    ts.shapes.cloth(scene, size=(0.6, 0.6), resolution=(7, 7), stiffness=400.0, damping=0.3, pinned=[0, 6])
    scene.add_wind((6, 0, 3), gust=0.5, gust_length=0.5)
    return scene, {"contacts": "off"}


def crowd_with_a_tolerance():
    """What contacts hold belongs to each of two solutions."""
    scene = ts.Scene(dim=2, gravity=(0, -9.81))
    scene.add_material("rubber", restitution=0.3, friction=0.4)
    scene.add_balls([[0, 0.06], [0.11, 0.06], [0.05, 0.3]], radius=0.05, material="rubber")
    scene.add_wall((0, 1), 0.0, "rubber")
    return scene, {"tolerance": 3e-2}


def lists_that_grow():
    """A cloud that falls together: more pairs than there was room for."""
    rng = np.random.default_rng(5)
    scene = ts.Scene(dim=2)
    x = rng.uniform(-3.0, 3.0, (400, 2))
    scene.add_balls(x, radius=0.05, velocity=-12.0 * x)
    return scene, {"dt": 1e-3, "contacts": "jacobi", "contact_iterations": 1}


SCENES = (*bits.SCENES, led_by_pins, in_the_wind, crowd_with_a_tolerance, lists_that_grow)
BY_NAME = {build.__name__: build for build in SCENES}


def steps_of(settings):
    """How far a run of these settings goes."""
    return 24 if "tolerance" in settings else STEPS


def digest(sim):
    """SHA-256 of positions and velocities."""
    return hashlib.sha256(sim.position.tobytes() + sim.velocity.tobytes()).hexdigest()


def whole(sim, start, steps):
    """In one call."""
    sim.resume(start)
    sim.step(steps)
    return digest(sim)


def in_calls(sim, start, steps, calls):
    """In so many calls, with looks in between."""
    sim.resume(start)
    cuts = np.linspace(0, steps, calls + 1).astype(int)
    for n in np.diff(cuts).tolist():
        sim.step(n)
        sim.contacts()
        sim.energy()
    return digest(sim)


def in_frames(sim, start, steps, fps):
    """As frames of so many a second; steps that are left are made at the end."""
    sim.resume(start)
    for _ in sim.frames(fps=fps, duration=steps * sim.dt - 1.0 / fps):  # none beyond the end
        pass
    sim.step(steps - round(sim.time / sim.dt))
    return digest(sim)


def from_moments(sim, start, steps, number, path=None, seed=3):
    """From moments at random steps, out of order; path: of the file through which one of them goes, in another simulation."""
    sim.resume(start)
    at = np.sort(np.random.default_rng(seed).integers(1, steps, number)).tolist()
    snapshots = []
    for before, step in zip([0, *at], at):
        sim.step(step - before)
        snapshots.append(sim.snapshot())
    found = []
    for step, snapshot in reversed(list(zip(at, snapshots))):
        sim.resume(snapshot)
        sim.step(steps - step)
        found.append(digest(sim))
    if path is not None:
        sim.resume(snapshots[number // 2])
        sim.save(path)
        with ts.Simulation.restore(path) as again:
            again.step(steps - at[number // 2])
            found.append(digest(again))
    return found


def short_chunks(monkeypatch=None, substeps=64):
    """Let chunks end often, and lists be full soon."""
    for module, name, value in ((stepper, "CHUNK", substeps), (stepper, "WORK", 0), (pairs, "POOL_LINKS", 16)):
        if monkeypatch is None:
            setattr(module, name, value)
        else:
            monkeypatch.setattr(module, name, value)


def differences(build, precision, **settings):
    """What differs from a run in one call."""
    scene, own = build()
    steps = steps_of(own)
    with (
        ts.Simulation(scene, arch="cpu", precision=precision, threads=2, **own | settings) as sim,
        tempfile.TemporaryDirectory() as folder,
    ):
        start = sim.snapshot()
        first = whole(sim, start, steps)
        found = {f"{calls} calls": in_calls(sim, start, steps, calls) for calls in (1, 7, 50) if calls <= steps}
        found |= {f"{fps} a second": in_frames(sim, start, steps, fps) for fps in (24, 30, 60)}
        moments = from_moments(sim, start, steps, 10, Path(folder) / "state.npz")
        found |= {f"moment {k}": one for k, one in enumerate(moments)}
    return [name for name, one in found.items() if one != first]


if __name__ == "__main__":
    short_chunks()
    precision = os.environ.get("TAICHI_SIM_PRECISION", "f32")
    for build in SCENES:
        if len(sys.argv) == 1 or build.__name__ in sys.argv[1:]:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                for driver in ("fused", "parallel"):
                    print(
                        build.__name__,
                        precision,
                        driver,
                        differences(build, precision, driver=driver) or "same",
                        flush=True,
                    )
