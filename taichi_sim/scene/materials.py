"""Materials and walls, and what a scene is made of."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_sim.scene.collision_groups import EVERY, ONLY

__all__ = ["Material", "Wall", "max_restitution", "used_materials"]


@dataclass(frozen=True, slots=True)
class Material:
    """Properties of a surface in contact. Where two of them meet: the larger restitution, the geometric mean of the
    frictions."""

    name: str
    restitution: float = 0.0  # 0: no bounce, 1: elastic
    friction: float = 0.0  # Coulomb coefficient
    viscous_friction: float = 0.0  # 1/s
    colour: tuple[float, float, float] | None = None  # sRGB, 0 to 1


@dataclass(frozen=True, slots=True)
class Wall:
    """A half space, solid where normal . x < offset."""

    normal: tuple[float, ...]  # unit
    offset: float  # m
    material: int
    group: int = ONLY  # bits, see Scene.groups
    mask: int = EVERY  # bits of the groups that it collides with


def used_materials(scene: Any) -> list[Material]:
    """The materials that something in the scene is made of."""
    used = {
        *np.unique(scene.material).tolist(),
        *(w.material for w in scene.walls),
        *(c.material for c in scene.colliders),
    }
    return [scene.materials[index] for index in sorted(used)]


def max_restitution(scene: Any) -> float:
    """Largest restitution of anything in the scene."""
    return max((material.restitution for material in used_materials(scene)), default=0.0)
