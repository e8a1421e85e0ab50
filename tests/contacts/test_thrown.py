"""Nothing goes through surfaces, however far from its way something is thrown after contacts were looked for."""

import numpy as np
import pytest
import taichi as ti
from physics_support import F64, simulate

import taichi_sim as ts

pytestmark = pytest.mark.long

H = 1e-3
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])  # of a tetrahedron


@ti.data_oriented
class Throw:
    """Moves balls of 1 kg by `way` [m] in a step, which their speeds do not tell before."""

    def allocate(self, model, state, fields):
        self.kick = fields.vectors(model.n, 3)

    @ti.func
    def accumulate(self, model: ti.template(), ball: ti.template(), impulse: ti.template(), h, time):
        for i in range(model.n):
            impulse[i] += self.kick[i]

    def by(self, way):
        self.kick.from_numpy((np.asarray(way) / H).astype(np.float64 if F64 else np.float32))


def thrown(scene, throw, driver="fused"):
    """A simulation whose solve settles little, so that ways have to be cut short."""
    settings = {"integrator": "symplectic_euler", "contacts": "jacobi", "contact_iterations": 1}
    return simulate(scene, ("ordered", driver), dt=H, forces=[throw], spin=False, **settings)


def inside(p, x, faces):
    """Whether points p (k, 3) lie in closed surfaces: their solid angles."""
    a, b, c = (x[faces[:, k]] - p[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(r, axis=2) for r in (a, b, c))
    dot = np.sum(a * b, axis=2) * lc + np.sum(b * c, axis=2) * la + np.sum(c * a, axis=2) * lb
    angle = 2 * np.arctan2(np.sum(a * np.cross(b, c), axis=2), la * lb * lc + dot)
    return np.abs(angle.sum(axis=1)) > 2 * np.pi


def test_tetrahedra_and_balls_thrown_about():
    """Some hold a ball, which stays in; the others stay out."""
    rng = np.random.default_rng(1)
    scene, throw = ts.Scene(dim=3), Throw()
    at = np.stack(np.unravel_index(rng.permutation(27)[:14], (3, 3, 3)), axis=1) * 0.5
    corner = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) * 0.35 + 0.05
    bodies = [scene.add_balls(place + corner, radius=0.01) for place in at]
    for balls in bodies:
        scene.add_triangles(balls[FACES], collides=True)
    x = rng.uniform(0, 1.5, (30, 3))
    x[: len(at)] = at + corner.mean(axis=0)
    loose = scene.add_balls(x, radius=rng.choice([0.003, 0.01, 0.02], len(x)))
    with thrown(scene, throw) as sim:
        x = sim.position
        start = [inside(x[loose], x, balls[FACES]) for balls in bodies]
        assert np.sum(start) >= len(bodies)
        assert sim.crossings() == 0
        for _ in range(100):
            x = sim.position
            v = rng.normal(size=x.shape) * rng.choice([0.0, 1.0, 20.0])
            for balls in bodies:
                v[balls] = rng.normal(size=3) * rng.choice([0.0, 10.0, 60.0])
            sim.resume(ts.Snapshot(x, v))
            way = rng.normal(size=x.shape) * rng.choice([0.0, 3e-3, 0.05, 0.2])
            way *= rng.random((len(x), 1)) < rng.choice([0.05, 0.3, 1.0])
            throw.by(way + 0.05 * (0.7 - x) * (rng.random() < 0.3))  # now and then all back to the middle
            sim.step()
            x = sim.position
            assert sim.crossings() == 0
            for balls, before in zip(bodies, start):
                assert np.array_equal(inside(x[loose], x, balls[FACES]), before)


def test_pins_that_start_all_at_once_meet_balls_that_are_in_no_surface():
    scene, rng = ts.Scene(dim=3), np.random.default_rng(4)
    pins = scene.add_balls([[0, 0, 0], [2, 0, 0], [0, 0, 2]], radius=0.02)
    scene.add_triangles(pins[None], collides=True)
    x = rng.uniform(0.1, 0.8, (20, 3))
    x[:, 1] = np.linspace(0.05, 0.3, 20)
    loose = scene.add_balls(x, radius=0.02)
    begin, speed = 10 * H, 200.0
    scene.add_moving_pins(pins, path=[(0.0, (0, 0, 0)), (begin, (0, 0, 0)), (begin + 1.0, (0, speed, 0))])
    with simulate(scene, dt=H) as sim:
        for _ in range(15):
            sim.step()
            x = sim.position
            assert np.all(x[loose, 1] > x[pins, 1].max()), "a ball went through"
        assert x[pins, 1].max() > 0.1  # and they moved


