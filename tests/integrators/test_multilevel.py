"""Levels of aggregates condition implicit stages: symmetric, positive, the same solutions, and passes that hardly grow."""

import numpy as np
import pytest
from physics_support import EPS, F64, GATHERED, VARIANTS, simulate
from scipy.sparse import coo_array, diags_array
from taichi_sim.kernels import reductions

import taichi_sim as ts
from taichi_sim.device.engine import ti
from taichi_sim.geometry.aggregation import levels_of
from taichi_sim.geometry.graph import components
from taichi_sim.integrators import ImplicitEuler, multilevel


def grid(width, height, first=0):
    """Edges of a grid of nodes, with the diagonals of one direction."""
    node = first + np.arange(width * height).reshape(width, height)
    sides = [(node[1:], node[:-1]), (node[:, 1:], node[:, :-1]), (node[1:, 1:], node[:-1, :-1])]
    return np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in sides])


def levels(edges, n, held=None):
    return levels_of(edges, np.zeros(n) if held is None else held, np.ones(n), components(n, edges), (0, 1, 2))


@pytest.mark.once
def test_levels_move_bodies_as_wholes_and_hold_what_is_held():
    held = np.zeros(600)
    held[0] = 50.0
    for given in (np.zeros(600), held):
        found, whole = levels(grid(20, 30), 600, given), np.ones(600)
        assert 2 <= len(found) <= 4
        for level in found:
            assert len(level.body) < 0.3 * level.weight.shape[0]
            assert (np.diff(level.weight.tocsc().indptr) > 0).all()
        weights = found[0].weight @ np.ones(len(found[0].body))
        free = np.ones(600, dtype=bool)
        if given[0] > 0:
            free[[0, 1, 30, 31]] = False
            assert weights[0] < 0.5  # a node near what is held hardly moves
        assert weights[free] == pytest.approx(whole[free])
    moved = found[0].mass.sum()
    assert 0.3 * 600 < moved < 600  # sum of squares of weights that add up to 1


def iterations(edges, n, held):
    """Those of conjugate gradients to 0.001, for the Laplacian of a graph with n nodes, some of them held, by its levels."""
    found = levels_of(edges, held, np.ones(n), components(n, edges), (0, 1))
    ends = np.concatenate([edges, edges[:, ::-1]])
    graph = coo_array((np.ones(len(ends)), tuple(ends.T)), shape=(n, n)).tocsr()
    matrix = (diags_array(graph.sum(axis=1) + held) - graph).tocsr()
    below, inverse = matrix.diagonal(), []
    for level in found:
        block = level.weight.multiply(level.weight).T @ below
        below = level.shares[1] * block
        inverse.append(1.0 / below - 1.0 / (level.shares[0] * block))

    def conditioned(residual):
        points, answer = [residual], 0.0
        for level in found:
            points.append(level.weight.T @ points[-1])
        for level, part, point in zip(found[::-1], inverse[::-1], points[:0:-1]):
            answer = level.weight @ (part * point + answer)
        return residual / matrix.diagonal() + answer

    residual = np.random.default_rng(3).normal(size=n)
    z = p = conditioned(residual)
    first = size = residual @ z
    count = 0
    while size > 1e-6 * first:
        product = matrix @ p
        residual = residual - size / (p @ product) * product
        z = conditioned(residual)
        before, size = size, residual @ z
        p = z + size / before * p
        count += 1
    return count


def mixed(edges, n):
    """A graph with its nodes numbered at random, and the new number of each."""
    number = np.random.default_rng(8).permutation(n)
    return number[edges], number


@pytest.mark.once
def test_iterations_hardly_grow_whatever_the_order_of_nodes():
    """Sheets held by a side, and a rope held by an end."""
    found = []
    for across in (22, 130):
        n = across * across
        held = np.zeros(n)
        held[:across] = 2.0
        edges, number = mixed(grid(across, across), n)
        mixed_held = np.zeros(n)
        mixed_held[number] = held
        found += [iterations(grid(across, across), n, held), iterations(edges, n, mixed_held)]
    rope = np.stack([np.arange(1999), np.arange(1, 2000)], axis=1)
    found.append(iterations(rope, 2000, np.eye(2000)[0]))
    print(found)
    assert max(found[2:4]) < 1.5 * min(found[:2])
    assert max(found) <= 17


@pytest.mark.once
def test_weights_of_a_body_do_not_depend_on_another():
    alone = levels(grid(9, 9), 81)
    beside = levels(np.concatenate([grid(12, 31), grid(9, 9, 372)]), 453)
    points = np.arange(372, 453)
    for one, level in zip(alone, beside):
        nodes = np.flatnonzero(level.body == 372) if level.body.max() >= 372 else np.flatnonzero(level.body > 0)
        assert np.array_equal(level.weight.toarray()[np.ix_(points, nodes)], one.weight.toarray())
        for here, there in zip(one.shares, level.shares):
            assert np.array_equal(there[nodes], here)
        points = nodes


