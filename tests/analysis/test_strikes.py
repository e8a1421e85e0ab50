"""Balls that strike nets, cloth and jelly: which methods answer that in which steps, and what is said where they do not."""

import warnings

import pytest
from physics_support import F64, simulate

import taichi_sim as ts
from taichi_sim.analysis.accuracy import Setup, impact_step
from taichi_sim.analysis.methods import IMPLICIT_EULER, TR_BDF2, VERLET, XPBD
from taichi_sim.analysis.outcome import of_energy
from taichi_sim.analysis.preflight import cautions
from taichi_sim.reports import check
from taichi_sim.simulation.settings import Settings


def struck_net(stiffness: float = 6e4, stone: float = 0.9, meshes: int = 5, **kinds) -> ts.Scene:
    """A net of 1.4 kg, pinned at its corners, and a stone that falls on it from .2 m; nothing bounces or rubs."""
    scene = ts.Scene(dim=3, gravity=(0.0, -9.81, 0.0))
    ts.shapes.net(
        scene, size=(0.7, 0.7), meshes=(meshes, meshes), pieces=2, position=(-0.35, 1.0, -0.35), pinned="corners", mass=1.4,
        stiffness=stiffness,
    )  # fmt: skip
    scene.add_balls([[0.02, 1.2, 0.03]], radius=0.09, mass=stone, **kinds)
    return scene


def impacts(scene: ts.Scene, method, h: float, rule: str = "gauss_seidel") -> list[str]:
    return [words for words in cautions(scene, Setup(method, h, "f64", rule)) if words.startswith("impacts: ")]


@pytest.mark.once
@pytest.mark.parametrize("method", [IMPLICIT_EULER, TR_BDF2, XPBD])
def test_steps_too_long_to_answer_impacts_are_warned_of_with_the_step_that_does(method):
    scene = struck_net()
    (words,) = impacts(scene, method, 1 / 150)
    assert words.endswith(", or verlet")
    step = float(words.split(" s, or verlet")[0].split()[-1])
    assert 1e-5 < step < 1e-3
    assert not impacts(scene, method, step)
    assert not impacts(scene, method, 1 / 150, rule="off")
    assert not impacts(scene, VERLET, 1 / 150)  # whose bound is warned of anyway


@pytest.mark.once
@pytest.mark.parametrize("bounce", [0.7, 0.95])
@pytest.mark.parametrize("method", [IMPLICIT_EULER, TR_BDF2])
def test_balls_that_strike_and_bounce_are_warned_of_once_with_one_step(method, bounce):
    """The shorter one, which `check` advises; within it nothing is said."""
    scene = struck_net(stiffness=2e4)
    scene.add_material("default", restitution=bounce)

    def said(h):
        words = cautions(scene, Setup(method, h, "f64", "gauss_seidel"))
        return [one for one in words if one.startswith(("impacts: ", "bounce: "))]

    (words,) = said(1 / 120)
    step = words.split("take steps of ")[1].split(" s")[0]
    assert f"restitution of {bounce:g}" in words
    assert said(float(step)) == []
    assert len(said(3.0 * float(step))) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with simulate(scene, integrator=method.name, dt=1 / 120) as sim:
            assert f"take steps of {step} s at most" in list(check.lines(sim))[-1]


@pytest.mark.once
def test_check_advises_the_step_that_it_warns_of():
    """Of the method in use, and of those that it compares; a step within it, and no contacts, are left to the user."""
    scene = struck_net()
    (words,) = impacts(scene, XPBD, 1 / 150)
    step = words.split("take steps of ")[1].split(" s, or verlet")[0]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with simulate(scene, integrator="xpbd", dt=1 / 150) as sim:
            advice = list(check.lines(sim))[-1]
        with simulate(scene, integrator="verlet") as sim:
            compared = [line for line in check.lines(sim) if "struck by balls" in line]
        with simulate(scene, integrator="implicit_euler", dt=1 / 150, contacts="off") as sim:
            free = list(check.lines(sim))[-1]
    assert advice.startswith(f"advice                take steps of {step} s at most, or verlet: ")
    assert len(compared) == 1
    assert f"xpbd, implicit_euler, tr_bdf2, struck by balls: steps of at most {step}, " in compared[0]
    assert "struck" not in free
    assert free.endswith("no spring limits the step; choose it by the accuracy you need")


