"""Bodies whose mass lies at their balls: what is said of how they turn, against their moments of inertia."""

import numpy as np
import pytest

import taichi_sim as ts
from taichi_sim.analysis.lumped_inertia import excess, sluggish

pytestmark = pytest.mark.once


@pytest.mark.parametrize(
    ("size", "bricks"), [((0.3, 0.2), (3, 2)), ((0.2, 0.3, 0.4), (2, 2, 3)), ((0.1, 0.5, 0.1), (1, 4, 1))]
)
def test_a_cuboid_turned_in_space(size, bricks):
    """By the moments of inertia of the balls and of the cuboid, about its axes, turned or not."""
    dim = len(size)
    scene = ts.Scene(dim=dim, gravity=(0.0,) * dim)
    more = {"rotation": (20.0, 30.0, 50.0)} if dim == 3 else {"rotation": 40.0}
    ts.shapes.jelly(scene, size, [n + 1 for n in bricks], density=800.0, young_modulus=1e5, **more)
    x = scene.position - scene.mass @ scene.position / scene.mass.sum()
    lumped = np.linalg.eigvalsh((scene.mass * x.T) @ x)
    exact = np.sort(scene.mass.sum() * np.square(size) / 12.0)
    ratios = [lumped.sum() / exact.sum()] if dim == 2 else (lumped.sum() - lumped) / (exact.sum() - exact)
    assert excess(scene.position[scene.bricks]) == pytest.approx(max(ratios) - 1.0, rel=1e-6)
    ((what, cure),) = sluggish(scene)
    assert "moment of inertia" in what
    assert "across" in cure


def test_tetrahedra_against_points_inside_them():
    rng = np.random.default_rng(6)
    corners = rng.normal(size=(5, 4, 3)) * (1.0, 0.6, 0.3)
    weight = rng.dirichlet(np.ones(4), 100_000)
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    volume /= volume.sum()
    points = np.einsum("pk,eka->epa", weight, corners)
    middle = np.einsum("e,epa->a", volume, points) / len(weight)
    inside, ends = (np.einsum("e,epa,epb->ab", volume, x - middle, x - middle) / x.shape[1] for x in (points, corners))
    about, lumped = (np.trace(one) * np.eye(3) - one for one in (inside, ends))
    assert excess(corners) == pytest.approx(
        np.linalg.eigvals(np.linalg.solve(about, lumped)).real.max() - 1.0, rel=0.02
    )


def test_a_fine_body_and_two_coarse_ones():
    scene = ts.Scene(dim=2)
    for k, n in enumerate((2, 3, 9)):
        ts.shapes.jelly(scene, (0.3, 0.3), (n, n), density=800.0, young_modulus=1e5, position=(k, 0))
    said = [what for what, _ in sluggish(scene)]
    assert len(said) == 2  # 1 + 2 / m^2: 3, 1.5 and 1.03
    assert "200 % larger" in said[0]
    assert "50 % larger" in said[1]


@pytest.mark.parametrize("flat", [1, 2, 3])
def test_what_is_flat_or_a_line_or_a_point_has_none(flat):
    """In any direction, where rounding leaves it a volume."""
    corners = np.random.default_rng(flat).normal(size=(6, 4, 3)) * (np.arange(3) >= flat)
    turn = np.linalg.qr(np.random.default_rng(9).normal(size=(3, 3)))[0]
    assert excess(corners @ turn + (3.0, -1.0, 0.2)) == 0.0
