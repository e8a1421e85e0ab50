"""Structure: what of a scene is compiled into the kernels of its simulation, as far as the scene shows it. Plain NumPy."""

from zlib import crc32

import numpy as np

from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.parts import PARTS
from taichi_sim.scene.probes import bodies_of
from taichi_sim.scene.scene import Scene, used_materials

__all__ = ["kind_of"]

COUNTED = (
    "balls",
    "springs",
    "moving_pins",
    "motors",
    "walls",
    "colliders",
    "materials",
    *(one.name for one in ELEMENTS),
)
VALUES = ("dt", "settle")  # settings that no kernel reads


def kind_of(scene: Scene) -> str:
    """Name of the kernels that a scene needs, as far as can be seen without assembling them: different for scenes that need
    different ones, and, but for what masses, radii and the damping of springs decide, equal for others."""
    materials = used_materials(scene)
    counts = (
        scene.dim,
        *(part.count(scene) for part in PARTS if part.name in COUNTED),
        int(scene.collides.sum()),
        int(scene.solid.sum()),
        sum(len(motor.springs) for motor in scene.motors),
        sum(collider.motion.moves for collider in scene.colliders),
        len(bodies_of(scene)),
        *(crc32(column.tobytes()) for column in (scene.pairs, scene.pinned)),
    )
    there = (
        np.any(scene.gravity != 0),
        any(m.friction > 0 or m.viscous_friction > 0 for m in materials),
        any(m.viscous_friction > 0 for m in materials),
        any(m.restitution > 0 for m in materials),
        np.isfinite(scene.break_strain).any(),
        scene.has_groups(),
        np.any(scene.damping > 0),
        *(feature(scene) for element in ELEMENTS for feature in element.features.values()),
    )
    settings = sorted((item for item in scene.settings.items() if item[0] not in VALUES), key=str)
    return repr((counts, tuple(map(bool, there)), settings))
