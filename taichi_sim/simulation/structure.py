"""Structure: in what a scene differs from another one so that other kernels are needed, in words. Plain NumPy."""

from collections.abc import Callable
from typing import Any

import numpy as np

from taichi_sim.scene.elements import ELEMENTS
from taichi_sim.scene.parts import PARTS
from taichi_sim.scene.probes import bodies_of
from taichi_sim.scene.scene import Scene, used_materials

__all__ = ["difference", "kind_of"]

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
COUNTS: dict[str, Callable[[Scene], Any]] = {
    "dimensions": lambda scene: scene.dim,
    **{part.words: part.count for part in PARTS if part.name in COUNTED},
    "sticks": lambda scene: int(scene.collides.sum()),
    "triangles that collide": lambda scene: int(scene.solid.sum()),
    "springs with motors": lambda scene: sum(len(motor.springs) for motor in scene.motors),
    "colliders that move": lambda scene: sum(collider.motion.moves for collider in scene.colliders),
    "walls and colliders with probes": lambda scene: len(bodies_of(scene)),
}
THERE: dict[str, Callable[[Scene], Any]] = {
    "gravity": lambda scene: np.any(scene.gravity != 0),
    "friction": lambda scene: any(m.friction > 0 or m.viscous_friction > 0 for m in used_materials(scene)),
    "viscous friction": lambda scene: any(m.viscous_friction > 0 for m in used_materials(scene)),
    "restitution": lambda scene: any(m.restitution > 0 for m in used_materials(scene)),
    "springs that tear": lambda scene: np.isfinite(scene.break_strain).any(),
    "collision groups": lambda scene: scene.has_groups(),
    "damping": lambda scene: np.any(scene.damping > 0),
    **{words: feature for element in ELEMENTS for words, feature in element.features.items()},
}


COMPILED = ("integrator", "contacts", "accumulate", "driver", "spin")  # of settings


def difference(before: Scene, after: Scene, settings: tuple[Any, Any], place: str, then: str, now: str) -> str:
    """Why `after` needs other kernels than `before`. settings: of both; place, then, now: what the parts of their simulations
    differ in."""
    for name in COMPILED:
        then_set, now_set = (_named(getattr(one, name)) for one in settings)
        if then_set != now_set:
            return f"{name} is {now_set} and the one that was compiled has {then_set}"
    for name, count in COUNTS.items():
        old, new = count(before), count(after)
        if old != new:
            return f"the scene has {new} {name} and the one that was compiled has {old}"
    for name, there in THERE.items():
        old, new = bool(there(before)), bool(there(after))
        if old != new:
            has, had = ("has", "none") if new else ("has no", "some")
            return f"the scene {has} {name}, and the one that was compiled has {had}"
    if before.pairs.shape == after.pairs.shape and not np.array_equal(before.pairs, after.pairs):
        return "the springs join other balls than in the scene that was compiled"
    if not np.array_equal(before.pinned, after.pinned):
        return "other balls are pinned than in the scene that was compiled"
    if place == "contacts":
        return f"contacts are made of other parts, {now}, than were compiled, {then.partition(' (')[0]}"
    if place in ("integrator.predicts", "integrator.implicit_damping"):
        weak, strong = ("weak", "strong") if now == str(place.endswith("predicts")) else ("strong", "weak")
        return f"damping is {weak} for the stiffness of its springs, where it was {strong}, and acts by another scheme"
    if place:
        return f"{place} is {now} where {then} was compiled"
    return "it needs fields of other sizes than the scene that was compiled"


def _named(value: Any) -> str:
    return repr(value) if isinstance(value, (str, bool)) else str(getattr(value, "name", type(value).__name__))


def kind_of(scene: Scene) -> str:
    """Different for scenes that need different kernels, as far as can be seen without assembling them."""
    there = {name: bool(is_there(scene)) for name, is_there in THERE.items()}
    counts = {name: count(scene) for name, count in COUNTS.items()}
    return repr((counts, there, sorted(scene.settings.items(), key=str)))