@pytest.mark.once
def test_what_nothing_joins_has_no_levels():
    assert levels(np.zeros((0, 2), dtype=int), 40) == []
    assert levels_of(np.zeros((0, 2), dtype=int), np.zeros(0), np.zeros(0), np.zeros(0, dtype=int), (0,)) == []


@ti.kernel
def condition(solver: ti.template(), residual: ti.types.ndarray(), answer: ti.types.ndarray()):
    """answer = the preconditioner times a residual, both (n, dim)."""
    for i in range(solver.n):
        for a in ti.static(range(solver.dim)):
            solver.sum[i][a] = residual[i, a]
    solver.levels.solve(solver.sum)
    for i in range(solver.n):
        z = solver._conditioned(i)
        for a in ti.static(range(solver.dim)):
            answer[i, a] = z[a]


def torn_cloth_and_jelly():
    """A sheet that tears from its pins, with bending, a free jelly, and a strip that is too small for levels."""
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    sheet = ts.shapes.cloth(scene, size=(1, 1), resolution=(16, 12), stiffness=1e4, pinned="corners", break_strain=0.01)
    scene.set_balls(sheet.balls[90:96], mass=2.0, velocity=(0, -3, 0))
    ts.shapes.jelly(scene, size=(0.4, 0.4, 0.4), resolution=(5, 5, 5), position=(0, 3, 0), stiffness=1e3)
    strip = scene.add_balls([(i, 5, 0) for i in range(6)], radius=0.01)
    scene.add_springs(np.stack([strip[1:], strip[:-1]], axis=1), stiffness=1e3)
    return scene


@pytest.mark.slow
@pytest.mark.parametrize("device", [False, True])
def test_symmetric_and_positive(device, monkeypatch):
    """The preconditioner is symmetric and positive, also where springs are torn and balls pinned, and as a device sums."""
    monkeypatch.setattr(reductions, "on_device", lambda: device)
    with simulate(
        torn_cloth_and_jelly(),
        GATHERED if device else VARIANTS[0],
        integrator="implicit_euler",
        dt=0.01,
        contacts="off",
    ) as sim:
        sim.step(12)
        assert sim.torn.any()
        solver, free = sim.parts.integrator.solver, ~sim.scene.pinned
        assert solver.levels.active
        rng = np.random.default_rng(5)
        smooth = np.sin(3.0 * sim.scene.position[:, [1, 2, 0]])
        given = [free[:, None] * one for one in (rng.normal(size=smooth.shape), smooth, np.ones_like(smooth))]
        found = []
        for one in given:
            residual = one.astype(np.float64 if F64 else np.float32)
            answer = np.zeros_like(residual)
            condition(solver, residual, answer)
            found.append(answer.astype(np.float64))
        product = np.array([[np.sum(a * b) for b in found] for a in given])
        size = np.sqrt(np.outer(np.diag(product), np.diag(product)))
        assert (np.linalg.eigvalsh(product / size) > 0.0).all()
        assert np.abs(product - product.T).max() < 1e3 * EPS * size.max()
        assert (found[0][~free] == 0.0).all()


def hanging(n, material):
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    sheet = {"material": material} if material else {"stiffness": 1e3, "mass": 0.2}
    ts.shapes.cloth(scene, size=(1, 1), resolution=(n, n), pinned="corners", surface_collision=False, **sheet)
    return scene


def solved(scene, dt, steps, method="implicit_euler"):
    with simulate(scene, integrator=method, dt=dt, substeps=1, contacts="off") as sim:
        sim.step(steps)
        return sim.solver().passes / steps, sim.position


@pytest.mark.long
@pytest.mark.parametrize("material", [None, "silk"])
def test_passes_hardly_grow_with_the_number_of_balls(material):
    """Half of a second's fall in steps of 1/60 s: blocks alone take 2.9 times as many at twice as many balls across, twice."""
    passes = [solved(hanging(n, material), 1 / 60, 8)[0] for n in (14, 28, 56)]
    print(passes)
    assert passes[2] < 1.5 * passes[0]


@pytest.mark.slow
def test_levels_save_passes(monkeypatch):
    """A cloth that swings as a whole takes fewer passes, to the same solution."""
    scene, found = ts.Scene(dim=3, gravity=(0, -10, 0)), []
    sheet = ts.shapes.cloth(scene, size=(1, 1), resolution=(20, 20), stiffness=1e4, mass=0.3)
    scene.set_balls(sheet.balls[:20], pinned=True)
    for fewest in (multilevel.FEWEST_BALLS, 10**6):
        monkeypatch.setattr(multilevel, "FEWEST_BALLS", fewest)
        found.append(solved(scene, 1e-2, 20, ImplicitEuler(1e-3)))
    print([passes for passes, _ in found])
    assert found[0][0] < 0.6 * found[1][0]
    assert found[0][1] == pytest.approx(found[1][1], abs=1e-3)
