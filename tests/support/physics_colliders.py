"""The scene that the tests of colliders share: every experiment and every target, far apart."""

from types import SimpleNamespace
from typing import Any

import numpy as np
from physics_support import box_mesh, vector

import taichi_sim as ts
from taichi_sim.scene.motion import rotation_matrix

H, G, R = 1e-3, 10.0, 0.05
SHOTS, SPEED = 125, 10 * R / H  # bullets at each shape, of 10 radii a step
ROOM = 8.0  # m between one experiment and the next
TURNTABLE = 2.7  # 1/s
THIN = 0.13  # of a cell of its grid, the thickness of a plate
LIFT = ((0.0, 0.0), (0.2, 0.0), (0.7, 0.5), (1.2, 0.5))  # s, m: waits, rises at 1 m/s, stands


def turn(dim, degrees):
    return degrees if dim == 2 else (0.0, 0.0, degrees)


def block(dim, x, y, z=1.0):
    return (x, y, z)[:dim]


def ring(n=24, m=12, wide=0.7, thick=0.3):
    """Vertices and triangles of a torus: a mesh with a hole, curved both ways."""
    u, v = np.meshgrid(np.arange(n) * 2 * np.pi / n, np.arange(m) * 2 * np.pi / m, indexing="ij")
    out = wide + thick * np.cos(v)
    points = np.stack([out * np.cos(u), out * np.sin(u), thick * np.sin(v)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    a, b = i * m + j, (i + 1) % n * m + j
    c, d = (i + 1) % n * m + (j + 1) % m, i * m + (j + 1) % m
    return points, np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])