def test_what_follows_something_that_is_cut_short():
    """A triangle is thrown onto a second one, in whose way nothing was, and which must stop; a ball follows that at its speed."""
    scene, throw = ts.Scene(dim=3), Throw()
    x = np.array([[-1.0, 0.0, -1.0], [2.0, 0.0, -1.0], [-1.0, 0.0, 2.0]])
    lower = scene.add_balls(x, radius=0.002)
    upper = scene.add_balls(0.1 * x + np.array([-0.5, 0.02, -0.5]), radius=0.002)
    scene.add_triangles([upper, lower], collides=True)
    last = scene.add_balls([[0.2, -0.0035, 0.2]], radius=0.001)  # aside of the thrown one
    scene.set_balls([*lower, *last], velocity=[0.0, 10.0, 0.0])
    with thrown(scene, throw) as sim:
        way = np.zeros((7, 3))
        way[upper, 1] = -0.2
        throw.by(way)
        sim.step()
        y = sim.position[:, 1]
        assert y[upper].min() > y[lower].max()
        assert y[lower].min() > y[last[0]]
        assert y[lower].max() < 0.5 * 10.0 * H  # it was cut short
        assert y[last[0]] > -0.0035


def test_what_comes_from_afar_at_its_own_speed():
    """Nothing is thrown: what flies further in a step than boxes of the tree are thick is listed before."""
    scene, throw = ts.Scene(dim=3), Throw()
    sheet = ts.shapes.cloth(
        scene, size=(1, 1), resolution=(12, 12), surface_collision=True, stiffness=0.0, bending_stiffness=0.0
    )
    x = np.random.default_rng(2).uniform(0.1, 0.9, (40, 3))
    x[:, 1] = np.linspace(0.05, 0.25, 40)
    shot = scene.add_balls(x, radius=0.002, velocity=(0, -200, 0))
    scene.set_balls(mass=1.0)
    with thrown(scene, throw) as sim:
        for _ in range(3):
            sim.step()
            x = sim.position
            cell = np.minimum((x[shot][:, [0, 2]] * 11).astype(int), 10) @ [12, 1]
            near = np.stack([x[sheet.balls[cell + k], 1] for k in (0, 1, 12, 13)])
            assert np.all(x[shot, 1] > near.min(axis=0) - 1e-6), "a ball went through"


def test_large_thin_sheets_thrown_onto_each_other():
    """Two triangles each, a thousand radii long: single precision must not lose the direction between them."""
    rng, layers = np.random.default_rng(0), 6
    scene, throw = ts.Scene(dim=3), Throw()
    square = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 1]]) - 0.5
    for _ in range(layers):
        balls = scene.add_balls(square, radius=1e-3)
        scene.add_triangles(balls[[[0, 2, 1], [1, 2, 3]]], collides=True)
    with thrown(scene, throw) as sim:
        for _ in range(60):
            turn = rng.normal(size=layers) * rng.choice([1e-4, 1e-2, 0.1], layers)
            c, s, o = np.cos(turn), np.sin(turn), np.zeros(layers)
            axes = np.moveaxis(np.array([[c, o, s], [o, o, o], [-s, o, c]]), 2, 0)
            x = np.einsum("lij,kj->lki", axes, square) + 1e-5 * rng.normal(size=(layers, 4, 3))
            x[:, :, 1] += 5e-3 * np.arange(layers)[:, None]
            sim.resume(ts.Snapshot(x.reshape(-1, 3), np.zeros((4 * layers, 3))))
            assert sim.crossings() == 0
            for _ in range(8):
                way = rng.normal(size=(4 * layers, 3)) * rng.choice([1e-4, 1e-3, 1e-2, 0.05])
                throw.by(way * [rng.choice([0.0, 0.1, 1.0]), 1.0, rng.choice([0.0, 0.1, 1.0])])
                sim.step()
                assert sim.crossings() == 0
