"""What `check` and the summary of a run say of errors, against runs that make them."""

import tracemalloc
import warnings

import numpy as np
import pytest
from physics_support import PRECISION, box_mesh, simulate

import taichi_sim as ts
from taichi_sim.analysis import accuracy, contact_loads, rebounds, sieves
from taichi_sim.analysis.methods import IMPLICIT_EULER, VERLET, XPBD
from taichi_sim.analysis.outcome import Scales, of_approach, of_cells, of_depth, of_energy, takers, untouched
from taichi_sim.geometry.spheres import icosphere
from taichi_sim.outputs import export
from taichi_sim.reports import check

pytestmark = pytest.mark.long_in("f32")

G, R = 10.0, 0.05
LONG = pytest.mark.long


def said(sim, subject):
    """What `check` says of a subject: figures in words, and the cure."""
    found = [f for f in accuracy.findings(sim.scene, sim.setup) if f.subject == subject]
    assert len(found) <= 1
    return found[0] if found else None


def figure(text, before):
    """The number in front of a word."""
    words = text[: text.index(before)].replace(";", " ").replace(",", " ").split()
    return float(words[-1])


# Rotation ---------------------------------------------------------------------------------------------------------------


def turning_pair(h, speed, pinned=()):
    """A dumb-bell of unequal masses, its heavier ball pinned or not, too stiff for steps of h seconds to resolve."""
    scene = ts.Scene(dim=2, gravity=(0, 0))
    b = scene.add_balls(
        [[0, 0], [0, 0.3]], radius=0.01, mass=[3.0, 1.0], velocity=[[0, 0], [-0.3 * speed, 0]], pinned=pinned
    )
    scene.add_springs([b], stiffness=1e3 / h**2)
    return scene


@pytest.mark.parametrize("method", ["xpbd", pytest.param("implicit_euler", marks=pytest.mark.slow)])
def test_bodies_that_turn_lose_as_much_angular_momentum_as_said(method):
    h, speed, end = 2e-3, 25.0, 0.6
    for pinned in ((), [0]):
        scene = turning_pair(h, speed, pinned)
        with warnings.catch_warnings(record=True) as seen:
            warnings.simplefilter("always")
            sim = ts.Simulation(scene, arch="cpu", precision=PRECISION, integrator=method, dt=h, contacts="off")
        with sim:
            assert any("rotation: " in str(w.message) for w in seen)  # 1.25 a second
            start = float(sim.angular_momentum()) if pinned else scene.mass.prod() / scene.mass.sum() * 0.09 * speed
            told = said(sim, "rotation")
            assert "take tr_bdf2" in told.cure
            assert figure(told.what, "of the angular momentum a second") == pytest.approx(
                h * speed**2, rel=0.05
            )  # two digits
            left = figure(said(sim, "rotation").what, " is left after 1 s")
            summary = export(sim, None, fps=20, duration=end)
            assert any(line.startswith("rotation ") for line in summary.lines())
            x, v, m = sim.position, sim.velocity, scene.mass * ~scene.pinned
            centre = np.zeros(2) if pinned else m @ x / m.sum()
            r, u = x - centre, v - (0 if pinned else m @ v / m.sum())
            end_momentum = float(m @ (r[:, 0] * u[:, 1] - r[:, 1] * u[:, 0]))
            kept = abs(end_momentum / start)
            assert kept == pytest.approx((1 + 2 * h * speed**2 * sim.time) ** -0.5, rel=0.05)
            assert left == pytest.approx((1 + 2 * h * speed**2) ** -0.5, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("pinned", [(), [0]])
def test_tr_bdf2_takes_as_much_angular_momentum_as_said(pinned):
    h, speed, steps = 2e-3, 275.0, 150
    scene = turning_pair(h, speed, pinned)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="rotation: ")
        sim = ts.Simulation(scene, arch="cpu", precision=PRECISION, integrator="tr_bdf2", dt=h, contacts="off")
    with sim:
        told = said(sim, "rotation")
        if pinned:
            assert told.cure == "take verlet, which keeps it, or shorter steps"
            assert figure(told.what, "of the angular momentum a second") == pytest.approx(
                h**3 * speed**4 / 40, rel=0.05
            )
        else:
            assert told is None
        sim.step(steps)
        mass = scene.mass * ~scene.pinned
        centre, mean = np.zeros((2, 2)) if pinned else (mass @ a / mass.sum() for a in (sim.position, sim.velocity))
        r, u = sim.position - centre, sim.velocity - mean
        kept = abs(mass @ (r[:, 0] * u[:, 1] - r[:, 1] * u[:, 0])) / ((1.0 if pinned else 0.75) * 0.09 * speed)
        lost = steps * (h * speed) ** 4 / 10 if pinned else 0.0
        assert kept == pytest.approx((1 + lost) ** -0.25, rel=0.02 if pinned else 1e-5)


