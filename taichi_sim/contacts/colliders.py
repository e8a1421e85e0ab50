"""Colliders as Taichi fields: shapes, where they are at the start of a step, and how they move until its end."""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.contacts.distance_grid import DistanceGrid
from taichi_sim.device.engine import ti
from taichi_sim.device.fields import Fields
from taichi_sim.device.model import Model
from taichi_sim.kernels.contacts import colliders as geometry
from taichi_sim.kernels.contacts.colliders import CUSTOM, MESH
from taichi_sim.kernels.contacts.collision_groups import meets
from taichi_sim.scene.collider_forms import Drawn, Form, Meshed
from taichi_sim.scene.motion import TICKS

__all__ = ["Colliders"]


def _lesser(a: NDArray, b: NDArray) -> NDArray:
    """The smaller one of two changes of the same sign, else 0: a steady change is one, a jump none."""
    return np.where(a * b > 0.0, np.sign(a) * np.minimum(np.abs(a), np.abs(b)), 0.0)


@ti.data_oriented
class Colliders:
    """All colliders of a scene. Motions are worked out on the host in float64, for TICKS substeps at a time: `motion`, of which
    `tick` is the present one. grids: of `distance_grids`."""

    def __init__(self, model: Model, fields: Fields, grids: list[DistanceGrid]) -> None:
        scene = model.scene
        self.dim, self.scene, self.count = model.dim, scene, len(scene.colliders)
        self.turn = 1 if model.dim == 2 else 3  # components of an angular velocity
        # number of each kind by a formula, and its Taichi function (shape, p), see kernels.contacts.colliders
        names = sorted({c.form.measured_by for c in scene.colliders} - {""})
        self.solids = [(number, getattr(geometry, name)) for number, name in enumerate(names)]
        kinds: dict[type[Form], int] = {Meshed: MESH, Drawn: CUSTOM}
        kinds |= {c.form: names.index(c.form.measured_by) for c in scene.colliders if c.form not in kinds}
        self.kinds = np.array([kinds[c.form] for c in scene.colliders])
        self.has_mesh, self.has_custom = (bool(np.any(self.kinds == kind)) for kind in (MESH, CUSTOM))
        # number of each that the user defines, and its Taichi function distance(p) [m], p in its own frame
        self.custom = [(k, c.shape.distance) for k, c in enumerate(scene.colliders) if c.form is Drawn]
        eps = float(np.finfo(np.float64 if fields.real == ti.f64 else np.float32).eps)
        self.difference = eps ** (1 / 3)  # of its extent: between points whose distances give a direction
        self.has_hollow = any(c.hollow > 0 for c in scene.colliders)
        self.has_faces = any(c.hollow > 0 and c.form.has_faces for c in scene.colliders)
        self.faces = 2 * model.dim if self.has_faces else 1
        moving = [k for k, c in enumerate(scene.colliders) if c.motion.moves]
        self.moving = moving
        self.movers, self.moves = len(moving), bool(moving)
        self.rotates = any(bool(np.any(scene.colliders[k].motion.turns)) for k in moving)
        self._shapes(model, fields, grids)
        vector = ti.types.vector(model.dim, fields.real)
        turn = fields.real if model.dim == 2 else vector
        # x: centre [m]; along, across: images of its local x and y axes; v [m/s], spin [1/s]: velocity and angular velocity in
        # the step to come; past_v, past_spin: those with which the step before ended
        columns = {"x": vector, "along": vector, "v": vector, "spin": turn, "past_v": vector, "past_spin": turn}
        if model.dim == 3:
            columns["across"] = vector
        x, rotation = (np.array(part) for part in zip(*(self._start(k) for k in range(self.count))))
        spin = np.zeros(self.count) if model.dim == 2 else np.zeros((self.count, 3))
        axes = {"along": rotation[:, :, 0], "across": rotation[:, :, 1]}
        first = {"x": x, **axes, **dict.fromkeys(("v", "past_v"), np.zeros_like(x)), "spin": spin, "past_spin": spin}
        self.pose = fields.table(columns, self.count, first)
        if self.moves:
            self.mover = fields.integers(np.array(moving))
            self.tick = fields.integers(1)
            self.motion = fields.table(columns, (TICKS + 1) * self.movers)
            self.width = sum(getattr(kind, "n", 1) for kind in columns.values())

    def _shapes(self, model: Model, fields: Fields, grids: list[DistanceGrid]) -> None:
        """The shapes, and the grids of meshes one behind the other."""
        colliders = model.scene.colliders
        real, dim = fields.real, model.dim
        vector, whole = ti.types.vector(dim, real), ti.types.vector(3, ti.i32)
        # half: of its size; radius: of what is round; hollow: thickness, 0 if solid; extent: radius of the sphere around it [m]
        columns = {"kind": ti.i32, "half": vector, "radius": real, "hollow": real, "surface": ti.i32, "extent": real}
        data: dict[str, NDArray] = {
            "kind": self.kinds,
            "half": np.array([c.half for c in colliders]),
            "radius": np.array([c.radius for c in colliders]),
            "hollow": np.array([c.hollow for c in colliders]),
            "surface": np.array([c.material for c in colliders]),
            "extent": np.array([c.extent for c in colliders]),
        }
        if self.has_faces:  # that a ball in it meets each by itself
            data["faces"] = np.array([self.faces if c.hollow > 0 and c.form.has_faces else 1 for c in colliders])
            columns["faces"] = ti.i32
        self.has_groups = model.has_groups
        if self.has_groups:
            data |= {"group": np.array([c.group for c in colliders]), "mask": np.array([c.mask for c in colliders])}
            columns |= {"group": ti.i32, "mask": ti.i32}
        if self.has_mesh:
            # of the grid of each mesh: first value, corner [m], inverse_cell [1/m], cells along each axis
            data["first"] = np.cumsum([0, *(g.value.size for g in grids[:-1])])
            data["low"] = np.array([g.low for g in grids])
            data["inverse_cell"] = np.array([1.0 / g.cell for g in grids])
            data["cells"] = np.array([g.value.shape[::-1] for g in grids])
            columns |= {"first": ti.i32, "low": vector, "inverse_cell": real, "cells": whole}
            self.widest_cell = max(g.cell for g in grids if g.value.size)  # m
            self.grid = fields.reals(np.concatenate([g.value.ravel() for g in grids]))  # m, distances
            nodes, triangles = (
                np.cumsum([0, *(len(part) for part in parts)])
                for parts in ([g.tree.boxes for g in grids], [g.tree.triangles for g in grids])
            )
            # of the tree of each mesh
            data |= {"first_node": nodes[:-1], "last_node": nodes[1:]}
            columns |= {"first_node": ti.i32, "last_node": ti.i32}
            cells, lists = (
                np.cumsum([0, *(len(part) for part in parts)])
                for parts in ([g.cells for g in grids], [g.listed for g in grids])
            )
            exact = [g.exact.ravel() + np.where(g.exact.ravel() < 0, -t, c) for g, t, c in zip(grids, triangles, cells)]
            cell = [g.cells_from(*first).ravel() for g, *first in zip(grids, cells, triangles, lists)]
            link = [(g.tree.links + np.array([k, t, t])).ravel() for g, k, t in zip(grids, nodes, triangles)]
            # as in DistanceGrid, of all one behind the other: exact (nodes of grids), cell (2 cells), listed; link (3 nodes)
            self.exact, self.cell, self.link = (fields.integers(np.concatenate(one)) for one in (exact, cell, link))
            entries: dict[str, NDArray] = {  # side by side, because both are asked at once; away [m]
                "triangle": np.concatenate([g.listed + t for g, t in zip(grids, triangles)]),
                "away": np.concatenate([g.away for g in grids]),
            }
            self.listed = fields.table({"triangle": ti.i32, "away": real}, len(entries["away"]), entries)
            self.box = fields.reals(np.concatenate([g.tree.boxes.ravel() for g in grids]))  # m, (6 nodes)
            self.triangle = fields.reals(np.concatenate([g.tree.triangles.ravel() for g in grids]))  # (40 triangles)
        self.shape = fields.table(columns, self.count, data)

    @ti.func
    def distance_from_origin(self, k):
        """Largest coordinate [m] of collider k's centre: the larger, the coarser are places as seen from its centre."""
        return ti.abs(self.pose[k].x).max()

    def _start(self, k: int) -> tuple[NDArray, NDArray]:
        x, rotation = self.scene.colliders[k].motion.at(0.0)
        return x[0], rotation[0]

    def load(self, time: float, h: float, first: int) -> None:
        """Work out the motion for TICKS substeps of h, from number `first` of those from `time` on."""
        if not self.moves:
            return
        table = np.empty((TICKS + 1, self.movers, self.width), dtype=np.float64)
        for m, k in enumerate(self.moving):
            x, rotation, v, spin = self.scene.colliders[k].motion.steps(time, h, first - 2, TICKS + 2)
            past = [one[1:-1] + 0.5 * _lesser(one[2:] - one[1:-1], one[1:-1] - one[:-2]) for one in (v, spin)]
            parts = (part[2:] for part in (x, rotation[:, :, 0], v, spin, rotation[:, :, 1]))
            table[:, m] = np.concatenate([*past, *parts], axis=1)[:, : self.width]
        real = np.float64 if self.motion.x.dtype == ti.f64 else np.float32
        self._load(np.ascontiguousarray(table.reshape(-1, self.width), dtype=real))

    @ti.kernel
    def _load(self, table: ti.types.ndarray()):
        d = ti.static(self.dim)
        w = ti.static(self.turn)
        self.tick[0] = 0
        for r in range(table.shape[0]):
            for a in ti.static(range(d)):
                self.motion[r].past_v[a] = table[r, a]
                self.motion[r].x[a] = table[r, d + w + a]
                self.motion[r].along[a] = table[r, 2 * d + w + a]
                self.motion[r].v[a] = table[r, 3 * d + w + a]
                if ti.static(d == 3):
                    self.motion[r].past_spin[a] = table[r, d + a]
                    self.motion[r].spin[a] = table[r, 4 * d + w + a]
                    self.motion[r].across[a] = table[r, 4 * d + 2 * w + a]
            if ti.static(d == 2):
                self.motion[r].past_spin = table[r, d]
                self.motion[r].spin = table[r, 4 * d + w]

    @ti.func
    def rewind(self):
        """Back to the start of the motion loaded."""
        if ti.static(self.moves):
            ti.loop_config(serialize=True)
            for _ in range(1):
                self.tick[0] = -1

    @ti.func
    def advance(self):
        """Go to the poses at the next substep."""
        if ti.static(self.moves):
            ti.loop_config(serialize=True)
            for _ in range(1):
                self.tick[0] = self.tick[0] + 1
                for m in range(self.movers):
                    self.pose[self.mover[m]] = self.motion[self.tick[0] * self.movers + m]

    @ti.func
    def collides_with(self, model: ti.template(), i, k):
        """True if the groups of ball i and collider k let them collide."""
        allowed = True
        if ti.static(self.has_groups):
            allowed = meets(model.group[i], model.mask[i], self.shape[k].group, self.shape[k].mask)
        return allowed

    @ti.func
    def distance(self, k, face, x, after, touch, exact):
        """Distance of the point x from collider k (one face of it, where it is hollow with faces), direction away from it, and
        whether x lies inside of a hollow one; `after` seconds into the step. touch, exact: see
        kernels.contacts.colliders.mesh_distance."""
        p = geometry.local(self, k, x, after)
        d, n, within = geometry.distance(self, k, p, touch, exact)
        d, n = geometry.face_distance(self, k, face, p, d, n, within)
        return d, geometry.world(self, k, n, after), within
