"""Bodies in an implicit stage: none depends on another that it does not touch."""

import warnings

import numpy as np
import pytest
from physics_support import F64, GATHERED, VARIANTS, simulate
from taichi_sim.kernels import reductions
from test_implicit_elements import Curve

import taichi_sim as ts
from taichi_sim.integrators import bodies
from taichi_sim.integrators.implicit_euler import ImplicitEuler
from taichi_sim.integrators.multilevel import FEWEST_BALLS

LONE = 3  # balls that nothing joins
NO_TIES = np.zeros((0, 2), dtype=int)


def add_strip(scene, place, number, seed, stiffness=1e4, mass=0.1, speed=1.0):
    """A bent strip of so many balls in 2D that moves any way."""
    rng = np.random.default_rng(seed)
    x = np.stack([0.1 * np.arange(number), 0.05 * rng.random(number)], axis=1) + place
    balls = scene.add_balls(x, velocity=speed * rng.normal(size=x.shape), mass=mass, radius=0.01)
    scene.add_springs(np.stack([balls[:-1], balls[1:]], axis=1), stiffness=stiffness, damping=1e-4 * stiffness)
    scene.add_springs(np.stack([balls[:-2], balls[2:]], axis=1), stiffness=0.1 * stiffness)
    return balls


def beside(number, other):
    """A pinned and a free strip, then another strip with what `other` says, or none, and lone balls."""
    scene = ts.Scene(dim=2, gravity=(0, -9.81))
    scene.set_balls([add_strip(scene, (0, 0), number, 1, stiffness=1e6)[0]], pinned=True)
    add_strip(scene, (0, 2), 5, 2)
    if other is not None:
        add_strip(scene, (0, 4), 7, 3, **other)
        scene.add_balls([(i, 9.0) for i in range(LONE)], radius=0.01)
    return scene


def after(scene, number, method, variant=VARIANTS[0]):
    """Places of the first two strips after 20 steps."""
    with simulate(scene, variant, integrator=method, dt=1 / 60, substeps=1, contacts="off") as sim:
        sim.step(20)
        return sim.position[: number + 5]


OTHERS = ({}, {"stiffness": 1e9, "speed": 30.0}, {"mass": 1e3, "speed": 0.0}, {"mass": 1e-3, "speed": 5.0})


@pytest.mark.once
@pytest.mark.slow_where(number=FEWEST_BALLS + 2)
@pytest.mark.slow_where(method="tr_bdf2")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("method", "number"), [("implicit_euler", 6), ("implicit_euler", FEWEST_BALLS + 2), ("tr_bdf2", 6)]
)
def test_a_body_does_not_depend_on_another(method, number):
    """The bits are equal beside any other, however stiff, heavy or fast that is, and alone; with and without levels."""
    found = [after(beside(number, other), number, method) for other in OTHERS]
    alone = after(beside(number, None), number, method)
    assert np.isfinite(alone).all()
    for other in found:
        assert np.array_equal(other, found[0])
    assert found[0] == pytest.approx(alone, rel=1e-4)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_body_does_not_depend_on_another_where_launches_run_ahead(monkeypatch):
    """As on a device: sums by groups, and bodies that go on while others still search."""
    expected = after(beside(6, {}), 6, ImplicitEuler(1e-4))
    monkeypatch.setattr(reductions, "on_device", lambda: True)
    found = [after(beside(6, other), 6, ImplicitEuler(1e-4), GATHERED) for other in OTHERS[:3]]
    assert np.array_equal(found[1], found[0])
    assert np.array_equal(found[2], found[0])
    assert found[0] == pytest.approx(expected, abs=1e-3)