@pytest.mark.once
def test_only_what_may_strike_a_body_is_warned_of():
    assert not impacts(struck_net(collides_with=[]), IMPLICIT_EULER, 1 / 150)
    alone = ts.Scene(dim=3)
    ts.shapes.net(alone, size=(0.7, 0.7), meshes=(5, 5), stiffness=6e4)
    assert not impacts(alone, IMPLICIT_EULER, 1 / 150)
    alone.add_collider(ts.Sphere((0.0, -0.5, 0.0), 0.3))  # stages hold what meets walls and colliders
    assert not impacts(alone, IMPLICIT_EULER, 1 / 150)
    chain = ts.Scene(dim=2)
    chain.add_balls([[0.3 * k, 0.0] for k in range(4)], radius=0.05)
    chain.add_springs([[k, k + 1] for k in range(3)], stiffness=6e4)
    assert not impacts(chain, IMPLICIT_EULER, 1 / 150)
    chain.add_balls([[0.3, 1.0]], radius=0.05, pinned=True)
    assert impacts(chain, IMPLICIT_EULER, 1 / 150)
    jelly = ts.Scene(dim=2)
    for x in (0.0, 2.0):
        ts.shapes.jelly(jelly, size=(0.4, 0.4), resolution=(3, 3), young_modulus=1e6, position=(x, 0.0))
    assert impacts(jelly, TR_BDF2, 1 / 150)


@pytest.mark.once
def test_auto_resolves_impacts_or_keeps_verlet():
    """Steps of 1/120 s let a stone through a net of knots of 10 g. Nor are steps longer than `check` advises."""
    found = Settings.resolve(struck_net(1e5, 0.5, meshes=9), {"integrator": "auto"})
    assert found.integrator.method.name == "verlet"
    assert ", the longest that answer impacts of balls on springs and elements, takes" in found.chosen
    scene = ts.Scene(dim=3, gravity=(0.0, -9.81, 0.0))  # a bar that nothing strikes, and two stones beside it
    ts.shapes.jelly(scene, size=(0.5, 0.2, 0.2), resolution=(11, 5, 5), young_modulus=2e10)
    scene.add_balls([[3.0, 1.0, 0.0], [3.0, 1.4, 0.0]], radius=0.05, collides_with=[])
    found = Settings.resolve(scene, {"integrator": "auto"})
    assert found.integrator.method.name == "implicit_euler"
    assert found.dt == impact_step(scene) < 1 / 120


@pytest.mark.slow
def test_energy_above_the_start_is_said_by_a_warning_and_in_the_summary():
    """Of a run whose energy at the end is below that of the start, by a spike between."""
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        with simulate(struck_net(), integrator="implicit_euler", dt=1 / 150, substeps=1) as sim:
            start = sim.energy().total
            totals = []
            for _ in range(75):
                sim.step()
                totals.append(sim.energy().total)
            said = of_energy(start, start - 0.1, sim.scales())
            sim.reset(struck_net(40.0))
            sim.run(0.4)
            assert of_energy(sim.energy().total, sim.energy().total, sim.scales()) == ""
    assert max(totals) > 1.5 * start
    (words,) = [str(w.message) for w in seen if "energy grew" in str(w.message)]
    assert "implicit_euler solves springs and elements before it knows of contacts between balls" in words
    assert words.endswith(" s, or verlet")
    rose = float(
        said.removeprefix("rose by up to ").split(" J above the least before, ")[0]
    )  # less what may be rounding
    assert rose == pytest.approx(max(totals) - start, rel=1e-3 if F64 else 0.03)
    assert " times the largest energy in motion that the start explains, " in said
    assert "wrong; implicit_euler solves springs" in said
