"""A built-in collider is a class, its form and a Taichi function: one that only this file knows is met, drawn, said, written and
read as the others are."""

import importlib
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
import taichi as ti
from physics_support import F64
from taichi_sim.kernels.contacts import colliders as distances

import taichi_sim as ts
from taichi_sim.analysis import sieves
from taichi_sim.analysis.frame import Placed as PlacedCollider
from taichi_sim.common import validation
from taichi_sim.files import toml_schema
from taichi_sim.outputs.parts import ROUND_FACES, _bodies
from taichi_sim.render.bodies import Bodies, filled
from taichi_sim.scene.collider_forms import Form
from taichi_sim.scene.collider_shapes import SHAPES
from taichi_sim.scene.placed import Checked, Placed

CLOSE = 1e-6 if F64 else 1e-3


class Cut(Form):
    """Part of the ball of `radius` about the origin that has x < half[0]."""

    measured_by = "cut_distance"

    @staticmethod
    def distances(one, p):
        return np.maximum(np.linalg.norm(p, axis=1) - one.radius, p[:, 0] - one.half[0])  # exact but near its rim

    @staticmethod
    def triangulated(one, around):
        return one.radius * np.eye(4, 3), np.array([(0, 1, 2), (3, 1, 0), (3, 2, 1), (3, 0, 2)])

    @staticmethod
    def outline(one, wider, around):
        widest = np.arccos(one.half[0] / one.radius)
        angle = np.linspace(widest, 2.0 * np.pi - widest, around)
        return (one.radius + wider) * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@dataclass(frozen=True)
class Dome(Placed):
    """Part of a ball that a plane leaves.

    Args:
        center: (dim,) of the ball [m]; radius: of the ball [m]; cut: of the plane, along x [m].
    """

    center: object
    radius: float
    cut: float

    def _checked(self, dim, where):
        radius = self._number(where, "radius", positive=True)
        half = np.zeros(dim)
        half[0] = validation.number(f"{where}.cut", self.cut, low=0.0, high=self.radius)
        return Checked(Cut, self._vector(where, "center", dim), half, radius)


@ti.func
def cut_distance(shape, p):
    """Distance of p from a dome, exact but near its rim, and the direction away from it."""
    d, n = p.norm() - shape.radius, p.normalized()
    if p[0] - shape.half[0] > d:
        d = p[0] - shape.half[0]
        n = 0.0 * p
        n[0] = 1.0
    return d, n


@pytest.fixture
def _known(monkeypatch):
    monkeypatch.setitem(SHAPES, "dome", Dome)
    monkeypatch.setattr(distances, "cut_distance", cut_distance, raising=False)
    importlib.reload(toml_schema)
    yield
    monkeypatch.undo()
    importlib.reload(toml_schema)


@pytest.mark.once
@pytest.mark.usefixtures("_known")
def test_another_collider_is_met_written_and_read(tmp_path):
    """A ball rests on the cut, which looks up, beside a box on which another one does."""
    scene = ts.Scene(dim=2, gravity=(0, -9.0))
    scene.add_collider(Dome((0.0, 0.0), radius=1.0, cut=0.4, rotation=90))
    scene.add_collider(ts.Box((3.0, 0.0), (1.0, 1.0)))
    scene.add_balls([[0.1, 0.5], [3.0, 0.6]], radius=0.1)
    scene.save(tmp_path / "dome.toml")
    scene = ts.load_scene(tmp_path / "dome.toml")
    assert [one.name for one in scene.colliders] == ["dome", "box"]
    with ts.Simulation(scene, dt=1e-3) as sim:
        sim.run(0.2)
        assert sim.position == pytest.approx(np.array([[0.1, 0.5], [3.0, 0.6]]), abs=CLOSE)
        sim.save(tmp_path / "dome.npz")
    with ts.Simulation.restore(tmp_path / "dome.npz") as sim:
        assert sim.scene.colliders[0].given == scene.colliders[0].given
    (tmp_path / "bad.toml").write_text((tmp_path / "dome.toml").read_text().replace("cut = 0.4", "cut = 4.0"))
    with pytest.raises(ts.SceneError, match=r"colliders\[0\].cut: 4.0 is not allowed"):
        ts.load_scene(tmp_path / "bad.toml")


@pytest.mark.usefixtures("_known")
@pytest.mark.parametrize("dim", [2, 3])
def test_another_collider_is_measured_and_drawn(dim):
    scene = ts.Scene(dim=dim)
    scene.add_collider(Dome([1.0] * dim, radius=0.5, cut=0.25))
    dome = scene.colliders[0]
    assert dome.distance(np.array([[2.0] * dim, [0.0] + [1.0] * (dim - 1)]), 0.0)[1] == pytest.approx(0.5)
    frame = SimpleNamespace(dim=dim, colliders=[PlacedCollider(dome, np.ones(dim), np.eye(dim))])
    if dim == 3:
        assert Bodies.of(frame).vertices.tolist() == (0.5 * np.eye(4, 3)).tolist()
        assert len(sieves._Edges.of(dome).angle) == 6
        assert sieves._width(dome)[0] == pytest.approx(0.25 / 3**0.5)  # half the height of that tetrahedron on its face
    else:
        corners = filled(frame)[0]
        assert corners[..., 0].max() == pytest.approx(1.25)
        assert corners[..., 0].min() == pytest.approx(0.5, abs=1e-3)
    assert [len(body.triangles) for body in _bodies(frame, [])] == [4 if dim == 3 else ROUND_FACES - 2]