def strip_on_a_disc(other):
    """Places after 20 steps of a strip that folds over a disc, beside another one with what `other` says; and whether each was
    deflated."""
    scene = ts.Scene(dim=2, gravity=(0, -9.81))
    scene.add_material("rough", friction=0.3)
    for k, own in enumerate([{}, other]):
        balls = add_strip(scene, (9.0 * k, 0.32), 17, k + 1, **{"stiffness": 1e5, "speed": 0.5, **own})
        scene.set_balls(balls, material="rough")
        scene.add_collider(ts.Sphere((9.0 * k + 0.75, 0.0), 0.3, material="rough"))
    with simulate(scene, GATHERED, integrator="implicit_euler", dt=1 / 120, substeps=1) as sim:
        own, deflated = sim.parts.integrator.solver.deflation.own, np.zeros(2, dtype=bool)
        for _ in range(20):
            sim.step(1)
            deflated |= own.to_numpy()["inverse"].any(axis=(1, 2))
        return sim.position[:17], deflated


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("ahead", [False, True])
def test_a_body_on_a_surface_does_not_depend_on_another(ahead, monkeypatch):
    """Deflation, and what surfaces do, are each body's own affair."""
    monkeypatch.setattr(reductions, "on_device", lambda: ahead)
    (first, deflated), *rest = [strip_on_a_disc(other) for other in OTHERS[:3]]
    assert deflated.all()
    for other, _ in rest:
        assert np.array_equal(other, first)


@pytest.mark.once
def test_balls_are_grouped_by_what_joins_them():
    scene = ts.Scene(dim=2)
    scene.add_balls([(i, 0) for i in range(10)], radius=0.1, pinned=[0, 3, 9])
    scene.add_springs([[1, 0], [0, 2], [2, 3], [5, 6], [6, 7]], stiffness=1.0)  # two hang on ball 0; 4, 8 are lone
    body, free, joined = bodies.bodies_of(scene, NO_TIES)
    assert body.tolist() == [0, 0, 1, 1, 2, 3, 3, 3, 2, 0]
    assert free.tolist() == [False, False, False, True]
    assert joined.tolist() == [True, True, False, True]


@pytest.mark.once
@pytest.mark.parametrize("device", [False, True])
def test_each_ball_is_in_one_part_of_its_body(device, monkeypatch):
    monkeypatch.setattr(reductions, "on_device", lambda: device)
    scene = ts.Scene(dim=2)
    sizes = (1100, 2, 70, 1, 4200, 64)
    for k, n in enumerate(sizes):
        balls = scene.add_balls([(i, k) for i in range(n)], radius=0.1)
        scene.add_springs(np.stack([balls[:-1], balls[1:]], axis=1), stiffness=1.0) if n > 1 else None
    with ts.Simulation(scene, arch="cpu", integrator="implicit_euler", contacts="off") as sim:
        found = sim.parts.integrator.solver.bodies
        part, span, chunk = found.part.to_numpy(), found.span.to_numpy(), found.chunk.to_numpy()
        order = found.order.to_numpy()
    covered = []
    for c in range(found.parts):
        balls = order[part["first"][c] + np.arange(part["count"][c]) * part["stride"][c]]
        assert set(found.body[balls]) == {part["body"][c]}
        assert len(balls) <= reductions.part_size()
        covered += balls.tolist()
    assert sorted(covered) == list(range(sum(sizes)))
    assert chunk[0] == 0
    assert chunk[found.chunks] == found.parts
    assert (np.diff(chunk[: found.chunks + 1]) > 0).all()
    rows = np.concatenate([np.arange(b, e) for b, e in zip(span["begin"], span["end"])])
    assert rows.tolist() == list(range(found.groups and found.parts, found.parts + found.groups))


# Bodies that elements join -----------------------------------------------------------------------------------------------

FABRIC = {"weft": 700.0, "shear": 60.0, "coupling": 100.0, "bending_rigidity": 5e-4, "mass_per_area": 0.3}
OTHER_SHEETS = ({}, {"warp": 1e8, "speed": 30.0}, {"mass_per_area": 1e3, "speed": 0.0})


