"""Surfaces: all that has infinite mass, the planes of walls and then slots for colliders, by one number."""

import numpy as np

from taichi_sim.contacts.collider_contacts import ColliderContacts
from taichi_sim.contacts.colliders import Colliders
from taichi_sim.contacts.impulse_totals import Received
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.kernels.contacts import contact_law
from taichi_sim.kernels.contacts.collision_groups import meets
from taichi_sim.kernels.contacts.nearby_colliders import FAR_GAP
from taichi_sim.kernels.vectors import lever
from taichi_sim.scene.probes import bodies_of

__all__ = ["Surfaces"]


@ti.data_oriented
class Planes:
    """The walls of a scene, half spaces that balls stay out of."""

    def __init__(self, model: Model, fields: Fields) -> None:
        walls = model.scene.walls
        self.model, self.count = model, len(walls)
        columns = {"normal": ti.types.vector(model.dim, fields.real), "offset": fields.real, "material": ti.i32}
        if model.has_groups:
            columns |= {"group": ti.i32, "mask": ti.i32}
        values = {name: np.array([getattr(wall, name) for wall in walls]) for name in columns}
        self.wall = fields.table(columns, self.count, values)

    @ti.func
    def gap(self, x, i, k):
        """Distance [m] from the surface of ball i at x to wall k, negative inside; far where they do not collide."""
        gap = self.wall[k].normal.dot(x) - self.wall[k].offset - self.model.radius[i]
        if ti.static(self.model.has_groups):
            if not meets(self.model.group[i], self.model.mask[i], self.wall[k].group, self.wall[k].mask):
                gap = FAR_GAP
        return gap


@ti.data_oriented
class Surfaces:
    """Places of the surfaces that each ball may touch: `count` of them, the `planes`, then those in the ball's slots for
    colliders (`collider_contacts`). colliders: None if the scene has none, then nothing of this is compiled."""

    def __init__(self, model: Model, fields: Fields, colliders: Colliders | None, takes_back: bool) -> None:
        self.model, self.colliders = model, colliders
        # of a coordinate, as a part of it
        self.rounding = 4.0 * float(np.finfo(np.float64 if fields.real == ti.f64 else np.float32).eps)
        self.planes = Planes(model, fields)
        self.has_colliders = colliders is not None
        self.moves, slots = False, 0
        if colliders is not None:
            self.collider_contacts = ColliderContacts(model, fields, colliders, self.rounding, self.planes.count)
            self.moves, slots = colliders.moves, self.collider_contacts.count
        self.count = self.planes.count + slots
        self.probed = bool(bodies_of(model.scene))
        if self.probed:
            self.received = Received(model, fields, takes_back)

    @ti.func
    def tolerance(self, x, i, far):
        """Gap [m] below which ball i at x touches; never finer than its coordinates are. far [m]: those of a collider's centre,
        from which points are looked at."""
        return contact_law.TOUCH_TOLERANCE * self.model.radius[i] + self.rounding * (ti.abs(x).max() + far)

    @ti.func
    def touch(self, x, i, k):
        """Gap [m] below which ball i at x touches its contact k; see `tolerance`."""
        far = 0.0 * self.model.radius[i]
        if ti.static(self.has_colliders):
            if k >= self.planes.count:
                far = self.collider_contacts.distance_from_origin(i, k - self.planes.count)
        return self.tolerance(x, i, far)

    @ti.func
    def law(self, i, k):
        """Pair law of ball i and its contact k, which must be no empty slot."""
        surface = 0
        if k < self.planes.count:  # a table must not be read where it ends
            surface = self.planes.wall[k].material
        elif ti.static(self.has_colliders):
            surface = self.colliders.shape[self.collider_contacts.collider(i, k - self.planes.count)].surface
        return self.law_of_material(i, surface, self.normal(i, k))

    @ti.func
    def law_of_material(self, i, surface, n):
        """Pair law of ball i and a material, along n."""
        law = contact_law.pair_law(self.model, self.model.surface[i], surface)
        return contact_law.as_resolved(self.model, law, contact_law.swing(self.model, i, n))

    @ti.func
    def gap(self, x, i, k):
        """Distance from the surface of ball i to its contact k [m], negative inside; of a slot as it was found."""
        gap = FAR_GAP + 0.0 * self.model.radius[i]
        if k < self.planes.count:
            gap = self.planes.gap(x, i, k)
        elif ti.static(self.has_colliders):
            gap = self.collider_contacts.gap(i, k - self.planes.count)
        return gap

    @ti.func
    def normal(self, i, k):
        """Direction from contact k to ball i."""
        n = ti.Vector.zero(float, self.model.dim)
        if k < self.planes.count:
            n = self.planes.wall[k].normal
        elif ti.static(self.has_colliders):
            n = self.collider_contacts.normal(i, k - self.planes.count)
        return n

    @ti.func
    def relative(self, v, i, k):
        """Velocity of ball i, given its own, from the surface of its contact k."""
        u = v
        if ti.static(self.moves):
            if k >= self.planes.count:
                u -= self.collider_contacts.velocity(i, k - self.planes.count)
        return u

    @ti.func
    def following(self, x, v, i, k, h):
        """Speed away from contact k with which ball i at x, sliding along it for h seconds with the velocity v, is neither in it
        nor off it: 0 where it is plane."""
        speed = 0.0 * self.model.radius[i]
        if ti.static(self.has_colliders):
            if k >= self.planes.count:
                slot = k - self.planes.count
                speed = self.collider_contacts.following(x, v, self.relative(v, i, k), i, slot, h)
        return speed

    @ti.func
    def turned_along(self, q, i, k, time):
        """The vector q turned as contact k of ball i turns in `time` seconds: half a step for the speed of the ball's surface.
        `relative` takes the chord of the place where the ball would be held, which one that rolls leaves on its way."""
        if ti.static(self.has_colliders):
            if ti.static(self.colliders.rotates):
                if k >= self.planes.count:
                    spin = self.colliders.pose[self.collider_contacts.collider(i, k - self.planes.count)].spin
                    q += time * lever(spin, q)
        return q

    @ti.func
    def record(self, i, k, p):
        """Its contact k gave ball i the impulse p, for probes."""
        self.received.add(i, self.receiver(i, k), p)

    @ti.func
    def receiver(self, i, k):
        """Number in `received` of contact k of ball i; -1 if no probe asks for it."""
        body = -1
        if k < self.planes.count:
            body = self.received.plane[k]
        elif ti.static(self.has_colliders):
            body = self.received.solid[self.collider_contacts.collider(i, k - self.planes.count)]
        return body
