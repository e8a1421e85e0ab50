"""Scenes of which a run has one trajectory, in either driver and however it is divided: every integrator, every rule and order
of contacts, every element, wind, moving pins, motors, control of the error, strong damping, tearing, colliders, surfaces,
lists that grow.

    python tests/support/trajectories.py [NAME ...]

runs each in both drivers, whole, in pieces, and from ten moments that were saved, and prints those whose bits differ.
"""

import hashlib
import os
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
import reference_bits as bits
from element_blocks import blocks
from physics_colliders import drum_scene

import taichi_sim as ts
from taichi_sim.contacts import pairs
from taichi_sim.simulation import stepper

STEPS = 300
KEYS = [(0.1, 0.0), (0.3, 0.2), (0.4, -0.1), (0.6, 0.0)]  # of a motor: s, 1


def led_by_pins():
    """A cloth of springs whose corners are led along paths; the step is left to the program."""
    scene = ts.Scene(dim=3, gravity=(0, -9.81, 0))
    sheet = ts.shapes.cloth(scene, size=(0.6, 0.6), resolution=(7, 7), stiffness=400.0, damping=0.3, pinned=[0, 6])
    scene.add_moving_pins(sheet.balls[[0, 6]], path=[(0.02, (0, 0, 0)), (0.1, (0.1, 0.2, 0)), (0.3, (-0.3, 0.1, 0.1))])
    return scene, {"contacts": "off"}


def muscle(n: int = 12, damping: float = 0.05) -> ts.Scene:
    """A chain of n balls whose springs all pull in turn, and one by keyframes."""
    scene = ts.Scene(dim=2, gravity=(0.0, -1.0))
    x = np.stack([0.5 * np.arange(n), np.zeros(n)], axis=1)
    balls = scene.add_balls(x, radius=0.05, mass=0.1, pinned=[0])
    springs = scene.add_springs(np.stack([balls[:-1], balls[1:]], axis=1), stiffness=200.0, damping=damping)
    scene.add_motor(springs[:-1], amplitude=0.2, frequency=3.0, phase=30.0 * np.arange(n - 2))
    scene.add_motor(springs[-1:], path=KEYS, repeat=True)
    return scene


def motors_verlet():
    return muscle(), {"dt": 1e-3, "contacts": "off"}


def motors_tr_bdf2():
    return muscle(), {"dt": 1e-3, "contacts": "off", "integrator": "tr_bdf2"}


def in_the_wind(damping=0.3):
    scene = ts.Scene(dim=3, gravity=(0, -9.81, 0))
    ts.shapes.cloth(scene, size=(0.6, 0.6), resolution=(7, 7), stiffness=400.0, damping=damping, pinned=[0, 6])
    scene.add_wind((6, 0, 3), gust=0.5, gust_length=0.5)
    return scene, {"contacts": "off"}


def in_the_wind_strongly_damped():
    return in_the_wind(damping=30.0)


def in_the_wind_implicit():
    return in_the_wind()[0], {"contacts": "off", "integrator": "implicit_euler", "dt": 2e-3}


def balloon_verlet():
    return bits.balloon_xpbd()[0], {"dt": 1e-3}


def pierced(resolution=(11, 11), weak=0.06, speed=0.0) -> ts.Scene:
    """A sheet between two pinned sides, weak along its middle, and a heavy ball that falls on it."""
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    sheet = ts.shapes.cloth(scene, size=(1, 1), resolution=resolution, stiffness=1500, damping=0.5, mass=0.3,
                            pinned="left", surface_collision=True)  # fmt: skip
    right = sheet.balls[scene.position[sheet.balls, 0] > scene.position[sheet.balls, 0].max() - 1e-6]
    scene.set_balls(right, pinned=True)
    if weak:
        x = scene.position[scene.pairs[sheet.springs]][:, :, 0] - scene.position[sheet.balls, 0].mean()
        across = (x.min(axis=1) < 1e-6) & (x.max(axis=1) > 1e-6)
        scene.set_springs(sheet.springs[across], break_strain=weak)
    centre = scene.position[sheet.balls].mean(axis=0)
    scene.add_balls(np.add([centre], [0.01, 0.3, 0.02]), radius=0.15, mass=3.0, velocity=(0.0, -speed, 0.0))
    return scene