def sheets(other):
    """A sheet of triangles and, unless None, another one; elements join both to one pinned ball, which they list first."""
    scene = ts.Scene(dim=3, gravity=(0.0, -9.81, 0.0))
    scene.add_balls([(0.0, 0.0, 0.9)], radius=0.01, pinned=True)
    threes, stiffness = [], []
    for k, own in enumerate([{}] if other is None else [{}, other]):
        fabric = {"warp": 900.0, "speed": 1.0, **FABRIC, **own}
        speed, place = fabric.pop("speed"), (0.0, 0.0, k * 1.0)
        balls = ts.shapes.cloth(scene, (0.6, 0.8), (6, 6), position=place, damping=1e-3, **fabric).balls
        scene.set_balls(balls, velocity=speed * np.random.default_rng(k).normal(size=(len(balls), 3)))
        threes.append([0, *balls[:2]])
        stiffness.append(1e4 if k == 0 else 1e-2 * fabric["warp"])
    return scene, Curve(threes, stiffness)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_sheet_does_not_depend_on_another():
    """The bits are equal beside any other that hangs on the same ball, however stiff, heavy or fast that is, and alone."""
    found = []
    for other in (None, *OTHER_SHEETS):
        scene, curve = sheets(other)
        with simulate(scene, forces=[curve], integrator="implicit_euler", dt=1 / 60, substeps=1, contacts="off") as sim:
            for kick in np.random.default_rng(9).normal(
                size=(5, 36, 3)
            ):  # the change of the step before is a bad guess now
                sim.set_velocity(np.concatenate([np.zeros((1, 3)), kick, sim.velocity[37:]]))
                sim.step(4)
            found.append(sim.position[:37])
    alone, first, *rest = found
    assert np.isfinite(alone).all()
    for other in rest:
        assert np.array_equal(other, first)
    assert first == pytest.approx(alone, rel=1e-10 if F64 else 1e-4)


@pytest.mark.once
def test_elements_join_their_free_balls_whichever_is_pinned():
    scene = ts.Scene(dim=3)
    scene.add_balls([(i, 0, 0) for i in range(8)], radius=0.1, pinned=[0, 6])
    curve = Curve([[0, 1, 2], [3, 0, 4], [5, 6, 0]], 1.0)  # ball 7 is lone
    with ts.Simulation(scene, forces=[curve], arch="cpu", integrator="implicit_euler", contacts="off") as sim:
        solver = sim.parts.integrator.solver
        held = solver.elements.held[0]
        start, corner = held.start.to_numpy(), held.corner.to_numpy()
    assert solver.bodies.body.tolist() == [0, 0, 0, 1, 1, 2, 2, 3]
    assert not solver.bodies.free.any()
    assert solver.bodies.joined.tolist() == [True, True, True, False]
    assert np.diff(start).tolist()[:8] == [0, 1, 0, 1, 0, 2, 0, 0]
    assert corner["ball"].tolist() == [0, 0, 0, 6]
    assert corner["entry"].tolist() == [0, 1, 2, 0]


@pytest.mark.slow
def test_compiling_says_nothing(capfd):
    scene = ts.Scene(dim=3, gravity=(0.0, -9.81, 0.0))
    ts.shapes.cloth(scene, (0.5, 0.4), (9, 7), position=(-0.25, 0.32, -0.2), damping=1e-3, warp=400.0, **FABRIC)
    scene.add_collider(ts.Sphere(center=(0.0, 0.2, 0.0), radius=0.1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with simulate(scene, integrator="implicit_euler", dt=0.01) as sim:
            sim.step(2)
    assert capfd.readouterr() == ("", "")


@pytest.mark.once
@pytest.mark.parametrize("method", ["implicit_euler", "tr_bdf2"])
def test_pinned_balls_that_hold_nothing_stand_still(method):
    """Listed before a body that falls, they were given what it did not fall by, and threw it up with their speed."""
    scene = ts.Scene(dim=2, gravity=(0.5, -4.0))
    pins = scene.add_balls([[0.0, 0.0], [0.3, 0.0], [0.6, 0.1]], radius=0.05, pinned=True)
    balls = scene.add_balls([[0.0, 3.0], [0.4, 3.0], [0.1, 3.3]], mass=[1.0, 3.0, 2.0], radius=0.05)
    scene.add_springs([balls[[0, 1]], balls[[1, 2]]], stiffness=300.0)
    with simulate(scene, integrator=method, dt=4e-3) as sim:
        start = sim.position[pins]
        sim.step(50)
        assert np.all(sim.velocity[pins] == 0.0)
        assert np.all(sim.position[pins] == start)
        np.testing.assert_allclose(sim.velocity[balls], np.tile([0.1, -0.8], (3, 1)), atol=1e-5)
