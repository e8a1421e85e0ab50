"""Meshes that are too coarse: what is said of them, against what bars, arcs and folds do."""

import numpy as np
import pytest
from statics import forces

import taichi_sim as ts
from taichi_sim.analysis import coarse_meshes
from taichi_sim.analysis.accuracy import Setup, findings
from taichi_sim.analysis.coarse_meshes import bent_findings, beyond_bricks, few_across, ropes
from taichi_sim.analysis.methods import VERLET
from taichi_sim.geometry.mesh import Surface
from taichi_sim.geometry.spheres import icosphere

pytestmark = pytest.mark.once


def said(scene):
    return [what for what, _ in (*bent_findings(scene), *few_across(scene))]


def number(words, after, before):
    return float(words.split(after)[1].split(before)[0])


def rope(dim, n, place, **more):
    """A rope of n balls at places (n, dim) [m]."""
    scene = ts.Scene(dim=dim, gravity=[0, -7, 0][:dim])
    body = ts.shapes.rope(scene, np.zeros(dim), np.eye(dim)[0] * 0.9, n, **more)
    scene.set_balls(body.balls, position=place)
    return scene


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("pieces", [6, 14])
def test_a_rod_in_an_arc(dim, pieces):
    """By the energy that its elements store, against EI / 2 times the turn squared over the length of a piece."""
    radius, rigidity, angle = 0.4, 0.03, np.linspace(0.2, 3.4, pieces + 1)
    circle = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)[:, :dim]
    turn = angle[1] - angle[0]
    piece = 2.0 * radius * np.sin(turn / 2.0)
    scene = rope(dim, pieces + 1, circle, length=pieces * piece, EI=rigidity, EA=1e4)
    curve = np.einsum("bk,bki->bi", scene.bend_weights, circle[scene.bends])
    stored = 0.5 * scene.bend_stiffness @ np.sum(curve**2, axis=1)
    exact = 0.5 * rigidity * turn**2 / piece * (pieces - 1)
    if turn < 0.35:
        assert said(scene) == []
        assert 1.0 - stored / exact < 0.01
    else:
        (what,) = said(scene)
        assert number(what, "it stores ", " %") / 100.0 == pytest.approx(1.0 - stored / exact, rel=0.1, abs=2e-3)
        assert number(what, "a radius of ", " m") == pytest.approx(radius, rel=0.05)


@pytest.mark.parametrize(("pieces", "late"), [(20, 0.29), (40, 0.094), (80, 0.027)])
def test_a_folded_rope(pieces, late):
    """Measured: the time of its end to 0.9 of the length, see tests/published/test_folded_chain.py."""
    i = np.arange(pieces + 1)
    along = np.where(i < pieces / 2, 0.0, np.where(i > pieces / 2, 0.5, 0.2)) / pieces
    scene = rope(2, pieces + 1, np.stack([along, -np.minimum(i, pieces - i) / pieces], axis=1))
    (what,) = said(scene)
    assert number(what, "is about ", " %") / 100.0 == pytest.approx(late, rel=0.4)
    setup = Setup(VERLET, 1e-4, "f64")
    assert [one.cure for one in findings(scene, setup) if one.subject == "mesh"] == ["take 123 pieces for 1 %"]


def test_a_rope_is_one_by_what_it_is_made_of():
    """Under a name of its own, and made by hand; not a square of springs, and not with one more across."""
    scene = ts.Scene(dim=2)
    corner = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    found = []
    for pairs in ([[0, 1], [1, 2], [2, 3]], [[0, 1], [1, 2], [2, 3], [3, 0]], [[0, 1], [2, 1], [3, 0]]):
        balls = scene.add_balls(corner + len(found), radius=0.1)
        scene.add_springs(balls[np.array(pairs)], stiffness=1.0)
        scene.set_name(balls, f"thing {len(found)}")
        found.append(balls)
    scene.add_springs([[found[0][1], found[1][1]]], stiffness=1.0)
    assert [one.name for one in ropes(scene)] == ["thing 0"]
    assert len(said(scene)) == 1


