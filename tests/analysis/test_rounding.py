"""What single precision loses far from the origin, as it is said before a run, against runs."""

import numpy as np
import pytest
from physics_support import F64, simulate

import taichi_sim as ts
from taichi_sim.analysis import accuracy
from taichi_sim.analysis.methods import VERLET
from taichi_sim.reports import check

G, R = 10.0, 0.05


def springs(far):
    """Two pendulums and a chain, `far` from the origin along x."""
    scene = ts.Scene(dim=2, gravity=(0.0, -G))
    for x, k in ((0.0, 1e3), (3.0, 1e5)):
        b = scene.add_balls([[far + x, 1.0], [far + x + 1.0, 1.0]], radius=R, pinned=[True, False])
        scene.add_springs([b], stiffness=k)
    b = scene.add_balls([[far + 6.0 + 0.3 * k, 1.0] for k in range(6)], radius=R, pinned=[True, *[False] * 5])
    scene.add_springs(np.stack([b[:-1], b[1:]], axis=1), stiffness=1e3)
    scene.add_balls([[far + 9.0, 0.0]], radius=R, velocity=(0.02, 0.0))
    return scene


@pytest.mark.slow
@pytest.mark.skipif(F64, reason="single precision loses it")
@pytest.mark.parametrize("compensated", [True, False])
def test_single_precision_loses_what_is_said_at_a_kilometre(monkeypatch, compensated):
    monkeypatch.setattr("taichi_sim.simulation.assembly.compensates", lambda *_: compensated)
    end = {}
    for far in (0.0, 1000.0):
        scene = springs(far)
        with simulate(scene, dt=1e-3, contacts="off") as sim:
            end[far] = np.array([frame.position for frame in sim.frames(100, 1.0)]) - [far, 0.0]
            _, ulp, error = accuracy.rounding_error(scene, sim.setup)
            report = "\n".join(check.lines(sim))
    off = np.linalg.norm(end[1000.0] - end[0.0], axis=2)[:, :-1].max()
    assert 0.3 * error < off < 3.0 * error
    moved = end[1000.0][-1, -1, 0] - 9.0
    if compensated:
        assert moved == pytest.approx(0.02, rel=0.01)
    else:
        assert 0.5 * ulp / 1e-3 > 0.02
        assert f"balls slower than {0.5 * ulp / 1e-3:.2g} m/s stand still" in report
        assert moved == 0.0


def test_single_precision_far_from_the_origin_is_warned_of():
    scene = ts.Scene(dim=2, gravity=(0.0, -G))
    scene.add_balls([[1000.0, R]], radius=R)
    scene.add_wall((0, 1))
    for far, warned in ((1000.0, True), (10.0, False)):
        scene.set_balls(position=[[far, R]])
        setup = accuracy.Setup(VERLET, 1e-3, "f32", "gauss_seidel")
        assert accuracy.single_precision(scene, setup)[1] == warned


def test_a_place_nearer_to_the_origin_is_advised_only_where_it_helps():
    scene = ts.Scene(dim=2)
    scene.add_balls([[0.0, 0.0], [3.0, 7.0]], radius=1e-4)
    assert "nearer" not in accuracy.nearer(scene)
    scene.set_balls(position=[[0.0, 60.0], [3.0, 67.0]])
    assert "nearer to the origin" in accuracy.nearer(scene)


def test_fine_bending_is_reported_in_single_precision():
    """A stencil of 1, -2, 1 over pieces of L / n at 1 m: the rounding of its balls, sqrt(6 / 12) ulp, over L / n^2."""
    for n, reported in ((60, False), (400, True)):
        scene = ts.Scene(dim=2)
        ts.shapes.rope(scene, (0.5, 0.0), (1.25, 0.0), n + 1, EI=1.0)
        found = accuracy.bending_error(scene)
        assert found == pytest.approx(np.sqrt(0.5) * np.spacing(np.float32(1.25)) * n**2 / 0.75, rel=1e-6)
        for precision in ("f32", "f64"):
            setup = accuracy.Setup(VERLET, 1e-3, precision)
            subjects = [finding.subject for finding in accuracy.findings(scene, setup)]
            assert ("bending" in subjects) == (reported and precision == "f32")
