"""Rebounds: speed that comes back where nothing bounces, by iterations over all contacts of a step. Measured; there is no law. No
Taichi."""

import numpy as np

from taichi_sim.scene.scene import Scene

__all__ = ["AT_ONCE", "IN_SWEEPS", "IN_TURN", "cure", "returned", "sentence"]

# impacts of pairs one by one; or by iterations over all contacts, by Jacobi or by Gauss-Seidel
IN_TURN, AT_ONCE, IN_SWEEPS = "in turn", "at once", "in sweeps"
LITTLE_BOUNCE = 0.3  # restitution below which a ball hardly comes back from two others on a floor
# part of its speed with which a disc comes back from one on the floor, where masses differ so many times; restitution 0
BY_JACOBI = ((1.0, 0.05), (4.0, 0.07), (16.0, 0.1), (50.0, 0.15), (100.0, 0.22))
BY_SWEEPS = ((1.0, 0.05), (2.0, 0.06), (4.0, 0.07), (8.0, 0.1), (16.0, 0.15), (50.0, 0.32), (100.0, 0.6))


def returned(scene: Scene, impacts: str) -> float:
    """Part of the speed of an impact that may come back where none should; 0 where impacts are solved in turn, balls bounce
    anyway, or fewer than two are loose."""
    loose = scene.loose()
    dull = any(scene.materials[k].restitution < LITTLE_BOUNCE for k in np.unique(scene.material[loose]))
    if impacts == IN_TURN or not dull or np.count_nonzero(loose) < 2 or not np.any(scene.gravity):
        return 0.0
    mass = scene.mass[loose]
    ratios, parts = zip(*(BY_JACOBI if impacts == AT_ONCE else BY_SWEEPS))
    return float(np.interp(np.log(mass.max() / mass.min()), np.log(ratios), parts))


def sentence(part: float) -> str:
    """Sentence about the speed that comes back."""
    return (
        f"of balls of restitution 0 that fall on others at rest: up to {part:.2g} of the speed comes back, because impacts are"
        " solved by iterations over all contacts"
    )


def cure(scene: Scene) -> str:
    """Advice on how impacts are solved in turn."""
    if scene.collides.any() or scene.solid.any():
        return "leave sticks, and surfaces that collide, out of such a scene"
    return 'run on a CPU with contacts = "gauss_seidel", and leave accumulate out'