@pytest.mark.parametrize("kind", ["grid", "mesh", "triangles"])
def test_a_sheet_on_a_cylinder(kind):
    """Bent by the spacing over the radius at each row of balls."""
    scene, radius, n = ts.Scene(dim=3), 0.11, 11
    ts.shapes.cloth(scene, (0.6, 0.5), (n, 9), bending_rigidity=2e-4)
    x = scene.position.copy()
    if kind != "grid":
        scene, faces = ts.Scene(dim=3), scene.triangles
        more = {"warp": 40.0} if kind == "triangles" else {}
        ts.shapes.cloth(scene, mesh=Surface(x, faces), bending_rigidity=2e-4, **more)
    assert said(scene) == []
    angle = x[:, 0] / radius
    scene.set_balls(position=np.stack([radius * np.sin(angle), radius * np.cos(angle), x[:, 2]], axis=1))
    (what,) = said(scene)
    assert number(what, "is bent by ", " rad") == pytest.approx(0.06 / radius, rel=0.02)
    assert number(what, "a radius of ", " m") == pytest.approx(radius, rel=0.1)


def beam(scene, x, long, high, wide, mu, poisson):
    """Part by which a bar along x that is held at one end is stiffer than a beam."""
    force, end = np.zeros_like(x), x[:, 0] > x[:, 0].max() - 1e-9
    force[end, 1] = 1e-6 / end.sum()
    free = np.repeat(~scene.pinned, x.shape[1])
    moved = np.zeros(x.size)
    moved[free] = np.linalg.solve(forces(scene, x)[1][np.ix_(free, free)], force.ravel()[free])
    young, area = 2.0 * mu * (1.0 + poisson), wide * high
    exact = 1e-6 * (long**3 / (3.0 * young * area * high**2 / 12.0) + long / (5.0 / 6.0 * mu * area))
    return exact / moved.reshape(x.shape)[end, 1].mean() - 1.0


def bar(dim, layers, poisson):
    """A bar of solids along x with so many boxes across."""
    size, count = np.array([0.9, 0.09, 0.09])[:dim], np.array([10 * layers, layers, layers])[:dim]
    scene = ts.Scene(dim=dim)
    grid = np.stack(np.meshgrid(*(np.arange(n + 1) for n in count), indexing="ij"), axis=-1).reshape(-1, dim)
    index = np.arange(len(grid)).reshape(count + 1)
    cut = {
        2: ((0, 1, 3), (0, 3, 2)),
        3: ((0, 1, 3, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7), (0, 4, 5, 7), (0, 5, 1, 7)),
    }
    corners = [index[tuple(slice(o, n + o) for o, n in zip(at, count))].ravel() for at in np.ndindex(*(2,) * dim)]
    solids = np.concatenate([np.stack([corners[k] for k in some], axis=1) for some in cut[dim]])
    x = grid * size / count
    turned = np.linalg.det(x[solids[:, 1:]] - x[solids[:, :1]]) < 0
    solids[turned] = solids[turned][:, [1, 0, *range(2, dim + 1)]]
    scene.new_object("jelly", scene.add_balls(x, radius=1e-3, mass=1.0))
    scene.add_solids(solids, young_modulus=1e4, poisson_ratio=poisson)
    return scene


@pytest.mark.parametrize(
    ("dim", "layers", "poisson", "much"),
    [(2, 1, 0.3, "2.9"), (3, 1, 0.45, "2.9"), (3, 2, 0.4999, "1.5"), (3, 2, 0.45, None), (2, 4, 0.9996, None)],
)
def test_a_body_of_few_solids_across_is_named(dim, layers, poisson, much):
    found = said(bar(dim, layers, poisson))
    if much is None:
        assert found == []
    else:
        assert len(found) == 1
        assert f"{much} times as stiff in bending as they should be" in found[0]


@pytest.mark.parametrize(("dim", "across"), [(2, 1), (2, 3), (2, 6), (3, 1), (3, 2)])
def test_a_bar_of_boxes_of_springs(dim, across):
    """Against a beam of the material that many boxes have, mu = sum k L^2 / (dim (dim + 2) V), within a tenth."""
    long, high = 1.2, 0.1
    scene = ts.Scene(dim=dim)
    size, count = (long, high, high)[:dim], (12 * across + 1, across + 1, across + 1)[:dim]
    ts.shapes.jelly(scene, size, count, stiffness=80.0, mass=1.0, pinned="left")
    x = scene.position
    mu = scene.stiffness @ scene.rest_length**2 / (dim * (dim + 2) * np.prod(size))
    excess = beam(scene, x, long, high, size[2] if dim == 3 else 1.0, mu, 1.0 / (dim + 1))
    (what,) = said(scene)
    if "times as stiff" in what:
        found = number(what, "it is about ", " times") - 1.0
    else:
        found = number(what, "it is about ", " %") / 100.0
    assert found == pytest.approx(excess, rel=0.1)


