"""Model: what stays constant while a scene runs, as Taichi fields, and only what some part of the scene needs."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.geometry.graph import incidence
from taichi_sim.scene.scene import Scene, used_materials

__all__ = ["SPIN_INERTIA_RATIOS", "Model", "phase_type"]

SPIN_INERTIA_RATIOS = {2: 2.0, 3: 2.5}  # m r^2 / I of a disc, of a solid sphere


@ti.data_oriented
class Model:
    """Constant fields of a scene with n balls in `dim` dimensions.

    Attributes that kernels read: `n`, `dim`; `inverse_mass` (n) [1/kg], 0 when pinned; `gravity` (1) [m/s^2]. For contacts,
    made on demand: `radius` (n) [m], `surface` (n) material index, `laws` (materials^2) restitution, friction, viscous friction
    for each pair of materials; `group`, `mask` (n) bits of collision groups, where the scene has some. `spins`: whether any
    ball spins; `spin_inertia_ratio`: m r^2 / I of those that do. `serial`: whether all loops run on one thread of a CPU.
    """

    def __init__(self, scene: Scene, fields: Fields, serial: bool = False) -> None:
        self.scene = scene
        self.fields = fields
        self.serial = serial
        self.n = scene.n_balls
        self.dim = scene.dim
        self.inverse_mass_array: NDArray[np.float64] = np.where(scene.pinned, 0.0, 1.0 / scene.mass)
        self.inverse_mass = fields.reals(self.inverse_mass_array)
        self.has_gravity = bool(np.any(scene.gravity != 0))
        self.gravity = fields.reals(scene.gravity[None])
        self.surfaces = len(scene.materials)
        self.spins = self.some_spin = False
        self.holds_back = False  # whether `swing` (n) [1] is there, see kernels.contacts.contact_law.swing
        self.swing: Any = None
        self.spin_inertia_ratio = SPIN_INERTIA_RATIOS[self.dim]

    def add_contact_fields(self) -> None:
        """Radii, materials and the table of pair laws: what every contact part reads."""
        scene, fields = self.scene, self.fields
        self.radius = fields.reals(scene.radius)
        self.surface = fields.integers(scene.material)
        self.has_groups = scene.has_groups()
        if self.has_groups:
            self.group, self.mask = fields.integers(scene.group), fields.integers(scene.mask)
        e = np.array([m.restitution for m in scene.materials])
        mu = np.array([m.friction for m in scene.materials])
        f = np.array([m.viscous_friction for m in scene.materials])
        used = used_materials(scene)
        self.has_viscous = any(m.viscous_friction > 0 for m in used)
        self.has_friction = self.has_viscous or any(m.friction > 0 for m in used)
        self.has_restitution = any(m.restitution > 0 for m in used)
        real = fields.real
        self.laws = fields.table(
            {"restitution": real, "friction": real, "viscous_friction": real},
            self.surfaces**2,
            {
                "restitution": np.maximum.outer(e, e).ravel(),
                "friction": np.sqrt(np.outer(mu, mu)).ravel(),
                "viscous_friction": np.sqrt(np.outer(f, f)).ravel(),
            },
        )

    def set_spinning(self, spinning: NDArray[np.bool_]) -> None:
        """Balls for which `spinning` (n) is true spin under friction, the others not at all."""
        self.spins, self.spinning = bool(spinning.any()), spinning
        self.some_spin = self.spins and not bool(np.all(spinning | self.scene.pinned))
        if self.some_spin:
            self.spin_ratios = self.fields.reals(np.where(spinning, self.spin_inertia_ratio, 0.0))

    @ti.func
    def spin_response(self, i):
        """m r^2 / I of ball i: spin per velocity that a sideways impulse gives; 0 where it does not spin."""
        if ti.static(self.some_spin):
            return self.spin_ratios[i]
        else:
            return ti.cast(self.spin_inertia_ratio, float)

    @ti.func
    def sideways(self, i):
        """Mass that ball i opposes to a sideways impulse at its surface, as a part of its own."""
        return 1.0 / (1.0 + self.spin_response(i))

    def joined(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Balls that a spring, a membrane, a solid or a brick joins each ball to, as (start (n + 1), other (2 m)), sorted."""
        return incidence(self.scene.excluded_pairs(), self.n)[:2]


def phase_type(dim: int, real: object) -> dict[str, object]:
    """Members of the struct that holds a ball: x [m] and v [m/s] side by side, so that one cache line serves a spring."""
    vector = ti.types.vector(dim, real)
    return {"x": vector, "v": vector}
