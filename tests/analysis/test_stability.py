"""The safe step: below the exact limit of every method, near it for the present shape, and no blow-up where it is kept."""

import warnings

import numpy as np
import pytest
from physics_support import F64, PRECISION, add_network, simulate, vector

import taichi_sim as ts
from taichi_sim.analysis.element_rates import Declared, Rates
from taichi_sim.analysis.methods import named
from taichi_sim.analysis.spring_bounds import largest_eigenvalue, present_eigenvalue
from taichi_sim.analysis.stability import stability, where_safe
from taichi_sim.reports import check

pytestmark = pytest.mark.long_in("f32")

EXPLICIT = ("symplectic_euler", "verlet", "rk4")


def matrices(scene, x):
    """M^-1/2 K M^-1/2 without the pressure of compressed springs, and the same of the damping, pinned balls left out."""
    n, dim = x.shape
    K, D = np.zeros((n, dim, n, dim)), np.zeros((n, dim, n, dim))
    for (i, j), k, c, rest in zip(scene.pairs, scene.stiffness, scene.damping, scene.rest_length):
        r = x[j] - x[i]
        d = np.linalg.norm(r)
        along = np.outer(r, r) / d**2
        for A, block in ((K, k * (along + max(0.0, 1 - rest / d) * (np.eye(dim) - along))), (D, c * along)):
            for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
                A[a, :, b, :] += sign * block
    scale = np.repeat(np.where(scene.pinned, 0.0, scene.mass**-0.5), dim)
    return [scale[:, None] * A.reshape(n * dim, n * dim) * scale[None] for A in (K, D)]


def network(dim, seed, n=24, damped=True, unit=1.0):
    """A random net, some of it pinned, masses over two decades; unit [s]: its time scale."""
    rng = np.random.default_rng(seed)
    scene = ts.Scene(dim=dim, gravity=vector(dim))
    add_network(scene, rng, n, damped, unit)
    return scene


@pytest.mark.parametrize("dim", [2, 3])
def test_bounds_are_below_the_exact_eigenvalue_and_the_present_one_is_the_closer(dim):
    closer = 0
    for seed in range(40):
        scene = network(dim, seed)
        K, D = matrices(scene, scene.position)
        zero = np.zeros(scene.n_springs)
        for exact, k, c in (
            (K, scene.stiffness, zero),
            (D, zero, scene.damping),
            (K + 30 * D, scene.stiffness, 30 * scene.damping),
        ):
            exact = np.linalg.eigvalsh(exact)[-1]
            present = present_eigenvalue(scene, k, c, scene.position)[0]
            any_shape = largest_eigenvalue(scene, k + c)[0]
            assert exact <= present * (1 + 1e-9)
            closer += present < any_shape
    assert closer > 100  # of 120; on few and unequal balls the simpler one can be the better


@pytest.mark.parametrize("side", [10, 20])
def test_present_bound_of_a_hanging_cloth(side):
    """Nine tenths of the exact step, masses over two decades."""
    scene = ts.Scene(dim=3, gravity=(0, -10, 0))
    sheet = ts.shapes.cloth(scene, size=(1, 1), resolution=(side, side), stiffness=1e3, damping=0.0)
    scene.set_balls(mass=scene.mass * 10.0 ** np.random.default_rng(side).uniform(-1, 1, scene.n_balls))
    scene.set_balls(sheet.balls[:side], pinned=True)
    exact = 2.0 / np.sqrt(np.linalg.eigvalsh(matrices(scene, scene.position)[0])[-1])
    found = stability(scene, named("verlet"), scene.position)
    assert 1.0 <= exact / found.dt_present < 1.25
    assert found.dt_any_shape <= found.dt_present
    assert stability(scene, named("verlet")).dt_present == found.dt_any_shape


def test_a_zero_length_spring_has_every_direction():
    scene = ts.Scene(dim=2)
    b = scene.add_balls([[0, 0], [0, 0]], radius=0.1, pinned=[0])
    scene.add_springs([b], stiffness=100.0, rest_length=0.0)
    assert stability(scene, named("verlet"), scene.position).dt_present == pytest.approx(0.2)