def test_boxes_and_what_is_straight_say_nothing():
    scene = ts.Scene(dim=3)
    ts.shapes.jelly(scene, (0.5, 0.1, 0.1), (6, 2, 2), young_modulus=1e3)
    ts.shapes.rope(scene, (0, 1, 0), (1, 1, 0), 8)
    ts.shapes.wheel(scene, (0, 2, 0), 0.3, 5)
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    ts.shapes.cloth(
        scene, mesh=Surface(corners, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])), bending_rigidity=1.0
    )
    assert said(scene) == []


def spindle(length):
    """Two square pyramids on one base of 0.3 m, whose tips are `length` [m] from it."""
    base = [[0.15, 0, 0.15], [0.15, 0, -0.15], [-0.15, 0, -0.15], [-0.15, 0, 0.15]]
    tips = [[0, length, 0], [0, -length, 0]]
    faces = [[k, (k + 1) % 4, 4] for k in range(4)] + [[(k + 1) % 4, k, 5] for k in range(4)]
    return Surface(np.array(base + tips, dtype=float), np.array(faces, dtype=np.int32))


def test_a_mesh_with_tips_that_no_brick_fills():
    """The distance said is that of the tip from the nearest brick. With the advised spacing nothing is said."""
    scene = ts.Scene(dim=3)
    body = ts.shapes.jelly(scene, mesh=spindle(0.6), spacing=0.08, rotation=(20, 0, 30), position=(1, 2, 3))
    ((what, cure),) = beyond_bricks(scene)
    far = scene.embedded_surfaces[0]
    tip = far.weights[4] @ scene.position[far.corners[4]]
    box = scene.position[scene.bricks].mean(axis=1)
    axes = scene.position[scene.bricks[0]][[4, 2, 1]] - scene.position[scene.bricks[0]][0]
    off = np.abs((tip - box) @ (axes / 0.08).T) - 0.04
    reach = np.linalg.norm(np.maximum(off, 0.0), axis=1).min()
    assert what.startswith("the mesh of jelly_0 reaches up to")
    assert number(what, "up to ", " m beyond") == pytest.approx(reach, rel=0.01)
    assert len(body.balls) == scene.n_balls
    spacing = number(cure, "spacing = ", " or fill")
    assert spacing < 0.08
    for better in ({"spacing": spacing}, {"fill": "tetrahedra"}):
        scene = ts.Scene(dim=3)
        ts.shapes.jelly(scene, mesh=spindle(0.6), **better)
        assert not list(beyond_bricks(scene))


@pytest.mark.parametrize("spacing", [0.12, 0.1, 0.08])
@pytest.mark.parametrize("half", [(0.5, 0.4, 0.3), (0.2, 0.3, 0.2)])
def test_the_advised_spacing_of_bricks_needs_no_further_advice(half, spacing):
    """Of ellipsoids, which bricks fill now better and now worse as these get smaller. Turning the body changes nothing."""
    ball = icosphere(2)
    ellipsoid = Surface(ball.vertices * half, ball.triangles)

    def advice(step, **place):
        scene = ts.Scene(dim=3)
        ts.shapes.jelly(scene, mesh=ellipsoid, spacing=step, **place)
        return [cure for _, cure in beyond_bricks(scene)]

    (cure,) = advice(spacing, rotation=(40, 10, 70), position=(-2, 1, 0.5))
    assert advice(spacing) == [cure]
    better = number(cure, "spacing = ", " or fill")
    assert 0.3 * spacing < better < spacing
    assert not advice(better)


def test_a_spacing_that_takes_too_many_boxes_to_try_is_not_promised(monkeypatch):
    monkeypatch.setattr(coarse_meshes, "MOST_TRIED", 100.0)
    scene = ts.Scene(dim=3)
    ts.shapes.jelly(scene, mesh=spindle(0.6), spacing=0.08)
    ((_, cure),) = beyond_bricks(scene)
    assert cure.startswith("try a spacing below 0.0")