def surfaces_that_tear():
    return pierced(resolution=(7, 7), speed=3.0), {"dt": 1e-3}


def drum():
    return drum_scene(2), {"dt": 2e-3, "contact_iterations": 2}


def crowd_of_unequal_masses():
    scene = bits._crowd(2, 30, seed=6)
    scene.set_balls(mass=10.0 ** np.random.default_rng(6).uniform(-1.5, 1.5, 30))
    scene.add_probe("floor", "impulse", wall=1)
    return scene, {"dt": 1e-3}


def crowd_gathered():
    return bits._crowd(2, 60), {"dt": 1e-3, "contacts": "jacobi", "accumulate": "gather"}


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


def elements():
    """A body of each kind of element."""
    return blocks(3, damping=0.02)[0], {"dt": 1e-3, "contacts": "off"}


def elements_implicit():
    return elements()[0], {"dt": 4e-3, "contacts": "off", "integrator": "tr_bdf2"}


def balls_on_a_mesh():
    scene = ts.Scene(dim=3, gravity=(0.0, -9.0, 0.0))
    scene.add_balls([[0.0, 0.3, 0.0], [0.1, 0.6, 0.0]], radius=0.14)
    corners = [[-1.0, 0.0, -1.0], [1.0, 0.0, -1.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]
    scene.add_collider(ts.Mesh((corners, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])))
    return scene, {"dt": 1e-3}


SCENES = (
    *bits.SCENES, led_by_pins, motors_verlet, motors_tr_bdf2, in_the_wind, in_the_wind_strongly_damped, in_the_wind_implicit,
    balloon_verlet, surfaces_that_tear, drum, crowd_of_unequal_masses, crowd_gathered,
    crowd_with_a_tolerance, lists_that_grow, elements, elements_implicit, balls_on_a_mesh,
)  # fmt: skip
BY_NAME = {build.__name__: build for build in SCENES}


def steps_of(settings):
    """How far a run of these settings goes."""
    return 24 if "tolerance" in settings else STEPS


def digest(sim):
    """SHA-256 of positions, velocities, spin and probed impulses, of what has torn, and of the error that was found."""
    arrays = (sim.position, sim.velocity, sim.angular_velocity, sim.parts.impulses())
    said = repr((None if sim.torn is None else sim.torn.tolist(), sim.error()))
    return hashlib.sha256(b"".join(one.tobytes() for one in arrays) + said.encode()).hexdigest()


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
    """As frames of so many a second, or of at least two in all; steps that are left are made at the end."""
    sim.resume(start)
    fps = max(fps, 2.0 / (steps * sim.dt))
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


def ways(build, precision, driver):
    """Digests at the end of one run in several ways, by name, the first in one call."""
    scene, own = build()
    steps = steps_of(own)
    with (
        ts.Simulation(scene, arch="cpu", precision=precision, threads=2, **own | {"driver": driver}) as sim,
        tempfile.TemporaryDirectory() as folder,
    ):
        start = sim.snapshot()
        found = {"whole": whole(sim, start, steps)}
        found |= {f"{calls} calls": in_calls(sim, start, steps, calls) for calls in (1, 7, 50) if calls <= steps}
        found |= {f"{fps} a second": in_frames(sim, start, steps, fps) for fps in (24, 30, 60)}
        moments = from_moments(sim, start, steps, 10, Path(folder) / "state.npz")
        return found | {f"moment {k}": one for k, one in enumerate(moments)}


def differences(build, precision):
    """Ways of a run, in both drivers, that end with other bits than one in one call."""
    found = {
        (driver, way): one for driver in ("fused", "parallel") for way, one in ways(build, precision, driver).items()
    }
    return [key for key, one in found.items() if one != found["fused", "whole"]]


if __name__ == "__main__":
    short_chunks()
    precision = os.environ.get("TAICHI_SIM_PRECISION", "f32")
    for build in SCENES:
        if len(sys.argv) == 1 or build.__name__ in sys.argv[1:]:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                print(build.__name__, precision, differences(build, precision) or "same", flush=True)
