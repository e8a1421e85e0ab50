"""taichi_sim: balls, springs, sticks, walls, cloth and jelly in 2D and 3D.

import taichi_sim as ts

scene = ts.Scene(dim=2, gravity=(0, -10))
scene.add_balls([[0.0, 1.0]], radius=0.1)
scene.add_wall((0, 1))
with ts.Simulation(scene) as sim:
    sim.run(1.0)
    print(sim.position)
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

from taichi_sim.common.version import __version__

if TYPE_CHECKING:
    from taichi_sim import shapes
    from taichi_sim.analysis.element_rates import largest_rate
    from taichi_sim.analysis.frame import Frame
    from taichi_sim.analysis.limits import StabilityLimit
    from taichi_sim.analysis.methods import Method
    from taichi_sim.common.errors import BackendError, SceneError, UnstableError
    from taichi_sim.contacts import ContactRule
    from taichi_sim.files.toml_reader import load_scene
    from taichi_sim.forces.element import Element
    from taichi_sim.forces.pointer import Pointer
    from taichi_sim.integrators import Integrator
    from taichi_sim.outputs import Output, open_output
    from taichi_sim.outputs.export import export
    from taichi_sim.outputs.quick import picture, video
    from taichi_sim.scene.collider_shapes import Box, Capsule, Sphere
    from taichi_sim.scene.mesh_colliders import ColliderShape, Mesh
    from taichi_sim.scene.scene import Scene
    from taichi_sim.scene.snapshot import Snapshot
    from taichi_sim.scene.spring_units import spring_from_rates
    from taichi_sim.simulation.simulation import Simulation
    from taichi_sim.sweeps.fit import fit
    from taichi_sim.sweeps.sweep import sweep
    from taichi_sim.viewer.web import LiveView

os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")  # Taichi announces itself on standard output

__all__ = [
    "BackendError",
    "Box",
    "Capsule",
    "ColliderShape",
    "ContactRule",
    "Element",
    "Frame",
    "Integrator",
    "LiveView",
    "Mesh",
    "Method",
    "Output",
    "Pointer",
    "Scene",
    "SceneError",
    "Simulation",
    "Snapshot",
    "Sphere",
    "StabilityLimit",
    "UnstableError",
    "__version__",
    "export",
    "fit",
    "largest_rate",
    "load_scene",
    "open_output",
    "picture",
    "shapes",
    "spring_from_rates",
    "sweep",
    "video",
]

_MODULES = {
    "BackendError": "taichi_sim.common.errors",
    "Box": "taichi_sim.scene.collider_shapes",
    "Capsule": "taichi_sim.scene.collider_shapes",
    "ColliderShape": "taichi_sim.scene.mesh_colliders",
    "ContactRule": "taichi_sim.contacts",
    "Element": "taichi_sim.forces.element",
    "Frame": "taichi_sim.analysis.frame",
    "Integrator": "taichi_sim.integrators",
    "LiveView": "taichi_sim.viewer.web",
    "Mesh": "taichi_sim.scene.mesh_colliders",
    "Method": "taichi_sim.analysis.methods",
    "Output": "taichi_sim.outputs",
    "Pointer": "taichi_sim.forces.pointer",
    "Scene": "taichi_sim.scene.scene",
    "SceneError": "taichi_sim.common.errors",
    "Simulation": "taichi_sim.simulation.simulation",
    "Snapshot": "taichi_sim.scene.snapshot",
    "Sphere": "taichi_sim.scene.collider_shapes",
    "StabilityLimit": "taichi_sim.analysis.limits",
    "UnstableError": "taichi_sim.common.errors",
    "export": "taichi_sim.outputs",
    "fit": "taichi_sim.sweeps.fit",
    "largest_rate": "taichi_sim.analysis.element_rates",
    "load_scene": "taichi_sim.files.toml_reader",
    "open_output": "taichi_sim.outputs",
    "picture": "taichi_sim.outputs.quick",
    "spring_from_rates": "taichi_sim.scene.spring_units",
    "sweep": "taichi_sim.sweeps.sweep",
    "video": "taichi_sim.outputs.quick",
}


def __dir__() -> list[str]:
    return sorted(__all__)


def __getattr__(name: str) -> Any:
    """Names are imported when first used: a command starts before it knows what it needs."""
    if name == "shapes":
        return import_module("taichi_sim.shapes")
    if name not in _MODULES:
        raise AttributeError(f"module 'taichi_sim' has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_MODULES[name]), name)
    return value
