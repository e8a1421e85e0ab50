"""A collider shape that the package does not know: a cone in 3D, a roof in 2D, both as a user writes them."""

from copy import copy

import numpy as np
import pytest
import taichi as ti
from physics_support import F64, simulate

import taichi_sim as ts
from taichi_sim.render import Renderer

pytestmark = [pytest.mark.slow, pytest.mark.long_in("f64")]

G, R, HEIGHT, RADIUS = 9.81, 0.05, 0.6, 1.0
SLOPE = np.array([RADIUS, -HEIGHT]) / np.hypot(RADIUS, HEIGHT)  # outward and down
NORMAL = np.array([HEIGHT, RADIUS]) / np.hypot(RADIUS, HEIGHT)
DOWN = G * -SLOPE[1]  # m/s^2 along the slope
CLOSE = 1e-6 if F64 else 1e-3
SIZE = (120, 90)


@ti.func
def beside_a_slope(out, up, r, h):
    """Signed distance of a point, so far out and up, from a triangle with the corners (-r, 0), (r, 0), (0, h)."""
    along = ti.math.clamp(((r - out) * r + up * h) / (r * r + h * h), 0.0, 1.0)
    side, base = ti.Vector([out - r * (1.0 - along), up - h * along]), ti.Vector([ti.max(out - r, 0.0), up])
    inside = up > 0.0 and (out - r) * h + up * r < 0.0
    return ti.select(inside, -1.0, 1.0) * ti.min(side.norm(), base.norm())


@ti.data_oriented
class Cone(ts.ColliderShape):
    """The example of ColliderShape."""

    def __init__(self, center, radius, height, **placed):
        super().__init__(center, **placed)
        self.radius, self.height = radius, height

    @ti.func
    def distance(self, p):
        return beside_a_slope(ti.sqrt(p[0] ** 2 + p[2] ** 2), p[1], self.radius, self.height)

    def surface(self):
        k, angle = np.arange(48), np.linspace(0, 2 * np.pi, 48, endpoint=False)
        rim = self.radius * np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
        base, side = ([k, np.roll(k, -1), 48 + 0 * k], [np.roll(k, -1), k, 49 + 0 * k])
        vertices = np.concatenate([rim, [[0, 0, 0], [0, self.height, 0]]])
        return vertices, np.concatenate([np.stack(base, axis=1), np.stack(side, axis=1)])


@ti.data_oriented
class Roof(ts.ColliderShape):
    """The same in 2D; a file holds the box around it."""

    def __init__(self, center, radius, height, **placed):
        super().__init__(center, **placed)
        self.radius, self.height = radius, height

    @ti.func
    def distance(self, p):
        return beside_a_slope(ti.abs(p[0]), p[1], self.radius, self.height)

    def surface(self):
        return [[-self.radius, 0], [self.radius, 0], [0, self.height]], [[0, 1, 2]]

    def saved_as(self):
        return ts.Box(self.center, (2 * self.radius, 2 * self.height), material=self.material)


def start(down, gap=0.0):
    """Centre (2,) [m] of a ball `down` metres from the tip along the slope, `gap` above it."""
    return np.array([0.0, HEIGHT]) + down * SLOPE + (R + gap) * NORMAL


def around(x, degrees):
    """A point (outward, up) as one in 3D."""
    return x[0] * np.cos(np.radians(degrees)), x[1], x[0] * np.sin(np.radians(degrees))


def scene_of(dim):
    scene = ts.Scene(dim=dim, gravity=(0, -G, 0)[:dim])
    scene.add_material("smooth")
    scene.add_material("rough", friction=1.0)
    scene.add_material("elastic", restitution=1.0)
    return scene


@pytest.fixture(scope="module")
def cone():
    """A smooth ball slides, a rough one rolls, each on its side, and an elastic one is dropped, off the axes."""
    scene = scene_of(3)
    for degrees, down, gap, material in (
        (30, 0.2, 0.0, "smooth"),
        (150, 0.2, 0.0, "rough"),
        (260, 0.5, 0.3, "elastic"),
    ):
        scene.add_balls(around(start(down, gap), degrees), radius=R, material=material, body=1)
    scene.add_collider(Cone((0, 0, 0), RADIUS, HEIGHT, material="rough"))
    with simulate(scene, dt=1e-3) as sim:
        x, v = [sim.position], [sim.velocity]
        for _ in range(400):
            sim.step()
            x.append(sim.position)
            v.append(sim.velocity)
        frame = next(iter(sim.frames(fps=60, duration=1 / 60)))
    return scene, np.array(x), np.array(v), frame


@pytest.mark.parametrize(("ball", "degrees", "part"), [(0, 30, 1.0), (1, 150, 5 / 7)], ids=["slides", "rolls"])
def test_a_ball_on_a_cone_slides_or_rolls(cone, ball, degrees, part):
    _, x, _, _ = cone
    t = 1e-3 * np.arange(len(x))
    way = 0.2 + 0.5 * part * DOWN * t**2
    assert way[-1] < np.hypot(RADIUS, HEIGHT)
    expected = np.array([around(start(s), degrees) for s in way])
    assert np.abs(x[:, ball] - expected).max() < 2 * CLOSE + 1e-3 * np.ptp(way)