if F64:

    @pytest.mark.slow_where(dim=2)
    @pytest.mark.parametrize("dim", [2, 3])
    @pytest.mark.parametrize("method", EXPLICIT)
    @pytest.mark.parametrize("damped", [True, False], ids=["damped", "undamped"])
    def test_no_automatic_step_blows_up_f64(damped, method, dim):
        """A hundred networks, their time scales such that the bound is 1 ms, let go with springs stretched by up to 30 %."""
        scene = ts.Scene(dim=dim, gravity=vector(dim))
        owner = []
        for seed in range(100):
            alone = network(dim, seed, 12, damped)
            add_network(
                scene, np.random.default_rng(seed), 12, damped, 1e-3 / stability(alone, named(method)).dt_any_shape
            )
            owner += [seed] * (scene.n_balls - len(owner))
        assert stability(scene, named(method)).dt_any_shape == pytest.approx(1e-3, rel=1e-6)
        with simulate(scene, integrator=method, contacts="off") as sim:
            assert sim.dt == pytest.approx(4e-4 if not damped and method != "rk4" else 9e-4, rel=1e-6)
            start = energies(scene, sim.position, sim.velocity, owner)
            sim.run(2.7)
            assert np.all(energies(scene, sim.position, sim.velocity, owner) < (1.0 if damped else 8.0) * start)


def energies(scene, x, v, owner):
    """(100,) J: kinetic and spring energy of each network."""
    owner = np.asarray(owner)
    i, j = scene.pairs.T
    stretch = np.linalg.norm(x[j] - x[i], axis=1) - scene.rest_length
    kinetic = np.bincount(owner, 0.5 * scene.mass * np.sum(v**2, axis=1) * ~scene.pinned)
    return kinetic + np.bincount(owner[i], 0.5 * scene.stiffness * stretch**2, len(kinetic))


def checked(scene, **settings):
    """Lines that `check` prints for a scene without contacts."""
    with simulate(scene, contacts="off", **settings) as sim:
        return "\n".join(check.lines(sim))


def test_check_names_what_limits_and_what_to_do():
    scene = ts.Scene(dim=2, gravity=(0, -10))
    b = scene.add_balls([[0, 0], [1, 0], [2, 0]], radius=0.1)
    scene.add_springs([b[:2], b[1:]], stiffness=[100.0, 1e6])
    text = checked(scene, dt=1e-3)
    assert "limited by            spring 1, ball " in text
    assert "without spring 1      0.1414 s would be the safe step" in text
    assert "spring 1 alone makes the step 100 times shorter; is its stiffness, or its ball's mass, meant?" in text
    assert "no limit" not in text.partition("\n\n")[0]  # but in the table
    text = checked(scene, integrator="verlet")
    assert "is 0.4 of that, since a longer one lets large motion of undamped springs" in text
    rows = {row.split()[0]: row.split() for row in text.splitlines() if row.startswith(("verlet ", "rk4 "))}
    for passes, row in ((1, rows["verlet"]), (4, rows["rk4"])):  # counted by the steps taken, not by the safe ones
        assert float(row[-1]) == pytest.approx(passes / float(row[-3]), rel=0.01)
    assert float(rows["verlet"][-3]) == pytest.approx(0.4 * float(rows["verlet"][1]), rel=1e-3)
    twin = ts.Scene(dim=2)
    pairs = twin.add_balls([[0, 0], [1, 0], [0, 3], [1, 3]], radius=0.1).reshape(2, 2)
    twin.add_springs(pairs, stiffness=100.0)
    text = checked(twin, dt=1e-3)
    assert "without spring" not in text
    assert " Hz, is undamped, and this step adds no damping: good" in text
    text = checked(scene, integrator="implicit_euler")
    assert "any step" in text
    assert "advice                no spring limits the step; choose it by the accuracy you need" in text
    assert "gains energy on an undamped spring" in checked(scene, integrator="explicit_euler", dt=1e-3)


def test_the_strongest_spring_of_the_busiest_ball_limits_and_not_a_weak_one_beside_it():
    """A weak spring joins the two balls that hold most."""
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 0], [1, 0], [0, 1], [1, 1], [0, 2], [1, 2]], radius=0.1)
    scene.add_springs([[0, 1], [0, 2], [1, 3], [0, 4], [1, 5]], stiffness=[1e-3, 40.0, 50.0, 45.0, 30.0])
    value, spring = largest_eigenvalue(scene, scene.stiffness)
    assert spring == 3  # of ball 0
    assert value == pytest.approx(85.001 / scene.mass[0] + 80.001 / scene.mass[1])