# Loads at contacts ------------------------------------------------------------------------------------------------------


def column_at_rest(n, stiffness, damping, gravity=G, pinned=()):
    """A column of balls of 1 kg on a floor, joined by springs that bear the weight above them; they do not meet each other."""
    scene = ts.Scene(dim=2, gravity=(0.0, -gravity))
    balls = scene.add_balls([[0.0, 0.02 + 0.1 * i] for i in range(n)], radius=0.02, mass=1.0, pinned=pinned, body=1)
    pairs = np.stack([balls[:-1], balls[1:]], axis=1)
    shortened = G * np.arange(n - 1, 0, -1) / stiffness
    scene.add_springs(pairs, stiffness=stiffness, damping=damping, rest_length=0.1 + shortened)
    scene.add_wall((0.0, 1.0))
    return scene


def load_of_lowest_spring(scene, sim):
    """Load [N] of the first spring."""
    return scene.stiffness[0] * (scene.rest_length[0] - np.diff(sim.position[:2, 1])[0])


@pytest.mark.parametrize(
    ("method", "n", "stiffness", "damping", "h", "within"),
    [
        ("xpbd", 10, 1e5, 20.0, 2e-3, 0.1),
        pytest.param("verlet", 6, 1e5, 600.0, 1e-3, 0.1, marks=pytest.mark.slow),
    ],
)
def test_springs_at_a_contact_bear_as_much_too_much_as_said(method, n, stiffness, damping, h, within):
    scene = column_at_rest(n, stiffness, damping)
    sim = simulate(scene, integrator=method, dt=h)
    told = said(sim, "load at contacts")
    assert told.cure.startswith("take verlet, which knows of contacts, or substeps of") == (method != "verlet")
    assert "substeps of" in told.cure
    summary = export(sim, None, fps=1, duration=3.0)
    assert any(line.startswith("load ") for line in summary.lines())
    excess = (load_of_lowest_spring(scene, sim) - G * (n - 1)) / (G * n)
    assert figure(told.what, "of its weight too much") == pytest.approx(excess, rel=within)
    step = figure(told.cure + ";", "s;")
    shorter = contact_loads.at_contacts(scene, sim.settings.integrator.method, step)
    if method == "verlet":
        assert shorter is None  # damping takes one stage there
    else:
        assert shorter.share(sim.settings.integrator.method, step) == pytest.approx(contact_loads.SHOWS, rel=0.1)


@pytest.mark.parametrize(("h", "within"), [(1 / 60, 0.1), (2e-3, 1e-6 if PRECISION == "f64" else 0.05)])
@pytest.mark.parametrize("method", ["implicit_euler", pytest.param("tr_bdf2", marks=pytest.mark.slow)])
def test_springs_on_a_floor_bear_the_weight_above_them(method, h, within):
    n = 7  # at 1/60 s the tolerance of the solution shows; a fall within the stage would add 84 times the weight
    scene = column_at_rest(n, 3e5, 40.0)
    with simulate(scene, integrator=method, dt=h, substeps=1) as sim:
        assert said(sim, "load at contacts") is None
        sim.run(2.0)  # after which its slowest swing is small enough
        assert load_of_lowest_spring(scene, sim) == pytest.approx(G * (n - 1), rel=within)


@pytest.mark.slow
def test_bodies_under_others_bear_as_much_too_much_as_said():
    """Two columns, one on the other: the springs on both sides of their contact, and a warning before a run."""
    n, stiffness, damping, h = 4, 6e4, 30.0, 1 / 300
    scene = ts.Scene(dim=2, gravity=(0.0, -G))
    balls = scene.add_balls([[0.0, 0.02 + 0.1 * i - 0.06 * (i >= n)] for i in range(2 * n)], radius=0.02, mass=1.0)
    pairs = np.array([[i, i + 1] for i in range(2 * n - 1) if i != n - 1])
    above = 2 * n - pairs[:, 1]
    scene.add_springs(balls[pairs], stiffness=stiffness, damping=damping, rest_length=0.1 + G * above / stiffness)
    scene.add_wall((0.0, 1.0))
    with pytest.warns(
        UserWarning, match="^load: .* its lowest balls bears .* next to the highest balls of the body of ball 3 "
    ):
        sim = ts.Simulation(scene, arch="cpu", precision=PRECISION, integrator="implicit_euler", dt=h, substeps=1)
    with sim:
        told = said(sim, "load at contacts").what
        sim.run(4.0)
        y = sim.position[:, 1]
        excess = stiffness * (scene.rest_length - np.diff(y)[pairs[:, 0]]) - G * above
    assert figure(told, "of its weight too much") == pytest.approx(excess[n - 1] / (G * n), rel=0.1)
    assert figure(told, "of what it bears") == pytest.approx(excess[n - 2] / (G * n), rel=0.1)


