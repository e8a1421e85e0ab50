"""Check of an installation: small scenes against stored results, in single precision.

The results are those of double precision on a CPU, written by tests/support/make_verify_results.py. No scene is chaotic: what
differs by more than the tolerance is a fault of the installation, its driver or its device, or a version whose physics differ.
"""

import json
import platform
from collections.abc import Callable, Iterator
from importlib import resources
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim import __version__, shapes
from taichi_sim.common.errors import UnstableError
from taichi_sim.common.machine import processor
from taichi_sim.device import backend
from taichi_sim.integrators import ImplicitEuler
from taichi_sim.scene.scene import Scene
from taichi_sim.simulation.simulation import Simulation

__all__ = ["CASES", "Case", "Result", "computed", "installation", "results"]

STORED = "verify_results.json"
TOLERANCE = 1e-5  # of the scene's size, and of the energy exchanged; single precision itself stays below 5e-7 on a CPU


class Case(NamedTuple):
    """name; scene: what builds it; settings of the Simulation; seconds: how long it runs; cpu: only the CPU can run it."""

    name: str
    scene: Callable[[], Scene]
    settings: dict[str, Any]
    seconds: float
    cpu: bool = False


class Result(NamedTuple):
    """deviation: the larger one of positions [scene sizes] and energy [energy exchanged]; None where the case cannot run here; a
    sentence where the run failed."""

    name: str
    deviation: float | None
    failed: str = ""

    @property
    def passed(self) -> bool:
        """True if the case ran and is right, or cannot run here."""
        return not self.failed and (self.deviation is None or self.deviation <= TOLERANCE)


def _chain() -> Scene:
    scene = Scene(dim=2, gravity=(0.0, -10.0))
    shapes.rope(
        scene, start=(0.0, 0.0), end=(0.7, 0.1), n=8, mass=0.4, stiffness=300.0, damping=0.2, radius=0.01, pinned=[0]
    )
    return scene


def _bounces() -> Scene:
    scene = Scene(dim=2, gravity=(0.0, -10.0))
    scene.add_material("rubber", restitution=0.8, friction=0.3)
    scene.add_wall((0.1, 1.0), material="rubber")
    x = [[0.0, 0.4], [0.6, 0.5], [1.2, 0.6]]
    scene.add_balls(x, radius=[0.1, 0.12, 0.08], velocity=(0.8, 0.0), mass=[1.0, 2.0, 0.5], material="rubber")
    return scene


def _collision() -> Scene:
    scene = Scene(dim=3, gravity=(0.0, 0.0, 0.0))
    scene.add_material("glass", restitution=0.7, friction=0.2)
    x = [[0.0, 0.0, 0.0], [0.5, 0.06, 0.02], [2.0, 0.0, 0.0], [2.4, 0.05, -0.03]]
    v = [[1.0, 0.0, 0.0], [-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.0, 0.0]]
    scene.add_balls(x, radius=0.1, velocity=v, mass=[1.0, 2.0, 3.0, 1.0], material="glass")
    return scene


def _cloth() -> Scene:
    scene = Scene(dim=3, gravity=(0.0, -10.0, 0.0))
    shapes.cloth(scene, size=(1.0, 1.0), resolution=(6, 6), mass=0.3, stiffness=400.0, damping=0.5, pinned=[0, 5])
    return scene


def _jelly() -> Scene:
    scene = Scene(dim=3, gravity=(0.0, -10.0, 0.0))
    made: dict[str, Any] = {"stiffness": 1200.0, "damping": 2.0}
    jelly = shapes.jelly(scene, (0.4, 0.3, 0.3), (4, 3, 3), position=(0.0, 0.5, 0.0), **made)
    scene.set_balls(jelly.balls, pinned=scene.position[jelly.balls, 0] < 0.01)
    return scene


CASES = (
    Case("verlet, springs", _chain, {"integrator": "verlet", "contacts": "off"}, 0.5),
    Case("rk4, springs", _chain, {"integrator": "rk4", "contacts": "off"}, 0.5),
    Case(
        "bounces, jacobi",
        _bounces,
        {"integrator": "symplectic_euler", "contacts": "jacobi", "accumulate": "gather"},
        0.5,
    ),
    Case("collisions, gauss_seidel", _collision, {"contacts": "gauss_seidel"}, 0.6, cpu=True),
    Case(  # solved until rounding ends it: methods stop within their tolerance, and not at the same place in it
        "cloth, implicit_euler",
        _cloth,
        {"integrator": ImplicitEuler(tolerance=3e-5), "contacts": "off", "dt": 4e-3},
        0.4,
    ),
    Case("jelly, xpbd, one spring at a time", _jelly, {"integrator": "xpbd", "contacts": "off"}, 0.2, cpu=True),
    Case(
        "jelly, xpbd, springs in parallel",
        _jelly,
        {"integrator": "xpbd", "contacts": "off", "accumulate": "gather"},
        0.2,
    ),
)


def computed(case: Case, **settings: Any) -> tuple[NDArray[np.float64], float, float]:
    """Positions (n, dim) [m] and total energy [J] at the end, and the energy that was exchanged [J], which differences of it are
    compared with."""
    with Simulation(case.scene(), **{"dt": 1e-3} | case.settings | settings) as sim:
        before = sim.energy()
        sim.run(case.seconds)
        after = sim.energy()
        exchanged = before.kinetic + after.kinetic + abs(after.gravity - before.gravity)
        return sim.position, float(after.total), float(exchanged)


def results(arch: str | None = None) -> Iterator[Result]:
    """Each case on this device against what is stored. Raises BackendError where there is none such."""
    stored = json.loads(resources.files("taichi_sim.reports").joinpath(STORED).read_text(encoding="utf-8"))
    device = backend.start(arch, "f32")
    for case in CASES:
        if case.cpu and device.arch != "cpu":
            yield Result(case.name, None)
            continue
        wanted = stored[case.name]
        try:
            x, energy, _ = computed(case, precision="f32")
        except UnstableError as error:
            yield Result(case.name, None, str(error))
            continue
        right = np.array(wanted["position"])
        size = float(np.ptp(right, axis=0).max())
        off = [float(np.abs(x - right).max()) / size, abs(energy - wanted["energy"]) / wanted["exchanged"]]
        yield Result(case.name, float(np.max(off)) if np.all(np.isfinite(off)) else np.inf)


def installation() -> str:
    """First lines of a report of a fault: versions, backend and machine."""
    runs = backend.running()
    system = f"{platform.system()} {platform.release()} {platform.machine()}"
    versions = f"NumPy {np.__version__}, Python {platform.python_version()}"
    return f"taichi-sim {__version__}, {runs}, {versions}\n{system}, {processor()}"