def test_a_ball_that_falls_on_a_cone_is_thrown_back_by_the_law(cone):
    _, x, v, _ = cone
    bounced = int(np.argmax(np.diff(v[:, 2, 1]) > 0.0)) + 2
    assert 0 < bounced < 390
    up = np.array(around(NORMAL, 260))
    speed = np.sqrt(2 * G * (x[0, 2, 1] - (x[0, 2] - 0.3 / NORMAL[1] * np.array([0, 1, 0]))[1]))
    before = np.array([0.0, -speed, 0.0])
    after = before - 2 * before @ up * up
    energy = 0.5 * np.sum(v[:, 2] ** 2, axis=1) + G * x[:, 2, 1]
    assert np.ptp(energy) < CLOSE * 10
    across = v[bounced, 2] - v[bounced, 2, 1] * np.array([0, 1, 0])
    assert np.abs(across - (after - after[1] * np.array([0, 1, 0]))).max() < 10 * CLOSE


def test_a_ball_on_the_tip_rests_where_it_touches():
    """A distance that is only that of the sides' lines is too small there: it would hold the ball a quarter of its radius up."""
    scene = scene_of(2)
    scene.add_balls([[0.0, 1.0 + R + 0.02]], radius=R, material="smooth")
    scene.add_collider(Roof((0.0, 0.0), 0.6, 1.0, material="smooth"))
    with simulate(scene, dt=1e-3) as sim:
        sim.step(200)
        assert abs(sim.position[0, 1] - (1.0 + R)) < 1e-3 * R
        assert np.abs(sim.velocity).max() < 1e-3


def test_it_is_drawn(cone):
    _, _, _, frame = cone
    without = copy(frame)
    without.colliders = ()
    pictures = []
    for one in (frame, without):
        with Renderer(one, size=SIZE) as renderer:
            pictures.append(renderer.render(one).astype(int))
    assert np.mean(np.abs(pictures[0] - pictures[1]).max(axis=2) > 20) > 0.05


def test_a_roof_that_moves_carries_a_ball_down_in_its_own_frame():
    scene = scene_of(2)
    scene.add_balls([start(0.2) * side for side in ((1, 1), (-1, 1))], radius=R, velocity=(0.7, 0.0), material="smooth")
    scene.add_collider(Roof((0.0, 0.0), RADIUS, HEIGHT, velocity=(0.7, 0.0), material="rough", colour=(1, 0, 0)))
    with simulate(scene, dt=1e-3) as sim:
        sim.step(300)
        x, t = sim.position, sim.time
        frame = next(iter(sim.frames(fps=60, duration=1 / 60)))
    moved = start(0.2 + 0.5 * DOWN * t**2)
    expected = np.array([moved * side + [0.7 * t, 0.0] for side in ((1, 1), (-1, 1))])
    assert np.abs(x - expected).max() < 3 * CLOSE
    with Renderer(frame, size=SIZE) as renderer:
        image = renderer.render(frame).astype(int)
    red = (image[..., 0] > 1.5 * image[..., 1]) & (image[..., 0] > 1.5 * image[..., 2])
    assert 0.1 < red.mean() < 0.6


def test_a_file_holds_what_the_shape_says(tmp_path):
    scene = scene_of(2)
    scene.add_balls([[0.0, 3.0]], radius=R)
    scene.add_collider(Roof((0.5, 0.0), RADIUS, HEIGHT, material="rough"))
    scene.save(tmp_path / "roof.toml")
    collider = ts.load_scene(tmp_path / "roof.toml").colliders[0]
    assert collider.name == "box"
    assert np.array_equal(collider.half, (RADIUS, HEIGHT))
    scene = scene_of(3)
    scene.add_balls([[0.0, 3.0, 0.0]], radius=R)
    scene.add_collider(Cone((0, 0, 0), RADIUS, HEIGHT))
    with pytest.raises(ts.SceneError, match=r"colliders\[0\]: a file cannot hold Cone"):
        scene.save(tmp_path / "cone.toml")


class Bare(ts.ColliderShape):
    pass


class Undrawn(Cone):
    surface = ts.ColliderShape.surface


class Open(Cone):
    def surface(self):
        vertices, triangles = super().surface()
        return vertices, triangles[1:]


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        (Bare((0, 0, 0)), r"Bare has no function distance\(p\)"),
        (Undrawn((0, 0, 0), 1, 1), "Undrawn needs a function surface"),
        (Open((0, 0, 0), 1, 1), "surface.* is not closed"),
        (object(), "ts.ColliderShape"),
    ],
)
def test_what_is_missing_is_said(shape, message):
    with pytest.raises(ts.SceneError, match=message):
        ts.Scene(dim=3).add_collider(shape)


def test_a_ball_may_not_start_inside():
    scene = scene_of(3)
    scene.add_balls([[0.3, 0.1, 0.1]], radius=R)
    scene.add_collider(Cone((0, 0, 0), RADIUS, HEIGHT))
    with pytest.raises(ts.SceneError, match=r"Cone.*starts around ball 0"):
        simulate(scene, dt=1e-3)