def test_bodies_that_rest_on_nothing_bear_nothing_too_much():
    scene = column_at_rest(5, 1e5, 20.0)
    told = contact_loads.at_contacts(scene, XPBD, 4e-3)
    assert told.share(XPBD, 4e-3) == pytest.approx(1.68)
    assert told.ball == 0
    assert contact_loads.at_contacts(scene, VERLET, 4e-3) is None
    assert contact_loads.at_contacts(scene, IMPLICIT_EULER, 4e-3) is None
    scene.add_balls([[0.0, -0.02], [0.1, -0.02]], radius=0.02, pinned=True)
    assert contact_loads.at_contacts(scene, IMPLICIT_EULER, 4e-3).ball == 0
    assert contact_loads.at_contacts(column_at_rest(5, 1e5, 20.0, pinned=[4]), XPBD, 4e-3) is None
    assert contact_loads.at_contacts(column_at_rest(5, 1e5, 20.0, gravity=0.0), XPBD, 4e-3) is None


def test_bodies_beside_others_do_not_rest_on_them():
    scene = column_at_rest(5, 1e5, 20.0)
    scene.add_balls([[0.05, -0.02], [-0.05, -0.3]], radius=0.02, pinned=True)
    assert contact_loads.at_contacts(scene, IMPLICIT_EULER, 4e-3) is None


@pytest.mark.parametrize("slope", [0.0, 0.4])
def test_what_elements_bear_too_much_does_not_depend_on_how_a_scene_lies(slope):
    h, young, size, n, density = 2e-3, 1e5, 0.3, 4, 500.0
    along, up = np.array([np.cos(slope), -np.sin(slope)]), np.array([np.sin(slope), np.cos(slope)])
    scene = ts.Scene(dim=2, gravity=tuple(-G * up))
    ts.shapes.jelly(
        scene,
        size=(size, size),
        resolution=(n, n),
        position=tuple(0.2 * up),
        rotation=-np.degrees(slope),
        young_modulus=young,
        poisson_ratio=0.0,
        density=density,
        damping=0.0,
    )
    scene.add_balls([tuple(0.1 * along - 0.1 * up)], radius=0.1, pinned=True)
    side = size / (n - 1)
    wanted = h**2 * young / side * size / (0.5 * density * side * size)  # half a row of bricks is the layer's
    told = contact_loads.at_contacts(scene, IMPLICIT_EULER, h)
    assert told.share(IMPLICIT_EULER, h) == pytest.approx(wanted, rel=1e-6)


# Bounces ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("e", [0.5, 0.9])
def test_bounces_end_as_low_and_as_early_as_said(e):
    h, high = 6e-3, 0.5
    scene = ts.Scene(dim=2, gravity=(0.0, -G))
    scene.add_material("rubber", restitution=e)
    scene.add_balls([[0.0, R + high]], radius=R, material="rubber")
    scene.add_wall((0, 1))
    with simulate(scene, dt=h, substeps=1) as sim:
        low, early = (figure(said(sim, "bounces").what, word) for word in (" m, ", " s early"))
        assert "take substeps" in said(sim, "bounces").cure
        end = np.sqrt(2.0 * high / G) * (1.0 + e) / (1.0 - e)
        y = []
        while sim.time < end:
            sim.step()
            y.append(sim.position[0, 1] - R)
    y = np.array(y)
    tops = y[1:-1][(y[1:-1] >= y[:-2]) & (y[1:-1] > y[2:]) & (y[1:-1] > 1e-6)]
    assert 0.9 * e**2 * low < tops[-1] < 1.1 * low
    still = h * (2 + np.flatnonzero(np.abs(np.diff(y)) > 1e-7)[-1])
    assert 0.4 * early < end - still < early + h


@pytest.mark.slow
def test_bounces_off_a_pinned_ball_are_as_high_as_said():
    """Forty heights, so that balls are met at any part of a step."""
    h, es = 4e-3, (0.4, 0.8, 1.0)
    high = np.linspace(0.4, 0.6, 40)
    scene = ts.Scene(dim=2, gravity=(0.0, -G))
    for k, e in enumerate(es):
        scene.add_material(f"m{k}", restitution=e)
        at = np.arange(40.0)[:, None] * [1.0, 0.0] + [100.0 * k, 0.0]
        scene.add_balls(at - [0.0, R], radius=R, pinned=True, material=f"m{k}")
        scene.add_balls(at + np.stack([0.0 * high, R + high], axis=1), radius=R, material=f"m{k}")
    with simulate(scene, dt=h, substeps=1, contacts="jacobi") as sim:
        y = []
        for _ in range(round(0.75 / h)):
            sim.step()
            y.append(sim.position[~scene.pinned, 1] - R)
    y = np.array(y).reshape(-1, 3, 40)
    hit = round(0.36 / h)  # all have bounced once
    higher = y[hit:].max(axis=0) / (high * np.array(es)[:, None] ** 2) - 1.0
    assert abs(np.mean(higher[2])) < 1e-3
    for k in range(2):
        alone = ts.Scene(dim=2, gravity=(0.0, -G))
        alone.add_material("m", restitution=es[k])
        alone.add_balls([[0, -R], [0, R + 0.5]], radius=R, pinned=[True, False], material="m")
        words = next(accuracy.findings(alone, accuracy.Setup(VERLET, h, "f64", "jacobi"))).what
        assert "too low" in words
        assert np.mean(higher[k]) == pytest.approx(-figure(words, " of its height"), rel=0.25)
        by_turns = accuracy.Setup(VERLET, h, "f64", "gauss_seidel", at_touch=True)
        assert "pinned" not in next(accuracy.findings(alone, by_turns)).what