def test_check_names_the_method_that_auto_would_take():
    scene = ts.Scene(dim=3, gravity=(0, -9.0, 0))
    ts.shapes.net(scene, size=(0.9, 0.8), meshes=(11, 12), stiffness=6e5, pinned="corners")
    named = 'integrator = "auto" would take implicit_euler: implicit_euler by steps of 0.0083 s takes an estimated 0.'
    for more, there in (({}, True), ({"integrator": "implicit_euler"}, False), ({"integrator": "auto"}, False)):
        with simulate(scene, contacts="off", **more) as sim:
            lines = list(check.lines(sim))
        assert any(line.startswith(named) for line in lines) is there
        for_pictures = lines[-1].endswith(
            "this step is for pictures; for a number with a known error run `taichi-sim tune`"
        )
        assert for_pictures is (more == {"integrator": "auto"})


def test_check_of_scenes_without_springs_or_motion():
    scene = ts.Scene(dim=2, gravity=(0, -10))
    b = scene.add_balls([[0, 0], [1, 0]], radius=0.1)
    with simulate(scene) as sim:
        assert "no spring moves a ball: every step is stable" in "\n".join(check.lines(sim))
    scene.add_springs([b], stiffness=100.0)
    scene.set_balls(pinned=True)
    with simulate(scene) as sim:
        assert "no spring moves a ball: every step is stable" in "\n".join(check.lines(sim))


def test_an_implicit_method_names_itself_where_no_spring_moves_a_ball():
    scene = ts.Scene(dim=2)
    scene.add_solids([scene.add_balls([[0, 0], [1, 0], [0, 1]], radius=0.1)], young_modulus=1e3, poisson_ratio=0.3)
    for name in ("implicit_euler", "tr_bdf2"):
        with simulate(scene, integrator=name) as sim:
            assert f"{name} is stable at any step" in sim.stability().reason


def test_check_of_scenes_whose_cells_limit_the_step():
    """That of methods that do not solve for them; others have none, and without springs xpbd makes none too soft."""
    scene = ts.Scene(dim=2)
    b = scene.add_balls([[0, 0], [1, 0], [0, 1]], radius=0.1)
    scene.add_cells([b], bulk_modulus=1e6)
    text = checked(scene)
    assert "without spring" not in text
    assert "any step is stable, but the error grows with it\n" in text
    scene.add_springs([b[:2], b[1:]], stiffness=100.0, damping=1.0)
    text = checked(scene, integrator="xpbd")
    assert "None" not in text
    assert "xpbd is stable at any step" in text
    assert "explicitly" not in text


def test_damping_of_bending_alone_limits_the_step():
    scene = ts.Scene(dim=3)
    scene.add_balls([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], radius=0.1, mass=1e-3)
    scene.add_bending([[0, 1, 2, 3]], weights=[1, -1, -1, 1], stiffness=0.0, damping=10.0)
    for method in ("verlet", "rk4"):
        assert stability(scene, named(method)).dt_any_shape < 1e-3
    for method in ("implicit_euler", "tr_bdf2", "xpbd"):  # which solve for it
        assert stability(scene, named(method)).dt_any_shape == np.inf


@pytest.mark.long
def test_another_step_gives_the_bits_of_a_simulation_made_with_it():
    """What depends on the step (damping, the slowest bounce, soft contacts) is set anew. Nothing touches in the first steps:
    what contacts hold may outlast `resume`."""
    scene = ts.Scene(dim=2, gravity=(0, -10))
    scene.add_material("wood", restitution=0.5)
    scene.add_wall((0, 1), 0.0, "wood")
    b = scene.add_balls([[0, 0.12], [1, 0.12], [0, 0.33], [1, 0.34]], radius=0.1, material="wood")
    scene.add_springs([b[:2]], stiffness=100.0, damping=5.0, rest_length=0.9)
    with (
        simulate(scene, integrator="verlet", dt=1e-3, substeps=1) as sim,
        simulate(scene, integrator="verlet", dt=1e-2, substeps=1) as made,
    ):
        sim.step(7)
        compiled = sim.kernels()
        sim.set_dt(1e-2)
        assert (sim.dt, sim.time) == (1e-2, pytest.approx(7e-3))
        sim.step(1)
        assert sim.time == pytest.approx(1.7e-2)
        sim.resume(ts.Snapshot(scene.position, scene.velocity))
        made.resume(ts.Snapshot(scene.position, scene.velocity))
        for one in (sim, made):
            one.step(40)
        assert sim.contacts().number > 0
        assert np.array_equal(sim.position, made.position)
        assert np.array_equal(sim.velocity, made.velocity)
        assert sim.kernels() == compiled
        with pytest.raises(ValueError, match="dt: -1"):
            sim.set_dt(-1)
        assert sim.dt == 1e-2


