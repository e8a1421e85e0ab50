"""The method that `auto` takes, by the scene and by what is asked; nothing is compiled."""

import numpy as np
import pytest
import taichi as ti

import taichi_sim as ts
from taichi_sim.simulation.settings import Settings

pytestmark = pytest.mark.once


def sheet(balls: int, **material) -> ts.Scene:
    scene = ts.Scene(dim=3)
    ts.shapes.cloth(scene, size=(0.8, 0.8), resolution=(balls, balls), pinned=[0], **material)
    return scene


def pendulum(stiffness: float) -> ts.Scene:
    scene = ts.Scene(dim=2)
    scene.add_balls([[0.0, 0.0], [0.7, 0.0]], radius=0.05, pinned=[0])
    scene.add_springs([[0, 1]], stiffness=stiffness)
    return scene


def resolved(scene: ts.Scene, **given) -> Settings:
    return Settings.resolve(scene, {"integrator": "auto", **given})


def test_small_scenes_and_loose_balls_keep_verlet() -> None:
    loose = ts.Scene(dim=3)
    loose.add_balls(np.eye(3), radius=0.1)
    for scene, why in (
        (loose, "nothing that is stiff limits its step"),
        (pendulum(3e4), "its own short steps are too little work to save any of it"),
    ):
        found = resolved(scene)
        assert found.integrator.method.name == "verlet"
        assert found.dt == "auto"
        assert why in found.chosen


def test_a_large_silk_cloth_takes_an_implicit_method_with_a_part_of_a_frame() -> None:
    found = resolved(sheet(160, material="silk"))
    assert found.integrator.method.name == "implicit_euler"
    assert found.dt == pytest.approx(1 / 120)
    assert found.chosen.startswith("implicit_euler by auto: implicit_euler by steps of 0.0083 s takes an estimated 0.")
    assert found.chosen.endswith(" of the work of verlet")
    assert found.time_step(sheet(8, material="silk"), None)[1] == 1


def test_more_stiffness_turns_the_choice_but_a_second_order_is_worth_more_passes() -> None:
    """Of a block of a soft material and of steel; where a tolerance is given, short steps are needed anyway."""
    scene = ts.Scene(dim=3)
    for modulus, method in ((2e4, "verlet"), (2e10, "implicit_euler")):
        scene = ts.Scene(dim=3)
        ts.shapes.jelly(scene, size=(0.5, 0.2, 0.2), resolution=(11, 5, 5), young_modulus=modulus)
        assert resolved(scene).integrator.method.name == method
    assert resolved(scene, tolerance=1e-3).integrator.method.name == "tr_bdf2"
    assert resolved(scene, tolerance=1e-3).dt == "auto"
    assert resolved(sheet(96, material="silk"), tolerance=1e-3).integrator.method.name == "verlet"


def test_levels_make_stiff_cloth_and_bars_cheaper_than_short_steps() -> None:
    """Measured of 64^2 balls of polyester and a bar of ratio 0.49: 1.3 and 2.0 s by Verlet, 0.7 and 0.8 s by implicit Euler."""
    bar = ts.Scene(dim=3)
    ts.shapes.jelly(
        bar, size=(0.7, 0.2, 0.1), resolution=(22, 7, 4), density=1200, young_modulus=9e6, poisson_ratio=0.49
    )
    for scene in (sheet(72, material="polyester", warp_angle=0.0), bar):
        assert resolved(scene).integrator.method.name == "implicit_euler"


def test_what_may_tear_keeps_verlet() -> None:
    """Of sheets that would else take an implicit method."""
    for material in ({"material": "silk"}, {"material": "polyester", "warp_angle": 0.0}):
        found = resolved(sheet(120, break_strain=0.2, **material))
        assert (found.integrator.method.name, found.dt) == ("verlet", "auto")
        assert "long steps do not resolve the pulls that tear springs" in found.chosen
        assert resolved(sheet(120, **material)).integrator.method.name == "implicit_euler"


def test_contacts_ask_for_more_of_a_gain() -> None:
    """Silk that folds over a sphere took .8 to 2.4 times the time of Verlet by implicit Euler, 20^2 to 96^2 balls, though it
    hangs for a fifth to a half; a sheet of steel is stiff enough; blocks that may touch something need a gain of two."""
    block = ts.Scene(dim=3)
    ts.shapes.jelly(block, size=(0.5, 0.3, 0.3), resolution=(11, 7, 7), young_modulus=6e7)
    steel = {"young_modulus": 2e11, "poisson_ratio": 0.3, "thickness": 5e-4, "mass_per_area": 3.9}
    for scene, method in (
        (sheet(28, material="silk"), "verlet"),
        (sheet(20, **steel), "implicit_euler"),
        (block, "verlet"),
    ):
        assert resolved(scene).integrator.method.name == "implicit_euler"
        scene.add_collider(ts.Sphere((0.0, -0.5, 0.0), 0.3))
        found = resolved(scene)
        assert found.integrator.method.name == method
        assert resolved(scene, contacts="off").integrator.method.name == "implicit_euler"
    assert found.chosen.endswith("of the work of verlet; auto wants less than 0.5 where contacts may cost more")


def test_a_step_that_is_given_decides() -> None:
    scene = pendulum(1e6)  # its bound is 2 ms
    for dt, substeps, method in ((1e-3, "auto", "verlet"), (0.01, "auto", "implicit_euler"), (0.01, 8, "verlet")):
        found = resolved(scene, dt=dt, substeps=substeps)
        assert (found.integrator.method.name, found.dt) == (method, dt)
    assert "beyond the bound of verlet, 0.002 s" in resolved(scene, dt=0.01).chosen


def test_an_unknown_force_keeps_verlet() -> None:
    @ti.data_oriented
    class Push:
        def accumulate(self, model, ball, impulse, h, time):
            """Nothing."""

    found = Settings.resolve(sheet(160, material="silk"), {"integrator": "auto"}, [Push()])
    assert found.integrator.method.name == "verlet"
    assert "does not declare how stiff it is" in found.chosen


def test_a_method_that_is_named_is_taken() -> None:
    found = Settings.resolve(sheet(160, material="silk"), {})
    assert (found.integrator.method.name, found.chosen) == ("verlet", "")