@pytest.mark.slow
def test_directions_after_impacts_are_off_as_said():
    """Four hundred balls that hit others at any offset and part of a step: what was struck leaves along the line between them."""
    rng, h, speed, n = np.random.default_rng(3), 3e-3, 4.0, 400
    scene = ts.Scene(dim=2)
    scene.add_material("steel", restitution=1.0)
    aside, start = rng.uniform(-0.95, 0.95, n) * 2 * R, -rng.uniform(3 * R, 4 * R, n)
    at = 10.0 * R * np.stack([np.arange(n) % 20, np.arange(n) // 20], axis=1)
    scene.add_balls(at, radius=R, material="steel")
    scene.add_balls(at + np.stack([start, aside], axis=1), radius=R, velocity=(speed, 0.0), material="steel")
    with simulate(scene, dt=h, substeps=1) as sim:  # in turn: at the moment of touch
        assert all("noticed" not in found.what for found in accuracy.findings(scene, sim.setup))
    with simulate(scene, dt=h, substeps=1, contacts="jacobi") as sim:
        told = said(sim, "impacts")
        assert told.cure
        sim.run(0.05)
        v = sim.velocity
    u = v[n:] - v[:n]
    sine = aside / (2 * R)
    angle = 2.0 * np.arcsin(sine)  # that the relative velocity turns by, from the way back
    exact = np.stack([-np.cos(angle), np.sin(angle)], axis=1) * speed
    off = np.arccos(np.clip(np.sum(u * exact, axis=1) / np.linalg.norm(u, axis=1) / speed, -1.0, 1.0))
    assert np.mean(off) == pytest.approx(figure(told.what, " rad"), rel=0.3)


# Piles ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("method", "contacts"),
    [
        ("verlet", "gauss_seidel"),
        pytest.param("symplectic_euler", "gauss_seidel", marks=LONG),
        pytest.param("verlet", "jacobi", marks=LONG),
    ],
)
@pytest.mark.slow
def test_columns_sink_in_as_said(method, contacts):
    scene = ts.Scene(dim=2, gravity=(0.0, -G))
    scene.add_balls([[0.0, (2 * k + 1) * R] for k in range(10)], radius=R)
    scene.add_wall((0, 1))
    with simulate(scene, integrator=method, contacts=contacts, dt=4e-3, substeps=1) as sim:
        depth = figure(said(sim, "overlap at rest").what, " m, ")
        sim.run(2.0)
        assert sim.contacts().penetration == pytest.approx(depth, rel=0.15)
        assert sim.contacts().unsolved < 2.0 * G * sim.dt


@LONG
def test_a_heap_sinks_in_as_said():
    scene = ts.Scene(dim=2, gravity=(0.0, -G))
    scene.add_balls(heap(), radius=R)
    for normal, offset in (((0, 1), 0.0), ((1, 0), 0.0), ((-1, 0), -21.0 * R)):
        scene.add_wall(normal, offset)
    with simulate(scene, dt=2e-3, substeps=1) as sim:
        depth = figure(said(sim, "overlap at rest").what, " m, ")
        sim.run(2.0)
        now = sim.contacts()
        assert 0.5 * depth < 2.0 * now.mean_penetration < 2.0 * depth  # half of the lowest
        assert now.penetration < 12.0 * depth


def heap():
    """Two hundred places above each other in a box 21 radii wide."""
    k = np.arange(200)
    return (
        2.05 * R * np.stack([k % 10, k // 10], axis=1)
        + 1.02 * R
        + np.random.default_rng(0).uniform(0, 0.02 * R, (200, 2))
    )


@LONG
def test_crowds_lose_what_is_said():
    rng = np.random.default_rng(3)
    scene = ts.Scene(dim=2, gravity=(0.0, -G))
    scene.add_material("default", restitution=1.0)
    grid = 0.2 * np.stack(np.divmod(np.arange(100), 10), axis=1) + 0.1
    scene.add_balls(grid + rng.uniform(-0.04, 0.04, (100, 2)), radius=R, velocity=rng.normal(size=(100, 2)))
    for normal, offset in (((1, 0), 0.0), ((-1, 0), -2.0), ((0, 1), 0.0), ((0, -1), -2.0)):
        scene.add_wall(normal, offset)
    for contacts, verdict in (("jacobi", "wrong"), ("gauss_seidel", "good")):
        with simulate(scene, contacts=contacts, dt=1e-3) as sim:
            told = said(sim, "crowds")
            summary = export(sim, None, fps=20, duration=2.0)
        assert (told is not None) == (contacts == "jacobi")
        lost = (summary.energy_start[3] - summary.energy_end[3]) / summary.scales.motion
        assert 0.25 < lost < 0.75 if told else abs(lost) < 2e-3
        assert f" J: {verdict}" in "\n".join(summary.lines())


# Cloth ------------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_cloth_lets_through_what_is_said_and_shows_what_is_said_of_the_rest():
    """Sheets dropped on posts of a tenth, three and six tenths of the spacing, on blades, and on a sphere."""
    a, r = 1.0 / 15.0, 0.03
    scene = ts.Scene(dim=3, gravity=(0.0, -G, 0.0))
    x, post = [], [(0.1 * a, True), (0.3 * a, True), (0.6 * a, False)]
    blade = [(0.02 * a, True), (0.3 * a, False)]
    ball = 0.25
    for k in range(6):
        sheet = ts.shapes.cloth(scene, size=(7 * a, 7 * a), resolution=(8, 8), radius=r, position=(2.0 * k, 0, 0))
        x.append(sheet.balls)
        middle = np.array([2.0 * k + 3.5 * a, 0.0, 3.5 * a])
        if k < 3:
            scene.add_collider(ts.Capsule(middle - [0, 3, 0], middle - [0, 0.2, 0], post[k][0]))
        elif k < 5:
            scene.add_collider(ts.Box(middle - [0, 0.4, 0], (2 * blade[k - 3][0], 0.5, 1.9)))
        else:
            scene.set_group(sheet.balls, "silk", ["ball"])
            scene.set_balls(sheet.balls, radius=0.002)
            scene.add_collider(ts.Sphere(middle - [0, ball + 0.1, 0], ball, group="ball"))
    scene.set_balls(body=1)  # nothing but colliders to touch
    goes = [through for _, through in (*post, *blade)] + [False]
    found = {int(s.what.split("[")[1].split("]")[0]) for s in sieves.sieves(scene)}
    assert found == set(np.flatnonzero(goes))
    assert {k for k in found if next(s for s in sieves.sieves(scene) if f"[{k}]" in s.what).strain <= 0.0} == {0, 3}
    with pytest.warns(
        UserWarning,
        match=r"colliders\[0\] \(capsule\), 0.013 m across, goes between the balls of cloth_\d: take balls at most",
    ):
        sim = ts.Simulation(scene, arch="cpu")
    with sim:
        sim.run(0.45)
        height = [sim.position[balls, 1] for balls in x]
        free = -0.5 * G * sim.time**2
        for k in range(5):
            held = height[k].max() > -0.2 - a
            assert held != goes[k], (k, height[k].max(), free)
        told = [f for f in accuracy.findings(scene, sim.setup) if "colliders[5]" in f.what]
        depth = figure(told[0].what, " m into")
        corners = sim.position[scene.triangles]
        own = np.isin(scene.triangles, x[5]).all(axis=1)
        longest = np.argmax(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), axis=1)
        n = np.arange(len(corners))
        halfway = 0.5 * (corners[n, longest] + corners[n, longest - 1])[own]
        middle = np.array([10.0 + 3.5 * a, -ball - 0.1, 3.5 * a])
        found = ball - np.linalg.norm(halfway - middle, axis=1).min()
        assert 0.5 * depth < found < 2.0 * depth


def test_small_balls_go_through_cloth_unless_its_surface_collides():
    for solid in (False, True):
        scene = ts.Scene(dim=3)
        ts.shapes.cloth(scene, resolution=(8, 8), radius=0.01, surface_collision=solid)
        ball = scene.add_balls([[0.5, 0.5, 0.5]], radius=0.02)
        found = list(sieves.sieves(scene))
        assert len(found) == (0 if solid else 1)
        if found:
            assert found[0].what == f"ball {ball[0]}"
            assert "surface_collision" in sieves.through(found[0])
    scene.set_group(ball, "dust", [])
    assert not list(sieves.sieves(scene))


@pytest.mark.once
def test_what_may_come_back_goes_with_the_ratio_of_masses():
    for mass in (0.3, 70.0):
        scene = ts.Scene(dim=2, gravity=(0.0, -G))
        scene.add_balls([[0, 0], [1, 0]], radius=0.1, mass=[mass, 4.0 * mass])
        for impacts, part in ((rebounds.IN_TURN, 0.0), (rebounds.AT_ONCE, 0.07), (rebounds.IN_SWEEPS, 0.07)):
            assert rebounds.returned(scene, impacts) == pytest.approx(part)


# While it runs and after ------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_piston_that_squeezes_is_warned_of_and_judged():
    """Three rows of five balls between a wall and a piston: one warning, with the time and how deep."""
    scene = ts.Scene(dim=2, gravity=(0.0, -G))
    scene.add_balls([[0.06 + 0.1 * i, 0.05 + 0.1 * j] for i in range(5) for j in range(3)], radius=R)
    scene.add_wall((0, 1))
    scene.add_wall((1, 0))
    scene.add_collider(ts.Box((0.8, 0.25), (0.5, 0.5), velocity=(-0.2, 0)))
    with simulate(scene, dt=1e-3, substeps=1) as sim, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        sim.run(0.9)
        assert any("overlap by" in str(w.message) for w in caught)  # it looks by itself
        summary = export(sim, None, fps=20, duration=0.1)
        depth = summary.relative_penetration
    deep = [str(w.message) for w in caught if "of the smaller radius" in str(w.message)]
    assert len(deep) == 1
    assert "stop it sooner" in deep[0]
    text = "\n".join(summary.lines())
    assert f"({depth:.2g} of a radius)" in text
    assert " m: wrong; where something that moves squeezes them, stop it sooner; else take shorter steps" in text
    assert "lost" not in text  # a piston works
    assert "at t = 0.9 s ball" in deep[0]


@pytest.mark.once
@pytest.mark.parametrize(
    ("now", "most", "cells", "verdict"),
    [(0, 0, 90, "good"), (0, 4, 90, "good"), (0, 9, 90, "look at it"), (1, 1, 900, "wrong"), (0, 1, 0, "look at it")],
)
def test_few_cells_that_turn_back_are_no_alarm(now, most, cells, verdict):
    assert of_cells(now, most, cells).split(";")[0] == verdict


@pytest.mark.once
@pytest.mark.parametrize("takes", [0.0, 0.1])
@pytest.mark.parametrize("kind", ["springs", "bending", "membranes", "bricks", "solids"])
def test_damping_of_every_element_takes_energy(kind, takes):
    scene = ts.Scene(dim=3)
    scene.add_balls([[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)], radius=0.01)
    solid = {"young_modulus": 1e3, "poisson_ratio": 0.3, "viscosity": takes}
    {
        "springs": lambda: scene.add_springs([[0, 1]], stiffness=1.0, damping=takes),
        "bending": lambda: scene.add_bending(
            [[0, 1, 2, 3]], weights=[[1.0, -1.0, -1.0, 1.0]], stiffness=1.0, damping=takes
        ),
        "membranes": lambda: scene.add_membranes([[0, 1, 2]], warp=1.0, weft=1.0, shear=1.0, damping=takes),
        "bricks": lambda: scene.add_bricks([list(range(8))], **solid),
        "solids": lambda: scene.add_solids([[0, 1, 2, 4]], **solid),
    }[kind]()
    assert takers(scene, touches=False) == (("damping",) if takes else ())


def test_verdicts_go_with_the_scene():
    scales = Scales(slow=0.02, drivers=(), takers=(), motion=10.0, swing=0.0, squeezes=False)
    assert of_approach(0.01, scales, 1.0, 2) == "good"
    assert of_approach(0.1, scales, 1.0, 2) == "look at it; take shorter steps, or more contact_iterations than 2"
    assert of_approach(1.0, scales, 1.0, 2).startswith("wrong")
    assert of_approach(1.0, scales, 100.0, 2) == "good"  # of a fast crowd
    assert [of_depth(part, False).split(";")[0] for part in (0.05, 0.3, 2.5)] == ["good", "look at it", "wrong"]
    assert of_energy(0.0, -0.01, scales).endswith("good")
    assert "look at it" in of_energy(0.0, -0.3, scales)
    assert "nothing in the scene explains it" in of_energy(0.0, 1.0, scales)
    assert of_energy(0.0, 1.0, scales._replace(rounding=2.0)).endswith("good")
    assert of_energy(0.0, 1e-12, scales._replace(motion=1e-12, rounding=1e-11)) == ""
    twice = of_energy(0.0, 1.0, scales._replace(gains=XPBD.why_energy_grows()))
    assert twice.endswith("xpbd goes through the springs twice in a step and leaves them stretched: take shorter steps")
    assert "nothing in the scene takes energy" in of_energy(0.0, -0.3, scales._replace(touches=False))
    lossy = scales._replace(takers=("restitution", "friction", "damping"))
    assert of_energy(0.0, -3.0, lossy) == "3 J of it went into restitution, friction and damping, as expected"
    words = "3 J of it went into damping, or into the own damping of xpbd: shorter steps tell"
    assert of_energy(0.0, -3.0, scales._replace(takers=("damping",), damps="xpbd")) == words
    assert untouched(("damping",)) == ("damping",)
    words = "3 J of it went into damping and contacts that no frame shows, or into the own damping of tr_bdf2: shorter steps tell"
    assert of_energy(0.0, -3.0, scales._replace(takers=untouched(lossy.takers), damps="tr_bdf2")) == words
    words = "3 J of it went into the own damping of xpbd; shorter steps lose less"
    assert of_energy(0.0, -3.0, scales._replace(damps="xpbd")) == words
    driven = of_energy(0.0, 5.0, scales._replace(drivers=("gases", "forces of your own")))
    assert driven.startswith(
        "gases and forces of your own may add or take energy here, so the energy change is no measure"
    )
    assert of_energy(0.0, 0.0, scales._replace(drivers=("motors",))) == ""
    swings = scales._replace(swing=0.25, elastic=0.16)  # of what is elastic at either end: more is no swing
    assert of_energy(0.0, 0.3, swings).endswith("good")
    assert "wrong" in of_energy(0.0, 0.8, swings)
    assert "good" in of_energy(0.0, 0.8, swings._replace(swing_power=0.5))


def silo(**kinds):
    """Discs between two walls, on a floor whose load is read; kinds: of their material."""
    scene = ts.Scene(dim=2, gravity=(0, -G))
    scene.add_material("grain", **kinds)
    scene.add_balls([[0.1 * k, R + 0.11 * row] for row in range(8) for k in range(4)], radius=R, material="grain")
    scene.add_wall((1, 0), -0.06, "grain")
    scene.add_wall((-1, 0), -0.36, "grain")
    scene.add_wall((0, 1), 0.0, "grain")
    return scene


def test_the_load_of_a_silo_is_said_to_be_one_of_many():
    """`check` says so where a probe reads it and friction may hold the balls; a lone floor carries all."""
    setup = accuracy.Setup(VERLET, 1e-3, PRECISION, "gauss_seidel")

    def finding(scene, reads=True):
        if reads:
            scene.add_probe("floor", "force", wall=len(scene.walls) - 1)
        return next((f for f in accuracy.findings(scene, setup) if f.subject == "load"), None)

    told = finding(silo(friction=0.3))
    assert "depends on how they came to rest" in told.what
    assert "let the floor sink" in told.cure
    alone = silo(friction=0.3)
    del alone.walls[:2]
    assert finding(silo(friction=0.3), reads=False) is finding(silo()) is finding(alone) is None


def test_where_nothing_touches_nothing_is_said():
    scene = ts.Scene(dim=2)
    scene.add_balls([[0, 1]], radius=0.1, velocity=[[0, 1]])
    scene.add_wall((0, 1))
    with simulate(scene, dt=1e-3) as sim:
        text = "\n".join(export(sim, None, fps=10, duration=0.1).lines())
        report = "\n".join(check.lines(sim))
    assert "contacts" not in text
    assert "penetration" not in text
    assert "residual" not in text
    for subject in ("bounces", "impacts", "overlap", "cloth"):
        assert subject not in report


@pytest.mark.once
@pytest.mark.parametrize("degrees", [50, 75, 90, 110])
def test_an_edge_comes_through_a_side_whose_balls_touch_its_two_faces(degrees):
    """The deepest of all places in which both balls of a side do so, found by trying."""
    ball, side, half = 0.2, 1.3, np.radians(degrees) / 2
    along, out = np.array([np.sin(half), -np.cos(half)]), np.array([np.cos(half), np.sin(half)])
    reach = np.linspace(0, 2 * side, 1500)
    one = reach[:, None] * along + ball * out
    other = one * (-1, 1)
    a, b = one[:, None], other[None]
    apart = np.linalg.norm(a - b, axis=2)
    run = b - a
    below = np.abs(run[..., 0] * a[..., 1] - run[..., 1] * a[..., 0]) / apart
    below *= np.sign(
        run[..., 0] * a[..., 1] - run[..., 1] * a[..., 0]
    )  # one lies to the right: positive under the edge
    fits = np.abs(apart - side) < 2e-3
    assert sieves.edge_dip(2 * half, ball, side) == pytest.approx(below[fits].max(), rel=0.02)


@pytest.mark.once
def test_check_names_edges_that_come_through_cloth_and_the_radius_that_keeps_them_below():
    def found(**cloth):
        scene = ts.Scene(dim=3, gravity=(0, -9.81, 0))
        scene.add_collider(ts.Box((0, 0.2, 0), (0.3, 0.4, 0.5), name="table"))
        scene.add_collider(ts.Mesh(box_mesh((0.2, 0.3, 0.2), (0.1, 0.15, 0.1)), name="brick"))
        ts.shapes.cloth(scene, size=(1, 1), resolution=(21, 21), surface_collision=True, **cloth)
        return [one for one in sieves.findings(scene) if one[0].startswith("edges")]

    (table, cure), (brick, _) = found()
    assert table == "edges of colliders[0] (table), 90 degrees sharp, come through by up to 0.018 m between its balls"
    assert brick.replace("[1] (brick)", "[0] (table)") == table
    assert cure == "take a radius of 0.025 m, or, with this radius, balls at most 0.025 m apart"
    assert found(radius=0.025) == []


@pytest.mark.once
def test_check_asks_for_no_radius_that_parts_of_the_surface_are_too_near_for():
    """A jelly whose skin has sharp corners, on an edge of 90 degrees. That comes through diagonals of squares of 0.06 m by most:
    0.06 sqrt(2) cos(45 degrees) / 2 keeps it out."""
    scene = ts.Scene(dim=3)
    scene.add_collider(ts.Box((0, 0.2, 0), (0.4, 0.4, 0.4)))
    ts.shapes.jelly(
        scene, size=(0.18, 0.18, 0.18), resolution=(4, 4, 4), position=(0, 0.6, 0), density=200.0, young_modulus=3e4,
        surface_collision=True,
    )  # fmt: skip
    said = accuracy.findings(scene, accuracy.Setup(VERLET, 1e-3, PRECISION, "gauss_seidel"))
    edges = next(one for one in said if one.what.startswith("edges"))
    assert edges.subject == "surface"
    assert edges.cure == (
        "a radius of 0.03 m, which keeps them out, is thicker than its parts are apart; with balls nearer to each other, and"
        " radii in proportion, they come less deep"
    )


def prism(width, height, length, turned=0.0):
    """A wedge with its edge up, turned about that edge's direction [degrees], as a mesh."""
    corners = np.array([(x, y, z) for z in (0, length) for x, y in ((-width / 2, 0), (width / 2, 0), (0, height))])
    c, s = np.cos(np.radians(turned)), np.sin(np.radians(turned))
    hull = [(0, 2, 1), (3, 4, 5), (0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4), (2, 0, 3), (2, 3, 5)]
    return ts.Mesh((corners @ np.array([(c, s, 0), (-s, c, 0), (0, 0, 1)]), hull))


@pytest.mark.once
@pytest.mark.parametrize(
    ("collider", "across", "reach"),
    [
        (prism(0.0003, 0.013, 0.7), 0.0003, 0.013),
        (prism(0.0003, 0.013, 0.7, turned=31), 0.0003, 0.013),
        (ts.Box((0.3, 0.3, 0.3), (0.013, 0.013, 0.7), rotation=(0, 0, 45)), 0.013, 0.013 * np.sqrt(2)),
        (prism(0.06, 0.4, 0.7, turned=200), 0.06, 0.4),
    ],
    ids=["wedge", "leaning wedge", "rod", "hatchet"],
)
def test_no_more_of_a_solid_comes_through_cloth_than_there_is(collider, across, reach):
    """A solid that fits between the balls is said to, and nothing of its edges, whose depth without the solid's end is up to 10 m
    here."""
    scene = ts.Scene(dim=3)
    scene.add_collider(collider)
    ts.shapes.cloth(scene, size=(1, 1), resolution=(14, 14), surface_collision=True)
    span = 0.01, 1.5
    edges = sieves._Edges.of(scene.colliders[0])
    sharp = edges.angle < edges.angle.min() + 1e-6
    assert edges.reach[sharp].min() == pytest.approx(reach, rel=1e-2)
    assert edges.deepest(*span)[0] <= edges.reach.max() < 0.8
    for goes in sieves.sieves(scene):
        assert goes.width == pytest.approx(across, rel=1e-2)
        assert not len(edges.fit(*span).angle)
    told = [what for what, _ in sieves.findings(scene)]
    assert [what.startswith("edges") for what in told] == [across > 0.05]
    if across > 0.05:
        assert 0.1 < figure(told[0], " m between") <= reach


@pytest.mark.once
def test_memory_for_a_fine_collider_below_cloth_grows_as_its_mesh_does():
    """4 times the triangles took 16 times the memory."""
    most = []
    for cuts in (2, 3, 4):  # the first imports
        ball = icosphere(cuts)
        scene = ts.Scene(dim=3)
        scene.add_collider(ts.Mesh((ball.vertices * (0.02, 0.3, 0.5), ball.triangles)))
        ts.shapes.cloth(scene, size=(1, 1), resolution=(7, 7))
        tracemalloc.start()
        (goes,) = sieves.sieves(scene)
        list(sieves.findings(scene))
        most.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert goes.width == pytest.approx(0.04, rel=0.02)
    assert most[2] < 5.0 * most[1]
