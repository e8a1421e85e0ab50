"""ColliderContacts: the colliders that each ball is at, in a few slots per ball. Walls solves them, friction and all, as it does
planes."""

from taichi_sim.contacts.colliders import Colliders
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.kernels.contacts import colliders as geometry
from taichi_sim.kernels.contacts.colliders import MESH
from taichi_sim.kernels.contacts.nearby_colliders import FAR_GAP

__all__ = ["ColliderContacts"]

SLOTS = {2: 3, 3: 4}  # contacts of one ball with colliders in the solve; impacts need none
# of the radius: the most that a surface may fall away from or rise into the way of a ball in a step beyond what the plane that
# touches it does as it turns
STEEPEST_FALL = 0.25


@ti.data_oriented
class ColliderContacts:
    """Contacts of balls with colliders, as the last search found them. rounding: of a coordinate, as a part of it; planes: how
    many walls there are beside them."""

    def __init__(self, model: Model, fields: Fields, colliders: Colliders, rounding: float, planes: int) -> None:
        self.model, self.colliders, self.rounding = model, colliders, rounding
        self.moves, self.faces = colliders.moves, colliders.faces
        self.count = SLOTS[model.dim]
        vector = ti.types.vector(model.dim, fields.real)
        # key: collider times `faces` plus its face, or EMPTY; gap [m], negative inside; normal: toward the ball
        columns = {"key": ti.i32, "gap": fields.real, "normal": vector}
        if self.moves:
            # m/s: velocity of the surface, along the chord of the step to come; what it has lost along the normal
            columns |= {"velocity": vector, "lost": fields.real}
        self.slot = fields.table(columns, model.n * self.count)
        self.filled = fields.integers(model.n)  # slots in use
        self.has_seams = colliders.count + planes > 1
        if colliders.has_mesh:
            self.exact = fields.integers(model.n)  # 1 where distances from meshes are exact, see nearby_colliders

    @ti.func
    def needs_exact(self, i):
        """True if ball i is at a seam, or may hit a mesh in this step, so that distances from meshes have to be exact."""
        yes = False
        if ti.static(self.colliders.has_mesh):
            yes = self.exact[i] == 1
        return yes

    @ti.func
    def slot_of_mesh(self, i, k):
        """The slot that holds the contact of ball i with collider k as it was found, if that is a mesh; else -1."""
        found = -1
        if ti.static(self.colliders.has_mesh):
            if self.colliders.shape[k].kind == MESH and self.filled[i] > 0:
                for s in range(i * self.count, (i + 1) * self.count):
                    if self.slot[s].key == k * self.faces:
                        found = s
        return found

    @ti.func
    def gap(self, i, s):
        """Distance [m] from the surface of ball i to the collider in its slot s as it was found, negative inside."""
        gap = FAR_GAP + 0.0 * self.model.radius[i]
        if self.filled[i] > 0:
            gap = self.slot[i * self.count + s].gap
        return gap

    @ti.func
    def normal(self, i, s):
        """Direction from the collider in slot s to ball i."""
        return self.slot[i * self.count + s].normal

    @ti.func
    def velocity(self, i, s):
        """Velocity [m/s] of the surface in slot s of ball i along the chord of the step, where colliders move."""
        return self.slot[i * self.count + s].velocity

    @ti.func
    def lost(self, i, s):
        """Speed [m/s] along the normal that the surface in slot s of ball i had at the end of the step before, over that which it
        has from now on."""
        lost = 0.0 * self.model.radius[i]
        if ti.static(self.moves):
            lost = self.slot[i * self.count + s].lost
        return lost

    @ti.func
    def collider(self, i, s):
        """The collider in slot s of ball i, which must not be empty."""
        return self.slot[i * self.count + s].key // self.faces

    @ti.func
    def distance_from_origin(self, i, s):
        """Distance [m] from the origin to the collider in slot s of ball i; 0 if the slot is empty."""
        far = 0.0 * self.model.radius[i]
        if self.filled[i] > 0 and self.slot[i * self.count + s].key >= 0:
            far = self.colliders.distance_from_origin(self.collider(i, s))
        return far

    @ti.func
    def following(self, x, v, u, i, s, h):
        """Speed away from the surface in slot s with which ball i at x, sliding along it for h seconds, is neither in it nor off
        it: 0 where it is plane. With it a ball on a curved surface moves along chords, which keeps its energy. v, u [m/s]:
        velocity of the ball, and from the surface."""
        slot = self.slot[i * self.count + s]
        n, own, r = slot.normal, slot.key // self.faces, self.model.radius[i]
        after = x + h * (v - n.dot(u) * n)
        rounding = self.rounding * (ti.abs(x).max() + self.colliders.distance_from_origin(own))
        most = STEEPEST_FALL * r
        fall = 0.0 * slot.gap
        k, others = own, False
        while k < self.colliders.count:  # it first; where it ends or falls away, all that may go on in its place
            if not others or self._goes_on(i, k, after, most):
                face = ti.select(others, 0, slot.key % self.faces)
                d, _, _ = self.colliders.distance(k, face, after, h, r, self.needs_exact(i))
                here = d - r - slot.gap
                fall = ti.max(0.0, ti.min(fall, here)) if others else here
            if others:
                k += 1
            elif fall > rounding:
                k, others = 0, True
            else:
                k = self.colliders.count
        fall = ti.select(ti.abs(fall) > rounding, fall, 0.0)
        plane = n.dot(geometry.carried_back(self.colliders, own, after, h) - x)
        return -ti.max(ti.min(0.0, plane) - most, ti.min(ti.max(0.0, plane) + most, fall)) / h

    @ti.func
    def _goes_on(self, i, k, x, reach):
        """True if ball i at x may be within `reach` [m] of collider k."""
        at_it = self.colliders.collides_with(self.model, i, k)
        return at_it and geometry.near(self.colliders, k, x, self.model.radius[i] + reach)
