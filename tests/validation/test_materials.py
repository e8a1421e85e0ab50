"""Cloth and jelly of a material in Simulation: at rest where Newton's method finds them, and back from being squeezed flat."""

import numpy as np
import pytest
from physics_support import simulate
from statics import at_rest

from taichi_sim import Box, Scene, shapes
from taichi_sim.analysis.diagnostics import inverted
from taichi_sim.geometry.spheres import icosphere
from taichi_sim.outputs.export import export
from taichi_sim.scene.bricks import corner_volumes
from taichi_sim.scene.cells import cell_volumes
from tests.support.drag import Drag

pytestmark = pytest.mark.long_in("f32")


def bar_and_strip():
    """A bar of jelly whose cells keep its volume, and a strip of cloth that bends, both held at one end."""
    scene = Scene(dim=3, gravity=(0, -10, 0))
    shapes.jelly(
        scene,
        (2.0, 0.4, 0.4),
        (11, 3, 3),
        young_modulus=2e5,
        poisson_ratio=0.4,
        density=100.0,
        pinned=list(range(9)),
    )
    shapes.cloth(
        scene,
        (0.6, 0.2),
        (10, 4),
        stretch_stiffness=100.0,
        bending_rigidity=1e-2,
        mass_per_area=0.1,
        position=(0, 2, 0),
        pinned=list(range(8)),
    )
    return scene


@pytest.mark.slow
def test_bar_and_strip_come_to_rest_where_newton_finds_them(precision):
    scene = bar_and_strip()
    want, _ = at_rest(scene, most=1e-8)
    with simulate(scene, integrator="verlet", dt=1e-3, contacts="off", forces=[Drag(6.0)]) as sim:
        sim.run(12.0)
        off = np.linalg.norm(sim.position - want, axis=1)
    for part in (scene.body == 1, scene.body == 2):
        sag = np.linalg.norm(want - scene.position, axis=1)[part].max()
        assert sag > 0.02
        assert off[part].max() < (1e-6 if precision == "f64" else 2e-3) * sag


@pytest.mark.slow
def test_a_jelly_that_falls_on_its_edge_is_not_crushed():
    """At Poisson's ratio 1/4; springs alone would end at 0.52 of its volume, with 96 of 432 tetrahedra inside out."""
    scene = Scene(dim=3, gravity=(0, -10, 0))
    scene.add_wall((0, 1, 0))
    made = {"young_modulus": 1.5e4, "density": 1000.0, "rotation": (0, 15, 35), "position": (0, 0.6, 0)}
    shapes.jelly(scene, (0.25, 0.25, 0.25), (7, 7, 7), **made)
    with simulate(scene, integrator="verlet", dt=1e-3) as sim:
        summary = export(sim, None, fps=100, duration=2.2)
        assert sim.inverted() == 0
        volume = corner_volumes(sim.position, scene.bricks).mean(axis=1).sum() / scene.brick_size.prod(axis=1).sum()
    assert volume == pytest.approx(1.0, abs=0.1)
    assert summary.inverted[0] == 0


@pytest.mark.slow
def test_a_letter_that_falls_keeps_its_volume():
    """It lands on an edge; tetrahedra that turned inside out there have all come back."""
    pytest.importorskip("shapely")
    scene = Scene(dim=3, gravity=(0, -10, 0))
    scene.add_wall((0, 1, 0))
    made = {"density": 1000.0, "young_modulus": 2e4, "poisson_ratio": 0.49}
    shapes.text(scene, "R", 0.4, spacing=0.07, depth=0.14, position=(0, 0.2, 0), rotation=(0, 0, 25), **made)
    volumes = []
    with simulate(scene, integrator="verlet", dt="auto") as sim:
        for _ in range(60):
            sim.run(0.05)
            volumes.append(cell_volumes(sim.position, scene.solids).sum())
        assert sim.inverted() == 0
    assert min(volumes) > 0.97 * cell_volumes(scene.position, scene.solids).sum()


@pytest.mark.slow
def test_a_filled_ball_comes_back_from_being_squeezed_flat():
    """A piston presses it to a hundredth of its height, so that bricks turn inside out, and leaves: when most of what it
    did is damped away none is."""
    scene = Scene(dim=3)
    scene.add_wall((0, 1, 0))
    shapes.jelly(scene, mesh=icosphere(2), spacing=0.4, young_modulus=1e5, position=(0, 1.15, 0), radius=0.02)
    path = [(0.0, (0, 0, 0)), (0.2, (0, -2.1, 0)), (0.25, (0, -2.1, 0)), (0.35, (0, 0.8, 0)), (9.0, (0, 0.8, 0))]
    scene.add_collider(Box((0, 3.2, 0), (6, 2, 6), path=path))
    with simulate(scene, integrator="verlet", dt=1e-3) as sim:
        sim.run(0.24)
        assert np.ptp(sim.position[:, 1]) < 0.15
        assert inverted(scene, sim.position) > 0
        sim.run(5.76)  # rounding alone decides whether the last one turns back after 2 or after 4 s
        assert inverted(scene, sim.position) == 0
        assert np.ptp(sim.position, axis=0) == pytest.approx(np.ptp(scene.position, axis=0), rel=0.3)
