"""TriangleContacts: triangles that collide, as thick as their balls, with balls, with sticks, and with each other."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.contacts.pairs import Pairs
from taichi_sim.contacts.weighted_contacts import WeightedContacts
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.forces.tearing import Severed
from taichi_sim.geometry.graph import components
from taichi_sim.geometry.mesh import sides
from taichi_sim.kernels.contacts import contact_law
from taichi_sim.kernels.contacts import triangle_pairs as loops
from taichi_sim.kernels.contacts.kinds import BALL_TRIANGLE
from taichi_sim.scene.scene import Scene

__all__ = ["TriangleContacts"]

MINIMUM_CAPACITY, CONTACTS_PER_BALL = 1 << 14, 16
LARGEST_CAPACITY = 1 << 28  # contacts; each has four entries
# of the smallest height of a ball's triangles, and of the distance at rest: what springs join keeps that, where it is thicker
SPACING = 0.5
LEAVES_PER_NODE = 8
SURFACE_SKIN = 0.5  # of the smallest radius of a surface, see kernels.contacts.ccd_triangles.begin
CANDIDATES_PER_CONTACT = 3  # room for them: some 45 a ball where a cloth is as thick as its springs are long
SUBTREE_HEIGHT = 5  # of what one thread of a device joins
MORTON_CELLS = (1 << 20) - 1  # cells along the longest side of what is put in order
UNBOUNDED_SPACING = 1e12  # m, the same of a ball without triangles


@ti.data_oriented
class TriangleContacts(WeightedContacts):
    """Contacts of balls and triangles, and of edges, with thickness: two things touch where they are as far apart as the radii
    there, those of a triangle's balls weighted by how near they are. For what becomes of a pair see
    kernels.contacts.triangle_pairs, for how pairs are found triangle_bvh. capacity: contacts known to be needed."""

    what = "surfaces that touch"
    names = ("triangles",)
    balls_per_contact = 4
    most = LARGEST_CAPACITY

    def __init__(self, model: Model, fields: Fields, pairs: Pairs, capacity: int = 0) -> None:
        scene, n = model.scene, model.n
        self.model, self.pairs, self.grid = model, pairs, pairs.grid
        triangles, beyond, across, edges, bare = owned_by_balls(scene)
        self.tears = bool(np.isfinite(scene.break_strain).any())
        self.tearing: Any = None  # see forces.tearing
        of_triangles = np.where(bare[:, None] > 0, -1, edges)  # sticks do not tear
        self.severed = [Severed(part, fields) for part in (triangles, of_triangles)] if self.tears else []
        # (n + 1) where those that each ball owns begin
        self.triangle_start, self.edge_start = (
            fields.integers(np.searchsorted(part[:, 0], np.arange(n + 1))) for part in (triangles, edges)
        )
        # beyond_a: third ball of the triangle beyond the edge across from a, or BORDER or NOT_OWNED
        names = ("a", "b", "c", "beyond_a", "beyond_b", "beyond_c")
        columns = dict(zip(names, np.concatenate([triangles, beyond], axis=1).T))
        if self.tears:
            self.severed_triangles, self.severed_edges = self.severed
            # across_a: the triangle of beyond_a, or the one that owns the edge
            columns |= dict(zip(("across_a", "across_b", "across_c"), across.T))
        self.triangle = fields.table(dict.fromkeys(columns, ti.i32), len(triangles), columns)
        # (n,) the one that stands for each ball where its corners are hit, -1 if it is in none
        self.own_triangle = fields.integers(first_triangle(triangles, n))
        # bare: 1, a stick of no triangle
        columns = {"one": edges[:, 0], "two": edges[:, 1], "bare": bare}
        self.edge = fields.table(dict.fromkeys(columns, ti.i32), len(edges), columns)
        self.spacing = fields.reals(spacing(scene))  # m, distance that springs keep
        self.joined_part = SPACING
        self.rest_position = fields.reals(scene.position)  # (n, 3) m
        start, other = model.joined()
        joins = np.stack([np.repeat(np.arange(n), np.diff(start)), other], axis=1)
        # (n,) the same number for balls that springs, elements or triangles hold together
        self.held_together = fields.integers(components(n, np.concatenate([joins, edges])))
        self.may_spin = fields.integers(
            1 - np.isin(np.arange(n), triangles)
        )  # balls of a surface, being points of it, do not
        vector = ti.types.vector(3, fields.real)
        self.expected_displacement = fields.vectors(n, 3)  # m, of a step, at the speeds with which pairs were found
        leaf_balls, self.leaf_count = leaf_order(scene, edges)
        self.leaves_per_node = LEAVES_PER_NODE
        self.bottom_nodes = 1 << (max(1, -(-self.leaf_count // LEAVES_PER_NODE)) - 1).bit_length()
        self.subtree_nodes = 1 << (self.bottom_nodes.bit_length() - 1) // 2
        self.stages = stages(self.bottom_nodes)
        self.leaf_ball = fields.integers(leaf_balls)  # the ball of each slot, those that own nothing last
        # low, high: corners of the box; reach: within which others concern it; displacement: of the step to come [m]
        box = {"low": vector, "high": vector, "reach": fields.real}
        self.leaf = fields.table({**box, "displacement": vector}, self.leaf_count)
        spread = {"lowest_displacement": vector, "highest_displacement": vector}
        self.node = fields.table({**box, **spread}, 2 * self.bottom_nodes)
        # allowed_part: of its way that each ball may make; effective_inverse_mass [1/kg]: see share_mass
        self.allowed_part, self.effective_inverse_mass = fields.reals(n), fields.reals(n)
        # 1 or 0. lists: pairs are listed; searches: candidates are looked for; expired: those of the last search hold no more;
        # left_path: some ball is not where it was expected; left_path_later: as what was found then cut its way short
        self.work = fields.table(
            dict.fromkeys(("lists", "searches", "expired", "left_path", "left_path_later"), ti.i32), 1
        )
        self.left_path = fields.integers(n)  # 1: not where it was expected
        self.capacity = max(capacity, MINIMUM_CAPACITY, CONTACTS_PER_BALL * len(np.unique(triangles)))
        self.most_solved = self.capacity  # one by one
        before = fields.bytes
        self.candidates_per_contact = CANDIDATES_PER_CONTACT
        self.candidate_capacity = CANDIDATES_PER_CONTACT * self.capacity
        # owner: the ball whose leaf found it; place: among its own; first: a ball or an edge; second: a triangle, or -1 - edge
        columns = dict.fromkeys(("owner", "place", "first", "second"), ti.i32)
        self.candidate = fields.table(columns, self.candidate_capacity)
        # distance [m]; thickness: distance at touch [m], with a minus: may not be gone through, but does not push; target [m/s];
        # planes: along the normal [m], see kernels.contacts.triangle_pairs.planes; normal: toward the upper side
        lengths = ("distance", "thickness", "target", "upper_plane", "lower_plane")
        columns = {**dict.fromkeys(("owner", "place", "kind"), ti.i32), "normal": vector}
        columns |= fields.impulses(model.dim, model.has_friction)
        self.contact = fields.table({**columns, **dict.fromkeys(lengths, fields.real)}, self.capacity)
        self.applied_impulse = fields.vectors(self.capacity, 3)  # N s
        self.member, self.entry = fields.integers(4 * self.capacity), fields.integers(4 * self.capacity)
        self.weight = fields.reals(4 * self.capacity)  # of each member
        self.bytes_each = (fields.bytes - before) / self.capacity
        self.first, self.number = fields.integers(n), fields.integers(n)
        self.used, self.candidates, self.entries, self.overflow = (fields.integers(1) for _ in range(4))
        # skin: by which candidates may be further apart than pairs that are listed [m], widest_skin or 0; fastest: longest way
        # of a ball in this step beside the common one [m]
        self.widest_skin = fields.reals(np.array([SURFACE_SKIN * float(np.min(scene.radius[np.unique(triangles)]))]))
        self.skin, self.fastest = fields.reals(1), fields.reals(1)
        # [m] where balls were at the last search, and the expected displacement of then
        self.searched_position, self.searched_displacement = fields.vectors(n, 3), fields.vectors(n, 3)
        # [m] in common to all: way since then, change of the expected displacement, way of this step
        self.common_way, self.common_change, self.common_step = (fields.vectors(1, 3) for _ in range(3))

    @ti.func
    def ball_of(self, c, k):
        """Ball k of contact c."""
        return self.member[4 * c + k]

    @ti.func
    def weight_of(self, c, k):
        """Weight of ball k of contact c."""
        return self.weight[4 * c + k]

    @ti.func
    def thickness(self, c):
        """Distance at touch [m], negative where contact c may not be gone through, but does not push."""
        return self.contact[c].thickness

    @ti.func
    def other_side(self, c):
        """Number of the first ball of the triangle, or of the second edge."""
        return ti.select(self.contact[c].kind == BALL_TRIANGLE, 1, 2)

    @ti.func
    def turns(self, c):
        """True if contact c is that of a triangle with a ball that is in no surface."""
        return self.contact[c].kind == BALL_TRIANGLE and self.may_spin[self.member[4 * c]] == 1

    @ti.func
    def comes_after(self, entry, other):
        """True if an entry comes after another: by owner of its contact, then by place among what the owner listed."""
        a, b = self.contact[entry // 4], self.contact[other // 4]
        return a.owner > b.owner or (a.owner == b.owner and a.place > b.place)

    @ti.func
    def shares(self, i):
        """Sum of g^2 n n^T over the contacts of ball i, and of g^2."""
        T, count = ti.Matrix.zero(float, 3, 3), 0.0 * self.effective_inverse_mass[i]
        for e in range(self.first[i], self.first[i] + self.number[i]):
            contact, g = self.contact[self.entry[e] // 4], self.weight[self.entry[e]]
            if contact.thickness >= 0.0:
                T += g * g * contact.normal.outer_product(contact.normal)
                count += g * g
        return T, count

    @ti.func
    def share_mass(self, T, count, i):
        """Note how ball i splits its mass, by all its contacts. |sum g_c p_c|^2 <= s sum |p_c|^2 for any impulses p_c along the
        normals with s the largest eigenvalue of sum g^2 n n^T, and for any at all with s = sum g^2: with W = sum w s over the
        balls of a contact an iteration adds no energy, and a lone contact has sum w g^2, which is exact."""
        s = count
        if ti.static(not self.model.has_friction):
            s = contact_law.largest_eigenvalue(T)
        self.effective_inverse_mass[i] = s * self.model.inverse_mass[i]

    @ti.func
    def inverse_mass(self, solver: ti.template(), c):
        """1 / kg: sum w s over the four balls, or, where masses are not split, sum w g^2."""
        total = 0.0 * self.weight[4 * c]
        if ti.static(solver.sums_plainly):
            total = self.weighted_sum(self.model.inverse_mass, c)
        else:
            for k in ti.static(range(4)):
                if self.weight[4 * c + k] != 0.0:
                    total += self.effective_inverse_mass[self.member[4 * c + k]]
        return total

    @ti.func
    def own_inverse_mass(self, solver: ti.template(), i):
        """Inverse mass [1/kg] of the part of ball i that takes part in one contact."""
        own = self.effective_inverse_mass[i]
        if ti.static(solver.sums_plainly):
            own = self.model.inverse_mass[i]
        return own

    @ti.func
    def groups(self):
        """Number of contacts."""
        return ti.min(self.used[0], self.capacity)

    @ti.func
    def solve_group(self, c, ball: ti.template(), solver: ti.template(), time):
        """Further impulse of contact c from the present velocities; viscous friction acts for `time` seconds."""
        if self.contact[c].thickness >= 0.0:
            u, none = self.relative_velocity(ball, c), ti.Vector.zero(float, 3)
            self.applied_impulse[c] = self.further_impulse(solver, c, u, self.inverse_mass(solver, c), none, time)


def stages(bottom_nodes: int) -> list[tuple[int, int]]:
    """Loops in which a device joins a tree: (first node, height of subtrees) of each, one thread for each subtree."""
    found, first = [], bottom_nodes
    while first > 1:
        height = min(SUBTREE_HEIGHT, first.bit_length() - 1)
        first >>= height
        found.append((first, height))
    return found


def owned_by_balls(scene: Scene) -> tuple[NDArray, NDArray, NDArray, NDArray, NDArray]:
    """The triangles that collide (t, 3), each from its lowest ball on, sorted; what lies beyond the edges across from their
    corners (t, 3): the ball of the next triangle, or BORDER, or NOT_OWNED; the triangles there (t, 3): the next one, or the one
    that owns the edge; all edges (e, 2) of triangles, and sticks, sorted; and which of them are bare sticks (e,)."""
    t = scene.triangles[scene.solid].astype(np.int64)
    first = np.argmin(t, axis=1)
    t = np.take_along_axis(t, (first[:, None] + np.arange(3)) % 3, axis=1)
    t = t[np.argsort(t[:, 0], kind="stable")]
    across = np.sort(sides(t[:, [1, 2, 0]]), axis=1)  # across from a, b, c
    edges, kind, times = np.unique(across, axis=0, return_inverse=True, return_counts=True)
    kind = kind.reshape(-1)
    order = np.argsort(kind, kind="stable")
    start = np.cumsum(times) - times
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order)) - start[kind[order]]
    corner = t.T.reshape(-1)
    following = order[start[kind] + (place + 1) % times[kind]]
    other = corner[following]
    next_one = np.where(place > 0, order[start[kind]], following) % max(1, len(t))
    beyond = np.where(place > 0, loops.NOT_OWNED, np.where(times[kind] > 1, other, loops.BORDER))
    sticks = np.unique(np.sort(scene.pairs[scene.collides].astype(np.int64), axis=1), axis=0).reshape(-1, 2)
    n = max(1, scene.n_balls)
    sticks = sticks[~np.isin(sticks @ [n, 1], edges @ [n, 1])]
    bare = np.repeat([0, 1], [len(edges), len(sticks)])
    edges = np.concatenate([edges, sticks])
    order = np.lexsort(edges.T[::-1])
    return t, beyond.reshape(3, -1).T, next_one.reshape(3, -1).T, edges[order], bare[order]


def first_triangle(triangles: NDArray, n: int) -> NDArray[np.int64]:
    """(n,) the first of the triangles (t, 3) that each ball is in; -1 if it is in none."""
    first = np.full(n, len(triangles))
    np.minimum.at(first, triangles, np.arange(len(triangles))[:, None])
    return np.where(first < len(triangles), first, -1)


def leaf_order(scene: Scene, edges: NDArray) -> tuple[NDArray[np.int64], int]:
    """All balls (n,), those that own edges (e, 2) first, and how many these are: surface by surface, on each along a curve that
    stays near what it has passed (Morton order), so that those in a row share small boxes for as long as it holds together."""
    n = scene.n_balls
    owners = np.unique(edges[:, 0])
    x = scene.position[owners]
    low, size = x.min(axis=0), float(np.ptp(x, axis=0).max())
    cell = ((x - low) * (MORTON_CELLS / size if size > 0 else 0.0)).astype(np.int64)
    code = np.zeros(len(owners), dtype=np.int64)
    for bit in range(MORTON_CELLS.bit_length()):
        for a in range(3):
            code |= (cell[:, a] >> bit & 1) << (3 * bit + a)
    order = np.lexsort([code, components(n, edges)[owners]])
    return np.concatenate([owners[order], np.setdiff1d(np.arange(n), owners)]), len(owners)


def spacing(scene: Scene) -> NDArray[np.float64]:
    """(n,) m, see SPACING."""
    t = scene.triangles[scene.solid]
    a, b, c = (scene.position[t[:, k]] for k in range(3))
    longest = np.max(
        [np.linalg.norm(b - a, axis=1), np.linalg.norm(c - b, axis=1), np.linalg.norm(a - c, axis=1)], axis=0
    )
    double = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    height = np.divide(double, longest, out=np.zeros_like(double), where=longest > 0)
    out = np.full(scene.n_balls, UNBOUNDED_SPACING)
    np.minimum.at(out, t.ravel(), np.repeat(SPACING * height, 3))
    return out
