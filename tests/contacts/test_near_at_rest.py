"""Surfaces that are nearer to themselves at rest than they are thick: contacts do not push them open, and `check` says so."""

import numpy as np
import pytest
from physics_support import F64, simulate

import taichi_sim as ts
from taichi_sim.reports import check

pytestmark = pytest.mark.long_in("f32")

H = 5e-4
ROUNDING = 1e-12 if F64 else 1e-5


def star(path):
    """A prism of four points whose faces are single polygons, which slivers fill."""
    angle = np.pi * np.arange(8) / 4
    outline = np.where(np.arange(8) % 2, 0.17, 0.4)[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    faces = [range(8, 0, -1), range(9, 17)]
    faces += [(k + 1, (k + 1) % 8 + 1, (k + 1) % 8 + 9, k + 9) for k in range(8)]
    text = [f"v {x} {y} {z}" for z in (0.08, -0.08) for x, y in outline]
    path.write_text("\n".join(text + ["f " + " ".join(map(str, face)) for face in faces]))
    return path


def torus(around=10, across=8):
    """Its tube is as thin as a side of its triangles is long."""
    i, j = (part.ravel() for part in np.meshgrid(np.arange(around), np.arange(across), indexing="ij"))
    a, b = 2 * np.pi * i / around, 2 * np.pi * j / across
    ring = 0.3 + 0.04 * np.cos(b)
    here, on, over, both = ((i + p) % around * across + (j + q) % across for p, q in ((0, 0), (1, 0), (0, 1), (1, 1)))
    corners = np.concatenate([np.stack([here, over, both], axis=1), np.stack([here, both, on], axis=1)])
    return np.stack([ring * np.cos(a), 0.04 * np.sin(b), ring * np.sin(a)], axis=1), corners


@pytest.fixture
def scene(tmp_path):
    """Both, on their way to a wall."""
    out = ts.Scene(dim=3)
    out.add_wall((0, 1, 0))
    thrown = {"surface_collision": True, "velocity": (0, -2.0, 0)}
    ts.shapes.cloth(out, mesh=star(tmp_path / "star.obj"), position=(0, 0.65, 0), **thrown)
    ts.shapes.cloth(out, mesh=torus(), position=(1.5, 0.3, 0), **thrown)
    noise = np.random.default_rng(4).normal(scale=1e-3, size=(out.n_balls, 3))
    out.set_balls(velocity=out.velocity + noise)
    return out


@pytest.mark.slow
def test_what_is_near_at_rest_gains_no_energy(scene):
    """In flight, where only noise moves it, and where it hits."""
    with simulate(scene, dt=H) as sim:
        said = "\n".join(check.lines(sim))
        start, total = sim.energy().total, []
        for _ in range(40):
            sim.step(20)
            total.append(sim.energy().total)
    assert max(total) <= start * (1 + ROUNDING)
    assert total[-1] < 0.9 * start, "nothing hit the wall"
    assert "are as near as" in said