class Laboratory:
    """The scene, the balls of each experiment by name, and where each stands."""

    def __init__(self, dim):
        self.dim, self.at, self.ball, self.next = dim, {}, {}, 0
        self.scene = ts.Scene(dim=dim, gravity=vector(dim, 0.0, -G))
        self.scene.add_material("elastic", restitution=1.0)
        self.scene.add_material("smooth")
        self.scene.add_material("rough", friction=1.0)
        self.scene.add_material("common", restitution=0.5, friction=0.25)
        self.body = self.scene.new_body()
        self._rest()
        self._slopes()
        self._rooms()
        self._movers()
        self.targets = self._targets()

    def place(self, name):
        self.at[name] = vector(self.dim, ROOM * self.next)
        self.next += 1
        return self.at[name]

    def add(self, name, x, material="smooth", **more):
        ball = self.scene.add_balls([x], radius=R, material=material, body=self.body, **more)
        self.ball[name] = int(ball[0])

    def _rest(self):
        dim, half = self.dim, vector(self.dim, 0.0, -0.5)
        c = self.place("corner")  # the first, with its wall to the left of all
        self.scene.add_wall(vector(dim, 1.0, 0.0), c[0] - 0.5)
        self.scene.add_collider(ts.Box(c + half, block(dim, 2.0, 1.0), material="common"))
        self.add("rolls into a corner", c + vector(dim, -0.3, R), "smooth", velocity=vector(dim, -1.0))
        c = self.place("box")
        self.scene.add_collider(ts.Box(c + half, np.ones(dim), rotation=turn(dim, 90), material="common"))
        self.add("rests on a box", c + vector(dim, 0.1, R), "common")
        self.add("dropped on a box", c + vector(dim, -0.2, R + 0.2), "common")
        c = self.place("capsule")
        ends = c - vector(dim, 0.5, 0.3), c + vector(dim, 0.5, -0.3)
        self.scene.add_collider(ts.Capsule(*ends, 0.3, material="common"))
        self.add("rests on a capsule", c + vector(dim, 0.1, R), "common")
        c = self.place("six boxes")
        for _ in range(6):  # more than a ball has slots
            self.scene.add_collider(ts.Box(c + half, np.ones(dim), material="common"))
        self.add("rests on six boxes", c + vector(dim, 0.1, R), "common")
        self.add("pinned", c + vector(dim, -0.2, -0.2), "common", pinned=True)
        if dim == 3:
            c = self.place("mesh")
            self.scene.add_collider(ts.Mesh(box_mesh(), position=c + half, material="common"))
            self.add("rests on a mesh", c + vector(dim, 0.1, R), "common")
            c = self.place("thin plate")
            tilt = rotation_matrix("", (9.0, 24.0, 13.0), 3)
            corners, triangles = box_mesh((2.4, 2.4 * THIN / 16, 2.4))
            self.scene.add_collider(ts.Mesh((corners @ tilt.T, triangles), position=c, resolution=16, material="rough"))
            for k, (x, z) in enumerate(((0.03, 0.4), (-0.41, -0.35), (0.62, -0.11))):
                y = 0.5 * THIN * 2.4 / 16 + R + 0.1 * k
                self.add(f"dropped on a thin plate {k}", c + tilt @ (x, y, z), "rough")

    def _slopes(self):
        for degrees in (20, 40):
            for part in (0.9, 1.1):
                name, angle = f"slope {degrees} {part}", np.radians(degrees)
                material = self.scene.add_material(name, friction=(part * np.tan(angle)) ** 2)
                n = vector(self.dim, -np.sin(angle), np.cos(angle))
                c = self.place(name)
                self.scene.add_collider(
                    ts.Box(c - 0.25 * n, block(self.dim, 6.0, 0.5), rotation=turn(self.dim, degrees), material="rough")
                )
                self.add(name, c + R * n, material)

    def _rooms(self):
        dim, side = self.dim, vector(self.dim, np.sin(np.radians(60)), -np.cos(np.radians(60)))
        c = self.place("hollow sphere")
        self.scene.add_collider(ts.Sphere(c, 1.0, hollow=0.2, material="smooth"))
        self.add("swings in a sphere", c + (1.0 - R) * side)
        c = self.place("hollow capsule")
        self.scene.add_collider(ts.Capsule(c - vector(dim, 1.0), c + vector(dim, 1.0), 1.0, hollow=0.2))
        self.add("swings in a capsule", c + vector(dim, 1.0) + (1.0 - R) * side)
        c = self.place("dome")
        self.scene.add_collider(ts.Sphere(c, 1.0, material="smooth"))
        self.add("slides off a sphere", c + (1.0 + R) * vector(dim, np.sin(0.1), np.cos(0.1)))
        c = self.place("elastic sphere")
        self.scene.add_collider(ts.Sphere(c, 1.0, material="elastic"))
        self.add("bounces on a sphere", c + vector(dim, 0.01, 1.5), "elastic")

    def _movers(self):
        dim = self.dim
        if dim == 3:
            c = self.place("turntable")
            arm, turning = np.array((0.9, 0.0, 0.3)), np.array((0.0, TURNTABLE, 0.0))
            plate = {"rotation_rate": np.degrees(turning), "pivot": c, "material": "rough"}
            self.scene.add_collider(ts.Box(c + vector(dim, 0.4, -0.5), (4.0, 1.0, 3.0), **plate))
            self.add("held on a turntable", c + arm + vector(dim, 0.0, R), "rough", velocity=np.cross(turning, arm))
        c = self.place("piston")
        self.scene.add_collider(ts.Box(c - vector(dim, 0.5), np.ones(dim), velocity=vector(dim, 2.0)))
        self.add("pushed by a piston", c + vector(dim, 0.3), "elastic")
        self.add("pinned before a piston", c + vector(dim, 0.4, 0.3), "elastic", pinned=True)
        c = self.place("conveyor")
        self.scene.add_collider(
            ts.Box(c - vector(dim, 0.0, 0.5), block(dim, 5.0, 1.0), velocity=vector(dim, 1.0), material="rough")
        )
        self.add("carried by a conveyor", c + vector(dim, 0.0, R), self.scene.add_material("worn", friction=0.04))
        c = self.place("lift")
        keys = [(t, vector(dim, 0.0, y - LIFT[0][1])) for t, y in LIFT]
        self.scene.add_collider(
            ts.Box(c + vector(dim, 0.0, LIFT[0][1] - 0.5), np.ones(dim), path=keys, material="smooth")
        )
        self.add("raised by a lift", c + vector(dim, 0.1, R))

    def _targets(self):
        """A collider of each shape, and the bullets that fly at it or within it."""
        dim, rng, targets = self.dim, np.random.default_rng(1), []
        spin = np.degrees(40.0 if dim == 2 else (20.0, 30.0, -40.0))
        tilt = 30.0 if dim == 2 else (20.0, 30.0, 40.0)
        along = vector(dim, 0.7, 0.3)
        shapes = [
            lambda c: ts.Sphere(c, 1.0, material="elastic"),
            lambda c: ts.Box(c, np.full(dim, 1.2), rotation=tilt, material="elastic"),
            lambda c: ts.Capsule(c - along, c + along, 0.4, material="elastic"),
            lambda c: ts.Sphere(c, 1.0, hollow=0.1, material="elastic"),
            lambda c: ts.Box(c, np.full(dim, 1.5), hollow=0.1, rotation=tilt, material="elastic"),
            lambda c: ts.Capsule(c - along, c + along, 0.6, hollow=0.1, material="elastic"),
            lambda c: ts.Box(c, np.full(dim, 1.2), rotation_rate=spin, material="elastic"),
            lambda c: ts.Capsule(c - along, c + along, 0.6, hollow=0.1, rotation_rate=spin, material="elastic"),
        ]
        if dim == 3:
            shapes += [lambda c: ts.Mesh(ring(), position=c, rotation=tilt, material="elastic")]
        for k, shape in enumerate(shapes):
            c = self.place(f"target {k}")
            number = self.scene.add_collider(shape(c))
            if self.scene.colliders[number].hollow:
                x, v = c + 0.2 * rng.uniform(-1, 1, (SHOTS, dim)), rng.normal(size=(SHOTS, dim))
            else:
                out = rng.normal(size=(SHOTS, dim))
                out *= rng.uniform(1.7, 2.5, (SHOTS, 1)) / np.linalg.norm(out, axis=1)[:, None]
                x, v = c + out, 0.6 * rng.uniform(-1, 1, (SHOTS, dim)) - out
            v *= SPEED / np.linalg.norm(v, axis=1)[:, None]
            balls = self.scene.add_balls(x, radius=R, velocity=v, material="elastic", body=self.body)
            targets.append(SimpleNamespace(collider=number, balls=balls, moves=k in (6, 7)))
        return targets


def drum_scene(dim):
    """A pile in a turning drum with a blade."""
    scene = ts.Scene(dim=dim, gravity=vector(dim, 0.0, -G))
    rubber = scene.add_material("rubber", restitution=0.2, friction=0.6)
    turning: dict[str, Any] = {"rotation_rate": np.degrees(1.5 if dim == 2 else (0.0, 0.0, 1.5)), "material": rubber}
    scene.add_collider(ts.Sphere(np.zeros(dim), 0.6, hollow=0.1, **turning))
    blade = vector(dim, 0.6), vector(dim, 0.45)
    scene.add_collider(ts.Capsule(*blade, 0.05, pivot=np.zeros(dim), **turning))
    resolution = (7, 5) if dim == 2 else (5, 3, 5)
    ts.shapes.pile(scene, resolution, 0.04, jitter=0.1, material=rubber, position=vector(dim, -0.25, -0.25, -0.2))
    return scene