def load_on_a_chain(load: float) -> ts.Scene:
    """Balls of 8 g on springs of 4e4 N/m below a pin, the last of another mass."""
    scene = ts.Scene(dim=2, gravity=(0.0, -9.81))
    b = scene.add_balls([[0.06 * k, 0.0] for k in range(9)], radius=0.01, mass=[0.008] * 8 + [load], pinned=[0])
    scene.add_springs(np.stack([b[:-1], b[1:]], axis=1), stiffness=4e4)
    return scene


def test_xpbd_tells_the_stiffness_that_its_springs_act_with():
    """One of the springs of a damped chain at rest is as soft; where steps are short, nothing is told."""
    scene = ts.Scene(dim=3, gravity=(0.0, -9.81, 0.0))
    b = scene.add_balls([[0.0, -0.5 * k, 0.0] for k in range(6)], radius=0.01, mass=0.3, pinned=[0])
    scene.add_springs(np.stack([b[:-1], b[1:]], axis=1), stiffness=2e3, damping=6.0)
    settings = {"arch": "cpu", "precision": PRECISION, "integrator": "xpbd", "contacts": "off"}
    with ts.Simulation(scene, dt=0.02, substeps=1, **settings) as sim:
        words = next(line for line in check.lines(sim) if line.startswith("softened")).split()
        sim.run(8.0)
        stretch = -np.diff(sim.position[:, 1]) - 0.5
    softest = np.min(0.3 * 9.81 * np.arange(5, 0, -1) / stretch)  # 613 N/m
    assert softest / 1.4 < float(words[words.index("about") + 1]) < softest < 0.5 * 2e3
    with ts.Simulation(scene, dt=1e-3, substeps=1, **settings) as sim:
        assert not any(line.startswith("softened") for line in check.lines(sim))


def test_xpbd_names_the_step_above_which_a_load_makes_springs_too_long():
    """All that is said names one step, which is a cure: there the warning is gone."""
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        with ts.Simulation(
            load_on_a_chain(0.7), arch="cpu", precision=PRECISION, integrator="xpbd", dt=1e-3, contacts="off"
        ) as sim:
            text = "\n".join(check.lines(sim))
            cure = next(str(w.message) for w in seen if "xpbd: spring" in str(w.message)).split()[-2]
            seen.clear()
            sim.set_dt(float(cure))
            assert not [w for w in seen if "xpbd: spring" in str(w.message)]
    assert float(cure) < 1e-3
    for words in (
        f"no limit, however the scene deforms; above {cure} s springs come out too long",
        f"xpbd stays bounded at any step, but in steps above {cure} s its two passes leave springs too long",
        f"advice                take steps of {cure} s at most",
    ):
        assert words in text
    assert "is stable at any step" not in text
    with simulate(load_on_a_chain(0.008), integrator="verlet", contacts="off") as sim:
        assert "makes them too soft in steps above" in "\n".join(check.lines(sim))  # of all that hangs at the pin


def test_what_is_not_linear_is_not_said_to_be_safe_in_any_shape():
    scene = ts.Scene(dim=3)
    scene.add_balls([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]], radius=0.1)
    scene.add_springs([[0, 1]], stiffness=10.0)
    verlet, any_shape = named("verlet"), "however the scene deforms"
    scene.add_bending([[0, 1, 2, 3]], weights=[[1.0, 1.0, -1.0, -1.0]], stiffness=2.0)
    assert where_safe(scene, verlet, Declared()) == any_shape
    scene.add_cells([[0, 1, 2, 3]], bulk_modulus=50.0)
    stay = "however springs deform, with cells about as now"
    assert where_safe(scene, verlet, Declared()) == stay
    assert where_safe(scene, named("tr_bdf2"), Declared()) == any_shape
    own = Declared(Rates(3.0, 0.0))
    assert where_safe(scene, verlet, own) == stay.replace("cells", "cells and user-defined forces")
    with simulate(scene, integrator="verlet", contacts="off") as sim:
        assert f"s, {stay}" in "\n".join(check.lines(sim))
